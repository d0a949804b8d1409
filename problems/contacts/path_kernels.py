"""Along a step: where corners come to, what they miss and what they meet, compiled."""

from __future__ import annotations

import numpy as np

from problems.contacts.dips import ARRIVAL, first_dip, floor_of
from problems.kernels.arena import zeros
from problems.kernels.compiled import kernel

ROUNDING = 1e-12
"""A gap that closes by less than this has not changed [m]."""
FORGET_LEVEL = 1e-6
"""A reference level is forgotten once the corner is this far outside [m]."""
END_SLACK = 1e-6
"""How far a corner may pass the end of its edge before it has left it, per edge length."""
MEETING = 20 * ARRIVAL
"""How near a corner and a part must come to have met [m]: at a tip the gap is less than that."""


@kernel
def path_end(q0, velocity, curvature, h, q=None):
    """q0 + h (velocity + h curvature), (3n,), written to q."""
    if q is None:
        q = np.empty_like(q0)
    for i in range(q.size):
        q[i] = q0[i] + h * (velocity[i] + h * curvature[i])
    return q


@kernel
def largest_motion(before, after, radius):
    """The farthest that any point of a body has moved between q (3n,) `before` and `after`."""
    most = 0.0
    for b in range(radius.size):
        x, y = after[3 * b] - before[3 * b], after[3 * b + 1] - before[3 * b + 1]
        turn = abs(after[3 * b + 2] - before[3 * b + 2])
        most = max(most, np.sqrt(x * x + y * y) + radius[b] * turn)
    return most


@kernel
def ways(velocity, curvature, h, radius, arena=None):
    """Bound of how far any point of each body moves on a path, there and back, (n + 1,) [m].

    velocity, curvature : those of `path_end`;  the last entry is that of the ground, 0
    """
    way = zeros(arena, radius.size + 1)
    for b in range(radius.size):
        i, j, l = 3 * b, 3 * b + 1, 3 * b + 2
        x = max(abs(velocity[i]), abs(velocity[i] + 2 * h * curvature[i]))
        y = max(abs(velocity[j]), abs(velocity[j] + 2 * h * curvature[j]))
        turn = max(abs(velocity[l]), abs(velocity[l] + 2 * h * curvature[l]))
        way[b] = h * (np.sqrt(x * x + y * y) + radius[b] * turn)
    return way


@kernel
def miss(before, after, way):
    """Whether corners and parts (N,), or one of each, whose gaps are `before` and `after` on a path
    [m], cannot have met on it.

    way : bound of how far points of both move, together [m].  The distance of the two, which is no
    less than a gap, falls to 0 and grows again by no more than that.
    """
    return np.maximum(0.0, before) + np.maximum(0.0, after) > way + MEETING


@kernel
def ends_inside(before, after):
    """Whether gaps (N,) or one gap, which may have been negative `before`, end below 0 [m]."""
    return after < np.minimum(0.0, before) - ROUNDING


@kernel
def beyond_edge(along, length):
    """Whether corners (N,) or one corner, so far `along` their edges, are past an end of them."""
    slack = END_SLACK * length
    return (along < -slack) | (along > length + slack)


@kernel
def contact_tolerance(contact_tol, corner_part, corner, part):
    """The lesser `Geometry.contact_tol` of both parts [m]."""
    return min(contact_tol[corner_part[corner]], contact_tol[part])


@kernel
def enters(path, h, gaps, bodies, local, edges, scratch):
    """Whether a corner ends below its reference level in a part, or dips into it on the way.

    gaps : its clearances at the two ends of the path, and the level [m];  others : see `first_dip`
    """
    before, after, level = gaps
    if ends_inside(before - level, after - level):
        return True
    return first_dip(path, h, bodies, local, edges, floor_of(before, level), scratch)[1] <= h


@kernel
def sink_levels(clearance, free, level):
    """`Candidates.note_clearances`; level (L,) is modified."""
    for i in range(level.size):
        if free[i]:
            if level[i] < 0.0 and clearance[i] > FORGET_LEVEL:
                level[i] = 0.0
            elif clearance[i] < level[i] - ROUNDING:
                level[i] = clearance[i]
