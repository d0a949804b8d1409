"""Steps of algorithm 1 in which nothing happens, many in one compiled call.

Taken one by one from Python each costs a hundred times what its arithmetic does.  Here they are
taken until something calls for the stepper (`problems.quiet`): a corner that crosses an edge or
leaves one, a contact that separates, a scheduled time, bodies that are still, a QP that is not
solved, friction that begins to slip or stops, whose passes are many or whose gain is 1 or more
(`problems.gain`).
"""

from __future__ import annotations

from math import hypot, inf

import numpy as np

import problems.multistep as multistep
from problems.contact_kernels import (
    clearances,
    column_speeds,
    compliances,
    contact_columns,
    dense_columns,
    gather_columns,
    own_gains,
    place_corners,
)
from problems.dips import MAX_HALVINGS
from problems.friction_kernels import (
    QUIET_PASSES,
    extrapolated_multipliers,
    forced_signs,
    spring_loads,
)
from problems.multistep import REDONE, SHORTEST_STEP, STOP_TRIALS
from problems.quiet import (
    A_BEFORE,
    CONTACT_TOL,
    COUNTED,
    CUTS,
    DROP_TOL,
    ENDED,
    EPS,
    EVENT,
    FIXED,
    H_MAX,
    HIGHEST,
    KNOWN,
    LOOK,
    MOST_PASSES,
    OPEN,
    PASSES,
    REACH,
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
    beyond_edge,
    enters,
    fastest_body,
    largest_motion,
    meeting_reach,
    path_end,
    sink_levels,
    stopping_lengths,
    ways,
    weighted_norm,
)
from solvers.active_set.compiled import kernel
from solvers.active_set.passes import friction_passes

second_order_bdf = kernel(multistep.second_order_bdf)
first_order_step = kernel(multistep.first_order_step)
second_order_step = kernel(multistep.second_order_step)
second_order_error = kernel(multistep.second_order_error)
next_length = kernel(multistep.next_length)
first_redone_length = kernel(multistep.first_redone_length)
redone_length = kernel(multistep.redone_length)


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
def go_on(state, q, v, a):
    """Make q, q̇, q̈ (3n,) the newest."""
    for i in range(q.size):
        state[Q, i] = q[i]
        state[V_BEFORE, i], state[V, i] = state[V, i], v[i]
        state[A_BEFORE, i], state[A, i] = state[A, i], a[i]


@kernel
def first_guess(run, normals, pose, h, w):
    """λ_* (N,) of the first pass, as `VelocityEquations._first_guess`.

    normals : (entries, bodies) of g_N at the end of the step;  pose : `place_corners` at its start
    w : h_n/h_{n−1}
    """
    known, shapes, state = run.counts[KNOWN], run.shapes, run.state
    if known > 0:
        return extrapolated_multipliers(run.lam, run.lam_before, known, w)
    if not run.frictions.signs.any():
        return np.full(run.lam.size, inf)
    edges = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    sides = shapes.edge_start, shapes.edge_length
    inverse_mass = 1 / run.D**2
    free = path_end(state[Q], state[V], 0.5 * inverse_mass * run.forces, h)
    there = place_corners(free, shapes.corner_body, shapes.corner_local)
    now = contact_columns(*pose, run.place, shapes.corner_body, *edges, *sides)[0]
    then = contact_columns(*there, run.place, shapes.corner_body, *edges, *sides)[0]
    return spring_loads(now, then, compliances(*normals, inverse_mass), h)


