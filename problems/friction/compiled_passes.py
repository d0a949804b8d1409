"""Passes of corrected friction, compiled: step 2 of algorithm 1, and Newton–Coulomb impulses.

What they are is said in `problems.friction.passes`; the loops that keep their QPs are in
`problems.stepping.velocity` and `problems.friction.newton_coulomb`.
"""

from __future__ import annotations

from math import inf

import numpy as np

import problems.formulas.multistep as multistep
from problems.contacts.active_kernels import friction_bounds
from problems.contacts.geometry_kernels import column_speeds, column_sum, dense_columns
from problems.formulas.multistep import FIRST_RATE
from problems.formulas.step_kernels import momentum, outcome, weighted_norm
from problems.friction.kernels import (
    driven_forces,
    force_change,
    forced_signs,
    small_newton_multipliers,
)
from problems.kernels.arena import numbers, zeros
from problems.kernels.compiled import kernel
from problems.kernels.numba_internals import in_rows, lent, read_only
from problems.least_norm.compiled import least_norm
from problems.least_norm.independence import SAFE_FRACTION, far_from_dependent
from problems.qp import LARGEST
from problems.qp_kernel import WARM, X

iteration_error = kernel(multistep.iteration_error)


@kernel
def qp_room(arena, m, k):
    """A (m, k) of zeros, d (m,), lower and upper (k,) of normals."""
    A, d = in_rows(zeros(arena, m * k), m, k), numbers(arena, m)
    lower, upper = zeros(arena, k), numbers(arena, k)
    for c in range(k):
        upper[c] = inf
    return A, d, lower, upper


@kernel
def cones(frictions):
    """Rows C (2 S, k) with C λ ≥ 0 ⇔ |λ_F| ≤ μ Σ λ_N of what sticks, as `friction.coulomb_rows`."""
    count = frictions.sticking.size
    C = np.zeros((2 * count, frictions.row.size))
    for r in range(C.shape[0]):
        j = frictions.sticking[r % count]
        C[r, frictions.sticking_column[r % count]] = -1.0 if r < count else 1.0
        for i in range(frictions.friction_of.size):
            if frictions.friction_of[i] == j:
                C[r, frictions.normal_column[i]] = frictions.mu[j]
    return C


