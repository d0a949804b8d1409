"""Steps of algorithm 1 in which nothing happens, many in one compiled call.

Between events a step is always the same: AB-r, columns, one QP, BDF-r, the length of the next.
Taken one by one from Python each costs a hundred times what its arithmetic does.  Here they are
taken until something calls for the stepper (`problems.quiet`): a corner that crosses an edge or
leaves one, a contact that separates, a scheduled time, bodies that are still, a QP that is not
solved, redundant contacts with friction, friction that wants another pass, slips or stops, or
whose gain is 1 or more (`problems.gain`).
"""

from __future__ import annotations

from math import hypot, inf

import numpy as np

import problems.multistep as multistep
from problems.contact_kernels import (
    clearances,
    column_speeds,
    column_sum,
    contact_columns,
    dense_columns,
    gather_columns,
    own_gains,
    place_corners,
)
from problems.dips import MAX_HALVINGS
from problems.friction_kernels import at_bound, driven_forces, force_change, friction_bounds
from problems.independence import SAFE_FRACTION, far_from_dependent
from problems.multistep import FIRST_RATE, REDONE, SHORTEST_STEP
from problems.qp import LARGEST
from problems.quiet import (
    A_BEFORE,
    CONTACT_TOL,
    CORRECTED,
    DROP_TOL,
    ENDED,
    EPS,
    EVENT,
    FIXED,
    H_MAX,
    HIGHEST,
    KNOWN,
    LOOK,
    OPEN,
    REACH,
    REDUNDANT,
    REJECTED,
    REST_SPEED,
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
from problems.step_kernels import (
    APPROACHING,
    STOPPED,
    beyond_edge,
    enters,
    fastest_body,
    largest_motion,
    meeting_reach,
    momentum,
    outcome,
    path_end,
    sink_levels,
    weighted_norm,
)
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
def covered(c, p, place, corner_part, corners, tolerance):
    """Whether an active point of the same two parts coincides with corner c."""
    own, x, y = corner_part[c], corners[c, 0], corners[c, 1]
    for j in range(place.shape[0]):
        one, two = corner_part[place[j, 0]], place[j, 1]
        same = (one == own and two == p) or (one == p and two == own)
        if same and hypot(corners[place[j, 0], 0] - x, corners[place[j, 0], 1] - y) <= tolerance:
            return True
    return False


@kernel
def any_at_bound(signs, lam_F, bound):
    """Whether a sticking contact is at its bound, so that it may begin to slide."""
    found = False
    for j in range(signs.size):
        found |= signs[j] == 0.0 and at_bound(lam_F[j], bound[j])
    return found


@kernel
def slips_on(signs, slip, new, eps):
    """Whether what slides does so after a step, too, see `Transitions._stopping_lengths`."""
    for j in range(signs.size):
        if signs[j] != 0.0 and (slip[j] * new[j] < 0.0 or abs(new[j]) <= STOPPED * eps):
            return False
    return True


@kernel
def go_on(state, q, v, a):
    """Make q, q̇, q̈ (3n,) the newest."""
    for i in range(q.size):
        state[Q, i] = q[i]
        state[V_BEFORE, i], state[V, i] = state[V, i], v[i]
        state[A_BEFORE, i], state[A, i] = state[A, i], a[i]


@kernel
def quiet_steps(run, written, posed, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `counts[TAKEN]` of them.

    run : `problems.quiet.QuietSteps`, whose arrays are updated
    written : zeros (3n, k), (3n,), (k,), (k,) for A, d and the bounds of the QP
    posed : the same memory, read only
    S, I, eps0, mode : see `algorithm_2`
    """
    shapes, D, state, reals, counts = run.shapes, run.D, run.state, run.reals, run.counts
    place, signs, lam, lam_before = run.place, run.signs, run.lam, run.lam_before
    corner, part, level, free = run.corner, run.part, run.level, run.free
    normal_column, sticking, sticking_column = run.normal_column, run.sticking, run.sticking_column
    track, gaps, multipliers = run.track, run.gaps, run.multipliers
    edges = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    sides = shapes.edge_start, shapes.edge_length
    A_written, d, lower, upper = written
    A_posed, d_posed, lower_posed, upper_posed = posed
    m, k, N, F = D.size, run.row.size, place.shape[0], signs.size
    phis = np.empty((MAX_HALVINGS + 2, shapes.edge_offset.shape[1]))
    right, left = np.empty(MAX_HALVINGS + 2), np.empty(shapes.edge_offset.shape[1])
    q, v, a, b = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    bend, lam_N, lam_F, bound = np.zeros(m), np.zeros(N), np.zeros(F), np.zeros(F)
    upper[:] = inf
    slides, inverse_mass = signs.any(), 1 / D**2
    pose = place_corners(state[Q], shapes.corner_body, shapes.corner_local)
    before = clearances(*pose, corner, part, *edges)
    _, _, g_F, bodies, _, _, _, _ = contact_columns(
        *pose, place, shapes.corner_body, *edges, *sides
    )
    rubs = np.ones(F, np.bool_)
    tangent, rubbing = gather_columns(g_F, g_F, bodies, run.first, rubs)
    slip = column_speeds(tangent, rubbing, state[V])
    for j in range(F):
        if signs[j] * slip[j] > 0.0:
            return
    longest, redone = inf, 0
    while counts[TAKEN] < gaps.size:
        counts[ENDED] = EVENT
        steps = counts[STEPS]
        order = 1 if steps < 2 else counts[HIGHEST]
        h = wish = min(step_length(state, reals, steps, order, D), longest)
        if reals[TIME] + h >= reals[UNTIL]:
            h = reals[UNTIL] - reals[TIME]
            if not counts[OPEN] or h <= SHORTEST_STEP:
                return
        w = h / reals[H] if reals[H] > 0.0 else 1.0
        alpha0, newest, oldest = second_order_bdf(w) if order == 2 else (1.0, 1.0, 0.0)
        for i in range(m):  # (3.1a), (3.1b)
            bend[i] = (state[V, i] - state[V_BEFORE, i]) / (2 * reals[H]) if order == 2 else 0.0
            b[i] = newest * state[V, i] - oldest * state[V_BEFORE, i]
        path_end(state[Q], state[V], bend, h, q)
        if not largest_motion(run.listed_at, q, shapes.radius) <= reals[REACH]:
            if counts[TAKEN] > 0:
                counts[ENDED] = STALE
            return
        pose = place_corners(q, shapes.corner_body, shapes.corner_local)
        after = clearances(*pose, corner, part, *edges)
        reach = meeting_reach(state[V], bend, h, shapes.radius)
        for i in range(corner.size):
            if not free[i] or after[i] - level[i] > reach:
                continue
            c, p = corner[i], part[i]
            met = enters(
                *(state[Q], state[V], bend, h, before[i], after[i], level[i]),
                *(shapes.corner_body[c], shapes.part_body[p], shapes.corner_local[c]),
                *(shapes.edge_normal[p], shapes.edge_offset[p], phis, right, left),
            )
            if met and not covered(c, p, place, shapes.corner_part, pose[0], reals[CONTACT_TOL]):
                return
        phi, g_N, g_F, bodies, _, along, length, _ = contact_columns(
            *pose, place, shapes.corner_body, *edges, *sides
        )
        for j in range(N):
            if beyond_edge(along[j], length[j]):
                return
        force = run.forces
        if F > 0:  # (4.2), (4.3)
            tangent, rubbing = gather_columns(g_N, g_F, bodies, run.first, rubs)
            for j in range(N):
                change = lam[j] - lam_before[j] if counts[KNOWN] > 1 else 0.0
                lam_N[j] = max(0.0, lam[j] + w * change) if counts[KNOWN] else inf
            bound = friction_bounds(run.friction_of, run.mu, lam_N)
            lam_F = driven_forces(signs, bound)
            force = force + column_sum(tangent, rubbing, lam_F, m)
            for j in range(sticking.size):
                c = sticking_column[j]
                lower[c], upper[c] = -bound[sticking[j]], bound[sticking[j]]
        if not momentum(b, force, D, h, LARGEST, d)[1]:
            return
        entries, pairs = g_N, bodies
        if k > N:
            entries, pairs = gather_columns(g_N, g_F, bodies, run.row, run.tangential)
        if k > 0:  # (3.2), (4.6)
            dense_columns(entries, pairs, D, A_written)
            if F > 0 and not far_from_dependent(A_written, SAFE_FRACTION):
                counts[ENDED] = REDUNDANT
                return
            algorithm_2(A_posed, d_posed, lower_posed, upper_posed, run.row_id, S, I, eps0, mode)
            mode |= WARM
            counts[SOLVES] += 1
            if I[COUNTS, STATUS] != SOLVED:
                return
        x = S[X, :k]
        for j in range(N):
            lam_N[j] = x[normal_column[j]]
        for j in range(sticking.size):
            lam_F[sticking[j]] = x[sticking_column[j]]
        outcome(entries, pairs, x, b, d, D, h, alpha0, v, a)
        if F > 0 and any_at_bound(signs, lam_F, bound):
            return
        if F > 0 and counts[CORRECTED]:  # (3.14)
            new_bound = friction_bounds(run.friction_of, run.mu, lam_N)
            moved = force_change(signs, lam_F, bound, new_bound)
            force = column_sum(tangent, rubbing, moved, m) * inverse_mass
            change, rounding = h / alpha0 * weighted_norm(D, force), h / alpha0 * run.eps0
            if not iteration_error(FIRST_RATE, change, rounding) <= 0.1 * reals[EPS]:
                return
        if slides:
            gains = own_gains(g_N, g_F, bodies, inverse_mass, run.friction_of, signs, run.mu)
            if gains.max() >= 1.0:
                return
        shorter = rejected_length(state, reals, steps, order, redone, a, h, D)
        if shorter < inf:
            longest, redone = shorter, redone + 1
            continue
        counts[REJECTED] += redone
        longest, redone = inf, 0
        if F > 0:
            new_slip = column_speeds(tangent, rubbing, v)
            if not slips_on(signs, slip, new_slip, reals[EPS]):
                return
            slip = new_slip
        # accepted
        counts[ENDED] = LOOK
        go_on(state, q, v, a)
        sink_levels(after, free, level)
        before = after
        reals[TIME] += h
        reals[H], reals[WISH] = h, wish
        n = counts[TAKEN]
        counts[TAKEN] += 1
        counts[STEPS] += 1
        counts[KNOWN] = min(counts[KNOWN] + 1, counts[STEPS], 2)
        track[n, 0] = reals[TIME]
        for i in range(m):
            track[n, 1 + i], track[n, 1 + m + i] = q[i], v[i]
        gaps[n] = inf
        for j in range(N):
            lam_before[j], lam[j] = lam[j], lam_N[j]
            multipliers[n, j] = lam_N[j]
            gaps[n] = min(gaps[n], phi[j])
        for j in range(F):
            multipliers[n, N + j] = lam_F[j]
        if fastest_body(D, v) <= reals[REST_SPEED]:
            return
        speed = column_speeds(g_N, bodies, v)
        for j in range(N):
            if speed[j] > reals[DROP_TOL] or speed[j] < -APPROACHING * reals[EPS]:
                return
