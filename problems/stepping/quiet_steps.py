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
from typing import NamedTuple

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
    rows_of,
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
from problems.kernels.compiled import kernel, stage
from problems.kernels.numba_internals import lent, read_only
from problems.qp import Indices, Vector
from problems.stepping.quiet_records import AGAIN, CHANGED, EVENT, LOOK

second_order_bdf = kernel(multistep.second_order_bdf)
first_order_step = kernel(multistep.first_order_step)
second_order_step = kernel(multistep.second_order_step)
second_order_error = kernel(multistep.second_order_error)
next_length = kernel(multistep.next_length)
first_redone_length = kernel(multistep.first_redone_length)
redone_length = kernel(multistep.redone_length)


class Work(NamedTuple):
    """What the steps of a stretch write to, for m = 3n coordinates, L candidates, N and F contacts.

    q, v, a : (m,) at the end of the step;  b, bend : (m,) of (3.1b), and the curvature of (3.1a)
    slip : (F,) g_Fᵀq̇, phi : (N,) and clearance : (L,) at its start
    lam_N, lam_F, bound : λ (N,), (F,) and μ Σ λ_* (F,) at its end
    qp : see `qp_room`;  phis, right, left : scratch of `first_dip`
    """

    inverse_mass: Vector
    q: Vector
    v: Vector
    a: Vector
    b: Vector
    bend: Vector
    slip: Vector
    phi: Vector
    clearance: Vector
    lam_N: Vector
    lam_F: Vector
    bound: Vector
    qp: tuple[Vector, Vector, Vector, Vector]
    phis: Vector
    right: Vector
    left: Vector


class Span(NamedTuple):
    """A trial: h, the one wished for [s], w = h_n/h_{n−1}, α₀, and the order of AB-r and BDF-r."""

    h: float
    wish: float
    w: float
    alpha0: float
    order: int


class Ended(NamedTuple):
    """Columns at the end of a trial: φ (N,), g_N, g_F (N, 6), their bodies, and of each friction.

    along, length : (N,) of the corners along their edges [m]
    tangent, rubbing : g_F (F, 6) of each friction, its bodies
    """

    phi: Vector
    g_N: Vector
    g_F: Vector
    bodies: Indices
    along: Vector
    length: Vector
    tangent: Vector
    rubbing: Indices


@stage
def work_of(run, contacts, frictions):
    """`Work` for steps with these contacts."""
    arena, m, L = run.arena, run.D.size, run.corner.size
    N, F, edges = contacts.place.shape[0], contacts.signs.size, run.shapes.edge_offset.shape[1]
    inverse_mass = numbers(arena, m)
    for i in range(m):
        inverse_mass[i] = 1 / run.D[i] ** 2
    return Work(
        inverse_mass,
        *(numbers(arena, m), numbers(arena, m), numbers(arena, m)),
        *(numbers(arena, m), numbers(arena, m)),
        *(numbers(arena, F), numbers(arena, N), numbers(arena, L)),
        *(zeros(arena, N), zeros(arena, F), zeros(arena, F)),
        qp_room(arena, m, frictions.row.size),
        table(arena, MAX_HALVINGS + 2, edges),
        *(numbers(arena, MAX_HALVINGS + 2), numbers(arena, edges)),
    )


@stage
def tables_of(shapes):
    """`Geometry.tables`."""
    return (
        *(shapes.corner_body, shapes.corner_local, shapes.part_body),
        *(shapes.edge_normal, shapes.edge_offset, shapes.edge_start, shapes.edge_length),
    )


@stage
def pose_of(run, q):
    """`place_corners` at q (3n,)."""
    return place_corners(q, run.shapes.corner_body, run.shapes.corner_local, run.arena)


@stage
def clearances_of(run, pose):
    """Those of the candidates (L,)."""
    edges = run.shapes.part_body, run.shapes.edge_normal, run.shapes.edge_offset
    return clearances(*pose, run.corner, run.part, *edges, run.arena)


