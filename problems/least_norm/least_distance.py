"""The least-distance problem of minimum-norm multipliers (4.8), stage by stage, compiled.

    minimise ½ zᵀz   subject to   E z ≥ e;       λ = λ_R + ‖λ‖ Q₂ z

`problems.least_norm.minimum_norm` says what it is.  Its QP is posed by `non_negative_form` and read
by `least_distance_point`; in between it is solved by whoever is asked: `least_norm` has a compiled
method, `minimum_norm` any solver.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from problems.kernels.arena import integers, numbers, table
from problems.kernels.compiled import kernel
from problems.kernels.numba_internals import in_rows, read_only
from problems.least_norm.independence import ACCURACY, RANK_TOL
from problems.least_norm.sparse_minimum_norm import SAME_FORCE
from problems.qp import Indices, Vector
from problems.qp_kernel import N_FLOAT_ROWS, N_INT_ROWS, WARM, X, method_at, room_size


class LeastDistance(NamedTuple):
    """(4.8) of k multipliers, c of them movable, l dimensions of N(A).

    x : (k,) within its bounds;  movable : (c,) those that are not fixed
    basis : (l, c) Q₂ᵀ;  particular : (c,) λ_R;  size : ‖λ‖ of the movable, 0 where λ stays as it is
    E, e : (p, l), (p,) rows of the bounds, `bounds` of them, then those of Coulomb
    """

    x: Vector
    movable: Indices
    basis: Vector
    particular: Vector
    size: float
    E: Vector
    e: Vector
    bounds: int


@kernel
def null_space(A):
    """Orthonormal basis (k − rank, k), in its rows, of the null space of A (m, k), which is spoilt.

    By Householder's QR decomposition of Aᵀ with column pivoting, as far as there is rank.
    """
    m, k = A.shape
    reflection, scale = np.zeros((min(m, k), k)), np.zeros(min(m, k))
    rank, first = 0, 0.0
    for c in range(min(m, k)):
        pivot, most = c, -1.0
        for j in range(c, m):
            square = 0.0
            for i in range(c, k):
                square += A[j, i] * A[j, i]
            if square > most:
                pivot, most = j, square
        length = sqrt(most)
        if c == 0:
            first = length
        if not length > RANK_TOL * first:
            break
        for i in range(k):
            A[c, i], A[pivot, i] = A[pivot, i], A[c, i]
        v = reflection[c]
        v[c:] = A[c, c:]
        v[c] += length if v[c] >= 0.0 else -length
        square = 0.0
        for i in range(c, k):
            square += v[i] * v[i]
        scale[c] = 2.0 / square
        for j in range(c + 1, m):
            product = 0.0
            for i in range(c, k):
                product += v[i] * A[j, i]
            product *= scale[c]
            for i in range(c, k):
                A[j, i] -= product * v[i]
        rank += 1
    basis = np.zeros((k - rank, k))
    for row in range(k - rank):
        basis[row, rank + row] = 1.0
        for c in range(rank - 1, -1, -1):
            product = 0.0
            for i in range(c, k):
                product += reflection[c, i] * basis[row, i]
            product *= scale[c]
            for i in range(c, k):
                basis[row, i] -= product * reflection[c, i]
    return basis


@kernel
def least_distance(A, lower, upper, x, C):
    """`LeastDistance` of a λ = x (k,) and A (m, k) within its bounds, with C λ ≥ 0, C (p, k)."""
    m, k = A.shape
    movable = np.flatnonzero(lower < upper)  # fixed rows would be two opposite inequalities
    count = movable.size
    x = np.minimum(np.maximum(x, lower), upper)
    moving, at = np.empty((m, count)), np.empty(count)
    for c in range(count):
        at[c] = x[movable[c]]
        for i in range(m):
            moving[i, c] = A[i, movable[c]]
    basis = null_space(moving)
    l = basis.shape[0]
    size = sqrt((at * at).sum()) if l > 0 else 0.0
    particular = at.copy()
    for row in range(l):
        product = (basis[row] * at).sum()
        for c in range(count):
            particular[c] -= product * basis[row, c]
    E, e = np.empty((2 * count + C.shape[0], l)), np.empty(2 * count + C.shape[0])
    bounds = 0
    for c in range(count):
        if lower[movable[c]] > -inf:
            E[bounds], e[bounds] = basis[:, c], lower[movable[c]] - particular[c]
            bounds += 1
    for c in range(count):
        if upper[movable[c]] < inf:
            E[bounds], e[bounds] = -basis[:, c], particular[c] - upper[movable[c]]
            bounds += 1
    rows = bounds + C.shape[0]
    for r in range(C.shape[0]):
        E[bounds + r] = 0.0
        e[bounds + r] = 0.0
        for j in range(k):
            if not lower[j] < upper[j]:
                e[bounds + r] -= C[r, j] * x[j]
        for c in range(count):
            weight = C[r, movable[c]]
            if weight != 0.0:
                e[bounds + r] -= weight * particular[c]
                for i in range(l):
                    E[bounds + r, i] += weight * basis[i, c]
    if size > 0.0:
        e /= size
    return LeastDistance(x, movable, basis, particular, size, E[:rows], e[:rows], bounds)


@kernel
def non_negative_form(E, e, arena=None):
    """A (l + 1, a) and d of the non-negative least-squares form of: min ‖z‖, E z ≥ e.

    Also the a rows of E (p, l) that it has, those that are more than rounding.  None of them is
    there where z = 0 meets them all.
    """
    p, l = E.shape
    acts, count, met = integers(arena, p), 0, True
    for row in range(p):
        if np.abs(E[row]).max() > RANK_TOL:
            acts[count] = row
            count += 1
            met &= e[row] <= 0.0
    if met:
        count = 0
    A, d = table(arena, l + 1, count), numbers(arena, l + 1)
    for c in range(count):
        for i in range(l):
            A[i, c] = E[acts[c], i]
        A[l, c] = e[acts[c]]
    for i in range(l):
        d[i] = 0.0
    d[l] = -1.0
    return A, d, acts[:count]


@kernel
def least_distance_point(A, x):
    """z (l,) from the answer x of the form above, and whether E z ≥ e has a solution."""
    l = A.shape[0] - 1
    z, last = np.zeros(l), -1.0
    for c in range(x.size):
        for i in range(l):
            z[i] += A[i, c] * x[c]
        last += A[l, c] * x[c]
    for i in range(l):
        z[i] /= -last
    return z, last < -RANK_TOL


@kernel
def of_least_norm(problem, A, lower, upper, z):
    """λ (k,) of a z; x where its A λ is another, as z is where there is almost no room for it."""
    x, movable, basis, particular, size = problem[:5]
    least = x.copy()
    for c in range(movable.size):
        value = particular[c]
        for i in range(z.size):
            value += size * z[i] * basis[i, c]
        j = movable[c]
        least[j] = min(max(value, lower[j]), upper[j])
    moved, force = 0.0, 0.0
    for i in range(A.shape[0]):
        change, own = 0.0, 0.0
        for j in range(x.size):
            change += A[i, j] * (least[j] - x[j])
            own += A[i, j] * x[j]
        moved += change * change
        force += own * own
    return least if sqrt(moved) <= SAME_FORCE * sqrt(force) else x


@kernel
def solved_point(E, e, arena, solve, mode):
    """z (l,) of least norm with E z ≥ e, whether there is one, and QPs solved for it.

    arena : see `problems.kernels.arena`;  solve, mode : see `problems.qp_kernel`
    """
    A, d, acts = non_negative_form(E, e, arena)
    count, n = acts.size, room_size(d.size, acts.size)
    if count == 0:
        return np.zeros(E.shape[1]), True, 0
    lower, upper = numbers(arena, count), numbers(arena, count)
    for c in range(count):
        lower[c], upper[c] = 0.0, inf
    S = table(arena, N_FLOAT_ROWS + 3 * n, n)
    I = in_rows(integers(arena, N_INT_ROWS * n), N_INT_ROWS, n)
    method_at(solve)(
        *(read_only(A), read_only(d), read_only(lower), read_only(upper)),
        *(read_only(acts), S, I, ACCURACY, mode & ~WARM),
    )
    z, found = least_distance_point(read_only(A), read_only(S[X, :count]))
    return z, found, 1


@kernel
def least_norm(A, lower, upper, x, C, arena, solve, mode):
    """λ (k,) of least norm with the A λ of x within the bounds and C λ ≥ 0, and QPs solved for it.

    C : (p, k), left out where it cannot be met;  the others: see `solved_point`
    """
    problem = least_distance(A, lower, upper, x, C)
    if problem.size == 0.0:
        return problem.x, 0
    E, e, bounds = problem.E, problem.e, problem.bounds
    z, found, solves = solved_point(E, e, arena, solve, mode)
    if not found and e.size > bounds:
        z, found, more = solved_point(E[:bounds], e[:bounds], arena, solve, mode)
        solves += more
    if not found:
        return problem.x, solves
    return of_least_norm(problem, A, lower, upper, z), solves
