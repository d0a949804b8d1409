"""The least multipliers (4.8) from an old decomposition, by conjugate gradients.

Lötstedt 1984, §4.2: where A lacks full column rank, the multipliers λ* of (4.6) are replaced by

    minimise ½ λᵀλ   subject to   A λ = A λ* = b,   lower ≤ λ ≤ upper                      (4.8)

The paper takes Q₂, a basis of N(A), from a QR decomposition of Aᵀ at every step, λ = λ_R + Q₂ z,
and solves for z; `problems.least_norm.minimum_norm` does.  It names, without telling it, "a method,
where old decompositions are utilized to accelerate a conjugate gradient procedure" (its [32]).  The
one here is our own reading of that sentence.  It needs neither Q nor Q₂:

1. The optimum is λ = clip(Aᵀ y, lower, upper) with y such that A λ = b: these are the conditions
   λ − Aᵀ y = s with s ≥ 0 at a lower bound, ≤ 0 at an upper one and 0 between.
2. With the set X of multipliers at a bound known, the others are λ_F = A_Fᵀ y, where
   A_F A_Fᵀ y = b − A_X λ_X.  Without X, that is the projection λ_R = A⁺ b onto R(Aᵀ).
3. The pivoted QR decomposition of an old Aᵀ, of rank r, names r independent rows I of A and gives
   R with A_Iᵀ R⁻¹ orthonormal, then.  y is sought on I alone, by conjugate gradients on

       R⁻ᵀ A_IF A_IFᵀ R⁻¹ w = R⁻ᵀ b_I,   y_I = R⁻¹ w,   λ_F = A_IFᵀ y_I

   With today's R and X empty the matrix is I: one iteration.  A multiplier in X, or a row that has
   come or gone since, changes the matrix by rank 1, and costs an iteration or so.
4. X is guessed from the last QP; what leaves its bounds, or is pushed back inside, changes it, and
   3 is repeated, at most `ROUNDS` times.

R belongs to the coordinates of the bodies and not to the contacts: it outlives a contact.  Nor need
the rank be known.  λ = clip(A_Iᵀ y) with A λ = b satisfies 1 whatever R, I and the rank are, so a
product with the rows outside I proves the answer.  Where the rank has risen, A λ = b fails and A is
decomposed anew; where it has fallen, A_I A_Iᵀ is singular but consistent, and λ is still unique.

Work is counted by `solvers.active_set.flops`, A dense.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from problems.least_norm.independence import RANK_TOL
from problems.qp import Indices, Vector
from solvers.active_set.flops import cg_iteration_flops

ACCURACY = 1e-10
"""Accuracy asked of λ, relative to ‖λ‖."""
ROUNDS = 10
"""Sets X that are tried."""
SLACK = 1e-8
"""A multiplier within this fraction of the largest from its bound stays where it is."""
CONSISTENT = 1e-7
"""‖A λ − b‖ above this fraction of ‖A‖ ‖λ‖ (and 10 times the accuracy asked) refutes an answer."""

Members = NDArray[np.int8]
"""−1 at the lower bound, 0 between, +1 at the upper bound."""


class Decomposition(NamedTuple):
    """What is kept of the pivoted QR decomposition of Aᵀ: R (r, r) and the rows I of A, (r,)."""

    R: Vector
    rows: Indices


class LeastNorm(NamedTuple):
    """An answer, or why there is none.

    lam : (k,);  members : of X;  refused : "" or "iterations", "rank", "set"
    iterations : of conjugate gradients, over all rounds;  flops : counted
    """

    lam: Vector
    members: Members
    refused: str
    rounds: int
    iterations: int
    flops: int


def decompose(A: Vector) -> Decomposition:
    """R and the independent rows of A (m, k), by the pivoted QR decomposition of Aᵀ."""
    R, pivots = sla.qr(A.T, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int((diagonal > RANK_TOL * diagonal[0]).sum()) if diagonal.size else 0
    return Decomposition(np.ascontiguousarray(R[:rank, :rank]), pivots[:rank].astype(np.int64))


def project(
    rows: Vector, R: Vector, b: Vector, accuracy: float = ACCURACY
) -> tuple[Vector, Vector, int]:
    """The least λ = Cᵀ y with C λ = b by conjugate gradients, R as preconditioner (step 3).

    rows : (r, f) C;  R : (r, r);  b : (r,)

    Stops at ‖R⁻ᵀ(b − C λ)‖ ≤ accuracy ‖R⁻ᵀ b‖; with today's R the left side is ‖δλ‖.  Returns λ
    (f,), y (r,) and the iterations made: −1 − iterations if they did not converge.
    """
    lam, y, remainder = np.zeros(rows.shape[1]), np.zeros(b.size), b
    search, gamma, first = np.zeros(b.size), 1.0, 0.0
    for iterations in range(b.size + 11):
        gradient = sla.solve_triangular(R, remainder, trans="T")
        before, gamma = gamma, float(gradient @ gradient)
        if iterations == 0:
            first = gamma
        if gamma <= accuracy**2 * first:
            return lam, y, iterations
        search = gradient + (gamma / before if iterations else 0.0) * search
        step = sla.solve_triangular(R, search)
        change = rows.T @ step
        curvature = float(change @ change)
        if curvature == 0.0:
            return lam, y, -1 - iterations
        alpha = gamma / curvature
        y, lam = y + alpha * step, lam + alpha * change
        remainder = b - rows @ lam
    return lam, y, -1 - iterations


def least_norm(
    A: Vector,
    b: Vector,
    lower: Vector,
    upper: Vector,
    kept: Decomposition,
    guess: Members | None = None,
    accuracy: float = ACCURACY,
) -> LeastNorm:
    """Solve (4.8) with an old decomposition, steps 2 to 4 above.

    A : (m, k);  b : (m,) A λ*;  lower, upper : (k,);  guess : (k,) of the set X, None: empty
    """
    (m, k), r = A.shape, kept.rows.size
    independent = A[kept.rows]
    members = np.zeros(k, np.int8) if guess is None else guess.astype(np.int8)
    members[~np.isfinite(np.where(members < 0, lower, upper)) & (members != 0)] = 0
    size = float(np.linalg.norm(A))
    lam, refused, rounds, iterations, flops = np.zeros(k), "set", 0, 0, 0
    while rounds < ROUNDS:
        rounds += 1
        free = members == 0
        f = int(free.sum())
        lam = np.where(members < 0, lower, np.where(members > 0, upper, 0.0))
        wanted = b - A[:, ~free] @ lam[~free]
        lam[free], y, made = project(independent[:, free], kept.R, wanted[kept.rows], accuracy)
        count = made if made >= 0 else -1 - made
        iterations += count
        # the iterations, the right side, the rows outside I, and what pushes on those in X
        flops += count * cg_iteration_flops(f, r) + r * r
        flops += 2 * m * (k - f) + 2 * (m - r) * k + 2 * r * (k - f)
        if made < 0:
            refused = "iterations"
            break
        push = independent.T @ y
        slack = SLACK * float(np.abs(lam).max(initial=0.0))
        below = push < lower + np.where(members < 0, slack, -slack)
        above = push > upper - np.where(members > 0, slack, -slack)
        # where both bounds are one, either side will do
        found = np.where(above, 1, np.where(below, -1, 0)).astype(np.int8)
        if (found == members).all():
            miss = float(np.linalg.norm(A @ lam - b))
            limit = max(CONSISTENT, 10 * accuracy) * size * float(np.linalg.norm(lam))
            refused = "rank" if miss > limit else ""
            break
        members = found
    return LeastNorm(np.clip(lam, lower, upper), members, refused, rounds, iterations, flops)
