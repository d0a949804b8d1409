"""Steps of algorithm 1 in which nothing happens, many in one compiled call.

Taken one by one from Python each costs a hundred times what its arithmetic does.  Here they are
taken until something calls for the stepper (`problems.stepping.quiet`): a corner that crosses an
edge or leaves one, parts that overlap, a scheduled time, bodies that are still, a QP that is not
solved, friction that stops, whose passes are many or whose gain is 1 or more
(`problems.stepping.gain`).  Contacts that separate and friction that begins to slip, which restart
nothing (step 4), are seen to on the way.
"""

from __future__ import annotations

from math import hypot, inf

import numpy as np

import problems.formulas.multistep as multistep
from problems.contacts.active_kernels import Frictions, qp_columns, without
from problems.contacts.dips import MAX_HALVINGS
from problems.contacts.geometry_kernels import (
    clearances,
    column_speeds,
    compliances,
    contact_columns,
    dense_columns,
    edge_distances,
    gather_columns,
    own_gains,
    past_tip,
    place_corners,
)
from problems.contacts.path_kernels import (
    beyond_edge,
    contact_tolerance,
    enters,
    largest_motion,
    miss,
    path_end,
    sink_levels,
    ways,
)
from problems.formulas.multistep import REDONE, SHORTEST_STEP, STOP_TRIALS
from problems.formulas.step_kernels import (
    APPROACHING,
    fastest_body,
    next_overlap,
    separates,
    stopping_lengths,
    weighted_norm,
)
from problems.friction.compiled_passes import friction_passes, qp_room
from problems.friction.kernels import (
    QUIET_PASSES,
    extrapolated_multipliers,
    forced_signs,
    spring_loads,
)
from problems.kernels.arena import numbers, table, zeros
from problems.kernels.compiled import kernel, lent, read_only
from problems.stepping.quiet_records import (
    A_BEFORE,
    AGAIN,
    ALLOWED,
    CHANGED,
    CHANGES,
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
def covered(c, p, place, shapes, corners):
    """Whether an active point of the same two parts coincides with corner c."""
    corner_part, x, y = shapes.corner_part, corners[c, 0], corners[c, 1]
    own, tolerance = corner_part[c], contact_tolerance(shapes.contact_tol, corner_part, c, p)
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
def first_guess(run, contacts, g_N, bodies, now, h, w):
    """λ_* (N,) of the first pass, as `VelocityEquations._first_guess`.

    g_N, bodies : (N, 6), (N, 2) at the end of the step;  now : φ (N,) at its start
    w : h_n/h_{n−1}
    """
    known, shapes, state, arena = run.counts[KNOWN], run.shapes, run.state, run.arena
    if known > 0:
        return extrapolated_multipliers(contacts.lam, contacts.lam_before, known, w, arena)
    if not contacts.signs.any():
        return np.full(contacts.lam.size, inf)
    m = run.D.size
    inverse_mass, fall, free = numbers(arena, m), numbers(arena, m), numbers(arena, m)
    for i in range(m):
        inverse_mass[i] = 1 / run.D[i] ** 2
        fall[i] = 0.5 * inverse_mass[i] * run.forces[i]
    path_end(state[Q], state[V], fall, h, free)
    points, centres, cosine, sine = place_corners(
        free, shapes.corner_body, shapes.corner_local, arena
    )
    then = contact_columns(
        points,
        centres,
        cosine,
        sine,
        contacts.place,
        shapes.corner_body,
        shapes.part_body,
        shapes.edge_normal,
        shapes.edge_offset,
        shapes.edge_start,
        shapes.edge_length,
        arena,
    )[0]
    return spring_loads(now, then, compliances(g_N, bodies, inverse_mass, arena), h, arena)


@kernel
def note_change(run, row_id, sense):
    """Tell the stepper that a contact has left or begun to slip, see `QuietSteps.changes`."""
    n = run.counts[CHANGES]
    run.changes[n, 0], run.changes[n, 1], run.sense[n] = run.counts[TAKEN], row_id, sense
    run.counts[CHANGES] += 1


@kernel
def wideness(shapes, place, j):
    """`contact_tolerance` of active contact j."""
    return contact_tolerance(shapes.contact_tol, shapes.corner_part, place[j, 0], place[j, 1])


@kernel
def let_go(run, contacts, pose, clearance, gap, speed, leaving):
    """Whether contacts that separate can be dropped here; `leaving` (N,) says which do.

    As `Transitions._drop_separating`: those behind a tip stay, and are looked at by the stepper.

    pose, clearance : `place_corners` and the `clearances` of all candidates
    gap, speed : (N,) φ and g_Nᵀq̇
    """
    edges = run.shapes.part_body, run.shapes.edge_normal, run.shapes.edge_offset
    for j in range(speed.size):
        wide = wideness(run.shapes, contacts.place, j)
        leaving[j] = separates(gap[j], speed[j], run.reals[DROP_TOL], wide)
    which = np.flatnonzero(leaving)
    at = np.empty(which.size, dtype=np.int64)
    for n in range(which.size):
        c, p, e = contacts.place[which[n]]
        at[n] = -1
        for i in range(run.corner.size):
            if run.corner[i] == c and run.part[i] == p:
                at[n] = i
        one = np.array([c]), np.array([p])
        phi = edge_distances(*pose, *one, *edges)[0]
        if at[n] < 0 or past_tip(phi, e):
            return False
    for n in range(which.size):
        i = at[n]
        run.free[i] = True
        if clearance[i] < 0.0:
            run.level[i] = clearance[i]
        note_change(run, contacts.normal_ids[which[n]], 0.0)
    return True


@kernel
def let_slip(run, contacts, leaving, slip):
    """Sticking contacts at their bound that slip, (F,) g_Fᵀq̇, faster than ε become sliding ones."""
    for j in range(slip.size):
        slides = run.at_bound[j] and abs(slip[j]) > run.reals[EPS]
        if not slides or contacts.signs[j] != 0.0:
            continue
        stays = False
        for i in range(leaving.size):
            stays |= contacts.friction_of[i] == j and not leaving[i]
        if stays:
            contacts.signs[j] = -np.sign(slip[j])
            note_change(run, contacts.friction_ids[j], contacts.signs[j])


@kernel
def steady_steps(run, contacts, frictions, leaving, solve, S, I, eps0, mode):
    """Take steps with the same contacts; `mode` for the next QP.

    frictions : the columns of `contacts`;  leaving : zeros (N,), to be told which contacts separate
    """
    run, contacts, frictions, leaving = lent(run), lent(contacts), lent(frictions), lent(leaving)
    S, I, arena = lent(S), lent(I), lent(run.arena)
    shapes, D, state, reals, counts = run.shapes, run.D, run.state, run.reals, run.counts
    place, lam, lam_before, signs = (
        contacts.place,
        contacts.lam,
        contacts.lam_before,
        contacts.signs,
    )
    corner, part, level, free = run.corner, run.part, run.level, run.free
    track, gaps, multipliers = run.track, run.gaps, run.multipliers
    corner_body, corner_local, radius = shapes.corner_body, shapes.corner_local, shapes.radius
    part_body, normal, offset = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    start, extent = shapes.edge_start, shapes.edge_length
    m, k, N, F = D.size, frictions.row.size, place.shape[0], signs.size
    qp = qp_room(arena, m, k)
    phis, left = table(arena, MAX_HALVINGS + 2, offset.shape[1]), numbers(arena, offset.shape[1])
    right, inverse_mass = numbers(arena, MAX_HALVINGS + 2), numbers(arena, m)
    q, v, a = numbers(arena, m), numbers(arena, m), numbers(arena, m)
    b, bend, slip = numbers(arena, m), numbers(arena, m), numbers(arena, F)
    lam_N, lam_F, bound = zeros(arena, N), zeros(arena, F), zeros(arena, F)
    before, phi_before = numbers(arena, corner.size), numbers(arena, N)
    slides, rubs = signs.any(), np.ones(F, np.bool_)
    for i in range(m):
        inverse_mass[i] = 1 / D[i] ** 2
    used, used_integers = arena.used[0], arena.used[1]
    # arrays are handed on one by one: to put them into a tuple first is to count who holds them
    points, centres, cosine, sine = place_corners(state[Q], corner_body, corner_local, arena)
    before[:] = clearances(
        points, centres, cosine, sine, corner, part, part_body, normal, offset, arena
    )
    phi, g_N, g_F, bodies, _, _ = contact_columns(
        points,
        centres,
        cosine,
        sine,
        place,
        corner_body,
        part_body,
        normal,
        offset,
        start,
        extent,
        arena,
    )
    phi_before[:] = phi
    tangent, rubbing = gather_columns(g_N, g_F, bodies, frictions.first, rubs, arena)
    slip[:] = column_speeds(tangent, rubbing, state[V], arena)
    for j in range(F):
        if signs[j] * slip[j] > 0.0:
            counts[ENDED] = EVENT
            return mode
    longest, redone, rejected, solved = inf, 0, 0, counts[SOLVES]
    cut, located, changes = inf, 0, counts[CHANGES]
    while counts[TAKEN] < gaps.size:
        counts[ENDED] = EVENT
        arena.used[0], arena.used[1] = used, used_integers
        steps = counts[STEPS]
        order = 1 if steps < 2 else counts[HIGHEST]
        wish = min(step_length(state, reals, steps, order, D), longest)
        h = min(wish, cut)
        if reals[TIME] + h >= reals[UNTIL]:
            h = reals[UNTIL] - reals[TIME]
            if not counts[OPEN] or h <= SHORTEST_STEP:
                return mode
        w = h / reals[H] if reals[H] > 0.0 else 1.0
        alpha0, newest, oldest = second_order_bdf(w) if order == 2 else (1.0, 1.0, 0.0)
        for i in range(m):  # (3.1a), (3.1b)
            bend[i] = (state[V, i] - state[V_BEFORE, i]) / (2 * reals[H]) if order == 2 else 0.0
            b[i] = newest * state[V, i] - oldest * state[V_BEFORE, i]
        path_end(state[Q], state[V], bend, h, q)
        if not largest_motion(run.listed_at, q, radius) <= reals[REACH]:
            if counts[TAKEN] > 0:
                counts[ENDED] = AGAIN
            return mode
        points, centres, cosine, sine = place_corners(q, corner_body, corner_local, arena)
        after = clearances(
            points, centres, cosine, sine, corner, part, part_body, normal, offset, arena
        )
        way = ways(state[V], bend, h, radius, arena)
        for i in range(corner.size):
            c, p = corner[i], part[i]
            one, two = corner_body[c], part_body[p]
            if not free[i] or miss(before[i] - level[i], after[i] - level[i], way[one] + way[two]):
                continue
            if enters(
                state[Q],
                state[V],
                bend,
                h,
                before[i],
                after[i],
                level[i],
                one,
                two,
                corner_local[c],
                normal[p],
                offset[p],
                phis,
                right,
                left,
            ):
                origin = place_corners(state[Q], corner_body, corner_local, arena)[0]
                spared = covered(c, p, place, shapes, origin)
                if not (spared and covered(c, p, place, shapes, points)):
                    return mode
        overlaps = next_overlap(
            0,
            run.pairs,
            reals[ALLOWED],
            state[V],
            bend,
            h,
            points,
            centres,
            cosine,
            sine,
            place,
            shapes.part_first,
            shapes.part_size,
            radius,
            corner_body,
            part_body,
            normal,
            offset,
            start,
            extent,
        )
        if overlaps >= 0:
            return mode
        phi, g_N, g_F, bodies, along, length = contact_columns(
            points,
            centres,
            cosine,
            sine,
            place,
            corner_body,
            part_body,
            normal,
            offset,
            start,
            extent,
            arena,
        )
        for j in range(N):
            if beyond_edge(along[j], length[j]):
                return mode
        entries, pairs, lam_star = g_N, bodies, lam_N
        if F > 0:
            tangent, rubbing = gather_columns(g_N, g_F, bodies, frictions.first, rubs, arena)
            lam_star = first_guess(run, contacts, g_N, bodies, phi_before, h, w)
        if k > N:
            entries, pairs = gather_columns(
                g_N, g_F, bodies, frictions.row, frictions.tangential, arena
            )
        if k > 0:
            dense_columns(entries, pairs, D, qp[0])
        passes, mode, solves = friction_passes(
            frictions,
            D,
            run.forces,
            (g_N, bodies),
            (entries, pairs),
            (tangent, rubbing),
            lam_star,
            b,
            h,
            alpha0,
            (counts[MOST_PASSES], 0.1 * reals[EPS], run.eps0, False),
            qp,
            (solve, S, I, eps0, mode),
            (v, a, lam_N, lam_F, bound),
            arena,
        )
        counts[SOLVES] += solves
        if passes == 0:
            return mode
        if slides:
            gains = own_gains(
                g_N, g_F, bodies, inverse_mass, frictions.friction_of, signs, frictions.mu, arena
            )
            if gains.max() >= 1.0:
                return mode
        shorter = rejected_length(state, reals, steps, order, redone, a, h, D)
        if shorter < inf:
            longest, redone, rejected = shorter, redone + 1, rejected + 1
            continue
        if F > 0:
            new_slip = column_speeds(tangent, rubbing, v, arena)
            lengths = stopping_lengths(signs, slip, new_slip, h, reals[EPS], arena)
            stop = lengths.min()
            if stop < SHORTEST_STEP or (stop < inf and not counts[CUTS]):
                return mode
            if stop < h * (1.0 - 1e-6):
                located += 1
                cut = stop if located < STOP_TRIALS else min(stop, h / 2)
                rejected += 1
                continue
            sigma = forced_signs(signs, lam_F, bound, new_slip, arena)
            for j in range(F):
                slip[j] = new_slip[j]
                run.at_bound[j], run.stopped[j] = sigma[j] != 0.0, lengths[j] <= h
        # accepted
        counts[ENDED] = LOOK
        counts[REJECTED] += rejected
        counts[COUNTED] += counts[SOLVES] - solved
        counts[PASSES] = passes
        longest, redone, rejected, solved = inf, 0, 0, counts[SOLVES]
        cut, located = inf, 0
        go_on(state, q, v, a)
        sink_levels(after, free, level)
        for i in range(corner.size):
            before[i] = after[i]
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
            phi_before[j] = phi[j]
            gaps[n] = min(gaps[n], phi[j])
        for j in range(F):
            multipliers[n, N + j] = lam_F[j]
        if run.stopped[:F].any() or passes > QUIET_PASSES:
            return mode
        speed = column_speeds(g_N, bodies, v, arena)
        slowest, any_leaves = 0.0, False
        for j in range(N):
            slowest = min(slowest, speed[j])
            wide = wideness(shapes, place, j)
            any_leaves |= separates(phi[j], speed[j], reals[DROP_TOL], wide)
        if fastest_body(D, v) <= reals[REST_SPEED] or slowest < -APPROACHING * reals[EPS]:
            return mode
        if any_leaves:
            pose = points, centres, cosine, sine
            if not let_go(run, contacts, pose, after, phi, speed, leaving):
                return mode
        let_slip(run, contacts, leaving, slip)
        if counts[CHANGES] > changes:
            counts[ENDED] = CHANGED
            return mode
    counts[ENDED] = AGAIN
    return mode


@kernel
def quiet_steps(run, solve, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `counts[TAKEN]` of them.

    run : `problems.stepping.quiet.QuietSteps`, whose arrays are updated
    solve, S, I, eps0, mode : see `problems.qp_kernel`
    """
    run = lent(run)
    contacts = run.contacts
    while True:
        run.arena.used[0], run.arena.used[1] = 0, 0
        columns = qp_columns(
            contacts.normal_ids, contacts.friction_ids, contacts.first, contacts.signs
        )
        rubs = contacts.friction_of, contacts.first, contacts.mu, contacts.signs
        frictions = Frictions(*rubs, read_only(columns[0]), *columns[1:])
        leaving = np.zeros(contacts.place.shape[0], np.bool_)
        mode = steady_steps(run, contacts, frictions, leaving, solve, S, I, eps0, mode)
        if run.counts[ENDED] != CHANGED:
            break
        if leaving.any():
            contacts = without(contacts, leaving)
    N, F = contacts.lam.size, contacts.signs.size
    run.contacts.lam[:N], run.contacts.lam_before[:N] = contacts.lam, contacts.lam_before
    run.contacts.signs[:F] = contacts.signs
