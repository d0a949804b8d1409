"""Where algorithm 2 begins: columns of length 1, a feasible x, and the free set F with its R.

1. A and x are scaled, A x = B z with b_j = a_j/‖a_j‖ and z_j = ‖a_j‖ x_j, so that every z_j is a
   force, every Δ_j = b_jᵀ r a velocity times mass, and one tolerance serves them all.
2. z begins at the previous x, row by row; what was at a bound is put on today's bound.  Cold, it
   begins at the feasible point nearest to 0.
3. F begins as the previous F.  Its old R loses the columns of rows that are gone or fixed, by
   Givens rotations, and gains today's columns of rows that are new.  Cold, F is a maximal set of
   independent columns of A (algorithm 2, step 1).

Rows that are neither free nor at a bound are the passive set P; they need no list of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.qp import AT_LOWER, AT_UPPER, FREE, ContactQP, Vector
from solvers.base import Start
from tests.solvers.numpy_twin.factorization import (
    Factorization,
    Positions,
    qr_delete,
    qr_insert,
)
from tests.solvers.numpy_twin.tally import Tally


class ScaledQP(NamedTuple):
    """minimise ½‖B z + d‖², lower ≤ z ≤ upper, with columns of B of length 1 (or 0).

    B : (m, k) Fortran order          d : (m,)
    lengths : (k,) ‖a_j‖, 1 for a zero column; z = lengths · x
    lower, upper : (k,) bounds on z
    movable : (k,) bool, lower < upper
    eps0 : accuracy asked in ‖A δx‖ (3.13)
    exact : work with Q and R of today's columns throughout
    """

    B: Vector
    d: Vector
    lengths: Vector
    lower: Vector
    upper: Vector
    movable: NDArray[np.bool_]
    eps0: float
    exact: bool


def scale_qp(qp: ContactQP, asked: float | None, exact: bool) -> ScaledQP:
    """Scale the columns of A to length 1.

    Asked for nothing, eps0 is 1e-9 · max_j |b_jᵀ d|, which is at most 1e-9 of the part of d that
    contact forces can change.
    """
    A = qp.dense_A
    lengths = np.sqrt(np.einsum("ij,ij->j", A, A))
    lengths[lengths == 0.0] = 1.0
    B = np.asfortranarray(A / lengths)
    if asked is None:
        asked = 1e-9 * float(np.abs(qp.d @ B).max(initial=0.0))
    lower, upper = lengths * qp.lower, lengths * qp.upper
    return ScaledQP(B, qp.d, lengths, lower, upper, qp.lower < qp.upper, asked, exact)


def initial_point(problem: ScaledQP, start: Start | None) -> Vector:
    """Feasible z from the previous x, with members of X on today's bounds; (k,)."""
    if start is None:
        return np.clip(np.zeros(problem.lengths.size), problem.lower, problem.upper)
    z = np.clip(problem.lengths * start.x, problem.lower, problem.upper)
    for member, bound in ((AT_LOWER, problem.lower), (AT_UPPER, problem.upper)):
        held = (start.working_set == member) & np.isfinite(bound)
        z[held] = bound[held]
    return z


def carry_factorization(
    problem: ScaledQP, start: Start, free: Positions, tally: Tally, oldest: float
) -> Factorization | None:
    """The old R on today's free columns, or None where there is none or it no longer fits.

    free : positions of the rows that shall be free
    oldest : age in QPs from which R is given up
    Columns found dependent today are left out, so that their rows are passive.
    """
    old = start.memory
    if not isinstance(old, Factorization) or old.age >= oldest:
        return None
    today = np.full(old_size(start, old), -1, dtype=np.intp)
    known = np.flatnonzero(start.previous >= 0)
    today[start.previous[known]] = known
    columns = today[old.columns]
    wanted = np.zeros(problem.lengths.size + 1, dtype=bool)
    wanted[free] = True
    # −1, a row that is gone, reads the last entry, which is False
    gone = np.flatnonzero(~wanted[columns])
    R = Factorization(columns, old.R, None, old.inverse_norm, old.age)
    if gone.size:
        R, flops = qr_delete(R, gone)
        tally.qr_updates += int(gone.size)
        tally.flops += flops
    wanted[columns] = False
    for j in np.flatnonzero(wanted[:-1]):
        try:
            grown, iterations, flops = qr_insert(R, problem.B, int(j), 2 * R.order + 20)
        except ArithmeticError:
            return None
        tally.cg_iterations += iterations
        tally.qr_updates += 1
        tally.flops += flops
        R = R if grown is None else grown
    return R


def old_size(start: Start, old: Factorization) -> int:
    """Rows of the QP that the old factorization belongs to, as far as they matter."""
    return 1 + max(int(start.previous.max(initial=-1)), int(old.columns.max(initial=-1)))


def free_rows(problem: ScaledQP, start: Start | None) -> Positions:
    """Rows that shall be free: the previous F and rows that are new; cold, all that can move."""
    free = problem.movable
    if start is not None:
        free = free & (start.working_set == FREE)
    return np.flatnonzero(free)
