"""The arithmetic of one time step, compiled: what is done at every step, whether or not anything
happens.  What the formulas mean is said in `problems.stepping.events` and
`problems.stepping.velocity`.
"""

from __future__ import annotations

import numpy as np

import problems.formulas.multistep as multistep
from problems.contacts.geometry_kernels import (
    column_speeds,
    contact_columns,
    least_overlap,
    room_for_columns,
)
from problems.kernels.arena import numbers
from problems.kernels.compiled import kernel

second_order_bdf = kernel(multistep.second_order_bdf)
first_order_step = kernel(multistep.first_order_step)
second_order_step = kernel(multistep.second_order_step)

STOPPED = 0.01
"""A contact that slips slower than this, in ε, has stopped."""
APPROACHING = 10.0
"""… and an active one that approaches faster than this was not what the QP says."""

FAR_TOO_DEEP = 10.0
"""Overlap of which a run tells, whatever holds the parts now, over what drift may leave."""

AJAR = 10.0
"""A contact that is open by more than so many `contact_tol` is none any more, …"""
OPENING = 0.01
"""… if it opens faster than this, in `drop_tol`: less is what solvers leave of g_Nᵀq̇ = 0."""


@kernel
def path_curvature(order, v, v_before, h_before, bend):
    """The curvature (3n,) of AB-r (3.1a), q_n = q + h (q̇ + h curvature), written to bend."""
    for i in range(bend.size):
        bend[i] = (v[i] - v_before[i]) / (2 * h_before) if order == 2 else 0.0


@kernel
def bdf(order, w, v, v_before, b):
    """α₀ of BDF-r (3.1b); b_n = −Σ_{i≥1} α_i q̇_{n−i} (3n,) is written to b.  w = h_n/h_{n−1}."""
    alpha0, newest, oldest = second_order_bdf(w) if order == 2 else (1.0, 1.0, 0.0)
    for i in range(b.size):
        b[i] = newest * v[i] - oldest * v_before[i]
    return alpha0


@kernel
def predicted(steps, h, w, v, a, a_before, guess):
    """q̇_n⁽⁰⁾ (3n,) for (3.9): q̇_{n−1}, AB-1 or AB-2 on q̈, by what `steps` have made available."""
    now, before = (0.0, 0.0) if steps == 0 else (1.0, 0.0) if steps == 1 else (1 + w / 2, w / 2)
    for i in range(guess.size):
        guess[i] = v[i] + h * (now * a[i] - before * a_before[i])


@kernel
def longest_step(D, order, a, a_before, h_before, eps, arena=None):
    """Largest h whose local error in q_n meets (3.5), ‖ℓ_n‖_M ≤ h ε; ∞ where it is 0.

    AB-1: ℓ = ½h² q̈.  AB-2: ℓ = h² (h/6 + h_{n−1}/4) q⃛, q⃛ ≈ (q̈_{n−1} − q̈_{n−2})/h_{n−1}.
    """
    if order == 1:
        return first_order_step(weighted_norm(D, a), eps)
    change = numbers(arena, a.size)
    for i in range(a.size):
        change[i] = a[i] - a_before[i]
    return second_order_step(weighted_norm(D, change) / h_before, h_before, eps)


@kernel
def separates(gap, speed, drop_tol, contact_tol):
    """Whether contacts (N,) or one contact, with g_Nᵀq̇ = `speed`, leave J_N (step 4).

    One that opens slowly does once it is wide open: what presses it shut again must meet a gap.
    contact_tol : (N,) or a number, see `contact_tolerance`
    """
    ajar = (gap > AJAR * contact_tol) & (speed > OPENING * drop_tol)
    return (speed > drop_tol) | ajar


