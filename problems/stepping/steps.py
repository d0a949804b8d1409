"""Steps of algorithm 1, many in one compiled call: all but what changes J_N, J_FO and J_FW.

A trial of a step is taken stage by stage:

    1. its length h by (3.5), q_n by AB-r (3.1a)                       `begin`
    3. whether anything may be met on the way                          `begin`
    2. q̇_n and λ_n by passes of QPs                                    `friction.passes.fixed_point`
       whether the error is small enough, and friction does not stop   `judge`
    5. the end of the step is the newest time point                    `accept`
    4. whether contacts separate or begin to slip                      `calm`

`take_steps` ends where the stepper is needed (`problems.stepping.stepper`) and goes on where it was
when it is called again.  With a compiled method (`problems.qp_kernel`) whole stretches between
events are one call; with any other solver, and with forces that vary, a call ends with each QP and
each force that it asks for (`problems.stepping.driver`).  Every step is taken here, whoever solves
its QPs and whether they are kept or not.
"""

from __future__ import annotations

from math import hypot, inf

import numpy as np

import problems.formulas.multistep as multistep
from problems.contacts.geometry_kernels import (
    clearances,
    column_speeds,
    compliances,
    contact_columns,
    dense_columns,
    gather_columns,
    own_gains,
    place_corners,
    room_for_columns,
    rows_of,
)
from problems.contacts.path_kernels import (
    beyond_edge,
    contact_tolerance,
    ends_inside,
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
    bdf,
    fastest_body,
    longest_step,
    next_overlap,
    path_curvature,
    predicted,
    separates,
    stopping_lengths,
    weighted_norm,
)
from problems.friction.kernels import QUIET_PASSES, forced_signs
from problems.friction.passes import (
    ANSWER,
    FAILED,
    FORCES,
    GUESS,
    MAX_PASSES,
    POSE,
    STUCK_PASSES,
    UNSETTLED,
    fixed_point,
)
from problems.friction.rules import extrapolated_multipliers, spring_loads
from problems.joints.row_kernels import joint_rows
from problems.kernels.compiled import kernel, stage
from problems.kernels.numba_internals import in_place, lent
from problems.stepping.records import (
    AGAIN,
    FORCED,
    GIVES_UP,
    GOES_ON,
    HELD,
    LOOK,
    LOOK_BACK,
    MEETS,
    PASS,
    STANDS,
    TRY,
)

asked_accuracy = kernel(multistep.asked_accuracy)
first_order_step = kernel(multistep.first_order_step)
second_order_error = kernel(multistep.second_order_error)
next_length = kernel(multistep.next_length)
first_redone_length = kernel(multistep.first_redone_length)
redone_length = kernel(multistep.redone_length)

MAX_TRIES = 60
"""Trials of one step before the simulation gives up."""
SHORT = 100 * SHORTEST_STEP
"""Steps up to this are taken as they are [s]."""


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
    return place_corners(q, run.shapes.corner_body, run.shapes.corner_local, run.passes.arena)


@stage
def note_clearances(run, pose, into):
    """Those of the candidates (L,)."""
    edges = run.shapes.part_body, run.shapes.edge_normal, run.shapes.edge_offset
    clearances(*pose, run.near.corner, run.near.part, *edges, into)


@stage
def note_columns(run, q, pose, phi):
    """Those of the contacts at q and its pose, of their frictions and of joints."""
    shapes, ends, passes = run.shapes, run.ends, run.passes
    (g_N, bodies), (g_F, rubbing) = passes.normals, passes.tangents
    contact_columns(
        *pose,
        run.contacts.place,
        *(shapes.corner_body, shapes.part_body, shapes.edge_normal, shapes.edge_offset),
        *(shapes.edge_start, shapes.edge_length),
        (phi, g_N, ends.tangent, bodies, ends.along, ends.length),
    )
    rows_of(ends.tangent, bodies, run.contacts.first, g_F, rubbing)
    joint_rows(q, run.rows, run.contacts.place.shape[0], phi, g_N, bodies)


@stage
def note_stops(run, q, phi):
    """φ (S,) of the stops that are not reached."""
    joint_rows(q, run.stops.rows, 0, phi, *run.stops.columns)


