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
from solvers.active_set.sparse_pattern import Pattern
from solvers.active_set.workspace import N_FLOAT_ROWS, N_INT_ROWS, OLD_F, SIZES, F

IN_F, IN_L, WORK = F, OLD_F, SIZES
"""Rows of another meaning than in `workspace`."""
LINK, NEXT, PLACE, BEGUN = range(N_INT_ROWS, N_INT_ROWS + 4)
"""Rows of I for `cholesky`."""


@dataclass(frozen=True, eq=False)
class SparseWorkspace:
    """What one sparse solve hands to the next; updated in place.

    pattern : of the QP that was solved, with Bx (nnz of B,) and Lx (nnz of L,)
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
    """Room for QPs of this pattern, with what `previous` remembers of x and its members."""
    n = max(m, pattern.order.size, 16, 0 if previous is None else previous.S.shape[1])
    made = SparseWorkspace(
        pattern,
        np.empty(pattern.Bi.size),
        np.empty(pattern.Li.size),
        np.zeros((N_FLOAT_ROWS, n)),
        np.zeros((BEGUN + 1, n), dtype=np.int64),
    )
    if previous is not None:
        old = previous.S.shape[1]
        made.S[:, :old] = previous.S
        made.I[:, :old] = previous.I
    return made
