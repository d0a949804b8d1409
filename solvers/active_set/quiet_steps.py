"""Steps of algorithm 1 in which nothing happens, many in one compiled call.

Between events a step is always the same: AB-r, columns, one QP, BDF-r, the length of the next.
Taken one by one from Python each costs a hundred times what its arithmetic does.  Here they are
taken until something calls for the stepper (`problems.quiet`): a corner that crosses an edge or
leaves one, a contact that separates, a scheduled time, bodies that are still, a QP that is not
solved.  Without friction and with forces that are constant in the meantime; that is what `Stepper`
does otherwise, up to rounding.
"""

from __future__ import annotations

from math import hypot, inf, sqrt

import numpy as np

from problems.contact_kernels import clearances, column_speeds, contact_columns, place_corners
from problems.quiet import (
    A_BEFORE,
    CONTACT_TOL,
    DROP_TOL,
    END_SLACK,
    EPS,
    FIXED,
    FORGET,
    GROWTH,
    H_MAX,
    HIGHEST,
    REACH,
    REST_SPEED,
    ROUNDING,
    SAFETY,
    SHORTEST,
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
from solvers.active_set.compiled import kernel
from solvers.active_set.loop import SOLVED, WARM, algorithm_2
from solvers.active_set.workspace import COUNTS, STATUS, X


@kernel
def largest_motion(before, after, radius):
    """Bound of how far any point has moved from q `before` to q `after` [m]."""
    most = 0.0
    for b in range(radius.size):
        i = 3 * b
        turn = radius[b] * abs(after[i + 2] - before[i + 2])
        most = max(most, hypot(after[i] - before[i], after[i + 1] - before[i + 1]) + turn)
    return most


@kernel
def next_length(state, reals, steps, order, D):
    """Step 1: h from (3.5) with its limits, as `Stepper._step_length`."""
    if reals[FIXED] > 0.0:
        return reals[FIXED]
    h = min(reals[WISH] if steps == 0 else reals[GROWTH] * reals[WISH], reals[H_MAX])
    if steps > 0:
        total = 0.0
        for i in range(D.size):
            change = state[A, i] - (state[A_BEFORE, i] if order == 2 else 0.0)
            total += (D[i] * change) ** 2
        size, allowed = sqrt(total), inf
        if order == 1 and size > 0.0:
            allowed = 2 * reals[EPS] / size
        elif size > 0.0:
            half = 0.75 * reals[H]
            allowed = sqrt(half * half + 6 * reals[EPS] * reals[H] / size) - half
        h = min(h, reals[SAFETY] * allowed)
    return max(h, 10 * reals[SHORTEST])


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
def quiet_steps(run, columns, A_posed, d, d_posed, S, I, eps0, mode):
    """Take steps until something happens or `track` is full; `counts[TAKEN]` of them.

    run : `problems.quiet.QuietSteps`, whose arrays are updated
    columns, d : (3n, N) zeros and (3n,), written to;  A_posed, d_posed : the same memory, read only
    S, I, eps0, mode : see `algorithm_2`
    """
    shapes, D, f, place = run.shapes, run.D, run.forces, run.place
    corner, part, level = run.corner, run.part, run.level
    state, reals, counts = run.state, run.reals, run.counts
    edges = shapes.part_body, shapes.edge_normal, shapes.edge_offset
    m, k = D.size, place.shape[0]
    q, v, a, r = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    before = np.empty(corner.size)
    known = False
    while counts[TAKEN] < run.gaps.size:
        steps = counts[STEPS]
        order = 1 if steps < 2 else counts[HIGHEST]
        h = next_length(state, reals, steps, order, D)
        if reals[TIME] + h >= reals[UNTIL]:
            return
        for i in range(m):  # (3.1a)
            bend = (state[V, i] - state[V_BEFORE, i]) / (2 * reals[H]) if order == 2 else 0.0
            q[i] = state[Q, i] + h * (state[V, i] + h * bend)
        if not largest_motion(run.listed_at, q, shapes.radius) <= reals[REACH]:
            counts[STALE] = min(counts[TAKEN], 1)
            return
        corners, centres, cosine, sine = place_corners(q, shapes.corner_body, shapes.corner_local)
        pose = corners, centres, cosine, sine
        if not known:
            for i in range(m):
                v[i] = state[Q, i]
            start = place_corners(v, shapes.corner_body, shapes.corner_local)
            before[:] = clearances(*start, corner, part, *edges)
            known = True
        after = clearances(*pose, corner, part, *edges)
        for i in range(corner.size):
            least = min(0.0, before[i] - level[i]) - reals[ROUNDING]
            if after[i] - level[i] < least and not covered(
                i, corner, part, shapes.corner_part, place, corners, reals[CONTACT_TOL]
            ):
                return
        phi, along, g_N, _, bodies, _ = contact_columns(
            *pose, place, shapes.corner_body, *edges, shapes.edge_start
        )
        for j in range(k):
            length = shapes.edge_length[place[j, 1], place[j, 2]]
            slack = reals[END_SLACK] * length
            if along[j] < -slack or along[j] > length + slack:
                return
        alpha0 = 1.0
        w = h / reals[H] if order == 2 else 0.0
        if order == 2:
            alpha0 = (1 + 2 * w) / (1 + w)
        for i in range(m):  # (3.1b)
            b = state[V, i]
            if order == 2:
                b = (1 + w) * b - w * w / (1 + w) * state[V_BEFORE, i]
            a[i] = b
            r[i] = d[i] = D[i] * (f[i] / (D[i] * D[i]) + b / h)
        if k > 0:  # (3.2)
            columns[:] = 0.0
            for j in range(k):
                for side in range(2):
                    b = bodies[j, side]
                    if b >= 0:
                        for e in range(3):
                            columns[3 * b + e, j] = g_N[j, 3 * side + e] / D[3 * b + e]
            algorithm_2(A_posed, d_posed, run.lower, run.upper, run.row_id, S, I, eps0, mode)
            mode |= WARM
            counts[SOLVES] += 1
            if I[COUNTS, STATUS] != SOLVED:
                return
            for i in range(m):
                for j in range(k):
                    r[i] += columns[i, j] * S[X, j]
        size = 0.0
        for i in range(m):
            v[i] = h / alpha0 * r[i] / D[i]
            a[i] = (alpha0 * v[i] - a[i]) / h
            size += (D[i] * a[i]) ** 2
        if steps == 0 and reals[FIXED] <= 0.0 and h * sqrt(size) > 2 * reals[EPS]:
            return
        # accepted
        for i in range(m):
            state[Q, i] = q[i]
            state[V_BEFORE, i], state[V, i] = state[V, i], v[i]
            state[A_BEFORE, i], state[A, i] = state[A, i], a[i]
        reals[TIME] += h
        reals[H] = reals[WISH] = h
        for i in range(corner.size):
            before[i] = after[i]
            if level[i] < 0.0 and after[i] > reals[FORGET]:
                level[i] = 0.0
            elif after[i] < level[i] - reals[ROUNDING]:
                level[i] = after[i]
        n = counts[TAKEN]
        track = run.track[n]
        track[0] = reals[TIME]
        least_gap = inf
        for i in range(m):
            track[1 + i], track[1 + m + i] = q[i], v[i]
        for j in range(k):
            run.multipliers[n, j] = S[X, j]
            least_gap = min(least_gap, phi[j])
        run.gaps[n] = least_gap
        counts[TAKEN] += 1
        counts[STEPS] += 1
        fastest = 0.0
        for b in range(m // 3):
            total = 0.0
            for i in range(3 * b, 3 * b + 3):
                total += (D[i] * v[i]) ** 2
            fastest = max(fastest, total)
        if sqrt(fastest) <= reals[REST_SPEED]:
            return
        speed = column_speeds(g_N, bodies, v)
        for j in range(k):
            if speed[j] > reals[DROP_TOL] or speed[j] < -10 * reals[EPS]:
                return
