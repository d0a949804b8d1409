"""Corners that were inside a part before the end of a step, if only for a while.

A corner can cut off the tip of a part within one step.  Afterwards the edges of the two bodies
cross, with no corner of either inside the other, and no corner would ever tell, or one that comes
down on another edge, from the wrong side, too late.  Two tips that meet exactly, as those of
triangles that slide on the ground, are never inside each other at all; so a corner that comes from
afar has a `floor` a little above 0.

A stretch of the path is free of dips where a single edge keeps the corner out all along it:
φ_e at its two ends is not below the curvature of φ_e over it, C s²/8 for a stretch of length s.
Other stretches are halved, the earlier half first, until a point inside the part turns up or all
are free.  With c the corner and a, b its body and the part's,

    C = |c̈ − ẍ_b| + 2 |ω_b| |ċ − ẋ_b| + (ω_b² + |α_b|) |c − x_b|

at its largest on the whole path, on which accelerations are constant (3.1a).

What is said of an edge holds of any direction u that turns with the part: with p the point of the
part that is farthest along u, the distance of c is at least φ_u = u·(c − p), and |φ̈_u| ≤ C for
|u| = 1.  A disc, which a corner of the part may keep out where no edge does, is kept out over a
stretch where φ_u ≥ ρ for the direction u from the nearest point of the part to the disc's centre at
either end of it.  A part that is a disc itself is not followed in its turning, and C is |c̈ − ẍ_b|.

An ellipse is kept out where φ_u ≥ h(u) (`problems.contacts.round_kernels`), and to C is added what
h may bend upwards as it turns in the part's coordinates, with ω and α its own less the part's: of
−ḧ = −h'' ω² − h' α no more than (a² − b²)/a ω² + (a − b) |α|.
"""

from __future__ import annotations

import numpy as np

from problems.bodies.path import Path
from problems.contacts.geometry import Geometry
from problems.contacts.round_kernels import (
    corner_between,
    edges_of,
    is_oblong,
    is_round,
    nearest_feature,
    nearest_to_oblong,
    oval_clearance,
    support,
)
from problems.kernels.compiled import kernel
from problems.qp import Indices, Vector

SHALLOW = 1e-9
"""Depth of a dip that is let pass [m]."""
ARRIVAL = 5e-8
"""How near a corner must come, from farther away, to have hit a part [m]."""
MAX_HALVINGS = 50


def dips(
    geometry: Geometry, path: Path, h: float, corner: Indices, part: Indices, floor: Vector
) -> tuple[Vector, Vector]:
    """The first stretches (start, end) of the path found at whose end a corner is below its floor.

    floor : (N,) clearance that counts as 0, not above that at the start of the path [m]

    Both (N,), inf where there is none.
    """
    return find_dips(path.parts, h, corner, part, floor, geometry.tables)


@kernel
def floor_of(clearance, level):
    """What a corner must not fall below on a path that starts at `clearance`, both [m].

    level : its reference level
    """
    return level + (ARRIVAL if clearance - level > ARRIVAL else min(0.0, clearance - level))


@kernel
def floors(clearance, level):
    """The same of N corners."""
    floor = np.empty(clearance.size)
    for i in range(clearance.size):
        floor[i] = floor_of(clearance[i], level[i])
    return floor


@kernel
def _edge_distances(path, h, bodies, local, edges, phi):
    """φ of a corner against every edge of a part at q + h (velocity + h curvature), into phi."""
    (q, velocity, curvature), (a, b), (normal, offset) = path, bodies, edges
    place = np.zeros((2, 3))
    for side in range(2):
        body = a if side == 0 else b
        if body >= 0:
            for j in range(3):
                i = 3 * body + j
                place[side, j] = q[i] + h * (velocity[i] + h * curvature[i])
    c, s = np.cos(place[0, 2]), np.sin(place[0, 2])
    x = place[0, 0] + c * local[0] - s * local[1] - place[1, 0]
    y = place[0, 1] + s * local[0] + c * local[1] - place[1, 1]
    c, s = np.cos(place[1, 2]), np.sin(place[1, 2])
    local_x, local_y = c * x + s * y, c * y - s * x
    for e in range(offset.size):
        phi[e] = normal[e, 0] * local_x + normal[e, 1] * local_y - offset[e]


