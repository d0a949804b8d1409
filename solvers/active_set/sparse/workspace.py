"""Where the sparse kernels keep their numbers: the rows of `workspace`, B and L by pattern.

S (rows, n) and I (rows, n) hold vectors of k or m entries, columns in the order of `Pattern`; what
is remembered from QP to QP (x, members, row_id) is in the order of the QP.  Here membership of F
and of L are marks, one for each column, and not lists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from problems.qp import Vector
from solvers.active_set.sparse.pattern import Pattern
from solvers.active_set.workspace import N_FLOAT_ROWS, N_INT_ROWS, OLD_F, SIZES, F

IN_F, IN_L, WORK = F, OLD_F, SIZES
"""Rows of another meaning than in `workspace`."""
SPREAD, CHANGED, WEIGHT, KEPT_Z, DUAL_LOW, DUAL_HIGH = range(N_FLOAT_ROWS, N_FLOAT_ROWS + 6)
PLACE, KEPT_F = range(N_INT_ROWS, N_INT_ROWS + 2)
LARGEST_SHIFT = 15
"""Rows of S and I for `cholesky`, for `interior` and for `loop.leap`; an entry of row REALS."""


@dataclass(eq=False)
class SparseWorkspace:
    """What one sparse solve hands to the next; updated in place, for other patterns, too.

    pattern : of the QP that was solved
    Bx : (2 k, width) B of that QP, and B of the QP that L was factorized in;  Lx : blocks of L
    S : (rows, n) float64, I : (rows, n) int64
    """

    pattern: Pattern
    Bx: Vector
    Lx: Vector
    S: Vector
    I: NDArray[np.int64]


def make_sparse_workspace(
    m: int, pattern: Pattern, previous: SparseWorkspace | None = None
) -> SparseWorkspace:
    """Room for QPs of this pattern, with what `previous` remembers of x and its members: the same
    where that is large enough, as fresh memory costs more than the pattern."""
    k, width = pattern.Bi.shape
    Bx, Lx, n = np.zeros((2 * k, width)), np.empty(pattern.Lp[-1]), max(m + 1, k, 16)
    old = 0 if previous is None else previous.S.shape[1]
    if previous is not None and n <= old:
        previous.pattern, previous.Bx, previous.Lx = pattern, Bx, Lx
        return previous
    S, I = np.zeros((DUAL_HIGH + 1, n)), np.zeros((KEPT_F + 1, n), dtype=np.int64)
    if previous is not None:
        S[:, :old], I[:, :old] = previous.S, previous.I
    return SparseWorkspace(pattern, Bx, Lx, S, I)
