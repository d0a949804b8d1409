"""The QR factorization of the free columns, A_F = Q R, of algorithm 2.

The columns are given at length 1 (see `start`), so that "dependent" has one meaning for all of
them: a column is dependent when its distance ρ from the span of the others is of the size of
rounding.  Functions return new factorizations and modify nothing.

    qr_factorize            pivoted Householder (Businger and Golub 1965), step 1
    karasalo_rank           how many of its columns are independent (Karasalo 1974)
    inverse_norm_estimate   ‖R⁻¹‖ for (3.20) and ε₁ (Cline, Moler, Stewart and Wilkinson 1979)
    qr_insert               append a column, step 8 (Gill, Golub, Murray and Saunders 1974)
    qr_delete               remove columns, step 6 (the same)

Q is kept where the factorization is used within one QP (the exact mode, for impulses).  A
factorization that outlives its QP is R alone, a preconditioner for tomorrow's A_F; it is updated
the same way, by Givens rotations and by today's columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dnrm2
from scipy.linalg.lapack import dgeqp3, dorgqr

from problems.qp import Vector
from solvers.active_set.flops import (
    cg_iteration_flops,
    delete_flops,
    insert_flops,
)
from tests.solvers.numpy_twin.conjugate_gradients import conjugate_gradients, solve_R
from tests.solvers.numpy_twin.tally import delete_many_flops

Positions = NDArray[np.intp]

UNIT_ROUNDOFF = 0.5 * float(np.finfo(np.float64).eps)
BLOCK = 32
"""Columns per block that LAPACK is given room for."""


@dataclass(frozen=True, eq=False)
class Factorization:
    """Upper triangular R of A_F = Q R, with the columns that it stands for.

    columns : (f,) positions of the columns in A, in the order of R
    R : (f, f) upper triangular, Fortran order
    Q : (m, f) with orthonormal columns, or None where it was not kept
    inverse_norm : estimate of ‖R⁻¹‖₂; 1 for f = 0, as for a single column
    age : QPs since the factorization was computed; 0 for one of today's A
    """

    columns: Positions
    R: Vector
    Q: Vector | None
    inverse_norm: float = 1.0
    age: int = 0

    @property
    def order(self) -> int:
        """Number f of free columns."""
        return int(self.columns.size)


def empty_factorization(m: int, keep_Q: bool) -> Factorization:
    """Of no columns at all."""
    nothing = np.zeros(0, dtype=np.intp)
    return Factorization(nothing, np.zeros((0, 0), order="F"), np.zeros((m, 0)) if keep_Q else None)


def dependence_tolerance(m: int) -> float:
    """Distance ρ of a unit column from the span of others that is rounding: 16 u √m."""
    return 16 * UNIT_ROUNDOFF * sqrt(max(m, 1))


def qr_factorize(A: Vector, columns: Positions, keep_Q: bool) -> Factorization:
    """Factorize a maximal set of independent columns among `columns` (step 1).

    A : (m, k) with columns of length 1; not modified
    columns : positions in A; the factorization holds those found independent, in pivot order
    keep_Q : form Q

    Householder reflections with the column of the greatest remaining length next (Businger and
    Golub 1965; LAPACK's dgeqp3), cut at the rank that `karasalo_rank` finds.
    """
    m, f = A.shape[0], int(columns.size)
    if f == 0 or m == 0:
        return empty_factorization(m, keep_Q)
    packed, pivots, tau, _, _ = dgeqp3(A[:, columns], lwork=2 * f + (f + 1) * BLOCK)
    n = min(m, f)
    R = np.triu(packed[:n, :n])
    rank = karasalo_rank(R, dependence_tolerance(m))
    if rank == 0:
        return empty_factorization(m, keep_Q)
    R = np.asfortranarray(R[:rank, :rank])
    Q = None
    if keep_Q:
        Q = dorgqr(packed[:, :rank], tau[:rank], lwork=rank * BLOCK)[0]
    return Factorization(columns[pivots[:rank] - 1], R, Q, inverse_norm_estimate(R))


def karasalo_rank(R: Vector, tolerance: float) -> int:
    """Order of the largest leading block of R with σ_min > `tolerance`.

    R : (n, n) upper triangular from a QR factorization with column pivoting; not modified

    1. Pivoting makes |r_jj| fall, and |r_jj| ≤ tolerance leaves a remainder of rounding size: the
       rank is at most the number r of larger pivots.
    2. Karasalo 1974 bounds σ_min of the leading block of order r from below, see
       `karasalo_bound`.  Above the tolerance it proves the rank.
    3. The bound can be too small by 2^(r−1).  Where it proves nothing, `inverse_norm_estimate`
       decides: r is lowered until 1/‖R⁻¹‖ > tolerance.

    This differs from the paper: step 3 is ours, since with hundreds of columns the bound alone
    would cut sound ones.
    """
    rank = int(np.count_nonzero(np.abs(np.diagonal(R)) > tolerance))
    while rank > 0:
        block = R[:rank, :rank]
        if karasalo_bound(block) > tolerance or inverse_norm_estimate(block) * tolerance < 1.0:
            break
        rank -= 1
    return rank


def karasalo_bound(R: Vector) -> float:
    """Lower bound 1/‖W(R)⁻¹‖_F ≤ σ_min(R), for a non-singular R (f, f), f > 0 (Karasalo 1974).

    W has the diagonal |r_ii| and −b_i, b_i = max_{j>i} |r_ij|, in the rest of row i, so that
    |R⁻¹| ≤ W⁻¹ entry by entry (Higham 2002, theorem 8.12).  By backward recursion over the rows,
    with S_i the sum of squares of the column sums of W⁻¹ below row i − 1,

        S_i = 1/r_ii² + (1 + b_i/|r_ii|)² S_{i+1},   ‖W⁻¹‖_F² = Σ 1/r_ii² + (b_i/|r_ii|)² S_{i+1}.
    """
    diagonal = np.abs(np.diagonal(R))
    largest = np.abs(np.triu(R, 1)).max(axis=1)
    ratios, inverses = (largest / diagonal).tolist(), (1.0 / diagonal).tolist()
    sums = total = 0.0
    for ratio, inverse in zip(reversed(ratios), reversed(inverses), strict=True):
        total += inverse * inverse + ratio * ratio * sums
        sums = inverse * inverse + (1.0 + ratio) ** 2 * sums
    return 1.0 / sqrt(total)


def inverse_norm_estimate(R: Vector) -> float:
    """Estimate ‖R⁻¹‖₂ from below for a non-singular upper triangular R (f, f), f > 0.

    Cline, Moler, Stewart and Wilkinson 1979:

    1. solve Rᵀ y = e, choosing each e_i = ±1 so that |y_i| and the sums that it leaves for the
       later unknowns grow most;
    2. solve R z = y; the estimate is ‖z‖/‖y‖.

    y is rich in the left singular vector of σ_min.  Over random R of order 8 to 200 the estimate is
    in the median 1.1, at worst 3.5 times too small.
    """
    f = R.shape[0]
    y, sums, diagonal = np.empty(f), np.zeros(f), np.diagonal(R).tolist()
    for i, pivot in enumerate(diagonal):
        sign = -1.0 if sums[i] > 0 else 1.0
        greedy = (sign - sums[i]) / pivot
        other = (-sign - sums[i]) / pivot
        row = R[i, i + 1 :]
        later = sums[i + 1 :]
        left_greedy, left_other = later + row * greedy, later + row * other
        if abs(greedy) + np.abs(left_greedy).sum() >= abs(other) + np.abs(left_other).sum():
            y[i], sums[i + 1 :] = greedy, left_greedy
        else:
            y[i], sums[i + 1 :] = other, left_other
    # dnrm2 scales, so that a nearly singular R does not overflow
    return float(dnrm2(solve_R(R, y / dnrm2(y))))


def qr_insert(
    factorization: Factorization, A: Vector, j: int, limit: float
) -> tuple[Factorization | None, int, int]:
    """Append column j of A to the factorization (step 8).

    A : (m, k) today's columns of length 1; not modified
    limit : conjugate gradient iterations allowed in all, where Q was not kept

    Returns the new factorization, or None where a_j depends on the free columns; the iterations
    made; and the operations spent.  The new column of R is (u; ρ) with

        u = Qᵀ a_j,     ρ = ‖a_j − Q u‖,

    by Gram-Schmidt, repeated until the remainder no longer shrinks.  Where R is yesterday's and Q
    is not kept, w minimises ‖a_j − A_F w‖ by conjugate gradients, u = R w and ρ is the remainder.
    Then A_F R⁻¹ gains a column of length 1 orthogonal to today's A_F: R is as good as before.

    a_j is dependent when ρ is no larger than the rounding in A_F w, tolerance × (1 + ‖w‖).
    Raises ArithmeticError when the limit was not enough: R is too old, factorize anew.
    """
    a, R, Q, f = A[:, j], factorization.R, factorization.Q, factorization.order
    u, w, s, iterations = np.zeros(f), np.zeros(f), a, 0
    rho = sqrt(a @ a)
    A_F, m = A[:, factorization.columns], a.size

    def spent(iterations: int) -> int:
        return insert_flops(m, f, Q is not None) + iterations * cg_iteration_flops(m, f)

    for _ in range(4 if f else 0):
        if Q is not None:
            step = Q.T @ s
            s = s - Q @ step
            u += step
            w = solve_R(R, u)
        else:
            aim = 0.1 * rho / factorization.inverse_norm
            found = conjugate_gradients(A_F, R, s, aim, limit - iterations)
            iterations += found.iterations
            if not found.converged:
                raise ArithmeticError("R is too old to insert a column")
            s = found.s
            w -= found.p
        before, rho = rho, sqrt(s @ s)
        if rho > 0.5 * before:
            break
        if rho <= dependence_tolerance(m) * (1.0 + sqrt(w @ w)):
            return None, iterations, spent(iterations)
    if rho == 0.0:
        return None, iterations, 0
    grown = np.zeros((f + 1, f + 1), order="F")
    grown[:f, :f] = R
    grown[:f, f] = u if Q is not None else R @ w
    grown[f, f] = rho
    return (
        replace(
            factorization,
            columns=np.append(factorization.columns, j),
            R=grown,
            Q=None if Q is None else np.column_stack([Q, s / rho]),
            # the last column of the new R⁻¹ is (−w; 1)/ρ
            inverse_norm=sqrt(factorization.inverse_norm**2 + (1.0 + w @ w) / rho**2)
            if f
            else 1.0 / rho,
        ),
        iterations,
        spent(iterations),
    )


def qr_delete(factorization: Factorization, positions: Positions) -> tuple[Factorization, int]:
    """Remove the columns at `positions` (in the order of R) from the factorization (step 6).

    One by one by Givens rotations; many at once by a Householder QR of the block that they leave
    right of and below the first of them, where that takes fewer operations.  Returns the new
    factorization and the operations spent.  ‖R⁻¹‖ can only fall; its estimate is kept as a bound.
    """
    Q, f = factorization.Q, factorization.order
    m, first, n = 0 if Q is None else Q.shape[0], int(positions.min()), int(positions.size)
    down = np.sort(positions)[::-1]
    one_by_one = sum(delete_flops(m, f - i, int(down[i]), Q is not None) for i in range(n))
    at_once = delete_many_flops(m, f, first, n, Q is not None)
    if n > 1 and at_once < one_by_one:
        R, Q = _householder_delete(factorization.R, Q, positions)
    else:
        R = factorization.R
        for i in down:
            R, Q = _givens_delete(R, Q, int(i))
    columns = np.delete(factorization.columns, positions)
    if columns.size == 0:
        return replace(factorization, columns=columns, R=R, Q=Q, inverse_norm=1.0), one_by_one
    return replace(factorization, columns=columns, R=R, Q=Q), min(at_once, one_by_one)


def _givens_delete(R: Vector, Q: Vector | None, i: int) -> tuple[Vector, Vector | None]:
    """R and Q without column i: rotations chase the subdiagonal that it leaves."""
    R = np.asfortranarray(np.delete(R, i, axis=1))
    Q = None if Q is None else Q.copy()
    for l in range(i, R.shape[1]):
        length = hypot(R[l, l], R[l + 1, l])
        c, s = R[l, l] / length, R[l + 1, l] / length
        G = np.array([[c, s], [-s, c]])
        R[l : l + 2, l:] = G @ R[l : l + 2, l:]
        R[l + 1, l] = 0.0
        if Q is not None:
            Q[:, l : l + 2] = Q[:, l : l + 2] @ G.T
    return np.asfortranarray(R[:-1]), None if Q is None else Q[:, :-1]


def _householder_delete(
    R: Vector, Q: Vector | None, positions: Positions
) -> tuple[Vector, Vector | None]:
    """R and Q without several columns: QR of the block right of and below the first of them."""
    first = int(positions.min())
    keep = np.delete(np.arange(R.shape[0]), positions)
    staircase = R[first:, keep[first:]]
    n = keep.size
    smaller = np.zeros((n, n), order="F")
    smaller[:first] = R[:first, keep]
    if Q is None:
        smaller[first:, first:] = np.linalg.qr(staircase, mode="r")
        return smaller, None
    turn, smaller[first:, first:] = np.linalg.qr(staircase)
    return smaller, np.hstack([Q[:, :first], Q[:, first:] @ turn])