@kernel
def _curvature_bound(path, h, bodies, radius):
    """C of the module's head for one corner, at `radius` from the centre of its body a."""
    (q, velocity, curvature), (a, b) = path, bodies
    speed, distance, spin_a, spin_b = 0.0, 0.0, 0.0, 0.0
    bend = np.zeros(3)
    for end in range(2):
        step = h * end
        apart, relative = np.zeros(2), np.zeros(2)
        for sign, body in ((1.0, a), (-1.0, b)):
            if body < 0:
                continue
            i = 3 * body
            for j in range(2):
                apart[j] += sign * (q[i + j] + step * (velocity[i + j] + step * curvature[i + j]))
                relative[j] += sign * (velocity[i + j] + 2 * step * curvature[i + j])
                if end == 0:
                    bend[j] += sign * 2 * curvature[i + j]
            spin = abs(velocity[i + 2] + 2 * step * curvature[i + 2])
            if sign > 0:
                spin_a = max(spin_a, spin)
            else:
                spin_b = max(spin_b, spin)
        distance = max(distance, np.hypot(apart[0], apart[1]) + radius)
        speed = max(speed, np.hypot(relative[0], relative[1]))
    speed += spin_a * radius
    turn_a = 2 * abs(curvature[3 * a + 2])
    turn_b = 2 * abs(curvature[3 * b + 2]) if b >= 0 else 0.0
    acceleration = np.hypot(bend[0], bend[1]) + (turn_a + spin_a * spin_a) * radius
    # the distance is largest inside the stretch at most by what the speed can add
    far = distance + speed * h
    return acceleration + 2 * spin_b * speed + (spin_b * spin_b + turn_b) * far


@kernel
def _wobble(path, h, bodies, b, k):
    """What the turning of an ellipse adds to C."""
    (_, velocity, curvature), (one, other) = path, bodies
    spin = 0.0
    for step in (0.0, h):
        relative = velocity[3 * one + 2] + 2 * step * curvature[3 * one + 2]
        if other >= 0:
            relative -= velocity[3 * other + 2] + 2 * step * curvature[3 * other + 2]
        spin = max(spin, abs(relative))
    turn = 2 * curvature[3 * one + 2] - (2 * curvature[3 * other + 2] if other >= 0 else 0.0)
    a = np.sqrt(b * b + k * k)
    return k * k / a * spin * spin + (a - b) * abs(turn)


@kernel
def _oval_at(path, h, bodies, local, turns):
    """The oval of a disc or an ellipse at q + h (velocity + h curvature), from the part's centre.

    turns : whether that is in the coordinates of the part's body
    """
    (q, velocity, curvature), (a, b) = path, bodies
    place = np.zeros((2, 3))
    for side in range(2):
        body = a if side == 0 else b
        if body >= 0:
            for j in range(3):
                i = 3 * body + j
                place[side, j] = q[i] + h * (velocity[i] + h * curvature[i])
    x, y = place[0, 0] - place[1, 0], place[0, 1] - place[1, 1]
    k_x = k_y = 0.0
    if local[3] > 0.0:
        k_x, k_y = local[3] * np.cos(place[0, 2]), local[3] * np.sin(place[0, 2])
    if not turns:
        return x, y, local[2], k_x, k_y
    c, s = np.cos(place[1, 2]), np.sin(place[1, 2])
    return c * x + s * y, c * y - s * x, local[2], c * k_x + s * k_y, c * k_y - s * k_x


@kernel
def _direction_from(x, y, normal, offset):
    """u from the nearest point of a part, no ellipse, to (x, y), and u·p of that point."""
    distance, e = nearest_feature(x, y, normal, offset)
    if is_round(normal, 0):
        size = max(np.hypot(x, y), 1e-300)
        return x / size, y / size, offset[0]
    if e < offset.size:
        return normal[e, 0], normal[e, 1], offset[e]
    i = e - offset.size
    p, r = corner_between((i - 1) % edges_of(offset), i, normal, offset)
    size = max(distance, 1e-300)
    u_x, u_y = (x - p) / size, (y - r) / size
    return u_x, u_y, u_x * p + u_y * r


@kernel
def _kept_out(one, other, edges, sag, level):
    """Whether the direction at the first of two ovals keeps them out between these."""
    normal, offset = edges
    if is_oblong(one, normal, offset):
        here, _, u_x, u_y = nearest_to_oblong(one, normal, offset)
        there = here + u_x * (other[0] - one[0]) + u_y * (other[1] - one[1])
        there += support(u_x, u_y, one[2], one[3], one[4])[0]
        there -= support(u_x, u_y, other[2], other[3], other[4])[0]
    else:
        u_x, u_y, far = _direction_from(one[0], one[1], normal, offset)
        far += one[2]
        here, there = u_x * one[0] + u_y * one[1] - far, u_x * other[0] + u_y * other[1] - far
    return min(here, there) - sag >= level


