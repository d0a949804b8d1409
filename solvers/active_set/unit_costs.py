"""C_QR and C_IT of one QP, counted in operations: of a factorization of A_F and of an iteration.

Algorithm 2 has two paths here, and each counts its own:

    dense    by the sizes m and f of A_F (`solvers.active_set.flops`)
    sparse   a factorization by what the sparse Cholesky kernel did, which depends on where the
             entries of A_F stand; an iteration by the entries of A_F and L

The estimate of ‖R⁻¹‖, which comes with every factorization, is left out, as in the paper.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.qp import ContactQP
from solvers.active_set.flops import cg_iteration_flops, qr_flops
from solvers.active_set.method import is_small_or_full
from solvers.active_set.sparse.cholesky import cholesky
from solvers.active_set.sparse.direction import iteration_flops
from solvers.active_set.sparse.loop import lay_out_sparse
from solvers.active_set.sparse.pattern import Pattern, is_narrow
from solvers.active_set.sparse.workspace import IN_L, SparseWorkspace, make_sparse_workspace
from solvers.active_set.tolerances import FIRST_SHIFT
from solvers.active_set.workspace import FACTORIZATION_FLOPS, REALS


class UnitCosts(NamedTuple):
    """What is counted of one QP.

    m, f : rows and columns of A_F;  C_QR, C_IT [flops];  sparse : which path they are of
    """

    m: int
    f: int
    C_QR: float
    C_IT: float
    sparse: bool


def goes_sparse(qp: ContactQP) -> bool:
    """Whether algorithm 2 takes its sparse path."""
    return not is_small_or_full(qp.A) and is_narrow(qp.A)


def dense_costs(m: int, f: int) -> UnitCosts:
    """By the sizes of A_F; in Python, for two numbers that are not worth compiling."""
    C_QR, C_IT = qr_flops.py_func(m, f), cg_iteration_flops.py_func(m, f)
    return UnitCosts(m, f, float(C_QR), float(C_IT), False)


def sparse_costs(qp: ContactQP, free: NDArray[np.bool_], pattern: Pattern) -> UnitCosts:
    """By factorizing the free columns (k,) of A; `pattern` is that of A."""
    room = make_sparse_workspace(qp.m, pattern)
    lay_out_sparse(pattern, qp.A.data, qp.d, qp.lower, qp.upper, room.Bx, room.S, qp.m)
    room.I[IN_L, : qp.k] = free[pattern.order]
    flops = cholesky(pattern, room.Bx, room.S, room.I, room.Lx, FIRST_SHIFT)
    f = int(np.count_nonzero(free))
    return UnitCosts(qp.m, f, float(flops), _iteration(pattern, f, qp.m), True)


def costs_counted(memory: Any, m: int, f: int) -> UnitCosts:
    """By what a solve left in its memory, with f free columns of A (m, k)."""
    if not isinstance(memory, SparseWorkspace):
        return dense_costs(m, f)
    C_QR = float(memory.S[REALS, FACTORIZATION_FLOPS])
    return UnitCosts(m, f, C_QR, _iteration(memory.pattern, f, m), True)


def _iteration(pattern: Pattern, f: int, m: int) -> float:
    return float(iteration_flops(pattern, f, m, False))
