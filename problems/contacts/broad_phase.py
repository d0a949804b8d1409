"""The broad phase, compiled: corners that come near other parts, by sort and sweep along x."""

from __future__ import annotations

import numpy as np

from problems.contacts.geometry_kernels import oval_from
from problems.contacts.round_kernels import is_round, oval_clearance
from problems.kernels.compiled import kernel


@kernel
def boxes(corners, first, size, moving):
    """Axis-aligned boxes (P, 4) of the moving parts: least x and y, greatest x and y."""
    box = np.empty((moving, 4))
    for p in range(moving):
        box[p, 0] = box[p, 1] = np.inf
        box[p, 2] = box[p, 3] = -np.inf
        for c in range(first[p], first[p] + size[p]):
            for j in range(2):
                reach = np.sqrt(corners[c, 2] ** 2 + corners[c, 3 + j] ** 2)
                box[p, j] = min(box[p, j], corners[c, j] - reach)
                box[p, 2 + j] = max(box[p, 2 + j], corners[c, j] + reach)
    return box


@kernel
def add_near(found, count, one, other, margin, pose, first, size, part_body, normal, offset):
    """Append to found (·, 2) from `count` on the corners of part `one` within `margin` of `other`.

    What is round and a polygon are one pair, of the centre of the one and the other, whatever of it
    is near; two that are round the centre of the first and the second.

    Returns found, made longer where it was full, and the count.
    """
    corners, centres, cosine, sine = pose
    b = part_body[other]
    if is_round(normal[other], 0) and (corners[first[one], 2] == 0.0 or one > other):
        return found, count
    for c in range(first[one], first[one] + size[one]):
        x, y = corners[c, 0] - centres[b, 0], corners[c, 1] - centres[b, 1]
        local_x, local_y = cosine[b] * x + sine[b] * y, cosine[b] * y - sine[b] * x
        most = -np.inf
        if corners[c, 2] > 0.0:
            oval = oval_from(corners, centres, cosine, sine, c, b)
            most = oval_clearance(oval, normal[other], offset[other])[0]
        else:
            for e in range(offset.shape[1]):
                value = normal[other, e, 0] * local_x + normal[other, e, 1] * local_y
                most = max(most, value - offset[other, e])
        if most <= margin:
            if count == found.shape[0]:
                longer = np.empty((2 * count, 2), dtype=np.int64)
                longer[:count] = found
                found = longer
            found[count, 0], found[count, 1] = c, other
            count += 1
    return found, count


@kernel
def near_corners(
    corners, centres, cosine, sine, margin, moving, first, size, part_body, normal, offset
):
    """Corners and parts (L,), (L,) of different bodies within `margin` [m] of each other.

    moving : parts of bodies; those after them are half planes
    """
    pose = corners, centres, cosine, sine
    box = boxes(corners, first, size, moving)
    order = np.argsort(box[:, 0], kind="mergesort")
    found, count = np.empty((64, 2), dtype=np.int64), 0
    for place in range(moving):
        p = order[place]
        for rival in range(place + 1, moving):
            r = order[rival]
            if box[r, 0] > box[p, 2] + margin:
                break
            apart = box[r, 1] > box[p, 3] + margin or box[p, 1] > box[r, 3] + margin
            if apart or part_body[p] == part_body[r]:
                continue
            for one, other in ((p, r), (r, p)):
                found, count = add_near(
                    found, count, one, other, margin, pose, first, size, part_body, normal, offset
                )
        for plane in range(moving, part_body.size):
            found, count = add_near(
                found, count, p, plane, margin, pose, first, size, part_body, normal, offset
            )
    return found[:count, 0].copy(), found[:count, 1].copy()


@kernel
def free_pairs(corner, part, active, n_corners):
    """Whether each pair (L,) of a corner and a part is none of the places (N, 3)."""
    # the places of a corner form a chain
    newest, older = np.full(n_corners, -1), np.empty(active.shape[0], dtype=np.int64)
    for i in range(active.shape[0]):
        older[i] = newest[active[i, 0]]
        newest[active[i, 0]] = i
    free = np.ones(corner.size, dtype=np.bool_)
    for l in range(corner.size):
        i = newest[corner[l]]
        while i >= 0:
            if active[i, 1] == part[l]:
                free[l] = False
            i = older[i]
    return free