@stage
def look_back(run):
    """φ, clearances and slip where the steps begin; s_i such that (2.9b) is satisfied there."""
    signs, slip = run.contacts.signs, run.ends.slip
    pose = pose_of(run, run.state.q)
    note_clearances(run, pose, run.near.before)
    note_columns(run, run.state.q, pose, run.ends.phi)
    note_stops(run, run.state.q, run.stops.before)
    slip[:] = column_speeds(*run.passes.tangents, run.state.v, run.passes.arena)
    for j in range(slip.size):
        if signs[j] != 0.0 and slip[j] != 0.0:
            signs[j] = -np.sign(slip[j])


@stage
def step_length(run, order):
    """Step 1: h from (3.5), with limits on growth; the old one after a restart."""
    state, settings, clock, steps = run.state, run.settings, run.clock[0], run.tally[0].steps
    if settings.fixed > 0.0:
        return settings.fixed
    allowed = inf
    if steps > 0:
        allowed = longest_step(
            run.passes.D, order, state.a, state.a_before, clock.h, settings.eps, run.passes.arena
        )
    return next_length(clock.wish, steps, allowed, settings.h_max)


@stage
def note_span(run):
    """Step 1: h, at most `longest` and `cut`; q by (3.1a), b of (3.1b), q̇_n⁽⁰⁾ of (3.9)."""
    state, clock, tally, trial = run.state, run.clock[0], run.tally[0], run.trial[0]
    passes, ends, now = run.passes, run.ends, run.passes.now[0]
    trial.order = 1 if tally.steps < 2 else run.settings.highest
    trial.wish = min(step_length(run, trial.order), trial.longest)
    left = clock.until - clock.time
    trial.h = min(trial.wish, trial.cut, left)
    # no step ends beyond it, not by rounding either: forces are those of the step's end
    trial.t = clock.until if trial.h == left else min(clock.time + trial.h, clock.until)
    trial.w = trial.h / clock.h if clock.h > 0.0 else 1.0
    path_curvature(trial.order, state.v, state.v_before, clock.h, ends.bend)
    path_end(state.q, state.v, ends.bend, trial.h, ends.q)
    now.h, now.alpha0 = trial.h, bdf(trial.order, trial.w, state.v, state.v_before, passes.b)
    if run.settings.depends:
        predicted(tally.steps, trial.h, trial.w, state.v, state.a, state.a_before, passes.guess)
    else:
        passes.guess[:] = state.v


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
def may_hit(run, pose):
    """Step 3: whether a corner may hit something on the way."""
    shapes, near, state, place = run.shapes, run.near, run.state, run.contacts.place
    h, bend, scratch = run.trial[0].h, run.ends.bend, run.scratch
    way = ways(state.v, bend, h, shapes.radius, run.passes.arena)
    for i in range(near.corner.size):
        c, p, level = near.corner[i], near.part[i], near.level[i]
        before, after = near.before[i], near.after[i]
        one, two = shapes.corner_body[c], shapes.part_body[p]
        if not near.free[i] or miss(before - level, after - level, way[one] + way[two]):
            continue
        if enters(
            (state.q, state.v, bend),
            h,
            (before, after, level),
            (one, two),
            shapes.corner_local[c],
            (shapes.edge_normal[p], shapes.edge_offset[p]),
            (scratch.phis, scratch.right, scratch.left),
        ):
            origin = pose_of(run, state.q)[0]
            if not (covered(c, p, place, shapes, origin) and covered(c, p, place, shapes, pose[0])):
                return True
    return False


@stage
def overlaps(run, pose):
    """Step 3: whether parts overlap at the end as they should not."""
    shapes = run.shapes
    motion = run.state.v, run.ends.bend, run.trial[0].h
    parts = shapes.part_first, shapes.part_size, shapes.radius
    near, place, allowed = run.near.pairs, run.contacts.place, run.settings.allowed
    begin = 0
    return next_overlap(begin, near, allowed, motion, pose, place, parts, tables_of(shapes)) >= 0


@stage
def leaves_edge(ends):
    """Step 3: whether an active corner is beyond its edge."""
    beyond = False
    for j in range(ends.along.size):
        beyond |= beyond_edge(ends.along[j], ends.length[j])
    return beyond