@kernel
def first_dip_of_oval(path, h, bodies, local, edges, floor, right):
    """`first_dip` of a disc or an ellipse; right : (MAX_HALVINGS + 2,) is written to."""
    normal, offset = edges
    curvature, (a, b) = path[2], bodies
    oblong = is_oblong((0.0, 0.0, local[2], local[3], 0.0), normal, offset)
    turns = oblong or not is_round(normal, 0)
    if turns:
        bend = _curvature_bound(path, h, bodies, 0.0)
    else:
        x, y = curvature[3 * a] - curvature[3 * b], curvature[3 * a + 1] - curvature[3 * b + 1]
        bend = 2 * np.hypot(x, y)
    if local[3] > 0.0:
        bend += _wobble(path, h, bodies, local[2], local[3])
    level = floor - SHALLOW
    start, top = 0.0, 0
    right[0] = h
    while top >= 0:
        length = right[top] - start
        one = _oval_at(path, start, bodies, local, turns)
        other = _oval_at(path, right[top], bodies, local, turns)
        sag = bend * length * length / 8
        inside = oval_clearance(other, normal, offset)[0] < level
        if top == MAX_HALVINGS and inside:
            return start, right[top]
        free = _kept_out(one, other, edges, sag, level) or _kept_out(other, one, edges, sag, level)
        if free or top == MAX_HALVINGS:
            start = right[top]
            top -= 1
            continue
        middle = start + length / 2
        top += 1
        right[top] = middle
        between = _oval_at(path, middle, bodies, local, turns)
        if oval_clearance(between, normal, offset)[0] < level:
            return start, middle
    return np.inf, np.inf


@kernel
def first_dip(path, h, bodies, local, edges, floor, scratch):
    """Start and end of the first stretch found at whose end a corner of body a is below its floor.

    Both are inf where there is none.

    path : q, velocity and curvature of `Path`;  bodies : a, b, those of the corner and of the part
    local : (4,) the corner in its body, and b and |k| of what is round about it
    edges : normals (E, 2) and offsets (E,) of the part
    scratch : (MAX_HALVINGS + 2, E), (MAX_HALVINGS + 2,), (E,)
    """
    phi, right, left = scratch
    if local[2] > 0.0:
        return first_dip_of_oval(path, h, bodies, local, edges, floor, right)
    bend = _curvature_bound(path, h, bodies, np.hypot(local[0], local[1]))
    level = floor - SHALLOW
    start, top = 0.0, 0
    right[0] = h
    _edge_distances(path, 0.0, bodies, local, edges, left)
    _edge_distances(path, h, bodies, local, edges, phi[0])
    while top >= 0:
        length = right[top] - start
        sag = bend * length * length / 8
        free = False
        for e in range(left.size):
            if min(left[e], phi[top, e]) - sag >= level:
                free = True
                break
        if top == MAX_HALVINGS and phi[top].max() < level:
            return start, right[top]
        if free or top == MAX_HALVINGS:
            start = right[top]
            left[:] = phi[top]
            top -= 1
            continue
        middle = start + length / 2
        top += 1
        right[top] = middle
        _edge_distances(path, middle, bodies, local, edges, phi[top])
        if phi[top].max() < level:
            return start, middle
    return np.inf, np.inf


@kernel
def find_dips(path, h, corner, part, floor, tables):
    """The same as `dips` from arrays: of a path, and `Geometry.tables`."""
    corner_body, corner_local, part_body, normal, offset = tables[:5]
    count, edges = corner.size, offset.shape[1]
    starts, ends = np.empty(count), np.empty(count)
    scratch = (
        np.empty((MAX_HALVINGS + 2, edges)),
        np.empty(MAX_HALVINGS + 2),
        np.empty(edges),
    )
    for i in range(count):
        c, p = corner[i], part[i]
        bodies, sides = (corner_body[c], part_body[p]), (normal[p], offset[p])
        starts[i], ends[i] = first_dip(path, h, bodies, corner_local[c], sides, floor[i], scratch)
    return starts, ends