@stage
def columns_of(run, contacts, frictions, pose):
    """`Ended` at a pose."""
    shapes, arena = run.shapes, run.arena
    phi, g_N, g_F, bodies, along, length = contact_columns(
        *pose,
        contacts.place,
        *(shapes.corner_body, shapes.part_body, shapes.edge_normal, shapes.edge_offset),
        *(shapes.edge_start, shapes.edge_length, arena),
    )
    tangent, rubbing = rows_of(g_F, bodies, frictions.first, arena)
    return Ended(phi, g_N, g_F, bodies, along, length, tangent, rubbing)


@stage
def look_back(run, contacts, frictions, work):
    """φ, clearances and slip where the steps begin; whether (2.9b) is satisfied there."""
    pose = pose_of(run, run.state.q)
    work.clearance[:] = clearances_of(run, pose)
    here = columns_of(run, contacts, frictions, pose)
    work.phi[:] = here.phi
    work.slip[:] = column_speeds(here.tangent, here.rubbing, run.state.v, run.arena)
    wrong = False
    for j in range(work.slip.size):
        wrong |= contacts.signs[j] * work.slip[j] > 0.0
    return not wrong


@stage
def step_length(run, order):
    """As `Stepper._step_length`."""
    state, settings, clock, steps = run.state, run.settings, run.clock[0], run.tally[0].steps
    if settings.fixed > 0.0:
        return settings.fixed
    allowed = inf
    if steps > 0 and order == 1:
        allowed = first_order_step(weighted_norm(run.D, state.a), settings.eps)
    elif steps > 0:
        jerk = weighted_norm(run.D, state.a - state.a_before) / clock.h
        allowed = second_order_step(jerk, clock.h, settings.eps)
    return next_length(clock.wish, steps, allowed, settings.h_max)


@stage
def next_span(run, work, longest, cut):
    """Step 1: h, at most `longest` and `cut`; q by (3.1a), b of (3.1b).  h = 0 where none fits."""
    state, clock, tally = run.state, run.clock[0], run.tally[0]
    order = 1 if tally.steps < 2 else run.settings.highest
    wish = min(step_length(run, order), longest)
    h = min(wish, cut)
    if clock.time + h >= clock.until:
        h = clock.until - clock.time
        if not tally.is_open or h <= SHORTEST_STEP:
            h = 0.0
    w = h / clock.h if clock.h > 0.0 else 1.0
    alpha0, newest, oldest = second_order_bdf(w) if order == 2 else (1.0, 1.0, 0.0)
    for i in range(work.b.size):
        bend = (state.v[i] - state.v_before[i]) / (2 * clock.h) if order == 2 else 0.0
        work.bend[i] = bend
        work.b[i] = newest * state.v[i] - oldest * state.v_before[i]
    path_end(state.q, state.v, work.bend, h, work.q)
    return Span(h, wish, w, alpha0, order)


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


@stage
def hits(run, place, work, h, pose, clearance):
    """Step 3: whether a corner may hit something on the way."""
    shapes, state = run.shapes, run.state
    before, way = work.clearance, ways(state.v, work.bend, h, shapes.radius, run.arena)
    for i in range(run.corner.size):
        c, p, level = run.corner[i], run.part[i], run.level[i]
        one, two = shapes.corner_body[c], shapes.part_body[p]
        if not run.free[i] or miss(before[i] - level, clearance[i] - level, way[one] + way[two]):
            continue
        if enters(
            (state.q, state.v, work.bend),
            h,
            (before[i], clearance[i], level),
            (one, two),
            shapes.corner_local[c],
            (shapes.edge_normal[p], shapes.edge_offset[p]),
            (work.phis, work.right, work.left),
        ):
            origin = pose_of(run, state.q)[0]
            if not (covered(c, p, place, shapes, origin) and covered(c, p, place, shapes, pose[0])):
                return True
    return False