@stage
def passes_stop(stops):
    """Step 3: whether a stop is passed by the end of the step."""
    passed = False
    for i in range(stops.after.size):
        passed |= ends_inside(stops.before[i], stops.after[i])
    return passed


@stage
def begin(run):
    """Steps 1 and 3 of a trial; why the stepper is needed before it can go on, or `GOES_ON`."""
    trial, tally, ends, shapes = run.trial[0], run.tally[0], run.ends, run.shapes
    trial.tries += 1
    if trial.tries > MAX_TRIES:
        return GIVES_UP
    note_span(run)
    looked = trial.looked > 0.0
    trial.hits = trial.overlaps = trial.ends = trial.stops = 1
    if looked and trial.h != trial.looked:
        return MEETS
    moved = largest_motion(run.near.listed_at, ends.q, shapes.radius)
    if not looked and not moved <= run.settings.reach:
        return AGAIN if tally.taken > 0 else MEETS
    pose = pose_of(run, ends.q)
    note_clearances(run, pose, run.near.after)
    note_columns(run, ends.q, pose, ends.phi_after)
    note_stops(run, ends.q, run.stops.after)
    if looked:
        return GOES_ON
    trial.hits = 1 if may_hit(run, pose) else 0
    trial.overlaps = 1 if overlaps(run, pose) else 0
    trial.ends = 1 if leaves_edge(ends) else 0
    trial.stops = 1 if passes_stop(run.stops) else 0
    meets = trial.hits + trial.overlaps + trial.ends + trial.stops > 0
    return MEETS if meets or run.settings.switches else GOES_ON


@stage
def first_guess(run):
    """λ_* (N,) of the first pass: ∞, or by (4.4), (4.3) or (4.2)."""
    state, passes, contacts, trial = run.state, run.passes, run.contacts, run.trial[0]
    known, h, arena, shapes = run.tally[0].known, trial.h, passes.arena, run.shapes
    if trial.stuck > 0 or (run.settings.corrects and known == 0 and not contacts.signs.any()):
        passes.lam_star[:] = inf
        return
    if known > 0:
        passes.lam_star[:] = extrapolated_multipliers(
            contacts.lam, contacts.lam_before, known, trial.w, arena
        )
        return
    m = passes.D.size
    fall, free = np.empty(m), np.empty(m)
    for i in range(m):
        # a force may jump where the step begins: it is the one after
        fall[i] = 0.5 * passes.inverse_mass[i] * run.ends.forces_before[i]
    path_end(state.q, state.v, fall, h, free)
    then = room_for_columns(contacts.place.shape[0])
    contact_columns(
        *pose_of(run, free),
        contacts.place,
        *(shapes.corner_body, shapes.part_body, shapes.edge_normal, shapes.edge_offset),
        *(shapes.edge_start, shapes.edge_length),
        then,
    )
    compliance = compliances(*passes.normals, passes.inverse_mass, arena)
    passes.lam_star[:] = spring_loads(run.ends.phi, then[0], compliance, h, arena)


@stage
def begin_passes(run):
    """Step 2: λ_* of the first pass, the columns of the QP."""
    passes, settings, trial, now = run.passes, run.settings, run.trial[0], run.passes.now[0]
    frictions, D = passes.frictions, passes.D
    (g_N, bodies), (entries, pairs) = passes.normals, passes.columns
    k, rubs = frictions.row.size, run.contacts.signs.size > 0
    for i in range(passes.b.size):
        passes.b[i] -= now.alpha0 * passes.lean[i]  # the QP is posed for q̇ − u/τ
    if rubs:
        first_guess(run)
    if k > bodies.shape[0]:
        gather_columns(
            *(g_N, run.ends.tangent, bodies, frictions.row, frictions.tangential, entries, pairs)
        )
    if trial.asks == 0:
        dense_columns(entries, pairs, D, passes.A)
    now.stage, now.number, now.solves, now.supplied = POSE, 0, 0, 0
    now.corrects = 1 if rubs and settings.corrects else 0
    now.depends = 1 if settings.depends else 0
    now.stuck, now.asks, now.next_only = trial.stuck, trial.asks, 0
    now.most = STUCK_PASSES if trial.stuck > 0 else MAX_PASSES
    iterates = now.corrects > 0 or settings.depends
    now.eps0 = asked_accuracy(settings.eps, iterates)
    now.tolerance = 0.1 * settings.eps


