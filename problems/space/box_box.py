"""Where two boxes touch: the axis that separates them best, and the points of contact along it.

 1. Of the 15 axes (faces of each, products of edges) that of the largest separation is the normal;
    an edge on an edge only where it separates more than every face by `PREFERENCE`, a face of the
    second box where it does more than one of the first by a tenth of that, or rounding would decide
 2. a face: the face of the other box that looks at it is cut by it.  Corners of one inside the
    other and crossings of their edges are the points of contact
 3. an edge on an edge: their nearest points

Corners of a face are numbered round it, and a feature by what it is made of, so that it keeps its
number while bodies move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from problems.qp import Vector
from problems.space.attitude import cross

PREFERENCE = 1e-4
"""How much more than a face two edges must separate, over the smaller box's least half side."""
SAME = 1e-9
"""Points nearer than this are one [m], and of edges this near to parallel there is no axis."""
ROUND = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=float)
"""Corners of a face, one after the other; edge i goes from corner i to the next."""
FACE, OTHER_FACE, EDGES = 0, 10_000, 20_000
"""Where the numbers of features begin: points on a face of the first box, of the second."""

Found = list[tuple[int, float, Vector, Vector]]
"""Feature, gap [m], place (3,), normal (3,) from the second box into the first."""


class BoxAt(NamedTuple):
    """centre (3,) [m];  R (3, 3) : its axes are the columns;  half (3,) sides [m]."""

    centre: Vector
    R: Vector
    half: Vector

    def extent(self, axes: Vector) -> Vector:
        """Half the length of its shadow on axes (k, 3)."""
        return np.asarray(np.abs(axes @ self.R) @ self.half)


def box_box(a: BoxAt, b: BoxAt, margin: float) -> Found:
    """Points of contact with gaps up to `margin` [m]."""
    edges = cross(a.R.T[:, None], b.R.T[None]).reshape(9, 3)
    length = np.linalg.norm(edges, axis=1)
    sound = np.flatnonzero(length > 1e-6)
    axes = np.vstack([a.R.T, b.R.T, edges[sound] / length[sound, None]])
    apart = a.centre - b.centre
    axes = np.where((axes @ apart)[:, None] < 0, -axes, axes)
    separation = axes @ apart - a.extent(axes) - b.extent(axes)
    if separation.max() > margin:
        return []
    face, other = int(np.argmax(separation[:3])), 3 + int(np.argmax(separation[3:6]))
    preference = PREFERENCE * min(a.half.min(), b.half.min())
    if separation[other] > separation[face] + 0.1 * preference:
        face = other
    crossed = 6 + int(np.argmax(separation[6:])) if sound.size else face
    if separation[crossed] > separation[face] + preference:
        return [_edge_on_edge(a, b, axes[crossed], int(sound[crossed - 6]))]
    if face < 3:
        return _on_face(a, b, face, -axes[face], FACE, margin)
    return _on_face(b, a, face - 3, axes[face], OTHER_FACE, margin)


def _edge_on_edge(a: BoxAt, b: BoxAt, n: Vector, which: int) -> tuple[int, float, Vector, Vector]:
    """The nearest points of the edges that look at each other."""
    i, j = divmod(which, 3)
    middle_a, code_a = _edge_towards(a, i, -n)
    middle_b, code_b = _edge_towards(b, j, n)
    u, w, between = a.R[:, i], b.R[:, j], middle_b - middle_a
    cosine = float(u @ w)
    s = (u @ between - cosine * (w @ between)) / (1 - cosine**2)
    t = (cosine * (u @ between) - w @ between) / (1 - cosine**2)
    one, two = middle_a + s * u, middle_b + t * w
    feature = EDGES + 1000 * which + 10 * code_a + code_b
    return feature, float(n @ (one - two)), 0.5 * (one + two), n


def _edge_towards(box: BoxAt, axis: int, n: Vector) -> tuple[Vector, int]:
    """Middle (3,) of the edge along an axis that is farthest along n, and its number."""
    side = np.where(box.R.T @ n >= 0, 1.0, -1.0)
    side[axis] = 0.0
    code = int((side > 0) @ (1, 2, 4))
    return box.centre + box.R @ (side * box.half), code


def _on_face(box: BoxAt, other: BoxAt, axis: int, n: Vector, base: int, margin: float) -> Found:
    """Points on the face of a box whose outer normal is n, beside the other's face towards it."""
    u, w = (axis + 1) % 3, (axis + 2) % 3
    half = box.half[[u, w]]
    against = other.R.T @ n
    k = int(np.argmax(np.abs(against)))
    side = -1.0 if against[k] > 0 else 1.0
    p, q = (k + 1) % 3, (k + 2) % 3
    local = np.zeros((4, 3))
    local[:, k], local[:, [p, q]] = side * other.half[k], ROUND * other.half[[p, q]]
    corners = (other.centre + local @ other.R.T - box.centre) @ box.R  # in axes of the box
    flat, depth = corners[:, [u, w]], corners[:, axis]
    up = 1.0 if n @ box.R[:, axis] > 0 else -1.0
    name = base + 1000 * (2 * axis + (up > 0)) + 100 * (2 * k + (side > 0))
    found: list[tuple[int, Vector]] = []
    for feature, place in _shared(flat, half):
        height = _height(flat, depth, place)
        at = np.zeros(3)
        at[[u, w]], at[axis] = place, height
        found.append((name + feature, at))
    outward = n if base == OTHER_FACE else -n
    # FACE: the normal of the first box points at the second, from which normals are told
    return [
        (feature, gap, box.centre + box.R @ at, outward)
        for feature, at in found
        if (gap := float(up * at[axis] - box.half[axis])) <= margin
    ]


def _shared(flat: Vector, half: Vector) -> list[tuple[int, Vector]]:
    """Corners of the area that a quadrangle (4, 2) shares with the rectangle |x| ≤ half, once each.

    Numbers: corners of the quadrangle 0 to 3, of the rectangle 4 to 7, crossings 8 to 23.
    """
    points = [(i, c) for i, c in enumerate(flat) if (np.abs(c) <= half + SAME).all()]
    points += [(4 + i, c) for i, c in enumerate(ROUND * half) if _inside(flat, c)]
    for i in range(4):
        start, way = flat[i], flat[(i + 1) % 4] - flat[i]
        for side in range(4):
            x, sign = side // 2, 1.0 if side % 2 else -1.0
            if abs(way[x]) <= SAME:
                continue
            share = (sign * half[x] - start[x]) / way[x]
            place = start + share * way
            if 0 <= share <= 1 and abs(place[1 - x]) <= half[1 - x]:
                points.append((8 + 4 * i + side, place))
    alone: list[tuple[int, Vector]] = []
    for feature, place in points:
        if all(np.abs(place - kept).max() > SAME for _, kept in alone):
            alone.append((feature, place))
    return alone


def _inside(flat: Vector, point: Vector) -> bool:
    """Whether a point is inside a convex quadrangle (4, 2), whichever way it goes round."""
    ways, to = np.roll(flat, -1, axis=0) - flat, point - flat
    turns = ways[:, 0] * to[:, 1] - ways[:, 1] * to[:, 0]
    return bool((turns >= 0).all() or (turns <= 0).all())


def _height(flat: Vector, depth: Vector, place: Vector) -> float:
    """Of the plane of the quadrangle at a place."""
    edges = np.array([flat[1] - flat[0], flat[3] - flat[0]])
    shares = np.linalg.solve(edges.T, place - flat[0])
    return float(depth[0] + shares @ (depth[1] - depth[0], depth[3] - depth[0]))