@stage
def overlaps(run, place, work, h, pose):
    """Step 3: whether parts overlap at the end as they should not."""
    shapes = run.shapes
    motion = run.state.v, work.bend, h
    parts = shapes.part_first, shapes.part_size, shapes.radius
    tables = tables_of(shapes)
    return next_overlap(0, run.pairs, run.settings.allowed, motion, pose, place, parts, tables) >= 0


@stage
def slides_off(ended):
    """Step 3: whether an active corner is beyond its edge."""
    ends = False
    for j in range(ended.along.size):
        ends |= beyond_edge(ended.along[j], ended.length[j])
    return ends


@stage
def first_guess(run, contacts, ended, phi, span):
    """λ_* (N,) of the first pass, as `VelocityEquations._first_guess`.

    phi : φ (N,) at the start of the step
    """
    known, h, state, arena = run.tally[0].known, span.h, run.state, run.arena
    if known > 0:
        return extrapolated_multipliers(contacts.lam, contacts.lam_before, known, span.w, arena)
    if not contacts.signs.any():
        return np.full(contacts.lam.size, inf)
    m, shapes = run.D.size, run.shapes
    inverse_mass, fall, free = numbers(arena, m), numbers(arena, m), numbers(arena, m)
    for i in range(m):
        inverse_mass[i] = 1 / run.D[i] ** 2
        fall[i] = 0.5 * inverse_mass[i] * run.forces[i]
    path_end(state.q, state.v, fall, h, free)
    then = contact_columns(
        *pose_of(run, free),
        contacts.place,
        *(shapes.corner_body, shapes.part_body, shapes.edge_normal, shapes.edge_offset),
        *(shapes.edge_start, shapes.edge_length, arena),
    )[0]
    compliance = compliances(ended.g_N, ended.bodies, inverse_mass, arena)
    return spring_loads(phi, then, compliance, h, arena)


@stage
def velocity(run, contacts, frictions, work, span, ended, room):
    """Step 2: q̇_n and λ_n by (4.5), (4.6).  As `friction_passes` returns."""
    arena, k, N = run.arena, frictions.row.size, contacts.place.shape[0]
    entries, pairs, lam_star = ended.g_N, ended.bodies, work.lam_N
    if contacts.signs.size > 0:
        lam_star = first_guess(run, contacts, ended, work.phi, span)
    if k > N:
        entries, pairs = gather_columns(
            *(ended.g_N, ended.g_F, ended.bodies, frictions.row, frictions.tangential, arena)
        )
    if k > 0:
        dense_columns(entries, pairs, run.D, work.qp[0])
    stop = run.tally[0].most_passes, 0.1 * run.settings.eps, run.eps0, False
    return friction_passes(
        frictions,
        (run.D, run.forces, work.b, span.h, span.alpha0),
        ((ended.g_N, ended.bodies), (entries, pairs), (ended.tangent, ended.rubbing)),
        lam_star,
        stop,
        work.qp,
        room,
        (work.v, work.a, work.lam_N, work.lam_F, work.bound),
        arena,
    )


@stage
def feeds_back(frictions, work, ended, arena):
    """Whether sliding friction presses itself with a gain of 1 or more."""
    if not frictions.signs.any():
        return False
    columns = ended.g_N, ended.g_F, ended.bodies
    rubs = frictions.friction_of, frictions.signs, frictions.mu
    return own_gains(*columns, work.inverse_mass, *rubs, arena).max() >= 1.0


@stage
def rejected_length(run, work, span, redone):
    """As `Stepper._rejected_length` of a step whose passes have settled."""
    eps, steps = run.settings.eps, run.tally[0].steps
    if run.settings.fixed > 0.0 or span.h <= 100 * SHORTEST_STEP:
        return inf
    if steps == 0:
        return first_redone_length(span.h, first_order_step(weighted_norm(run.D, work.a), eps))
    if span.order == 1 or redone >= REDONE:
        return inf
    change = weighted_norm(run.D, work.a - run.state.a)
    return redone_length(span.h, second_order_error(change, span.h, run.clock[0].h), eps)