@stage
def rejected_length(run):
    """A shorter h where the trial does not do, else ∞.

    It is the first step after a restart, whose local error is known only now; or, where that is to
    be checked, the error is much larger than (3.5) had it.
    """
    eps, trial, passes = run.settings.eps, run.trial[0], run.passes
    h, D = trial.h, run.passes.D
    if run.settings.fixed > 0.0 or trial.stuck > 0 or h <= SHORT:
        return inf
    if run.tally[0].steps == 0:
        return first_redone_length(h, first_order_step(weighted_norm(D, passes.a), eps))
    if trial.order == 1 or trial.redone >= REDONE:
        return inf
    change = weighted_norm(D, passes.a - run.state.a)
    return redone_length(h, second_order_error(change, h, run.clock[0].h), eps)


@stage
def friction_stops(run):
    """The h at which the first friction stops, ∞ where none does; `Ends` know of all."""
    contacts, ends, passes, h = run.contacts, run.ends, run.passes, run.trial[0].h
    arena, frictions = passes.arena, passes.frictions
    ends.slip_after[:] = column_speeds(*passes.tangents, passes.v, arena)
    ends.lengths[:] = stopping_lengths(
        contacts.signs, ends.slip, ends.slip_after, h, run.settings.eps, arena
    )
    sigma = forced_signs(frictions.signs, passes.lam_F, passes.bound, ends.slip_after, arena)
    first = inf
    for j in range(sigma.size):
        ends.at_bound[j] = sigma[j] != 0.0
        first = min(first, ends.lengths[j])
    return first


@stage
def judge(run, settled):
    """Whether the trial is the step, `LOOK`, or what else is to be done; `TRY`: a shorter one."""
    trial = run.trial[0]
    stop = friction_stops(run)
    if not settled:
        trial.longest = trial.h / 2
        return UNSETTLED
    shorter = rejected_length(run)
    if shorter < inf:
        trial.longest, trial.redone = shorter, trial.redone + 1
        return GOES_ON
    if stop < trial.h and not run.settings.cuts:
        return HELD
    if stop < SHORTEST_STEP:
        return STANDS
    if stop < trial.h * (1.0 - 1e-6):
        trial.located += 1
        trial.cut = stop if trial.located < STOP_TRIALS else min(stop, trial.h / 2)
        return GOES_ON
    return LOOK


@stage
def accept(run):
    """Make the end of the trial the newest time point, and keep it."""
    state, clock, tally, trial = run.state, run.clock[0], run.tally[0], run.trial[0]
    contacts, near, passes, ends = run.contacts, run.near, run.passes, run.ends
    m, N, F, n = ends.q.size, ends.phi.size, ends.slip.size, tally.taken
    for i in range(m):
        state.q[i] = ends.q[i]
        state.v_before[i], state.v[i] = state.v[i], passes.v[i]
        state.a_before[i], state.a[i] = state.a[i], passes.a[i]
    sink_levels(near.after, near.free, near.level)
    near.before[:] = near.after
    clock.time, clock.h, clock.wish = trial.t, trial.h, trial.wish
    tally.taken += 1
    tally.steps += 1
    # λ from before a restart is never extrapolated: (4.4), (4.3), (4.2) after a jump in q̇, and
    # (4.3), (4.3), (4.2) after one in q̈
    tally.known = min(tally.known + 1, tally.steps, 2)
    run.track[n, 0] = clock.time
    for i in range(m):
        run.track[n, 1 + i], run.track[n, 1 + m + i] = state.q[i], state.v[i]
    run.gaps[n] = inf
    for j in range(N):
        contacts.lam_before[j], contacts.lam[j] = contacts.lam[j], passes.lam_N[j]
        run.multipliers[n, j] = passes.lam_N[j]
        ends.phi[j] = ends.phi_after[j]
    for j in range(contacts.place.shape[0]):
        run.gaps[n] = min(run.gaps[n], ends.phi[j])
    run.stops.before[:] = run.stops.after
    for j in range(F):
        run.multipliers[n, N + j] = passes.lam_F[j]
        ends.slip[j] = ends.slip_after[j]


