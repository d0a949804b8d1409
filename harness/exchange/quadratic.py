"""Convex QPs of others, min ½ xᵀP x + qᵀx, low ≤ C x ≤ high, lower ≤ x ≤ upper, with bounds only.

Without C the QP is ours already, by the factors of P (`harness.exchange.factors`).  With it, P must
be definite, P = RᵀR, and the unknowns become the multipliers y of all its rows, bounds among them:
with z = R x + R⁻ᵀq the problem is min ½‖z‖², F z ≥ p, where F holds a row of C or of the identity
times R⁻¹, y ≥ 0 for a row with one bound and y free for an equality.

1. *velocity form*, as (3.4) is that of (3.2): where F z₀ = p has a solution, A = Fᵀ, d = −z₀.  Then
   z = A y.
2. *least distance* (Lawson and Hanson 1974, chapter 23) otherwise: A = [Fᵀ; pᵀ/s], d = −e_{n+1},
   with a power of two s, the `unit`, which makes p as large as F.  Then z = −s r₁…ₙ/r_{n+1},
   r = A y + d; r = 0 says that no x meets the rows.

Both are exact: their answers are the multipliers of the problem, up to a factor in 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from harness.exchange.factors import factor
from harness.exchange.foreign import Foreign, bounds, endless, in_order, matrix, vector
from problems.qp import ContactQP, Indices, Matrix, Vector

EXACT = 1e-12
"""‖F z₀ − p‖/‖p‖ up to which F z₀ = p has a solution."""


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """min ½‖A x − b‖², lower ≤ x ≤ upper: ours, with d = −b."""

    A: Matrix
    b: Vector
    lower: Vector
    upper: Vector
    row_id: Indices | None = None

    @classmethod
    def of(cls, A: Any, b: Any, lb: Any = None, ub: Any = None, ids: Any = None) -> LeastSquares:
        """Of foreign arrays.  Raises Foreign, naming the field."""
        A = matrix("A", A)
        m, k = A.shape
        numbers = None if ids is None else vector("row_id", ids, k)
        if numbers is not None and np.unique(numbers.astype(np.int64)).size != k:
            raise Foreign("row_id: holds a number twice")
        return cls(A, vector("b", b, m), *bounds(lb, ub, k),
                   None if numbers is None else numbers.astype(np.int64))  # fmt: skip

    def qps(self, tolerance: float) -> tuple[list[ContactQP], dict[str, Any]]:
        """The one QP, and what is to be said of it."""
        qp = ContactQP(self.A, -self.b, self.lower, self.upper, row_id=self.row_id)
        return [qp], {"import.form": "as given"}


@dataclass(frozen=True, eq=False)
class Quadratic:
    """P (n, n), q (n,), C (c, n), low, high (c,), lower, upper (n,)."""

    P: Matrix
    q: Vector
    C: Matrix
    low: Vector
    high: Vector
    lower: Vector
    upper: Vector

    @classmethod
    def of(
        cls, P: Any, q: Any, rows: list[tuple[str, Any, Any, Any]], lb: Any = None, ub: Any = None
    ) -> Quadratic:
        """Of foreign arrays.

        rows : general constraints, each (name, C, low, high) with None for no bound

        A row of C with one entry is a bound on that x, and one of zeros is none.

        Raises Foreign, naming the field.
        """
        q = vector("q", q)
        P = matrix("P", P, (q.size, q.size))
        lower, upper = bounds(lb, ub, q.size)
        Cs, lows, highs = [sp.csr_array((0, q.size))], [np.zeros(0)], [np.zeros(0)]
        for name, C, low, high in rows:
            C = sp.csr_array(matrix(name, C, (None, q.size)))
            count = C.shape[0]
            l_, u_ = (
                np.full(count, side) if value is None else vector(label, value, count, bound=True)
                for label, value, side in ((f"{name}'s lower bound", low, -np.inf),
                                           (f"{name}'s upper bound", high, np.inf))
            )  # fmt: skip
            in_order(f"{name}'s lower bound", l_, "the upper", u_)
            Cs.append(C)
            lows.append(l_)
            highs.append(u_)
        C = sp.csr_array(sp.vstack(Cs))
        C.eliminate_zeros()
        low, high = np.concatenate(lows), np.concatenate(highs)
        single = np.diff(C.indptr) == 1
        for i in np.flatnonzero(single).tolist():
            j, a = int(C.indices[C.indptr[i]]), float(C.data[C.indptr[i]])
            ends = sorted((low[i] / a, high[i] / a))
            lower[j], upper[j] = max(lower[j], ends[0]), min(upper[j], ends[1])
        lower, upper = endless(lower), endless(upper)
        in_order("lb", lower, "ub, rows of one entry among them,", upper)
        empty = np.diff(C.indptr) == 0
        for i in np.flatnonzero(empty & ((low > 0) | (high < 0)))[:1]:
            raise Foreign(f"rows: number {i} is 0, and its bounds {low[i]:g} and {high[i]:g} are "
                          "on one side of that: no x meets it")  # fmt: skip
        kept = np.flatnonzero(~single & ~empty & (np.isfinite(low) | np.isfinite(high)))
        return cls(P, q, sp.csc_array(C[kept]), low[kept], high[kept], lower, upper)

    def qps(self, tolerance: float) -> tuple[list[ContactQP], dict[str, Any]]:
        """The one QP, and what is to be said of it.

        Raises Foreign where P is not convex, or rows need a definite P and it is not.
        """
        made = factor(self.P, self.q, tolerance)
        if not self.C.shape[0]:
            qp = ContactQP(made.A, made.d, self.lower, self.upper)
            return [qp], {"import.form": "factored", **made.notes()}
        n = self.q.size
        if made.rank < n:
            raise Foreign(
                f"P: has rank {made.rank} of {n} beside {self.C.shape[0]} general constraints; a "
                "problem with bounds only is known for a definite P, or without such rows: drop "
                "them, or add a small multiple of the identity"
            )
        F, p, equal, ids = self._rows(made.A, made.d)
        lower = np.where(equal, -np.inf, 0.0)
        start = _solved(F, p)
        residual = float(np.linalg.norm(F @ start - p)) / (float(np.linalg.norm(p)) or 1.0)
        unit = 1.0
        if residual <= EXACT:
            A, d, form = F.T, -start, "velocity form"
        else:
            unit = 2.0 ** int(np.frexp(np.linalg.norm(p) / (_size(F) or 1.0))[1])
            scaled = p / unit
            A = sp.vstack([F.T, scaled[None]]) if sp.issparse(F) else np.vstack([F.T, scaled])
            d, form = np.r_[np.zeros(n), -1.0], "least distance"
        if sp.issparse(A):
            A = sp.csc_array(A)
        qp = ContactQP(A, d, lower, np.full(p.size, np.inf), row_id=ids)
        return [qp], {
            "import.form": form,
            "import.residual": residual,
            "import.unit": unit,
            **made.notes(),
        }

    def _rows(self, R: Matrix, g: Vector) -> tuple[Matrix, Vector, np.ndarray, Indices]:
        """F, p, which rows are equalities, and ids: 2 i for a lower side, 2 i + 1 for an upper."""
        n = self.q.size
        E = sp.csr_array(sp.vstack([self.C, sp.eye_array(n)]))
        low, high = np.r_[self.low, self.lower], np.r_[self.high, self.upper]
        equal = low == high
        below = np.flatnonzero(np.isfinite(low))
        above = np.flatnonzero(np.isfinite(high) & ~equal)
        signed = sp.vstack([E[below], -E[above]], format="csr")
        p = np.r_[low[below], -high[above]]
        F = _over(signed, R)
        ids = np.r_[2 * below, 2 * above + 1]
        return F, p + F @ g, np.r_[equal[below], np.zeros(above.size, bool)], ids


def _over(E: sp.csr_array, R: Matrix) -> Matrix:
    """E R⁻¹."""
    if sp.issparse(R):  # diagonal, and the order of its rows is that of x
        return sp.csr_array(E / R.diagonal()[None])
    return np.ascontiguousarray(la.solve(R.T, E.T.toarray()).T)


def _solved(F: Matrix, p: Vector) -> Vector:
    """The least z with F z nearest to p."""
    if sp.issparse(F):
        return np.asarray(spla.lsqr(F, p, atol=1e-15, btol=1e-15, iter_lim=20 * F.shape[1])[0])
    return np.asarray(np.linalg.lstsq(F, p, rcond=None)[0])


def _size(F: Matrix) -> float:
    return float(sp.linalg.norm(F) if sp.issparse(F) else np.linalg.norm(F))
