"""Steps of algorithm 1 in which nothing happens, many in one compiled call.

Between events a step is always the same: AB-r, columns, one QP, BDF-r, the length of the next.
Taken one by one from Python each costs a hundred times what its arithmetic does.  Here they are
taken until something calls for the stepper (`problems.quiet`): a corner that crosses an edge or
leaves one, a contact that separates, a scheduled time, bodies that are still, a QP that is not
solved, redundant contacts with friction, friction that wants another pass, slips or stops, or
whose gain is 1 or more (`problems.gain`).
"""

from __future__ import annotations

from math import hypot, inf, sqrt

import numpy as np

import problems.multistep as multistep
from problems.contact_kernels import (
    clearances,
    column_speeds,
    contact_columns,
    own_gains,
    place_corners,
)
from problems.dips import ARRIVAL, MAX_HALVINGS, first_dip, floor_of
from problems.multistep import FIRST_RATE, REDONE, SHORTEST_STEP
from problems.quiet import (
    A_BEFORE,
    AT_BOUND,
    CONTACT_TOL,
    CORRECTED,
    DROP_TOL,
    END_SLACK,
    EPS,
    FIXED,
    FORGET,
    H_MAX,
    HIGHEST,
    KNOWN,
    OPEN,
    REACH,
    REJECTED,
    REST_SPEED,
    ROUNDING,
    SAFE_FRACTION,
    SOLVES,
    STALE,
    STEPS,
    TAKEN,
    TIME,
    UNTIL,
    V_BEFORE,
    WISH,
    A,
    H,
    Q,
    V,
)
from problems.step_kernels import farthest_way, largest_motion, weighted_norm
from solvers.active_set.compiled import kernel
from solvers.active_set.loop import SOLVED, WARM, algorithm_2
from solvers.active_set.workspace import COUNTS, STATUS, X

second_order_bdf = kernel(multistep.second_order_bdf)
first_order_step = kernel(multistep.first_order_step)
second_order_step = kernel(multistep.second_order_step)
second_order_error = kernel(multistep.second_order_error)
next_length = kernel(multistep.next_length)
first_redone_length = kernel(multistep.first_redone_length)
redone_length = kernel(multistep.redone_length)
iteration_error = kernel(multistep.iteration_error)


@kernel
def step_length(state, reals, steps, order, D):
    """As `Stepper._step_length`."""
    if reals[FIXED] > 0.0:
        return reals[FIXED]
    allowed = inf
    if steps > 0 and order == 1:
        allowed = first_order_step(weighted_norm(D, state[A]), reals[EPS])
    elif steps > 0:
        jerk = weighted_norm(D, state[A] - state[A_BEFORE]) / reals[H]
        allowed = second_order_step(jerk, reals[H], reals[EPS])
    return next_length(reals[WISH], steps, allowed, reals[H_MAX])


@kernel
def rejected_length(state, reals, steps, order, redone, a, h, D):
    """As `Stepper._rejected_length` of a step whose passes have settled."""
    if reals[FIXED] > 0.0 or h <= 100 * SHORTEST_STEP:
        return inf
    if steps == 0:
        return first_redone_length(h, first_order_step(weighted_norm(D, a), reals[EPS]))
    if order == 1 or redone >= REDONE:
        return inf
    error = second_order_error(weighted_norm(D, a - state[A]), h, reals[H])
    return redone_length(h, error, reals[EPS])


@kernel
def covered(i, corner, part, corner_part, place, corners, tolerance):
    """Whether an active point of the same two parts coincides with candidate i."""
    own, other = corner_part[corner[i]], part[i]
    x, y = corners[corner[i], 0], corners[corner[i], 1]
    for j in range(place.shape[0]):
        one, two = corner_part[place[j, 0]], place[j, 1]
        if (one == own and two == other) or (one == other and two == own):
            c = place[j, 0]
            if hypot(corners[c, 0] - x, corners[c, 1] - y) <= tolerance:
                return True
    return False