@kernel
def next_overlap(begin, pairs, allowed, motion, pose, places, parts, tables):
    """The first pair from `begin` on that should not overlap as it does at the end of a path.

    pairs : (P, 2) parts that are near;  allowed : overlap that drift may leave [m]
    motion : velocity, curvature (3n,) and h of the path;  pose : at its end
    places : (N, 3) of J_N;  parts : first corner and size of each part, radius of each body
    tables : `Geometry.tables`

    −1 where there is none.  A pair may overlap by more where a constraint of J_N is just there, or
    where its parts leave each other; but not by `FAR_TOO_DEEP` times as much.
    """
    (velocity, curvature, h), (first, size, radius) = motion, parts
    corner_body, _, part_body, normal, offset, start, length = tables
    centres = pose[1]
    for i in range(begin, pairs.shape[0]):
        one, two = pairs[i, 0], pairs[i, 1]
        a, b = part_body[one], part_body[two]
        if a >= 0 and b >= 0:
            x, y = centres[a, 0] - centres[b, 0], centres[a, 1] - centres[b, 1]
            reach = radius[a] + radius[b]
            if x * x + y * y > reach * reach:
                continue
        depth, c, p, e = least_overlap(
            pose, one, two, allowed, (first, size, part_body), (normal, offset)
        )
        if depth < allowed:
            continue
        if depth >= FAR_TOO_DEEP * allowed:
            return i
        held = False
        for j in range(places.shape[0]):
            held |= places[j, 0] == c and places[j, 1] == p and places[j, 2] == e
        if held:
            continue
        columns = room_for_columns(1)
        contact_columns(
            *(*pose, np.array([[c, p, e]]), corner_body, part_body),
            *(normal, offset, start, length, columns),
        )
        if column_speeds(columns[1], columns[3], velocity + 2 * h * curvature)[0] < 0.0:
            return i
    return -1


@kernel
def momentum(b, force, D, h, limit, d=None):
    """d = D b/h + D⁻ᵀ f (3.2), (m,), and whether its entries are numbers up to ±limit."""
    if d is None:
        d = np.empty_like(b)
    within = True
    for i in range(b.size):
        d[i] = D[i] * b[i] / h + force[i] / D[i]
        if not abs(d[i]) <= limit:
            within = False
    return d, within


@kernel
def outcome(entries, bodies, x, b, d, D, h, alpha0, v=None, a=None):
    """q̇ = (h/α₀) D⁻¹ (A x + d) and q̈ = (α₀ q̇ − b)/h (3.1b), (m,).

    entries (k, 6), bodies (k, 2) : the columns of G that x (k,) belongs to
    """
    if v is None or a is None:
        v, a = np.empty_like(d), np.empty_like(d)
    v[:] = 0.0
    for j in range(x.size):
        if x[j] != 0.0:
            for side in range(2):
                body = bodies[j, side]
                if body >= 0:
                    for l in range(3):
                        v[3 * body + l] += entries[j, 3 * side + l] * x[j]
    for i in range(v.size):
        v[i] = h / alpha0 * (v[i] / D[i] + d[i]) / D[i]
        a[i] = (alpha0 * v[i] - b[i]) / h
    return v, a


@kernel
def stopping_lengths(signs, before, after, h, eps, arena=None):
    """h at which each sliding contact stops (F,), by linear interpolation of g_Fᵀq̇; else ∞.

    signs : (F,) s, 0 of a sticking one;  before, after : (F,) g_Fᵀq̇ at the ends of a step h
    A contact that slips slower than `STOPPED` ε at h has stopped there.
    """
    lengths = numbers(arena, signs.size)
    for j in range(signs.size):
        lengths[j] = np.inf
        if signs[j] == 0.0:
            continue
        if abs(after[j]) <= STOPPED * eps:
            lengths[j] = h
        elif before[j] * after[j] < 0.0:
            lengths[j] = h * before[j] / (before[j] - after[j])
    return lengths


@kernel
def weighted_norm(D, v):
    """‖v‖_M = ‖D v‖₂ (2.19)."""
    total = 0.0
    for i in range(v.size):
        total += (D[i] * v[i]) ** 2
    return np.sqrt(total)


@kernel
def fastest_body(D, v):
    """max_i ‖q̇_i‖_M over the bodies."""
    most = 0.0
    for b in range(v.size // 3):
        total = 0.0
        for i in range(3 * b, 3 * b + 3):
            total += (D[i] * v[i]) ** 2
        most = max(most, total)
    return np.sqrt(most)