@kernel
def friction_passes(frictions, step, columns, lam_star, stop, qp, room, found, arena):
    """q̇ and λ by (4.5), (4.6).  How many passes settled, `mode` for the next QP, QPs solved.

    There are 0 passes where they do not settle, or a QP is not solved.

    frictions : `problems.contacts.active_kernels.Frictions`
    step : D, f, b (m,), h and α₀ of (3.1b)
    columns : (entries (·, 6), bodies (·, 2)) of g_N, of the QP as it is laid out, and of g_F
    lam_star : (N,) of the first pass
    stop : passes at most; the change of ‖q̇‖_M that another may make; ε₀ of a QP; whether it is the
        next pass that counts, and not all further ones by (3.14)
    qp : A, and room for d, lower and upper, see `qp_room`
    room : solve, S, I, eps0 and mode, see `problems.qp_kernel`
    found : v, a, lam_N, lam_F and bound, written to
    arena : see `problems.kernels.arena`
    """
    # tuples are lent, and arrays handed on one by one: else it is counted each time who holds them
    frictions, columns = lent(frictions), lent(columns)
    normals, (entries, pairs), tangents = columns
    g_F, rubbing = tangents
    D, forces, b, h, alpha0 = lent(step)
    signs, sticking = frictions.signs, frictions.sticking
    friction_of, mu = frictions.friction_of, frictions.mu
    A, d, lower, upper = lent(qp)
    solve, S, I, eps0, mode = lent(room)
    v, a, lam_N, lam_F, bound = lent(found)
    lam_star, arena = lent(lam_star), lent(arena)
    most, tolerance, rounding, next_only = stop
    m, k, N, F = D.size, frictions.row.size, lam_N.size, lam_F.size
    inverse_mass, force = numbers(arena, m), numbers(arena, m)
    for i in range(m):
        inverse_mass[i], force[i] = 1 / D[i] ** 2, forces[i]
    change_before, solves = inf, 0
    redundant = F > 0 and not far_from_dependent(A, SAFE_FRACTION, arena)
    C = cones(frictions) if redundant and most > 1 else np.zeros((0, k))
    used, used_integers = arena.used[0], arena.used[1]
    for number in range(1, most + 1):
        arena.used[0], arena.used[1] = used, used_integers
        if F > 0:
            bound[:] = friction_bounds(friction_of, mu, lam_star, arena)
            lam_F[:] = driven_forces(signs, bound, arena)
            driven = column_sum(g_F, rubbing, lam_F, m, arena)
            for i in range(m):
                force[i] = forces[i] + driven[i]
            for j in range(sticking.size):
                c = frictions.sticking_column[j]
                lower[c], upper[c] = -bound[sticking[j]], bound[sticking[j]]
        if not momentum(b, force, D, h, LARGEST, d)[1]:
            return 0, mode, solves
        if k > 0:  # (3.2), (4.6)
            solved = solve(
                *(read_only(A), read_only(d), read_only(lower), read_only(upper)),
                *(read_only(frictions.row_id), S, I, eps0, mode),
            )
            mode |= WARM
            solves += 1
            if not solved:
                return 0, mode, solves
        x = S[X, :k]
        outcome(entries, pairs, x, b, d, D, h, alpha0, v, a)
        if redundant:
            x, more = least_norm(A, lower, upper, x, C, arena, solve, mode)
            solves += more
        for j in range(N):
            lam_N[j] = x[frictions.normal_column[j]]
        for j in range(sticking.size):
            lam_F[sticking[j]] = x[frictions.sticking_column[j]]
        if most == 1:
            return number, mode, solves
        new_bound = friction_bounds(friction_of, mu, lam_N, arena)
        moved = force_change(signs, lam_F, bound, new_bound, arena)
        off = column_sum(g_F, rubbing, moved, m, arena)
        for i in range(m):
            off[i] *= inverse_mass[i]
        change = h / alpha0 * weighted_norm(D, off)
        rate = change / change_before if number > 1 and change_before > 0.0 else FIRST_RATE
        if next_only:
            left = change
        else:  # (3.14)
            left = iteration_error(rate, 0.0, change, h / alpha0 * rounding) if rate < 1.0 else inf
        if left <= tolerance:
            return number, mode, solves
        change_before = change
        slip = column_speeds(g_F, rubbing, v, arena)
        sigma = forced_signs(signs, lam_F, bound, slip, arena)
        lam_star = small_newton_multipliers(
            *(normals, tangents, inverse_mass, friction_of, mu),
            *(signs, sigma, lam_star, lam_N, False),
        )
    return 0, mode, solves


@kernel
def impulse_passes(collision, most, tolerance, arena, solve, S, I, accuracy, mode):
    """Whether a collision settled; q̇₊ (m,), Λ_N (N,), Λ_F (F,) and the QPs solved.

    collision : `problems.friction.collision.Collision`;  the others: see `friction_passes`
    """
    frictions, D, v, F, columns, layout, tangents = collision
    count, m = columns[1].shape[0], D.size
    after, a, lam_N = np.empty(m), np.empty(m), np.zeros(count)
    lam_F, bound = np.zeros(frictions.mu.size), np.zeros(frictions.mu.size)
    qp = qp_room(arena, m, frictions.row.size)
    dense_columns(*layout, D, qp[0])
    passes, _, solves = friction_passes(
        frictions,
        (D, F, v, 1.0, 1.0),
        (columns, layout, tangents),
        np.full(count, inf),
        (most, tolerance, accuracy, True),
        qp,
        (solve, S, I, accuracy, mode),
        (after, a, lam_N, lam_F, bound),
        arena,
    )
    return passes > 0, after, lam_N, lam_F, solves