@kernel
def friction_bounds(friction_of, mu, lam_N, bound):
    """bound := μ Σ λ_N of each friction (F,)."""
    bound[:] = 0.0
    for i in range(friction_of.size):
        if friction_of[i] >= 0:
            bound[friction_of[i]] += lam_N[i]
    for j in range(mu.size):
        bound[j] *= mu[j]


@kernel
def surely_independent(A, fraction):
    """Whether AᵀA − τ²I has Cholesky factors, see `problems.minimum_norm.surely_independent`."""
    m, k = A.shape
    if k > m:
        return False
    L, trace = np.empty((k, k)), 0.0
    for i in range(k):
        for j in range(i + 1):
            total = 0.0
            for e in range(m):
                total += A[e, i] * A[e, j]
            L[i, j] = total
        trace += L[i, i]
    for i in range(k):
        for j in range(i + 1):
            value = L[i, j] - (fraction**2 * trace if i == j else 0.0)
            for e in range(j):
                value -= L[i, e] * L[j, e]
            if i > j:
                L[i, j] = value / L[j, j]
            elif value > 0.0:
                L[i, i] = sqrt(value)
            else:
                return False
    return True


@kernel
def fill(columns, order, g_N, g_F, first, sticking, bodies, D):
    """A = D⁻ᵀ[G_N, G_F] in the order of the QP's columns; `columns` holds zeros or the last A."""
    N = g_N.shape[0]
    for c in range(order.size):
        normal = order[c] < N
        j = order[c] if normal else first[sticking[order[c] - N]]
        for side in range(2):
            b = bodies[j, side]
            if b >= 0:
                for e in range(3):
                    entry = g_N[j, 3 * side + e] if normal else g_F[j, 3 * side + e]
                    columns[3 * b + e, c] = entry / D[3 * b + e]


@kernel
def settled(run, lam_N, lam_F, bound, new_bound, g_F, bodies, weight, force):
    """Whether another pass would not change q̇ by more than (3.14) allows; `force` is scratch.

    False also where a sticking contact is at its bound, because it may begin to slide.
    """
    eps = run.reals[EPS]
    for j in range(run.mu.size):
        stuck = abs(lam_F[j])
        if run.signs[j] == 0.0 and stuck >= bound[j] * (1 - run.reals[AT_BOUND]):
            return False
    if not run.counts[CORRECTED]:
        return True
    friction_bounds(run.friction_of, run.mu, lam_N, new_bound)
    force[:] = 0.0
    for j in range(run.mu.size):
        moved = run.signs[j] * (new_bound[j] - bound[j])
        if run.signs[j] == 0.0:
            moved = min(0.0, new_bound[j] - abs(lam_F[j])) * (-1.0 if lam_F[j] < 0.0 else 1.0)
        for side in range(2):
            b = bodies[run.first[j], side]
            if b >= 0:
                for e in range(3):
                    force[3 * b + e] += g_F[run.first[j], 3 * side + e] * moved
    total = 0.0
    for i in range(force.size):
        total += (force[i] / run.D[i]) ** 2
    return iteration_error(FIRST_RATE, weight * sqrt(total), weight * run.eps0) <= 0.1 * eps


