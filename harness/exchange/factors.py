"""½ xᵀP x + qᵀx as ½‖A x + d‖² but for a constant: what the two have in common, and what is lost.

1. P must be symmetric; what it lacks of it is measured, and above a tolerance P is refused.
2. P = V Λ Vᵀ.  A negative eigenvalue beyond the tolerance is refused: the problem is not convex.
   Those up to rounding, and up to the size of the most negative one, are 0.
3. A = Λ^½ Vᵀ (rank, n), d = Λ^−½ Vᵀ q.  The part of q outside the range of P has no counterpart:
   measured, and refused above the tolerance, since x would go along it without end or to a bound.

Of a diagonal P all of this is exact but for square roots, at any size.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from harness.exchange.foreign import Foreign
from problems.qp import Matrix, Vector

TOLERANCE = 1e-9
"""Relative size of what may be lost, if nothing is said."""
DENSE_LIMIT = 4000
"""Largest order of a P that is not diagonal."""


class Factor(NamedTuple):
    """A (rank, n), d (rank,);  asymmetry : ‖P − Pᵀ‖/‖P‖;  least : the most negative eigenvalue
    over the largest, or 0;
    lost : ‖q − Aᵀd‖/‖q‖"""

    A: Matrix
    d: Vector
    rank: int
    asymmetry: float
    least: float
    lost: float

    def notes(self) -> dict[str, float]:
        """What a recording is told of it."""
        return {
            f"import.{name}": getattr(self, name) for name in ("rank", "asymmetry", "least", "lost")
        }


def factor(P: Matrix, q: Vector, tolerance: float = TOLERANCE, name: str = "P") -> Factor:
    """A and d of P (n, n) and q (n,).

    Raises Foreign, with the figure, for a P that is not symmetric or not semidefinite, or a q that
    is not in its range, by more than the tolerance.
    """
    n = q.size
    size = _norm(P)
    asymmetry = _norm(P - P.T) / size if size > 0 else 0.0
    _refuse(name, "is not symmetric", f"‖{name} − {name}ᵀ‖/‖{name}‖", asymmetry, tolerance)
    diagonal = _diagonal(P)
    if diagonal is not None:
        values, vectors = diagonal, None
    elif n > DENSE_LIMIT:
        raise Foreign(f"{name}: has order {n}, and is factored up to {DENSE_LIMIT} unless diagonal")
    else:
        dense = _dense(P)
        values, vectors = np.linalg.eigh(0.5 * (dense + dense.T))
    largest = float(np.abs(values).max(initial=0.0))
    least = float(values.min(initial=0.0)) / largest if largest > 0 else 0.0
    _refuse(name, "is not positive semidefinite", "−λ_min/λ_max", -least, tolerance)
    rounding = 0.0 if vectors is None else 8 * n * float(np.finfo(float).eps)
    noise = max(rounding, -least)
    kept = np.flatnonzero(values > noise * largest)
    roots = np.sqrt(values[kept])
    if vectors is None:
        A: Matrix = sp.csc_array((roots, (np.arange(kept.size), kept)), shape=(kept.size, n))
        A = A if sp.issparse(P) else _dense(A)
        d = q[kept] / roots
    else:
        A = roots[:, None] * vectors[:, kept].T
        d = (vectors[:, kept].T @ q) / roots
    lost = _share(q - A.T @ d, q)
    _refuse("q", f"is not in the range of {name}", "‖q − Aᵀd‖/‖q‖", lost, tolerance)
    return Factor(A, d, int(kept.size), asymmetry, least, lost)


def _refuse(name: str, what: str, figure: str, value: float, tolerance: float) -> None:
    if value > tolerance:
        raise Foreign(
            f"{name}: {what}: {figure} = {value:.1e}, more than {tolerance:.1e}; mend the data, or "
            f"give --tolerance {2 * value:.0e} to have it dropped"
        )


def _dense(P: Any) -> Vector:
    return np.asarray(P.toarray() if sp.issparse(P) else P)


def _norm(M: Matrix) -> float:
    return float(sp.linalg.norm(M) if sp.issparse(M) else np.linalg.norm(M))


def _share(part: Vector, whole: Vector) -> float:
    size = float(np.linalg.norm(whole))
    return float(np.linalg.norm(part)) / size if size > 0 else 0.0


def _diagonal(P: Matrix) -> Vector | None:
    """The diagonal of P, if there is nothing else."""
    values = np.asarray(P.diagonal())
    count = sp.coo_array(P).count_nonzero()
    return values if count == np.count_nonzero(values) else None