@stage
def accept(run, contacts, work, span, ended, clearance):
    """Make the end of the trial the newest time point, and keep it."""
    state, clock, tally, m = run.state, run.clock[0], run.tally[0], work.q.size
    N, F, n = contacts.place.shape[0], contacts.signs.size, run.tally[0].taken
    for i in range(m):
        state.q[i] = work.q[i]
        state.v_before[i], state.v[i] = state.v[i], work.v[i]
        state.a_before[i], state.a[i] = state.a[i], work.a[i]
    sink_levels(clearance, run.free, run.level)
    work.clearance[:] = clearance
    clock.time += span.h
    clock.h, clock.wish = span.h, span.wish
    tally.taken += 1
    tally.steps += 1
    tally.known = min(tally.known + 1, tally.steps, 2)
    run.track[n, 0] = clock.time
    for i in range(m):
        run.track[n, 1 + i], run.track[n, 1 + m + i] = work.q[i], work.v[i]
    run.gaps[n] = inf
    for j in range(N):
        contacts.lam_before[j], contacts.lam[j] = contacts.lam[j], work.lam_N[j]
        run.multipliers[n, j] = work.lam_N[j]
        work.phi[j] = ended.phi[j]
        run.gaps[n] = min(run.gaps[n], ended.phi[j])
    for j in range(F):
        run.multipliers[n, N + j] = work.lam_F[j]


@kernel
def note_change(run, row_id, sense):
    """Tell the stepper that a contact has left or begun to slip, see `QuietSteps.changes`."""
    tally = run.tally[0]
    n = tally.changes
    run.changes[n, 0], run.changes[n, 1], run.sense[n] = tally.taken, row_id, sense
    tally.changes = n + 1


@kernel
def wideness(shapes, place, j):
    """`contact_tolerance` of active contact j."""
    return contact_tolerance(shapes.contact_tol, shapes.corner_part, place[j, 0], place[j, 1])


@stage
def any_separates(run, contacts, gap, speed):
    """Step 4: whether a contact with φ and g_Nᵀq̇ (N,) is to leave J_N."""
    for j in range(speed.size):
        wide = wideness(run.shapes, contacts.place, j)
        if separates(gap[j], speed[j], run.settings.drop_tol, wide):
            return True
    return False


@kernel
def let_go(run, contacts, pose, clearance, gap, speed, leaving):
    """Whether contacts that separate can be dropped here; `leaving` (N,) says which do.

    As `Transitions.drop_separating`: those behind a tip stay, and are looked at by the stepper.

    pose, clearance : `place_corners` and the `clearances` of all candidates
    gap, speed : (N,) φ and g_Nᵀq̇
    """
    edges = run.shapes.part_body, run.shapes.edge_normal, run.shapes.edge_offset
    for j in range(speed.size):
        wide = wideness(run.shapes, contacts.place, j)
        leaving[j] = separates(gap[j], speed[j], run.settings.drop_tol, wide)
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
        slides = run.at_bound[j] and abs(slip[j]) > run.settings.eps
        if not slides or contacts.signs[j] != 0.0:
            continue
        stays = False
        for i in range(leaving.size):
            stays |= contacts.friction_of[i] == j and not leaving[i]
        if stays:
            contacts.signs[j] = -np.sign(slip[j])
            note_change(run, contacts.friction_ids[j], contacts.signs[j])


@stage
def step_four(run, contacts, frictions, work, pose, ended, leaving):
    """Step 4 after an accepted step; whether the next one may be taken here, too."""
    tally, settings, F = run.tally[0], run.settings, work.slip.size
    if run.stopped[:F].any() or tally.passes > QUIET_PASSES:
        return False
    speed, slowest = column_speeds(ended.g_N, ended.bodies, work.v, run.arena), 0.0
    for j in range(speed.size):
        slowest = min(slowest, speed[j])
    still = fastest_body(run.D, work.v) <= settings.rest_speed
    if still or slowest < -APPROACHING * settings.eps:
        return False
    before = tally.changes
    if any_separates(run, contacts, ended.phi, speed) and not let_go(
        run, contacts, pose, work.clearance, ended.phi, speed, leaving
    ):
        return False
    let_slip(run, contacts, leaving, work.slip)
    if tally.changes > before:
        tally.ended = CHANGED
        return False
    return True