@kernel
def quiet_steps(run, written, posed, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `counts[TAKEN]` of them.

    run : `problems.quiet.QuietSteps`, whose arrays are updated
    written : zeros (3n, k), (3n,), (k,), (k,) for A, d and the bounds of the QP
    posed : the same memory, read only
    S, I, eps0, mode : see `algorithm_2`
    """
    shapes, D, f, place, first = run.shapes, run.D, run.forces, run.place, run.first
    corner, part, level = run.corner, run.part, run.level
    state, reals, counts = run.state, run.reals, run.counts
    edges = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    A_written, d, lower, upper = written
    A_posed, d_posed, lower_posed, upper_posed = posed
    m, k, N, F = D.size, run.order.size, place.shape[0], run.mu.size
    q, v, a, r = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    bend, before = np.empty(m), np.empty(corner.size)
    phis = np.empty((MAX_HALVINGS + 2, shapes.edge_offset.shape[1]))
    right, left = np.empty(MAX_HALVINGS + 2), np.empty(shapes.edge_offset.shape[1])
    slip, slides, inverse_mass = np.zeros(F), run.signs.any(), 1 / D**2
    lam_N, lam_F, bound, new_bound = np.zeros(N), np.zeros(F), np.zeros(F), np.zeros(F)
    q[:] = state[Q]
    v[:] = state[V]
    pose = place_corners(q, shapes.corner_body, shapes.corner_local)
    before[:] = clearances(*pose, corner, part, *edges)
    if F > 0:
        _, _, g_F, bodies, _, _, _, _ = contact_columns(
            *pose, place, shapes.corner_body, *edges, shapes.edge_start, shapes.edge_length
        )
        speed = column_speeds(g_F, bodies, v)
        for j in range(F):
            slip[j] = speed[first[j]]
            if run.signs[j] * slip[j] > 0.0:
                return
    spring = F > 0 and not (counts[CORRECTED] and len(run.sticking) == F)
    longest, redone = inf, 0
    while counts[TAKEN] < run.gaps.size:
        steps = counts[STEPS]
        order = 1 if steps < 2 else counts[HIGHEST]
        h = step_length(state, reals, steps, order, D)
        h = wish = min(h, longest)
        if spring and counts[KNOWN] == 0:
            return
        if reals[TIME] + h >= reals[UNTIL]:
            h = reals[UNTIL] - reals[TIME]
            if not counts[OPEN] or h <= SHORTEST_STEP:
                return
        for i in range(m):  # (3.1a)
            bend[i] = (state[V, i] - state[V_BEFORE, i]) / (2 * reals[H]) if order == 2 else 0.0
            q[i] = state[Q, i] + h * (state[V, i] + h * bend[i])
        if not largest_motion(run.listed_at, q, shapes.radius) <= reals[REACH]:
            counts[STALE] = min(counts[TAKEN], 1)
            return
        pose = place_corners(q, shapes.corner_body, shapes.corner_local)
        after = clearances(*pose, corner, part, *edges)
        reach = 2.0 * farthest_way(state[V], bend, h, shapes.radius) + ARRIVAL
        for i in range(corner.size):
            gap, c, p = after[i] - level[i], corner[i], part[i]
            if gap > reach:  # two points cannot meet and part as far again
                continue
            enters = gap < min(0.0, before[i] - level[i]) - reals[ROUNDING] or (
                first_dip(
                    *(state[Q], state[V], bend, h, shapes.corner_body[c], shapes.part_body[p]),
                    *(shapes.corner_local[c], shapes.edge_normal[p], shapes.edge_offset[p]),
                    *(floor_of(before[i], level[i]), phis, right, left),
                )[1]
                <= h
            )
            if enters and not covered(
                i, corner, part, shapes.corner_part, place, pose[0], reals[CONTACT_TOL]
            ):
                return
        phi, g_N, g_F, bodies, _, along, length, _ = contact_columns(
            *pose, place, shapes.corner_body, *edges, shapes.edge_start, shapes.edge_length
        )
        for j in range(N):
            slack = reals[END_SLACK] * length[j]
            if along[j] < -slack or along[j] > length[j] + slack:
                return
        w = h / reals[H] if reals[H] > 0.0 else 1.0
        alpha0, newest, oldest = second_order_bdf(w) if order == 2 else (1.0, 1.0, 0.0)
        for i in range(m):  # (3.1b)
            a[i] = newest * state[V, i] - oldest * state[V_BEFORE, i]
            r[i] = f[i]
        if F > 0:  # (4.2), (4.3)
            for j in range(N):
                change = run.lam[j] - run.lam_before[j] if counts[KNOWN] > 1 else 0.0
                lam_N[j] = max(0.0, run.lam[j] + w * change) if counts[KNOWN] else inf
            friction_bounds(run.friction_of, run.mu, lam_N, bound)
            for j in range(F):
                lam_F[j] = run.signs[j] * bound[j]
                for side in range(2):
                    b = bodies[first[j], side]
                    if b >= 0 and lam_F[j] != 0.0:
                        for e in range(3):
                            r[3 * b + e] += g_F[first[j], 3 * side + e] * lam_F[j]
        for i in range(m):
            r[i] = d[i] = r[i] / D[i] + D[i] * a[i] / h
        if k > 0:  # (3.2), (4.6)
            fill(A_written, run.order, g_N, g_F, first, run.sticking, bodies, D)
            if F > 0 and not surely_independent(A_written, reals[SAFE_FRACTION]):
                return
            for c in range(k):
                j = run.order[c] - N
                lower[c] = -bound[run.sticking[j]] if j >= 0 else 0.0
                upper[c] = bound[run.sticking[j]] if j >= 0 else inf
            algorithm_2(A_posed, d_posed, lower_posed, upper_posed, run.row_id, S, I, eps0, mode)
            mode |= WARM
            counts[SOLVES] += 1
            if I[COUNTS, STATUS] != SOLVED:
                return
            for c in range(k):
                j = run.order[c]
                if j < N:
                    lam_N[j] = S[X, c]
                else:
                    lam_F[run.sticking[j - N]] = S[X, c]
            for i in range(m):
                for c in range(k):
                    r[i] += A_written[i, c] * S[X, c]
        weight = h / alpha0
        if F > 0 and not settled(run, lam_N, lam_F, bound, new_bound, g_F, bodies, weight, v):
            return
        if slides:
            gains = own_gains(g_N, g_F, bodies, inverse_mass, run.friction_of, run.signs, run.mu)
            if gains.max() >= 1.0:
                return
        for i in range(m):
            v[i] = weight * r[i] / D[i]
            a[i] = (alpha0 * v[i] - a[i]) / h
        shorter = rejected_length(state, reals, steps, order, redone, a, h, D)
        if shorter < inf:
            longest, redone = shorter, redone + 1
            continue
        counts[REJECTED] += redone
        longest, redone = inf, 0
        if F > 0:
            speed = column_speeds(g_F, bodies, v)
            for j in range(F):
                new = speed[first[j]]
                stops = slip[j] * new < 0.0 or abs(new) <= 0.01 * reals[EPS]
                if run.signs[j] != 0.0 and stops:
                    return
            for j in range(F):
                slip[j] = speed[first[j]]
        # accepted
        for i in range(m):
            state[Q, i] = q[i]
            state[V_BEFORE, i], state[V, i] = state[V, i], v[i]
            state[A_BEFORE, i], state[A, i] = state[A, i], a[i]
        reals[TIME] += h
        reals[H], reals[WISH] = h, wish
        for i in range(corner.size):
            before[i] = after[i]
            if level[i] < 0.0 and after[i] > reals[FORGET]:
                level[i] = 0.0
            elif after[i] < level[i] - reals[ROUNDING]:
                level[i] = after[i]
        n = counts[TAKEN]
        counts[TAKEN] += 1
        counts[STEPS] += 1
        counts[KNOWN] = min(counts[KNOWN] + 1, counts[STEPS], 2)
        track = run.track[n]
        track[0] = reals[TIME]
        for i in range(m):
            track[1 + i], track[1 + m + i] = q[i], v[i]
        run.gaps[n] = inf
        for j in range(N):
            run.lam_before[j], run.lam[j] = run.lam[j], lam_N[j]
            run.multipliers[n, j] = lam_N[j]
            run.gaps[n] = min(run.gaps[n], phi[j])
        for j in range(F):
            run.multipliers[n, N + j] = lam_F[j]
        fastest = 0.0
        for b in range(m // 3):
            total = 0.0
            for i in range(3 * b, 3 * b + 3):
                total += (D[i] * v[i]) ** 2
            fastest = max(fastest, total)
        if sqrt(fastest) <= reals[REST_SPEED]:
            return
        speed = column_speeds(g_N, bodies, v)
        for j in range(N):
            if speed[j] > reals[DROP_TOL] or speed[j] < -10 * reals[EPS]:
                return