@stage
def feeds_back(run):
    """Whether sliding friction presses itself with a gain of 1 or more."""
    passes, frictions = run.passes, run.passes.frictions
    if not frictions.signs.any():
        return False
    (g_N, bodies), rubs = passes.normals, (frictions.friction_of, frictions.signs, frictions.mu)
    columns = g_N, run.ends.tangent, bodies
    return own_gains(*columns, passes.inverse_mass, *rubs, passes.arena).max() >= 1.0


@stage
def calm(run):
    """Step 4: whether the stepper has nothing to see to after an accepted step."""
    tally, settings, trial, ends, passes = (
        *(run.tally[0], run.settings, run.trial[0]),
        *(run.ends, run.passes),
    )
    watched = tally.watched > 0 or trial.looked > 0.0 or trial.stuck > 0
    if watched or passes.now[0].number > QUIET_PASSES or feeds_back(run):
        return False
    for j in range(ends.slip.size):
        slips = ends.at_bound[j] and abs(ends.slip[j]) > settings.eps
        if ends.lengths[j] <= trial.h or (slips and run.contacts.signs[j] == 0.0):
            return False
    speed = column_speeds(*passes.normals, passes.v, passes.arena)
    place, tol, part = run.contacts.place, run.shapes.contact_tol, run.shapes.corner_part
    for j in range(place.shape[0]):
        wide = contact_tolerance(tol, part, place[j, 0], place[j, 1])
        leaves = separates(ends.phi[j], speed[j], settings.drop_tol, wide)
        if leaves or speed[j] < -APPROACHING * settings.eps:
            return False
    for i in range(run.rows.stop.size):
        if run.rows.stop[i] > 0 and speed[place.shape[0] + i] > settings.drop_tol:
            return False
    return fastest_body(passes.D, passes.v) > settings.rest_speed


@stage
def after_step(run):
    """Why a call ends after an accepted step, or `GOES_ON`."""
    clock, tally, trial = run.clock[0], run.tally[0], run.trial[0]
    is_calm = calm(run)
    trial.longest = trial.cut = inf
    trial.looked, trial.tries, trial.redone, trial.located = 0.0, 0, 0, 0
    over = clock.until - clock.time <= SHORTEST_STEP
    if not is_calm or (over and tally.is_open == 0):
        return LOOK
    return AGAIN if over or tally.taken >= tally.most else GOES_ON


@kernel
def take_steps(run, solve, S, I, eps0, mode):
    """Take steps until something happens or there is no more room; `tally.ended` says why it ends.

    run : `problems.stepping.records.Steps`, whose arrays are updated
    solve, S, I, eps0, mode : see `problems.qp_kernel`
    """
    # what is in a tuple is lent: else it is counted each time who holds it
    run, S, I = in_place(lent(run)), lent(S), lent(I)
    tally, trial, used = run.tally[0], run.trial[0], run.passes.arena.used
    if trial.stage == LOOK_BACK:
        used[0], used[1] = 0, 0
        look_back(run)
        trial.stage = TRY
    while True:
        used[0], used[1] = 0, 0
        if trial.stage == TRY:
            tally.ended = begin(run)
            if tally.ended != GOES_ON:
                return
            trial.stage = FORCED
            if run.settings.supplied:
                tally.ended = FORCES
                return
        if trial.stage == FORCED:
            begin_passes(run)
            trial.stage = PASS
        tally.ended, mode = fixed_point(run.passes, solve, S, I, eps0, mode)
        if tally.ended == ANSWER or tally.ended == FORCES or tally.ended == GUESS:
            return
        trial.stage = TRY
        if tally.ended == FAILED:
            return
        tally.solves += run.passes.now[0].solves
        # so short a step, where everything may stick, is taken as it is
        settled = tally.ended != UNSETTLED or (trial.stuck > 0 and trial.h <= SHORT)
        tally.ended = judge(run, settled)
        if tally.ended != LOOK:
            tally.rejected += 1
            if tally.ended == GOES_ON:
                continue
            return
        accept(run)
        tally.ended = after_step(run)
        if tally.ended != GOES_ON:
            return
