"""What can be said of a QP before anyone solves it: rank, scale, and the accuracies asked of it.

`scale` = ‖A A⁺ d‖ is the part of d that contact forces can change.  ‖d‖ itself flatters: it holds
the whole momentum over h and is 10 to 40,000 times larger in moving scenes.  Where the contacts
can change nothing (A A⁺ d is rounding of d), the scale is ‖d‖, and 1 if that is 0 as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems.qp import ContactQP, Vector

RANK_TOL = 1e-10
"""A singular value counts towards the rank if it exceeds this fraction of the largest."""
NOISE = 1e-12
"""‖A A⁺ d‖ below this fraction of ‖d‖ is rounding."""
ASKED_RELATIVE = {"high": 1e-9, "default": 1e-6}
"""Settings that ask for a fraction of `scale`; `paper` asks for each QP's own eps0."""
SETTINGS = ("paper", *ASKED_RELATIVE)


@dataclass(frozen=True, eq=False)
class Facts:
    """Rank and scale of one QP, and A once more in extended precision for the error bound.

    rank : singular values above `RANK_TOL` of the largest
    scale : ‖A A⁺ d‖, unit of `glambda_error`
    A, d : in `numpy.longdouble`, which holds float64 exactly
    norms : (k,) lengths of the columns, 1 for a column of zeros
    unit_columns : A with columns of length 1, so that rank is not a matter of units
    """

    qp: ContactQP
    rank: int
    scale: float
    A: np.ndarray
    d: np.ndarray
    norms: Vector
    unit_columns: Vector

    def asked(self, setting: str) -> float:
        """Accuracy in ‖A δx‖ that a setting asks for, or that `default` is judged by.

        Raises ValueError for an unknown setting.
        """
        if setting == "paper":
            return self.qp.eps0
        if setting not in ASKED_RELATIVE:
            raise ValueError(f"setting {setting!r} is unknown; choose from {', '.join(SETTINGS)}")
        return ASKED_RELATIVE[setting] * self.scale


def facts_of(qp: ContactQP) -> Facts:
    """Rank and scale of `qp` by singular value decomposition."""
    A = qp.dense_A
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    unit_columns = A / norms
    basis, sigma, _ = np.linalg.svd(unit_columns, full_matrices=False)
    size = float(np.linalg.norm(qp.d))
    scale = float(np.linalg.norm(basis[:, : _rank(sigma)].T @ qp.d))
    if scale <= NOISE * size or scale == 0.0:
        scale = size or 1.0
    return Facts(
        qp=qp,
        rank=_rank(np.linalg.svd(A, compute_uv=False)),
        scale=scale,
        A=A.astype(np.longdouble),
        d=qp.d.astype(np.longdouble),
        norms=norms,
        unit_columns=unit_columns,
    )


def _rank(sigma: np.ndarray) -> int:
    return int((sigma > RANK_TOL * sigma[0]).sum()) if sigma.size else 0