@kernel
def steady_steps(run, contacts, frictions, leaving, solve, S, I, eps0, mode):
    """Take steps of algorithm 1 with the same contacts; `mode` for the next QP.

    frictions : the columns of `contacts`;  leaving : zeros (N,), to be told which contacts separate
    """
    run, contacts, frictions, leaving = lent(run), lent(contacts), lent(frictions), lent(leaving)
    S, I, arena = lent(S), lent(I), lent(run.arena)
    work, tally, F = work_of(run, contacts, frictions), run.tally[0], contacts.signs.size
    used, used_integers = arena.used[0], arena.used[1]
    tally.ended = EVENT
    if not look_back(run, contacts, frictions, work):
        return mode
    longest, cut, redone, located, rejected, solved = inf, inf, 0, 0, 0, tally.solves
    while tally.taken < run.gaps.size:
        tally.ended = EVENT
        arena.used[0], arena.used[1] = used, used_integers
        span = next_span(run, work, longest, cut)  # step 1
        if span.h == 0.0:
            return mode
        if not largest_motion(run.listed_at, work.q, run.shapes.radius) <= run.settings.reach:
            tally.ended = AGAIN if tally.taken > 0 else EVENT
            return mode
        pose = pose_of(run, work.q)
        clearance = clearances_of(run, pose)
        if hits(run, contacts.place, work, span.h, pose, clearance):  # step 3
            return mode
        if overlaps(run, contacts.place, work, span.h, pose):
            return mode
        ended = columns_of(run, contacts, frictions, pose)
        if slides_off(ended):
            return mode
        room = solve, S, I, eps0, mode
        passes, mode, solves = velocity(run, contacts, frictions, work, span, ended, room)  # step 2
        tally.solves += solves
        if passes == 0 or feeds_back(frictions, work, ended, arena):
            return mode
        shorter = rejected_length(run, work, span, redone)
        if shorter < inf:
            longest, redone, rejected = shorter, redone + 1, rejected + 1
            continue
        if F > 0:
            slip = column_speeds(ended.tangent, ended.rubbing, work.v, arena)
            lengths = stopping_lengths(
                contacts.signs, work.slip, slip, span.h, run.settings.eps, arena
            )
            stop = lengths.min()
            if stop < SHORTEST_STEP or (stop < inf and not run.settings.cuts):
                return mode
            if stop < span.h * (1.0 - 1e-6):
                located, rejected = located + 1, rejected + 1
                cut = stop if located < STOP_TRIALS else min(stop, span.h / 2)
                continue
            sigma = forced_signs(contacts.signs, work.lam_F, work.bound, slip, arena)
            for j in range(F):
                work.slip[j] = slip[j]
                run.at_bound[j], run.stopped[j] = sigma[j] != 0.0, lengths[j] <= span.h
        tally.ended, tally.passes = LOOK, passes
        tally.rejected += rejected
        tally.counted += tally.solves - solved
        accept(run, contacts, work, span, ended, clearance)
        longest, cut, redone, located, rejected, solved = inf, inf, 0, 0, 0, tally.solves
        if not step_four(run, contacts, frictions, work, pose, ended, leaving):
            return mode
    tally.ended = AGAIN
    return mode


@kernel
def quiet_steps(run, solve, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `tally.taken` of them.

    run : `problems.stepping.quiet_records.QuietSteps`, whose arrays are updated
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
        if run.tally[0].ended != CHANGED:
            break
        if leaving.any():
            contacts = without(contacts, leaving)
    N, F = contacts.lam.size, contacts.signs.size
    run.contacts.lam[:N], run.contacts.lam_before[:N] = contacts.lam, contacts.lam_before
    run.contacts.signs[:F] = contacts.signs