@kernel
def quiet_steps(run, written, posed, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `counts[TAKEN]` of them.

    run : `problems.quiet.QuietSteps`, whose arrays are updated
    written, posed : zeros (3n, k), (3n,), (k,), (k,) for A, d and the bounds of the QP, and a
        `LeastDistance`; the same memory, read only
    S, I, eps0, mode : see `algorithm_2`
    """
    shapes, D, state, reals, counts = run.shapes, run.D, run.state, run.reals, run.counts
    place, frictions, lam, lam_before = run.place, run.frictions, run.lam, run.lam_before
    signs = frictions.signs
    corner, part, level, free = run.corner, run.part, run.level, run.free
    track, gaps, multipliers = run.track, run.gaps, run.multipliers
    edges = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    sides = shapes.edge_start, shapes.edge_length
    A_written, _, _, upper, _ = written
    m, k, N, F = D.size, frictions.row.size, place.shape[0], signs.size
    phis = np.empty((MAX_HALVINGS + 2, shapes.edge_offset.shape[1]))
    right, left = np.empty(MAX_HALVINGS + 2), np.empty(shapes.edge_offset.shape[1])
    q, v, a = np.empty(m), np.empty(m), np.empty(m)
    b, bend = np.empty(m), np.zeros(m)
    lam_N, lam_F, bound = np.zeros(N), np.zeros(F), np.zeros(F)
    upper[:] = inf
    slides, inverse_mass = signs.any(), 1 / D**2
    pose_before = pose = place_corners(state[Q], shapes.corner_body, shapes.corner_local)
    before = clearances(*pose, corner, part, *edges)
    _, _, g_F, bodies, _, _, _, _ = contact_columns(
        *pose, place, shapes.corner_body, *edges, *sides
    )
    rubs = np.ones(F, np.bool_)
    tangent, rubbing = gather_columns(g_F, g_F, bodies, frictions.first, rubs)
    slip = column_speeds(tangent, rubbing, state[V])
    for j in range(F):
        if signs[j] * slip[j] > 0.0:
            return
    longest, redone, rejected, solved = inf, 0, 0, 0
    cut, located, done = inf, 0, False
    while counts[TAKEN] < gaps.size:
        counts[ENDED] = EVENT
        steps = counts[STEPS]
        order = 1 if steps < 2 else counts[HIGHEST]
        wish = min(step_length(state, reals, steps, order, D), longest)
        h = min(wish, cut)
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
        way = ways(state[V], bend, h, shapes.radius)
        for i in range(corner.size):
            c, p = corner[i], part[i]
            reach = meeting_reach(way, shapes.corner_body[c], shapes.part_body[p])
            if not free[i] or after[i] - level[i] > reach:
                continue
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
        entries, pairs, lam_star = g_N, bodies, lam_N
        if F > 0:
            tangent, rubbing = gather_columns(g_N, g_F, bodies, frictions.first, rubs)
            lam_star = first_guess(run, (g_N, bodies), pose_before, h, w)
        if k > N:
            entries, pairs = gather_columns(g_N, g_F, bodies, frictions.row, frictions.tangential)
        if k > 0:
            dense_columns(entries, pairs, D, A_written)
        passes, mode, solves = friction_passes(
            *(frictions, D, run.forces, (g_N, bodies), (entries, pairs), (tangent, rubbing)),
            *(lam_star, b, h, alpha0, (counts[MOST_PASSES], 0.1 * reals[EPS], run.eps0, False)),
            *(written, posed, (S, I, eps0, mode), (v, a, lam_N, lam_F, bound)),
        )
        counts[SOLVES] += solves
        if passes == 0:
            return
        if slides:
            gains = own_gains(
                g_N, g_F, bodies, inverse_mass, frictions.friction_of, signs, frictions.mu
            )
            if gains.max() >= 1.0:
                return
        shorter = rejected_length(state, reals, steps, order, redone, a, h, D)
        if shorter < inf:
            longest, redone, rejected = shorter, redone + 1, rejected + 1
            continue
        if F > 0:
            new_slip = column_speeds(tangent, rubbing, v)
            lengths = stopping_lengths(signs, slip, new_slip, h, reals[EPS])
            stop = lengths.min()
            if stop < SHORTEST_STEP or (stop < inf and not counts[CUTS]):
                return
            if stop < h * (1.0 - 1e-6):
                located += 1
                cut = stop if located < STOP_TRIALS else min(stop, h / 2)
                rejected += 1
                continue
            slip = new_slip
            sigma = forced_signs(signs, lam_F, bound, slip)
            for j in range(F):
                run.at_bound[j], run.stopped[j] = sigma[j] != 0.0, lengths[j] <= h
                done |= run.stopped[j] or (
                    signs[j] == 0.0 and run.at_bound[j] and abs(slip[j]) > reals[EPS]
                )
        # accepted
        counts[ENDED] = LOOK
        counts[REJECTED] += rejected
        counts[COUNTED] += counts[SOLVES] - solved
        counts[PASSES] = passes
        longest, redone, rejected, solved = inf, 0, 0, counts[SOLVES]
        cut, located = inf, 0
        go_on(state, q, v, a)
        sink_levels(after, free, level)
        before, pose_before = after, pose
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
        if done or passes > QUIET_PASSES or fastest_body(D, v) <= reals[REST_SPEED]:
            return
        speed = column_speeds(g_N, bodies, v)
        for j in range(N):
            if speed[j] > reals[DROP_TOL] or speed[j] < -APPROACHING * reals[EPS]:
                return
