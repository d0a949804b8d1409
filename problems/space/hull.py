"""Convex polyhedra: corners, faces and edges, and where two of them touch.

A `Hull` is made of its corners once.  Two hulls touch along the axis that separates them best, as
two boxes do (`problems.space.box_box`):

 1. Of the outer normals of all faces, and the products of all edges of one with those of the other,
    that of the largest separation is the normal; an edge on an edge only where it separates more
    than every face by `PREFERENCE`, a face of the second where it does by a tenth of that
 2. a face: the face of the other hull that looks at it most is laid beside it.  Corners of one
    inside the other and crossings of their edges are the points of contact
 3. an edge on an edge: their nearest points
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from problems.qp import Vector
from problems.space.attitude import cross
from problems.space.box_box import EDGES, FACE, OTHER_FACE, PREFERENCE, SAME, Found

ALIKE, PARALLEL = 1e-7, 1e-6
"""Outer normals this near are of one face, and edges whose product is this small have no axis."""
FLAT = 1e-9
"""Corners this near to the plane of a face are of it, over the size of the hull."""
MOST = 300
"""Of faces and of edges: features are numbered by them."""


class Hull(NamedTuple):
    """A convex polyhedron in axes of its body.

    corners : (c, 3) [m];  normals : (f, 3) outer ones of the faces;  offsets : (f,) n·x of them [m]
    faces : corners of each, round its normal;  edges : (e, 2) corners
    """

    corners: Vector
    normals: Vector
    offsets: Vector
    faces: tuple[tuple[int, ...], ...]
    edges: Vector

    @classmethod
    def of(cls, points: ArrayLike) -> Hull:
        """That of points (c, 3), each of which must be a corner of it.

        Raises ValueError for points in a plane, or one that is no corner.
        """
        corners = np.array(points, dtype=np.float64).reshape(-1, 3)
        try:
            made = scipy.spatial.ConvexHull(corners)
        except (scipy.spatial.QhullError, ValueError):
            raise ValueError(f"{len(corners)} points that span no volume make no hull") from None
        inner = np.setdiff1d(np.arange(len(corners)), made.vertices)
        if inner.size:
            raise ValueError(f"point {inner[0]} is no corner of the hull; leave it out")
        size = float(np.linalg.norm(corners - corners.mean(axis=0), axis=1).max())
        planes: list[Vector] = []
        for plane in made.equations[np.lexsort(made.equations.round(9).T)]:
            if all(np.abs(plane[:3] - kept[:3]).max() > ALIKE for kept in planes):
                planes.append(plane)
        faces = tuple(_round(corners, plane, FLAT * size) for plane in planes)
        edges = sorted(
            {
                (min(pair), max(pair))
                for face in faces
                for pair in zip(face, (*face[1:], face[0]), strict=True)
            }
        )
        if len(edges) > MOST:
            raise ValueError(f"a hull of {len(edges)} edges; {MOST} are the most")
        normals = np.array([plane[:3] for plane in planes])
        offsets = np.array([float((corners @ n).max()) for n in normals])
        return cls(corners, normals, offsets, faces, np.array(edges))

    def at(self, centre: Vector, R: Vector) -> Hull:
        """In the world, where the body is."""
        normals = self.normals @ R.T
        return Hull(
            centre + self.corners @ R.T, normals, self.offsets + normals @ centre, *self[3:]
        )

    def nearest(self, place: Vector) -> Vector:
        """The point (3,) of the hull that is nearest to a place outside, or the place itself."""
        heights = self.normals @ place - self.offsets
        if heights.max() <= 0:
            return place
        starts, ways = self.corners[self.edges[:, 0]], self.ways
        share = np.sum((place - starts) * ways, axis=1) / np.sum(ways * ways, axis=1)
        best = starts + np.clip(share, 0.0, 1.0)[:, None] * ways
        for face in np.flatnonzero(heights > 0):
            foot = place - heights[face] * self.normals[face]
            corners = self.corners[list(self.faces[face])]
            sides = cross(np.roll(corners, -1, axis=0) - corners, foot - corners)
            if (sides @ self.normals[face] >= 0).all():
                best = np.vstack([best, foot])
        found: Vector = best[np.argmin(np.linalg.norm(best - place, axis=1))]
        return found

    @property
    def ways(self) -> Vector:
        """(e, 3) along the edges."""
        made: Vector = self.corners[self.edges[:, 1]] - self.corners[self.edges[:, 0]]
        return made


def _round(corners: Vector, plane: Vector, tolerance: float) -> tuple[int, ...]:
    """Corners on a plane, counter-clockwise as seen from outside, from the lowest number on."""
    on = np.flatnonzero(np.abs(corners @ plane[:3] + plane[3]) <= tolerance)
    middle = corners[on].mean(axis=0)
    u = corners[on[0]] - middle
    w = np.cross(plane[:3], u)
    angles = np.arctan2((corners[on] - middle) @ w, (corners[on] - middle) @ u)
    return tuple(on[np.argsort(angles % (2 * np.pi - 1e-9), kind="stable")].tolist())


def hull_hull(a: Hull, b: Hull, margin: float) -> Found:
    """Points of contact of two hulls in the world, with gaps up to `margin` [m].

    Normals point from the second into the first, as in `problems.space.box_box`.
    """
    of_a = (b.corners @ a.normals.T).min(axis=0) - a.offsets
    of_b = (a.corners @ b.normals.T).min(axis=0) - b.offsets
    if max(of_a.max(), of_b.max()) > margin:
        return []
    face, other = int(np.argmax(of_a)), int(np.argmax(of_b))
    preference = PREFERENCE * 0.5 * min(thickness(a), thickness(b))
    best = max(of_a[face], of_b[other])
    crossed = _edges(a, b)
    if crossed is not None and crossed[1] > margin:
        return []
    if crossed is not None and crossed[1] > best + preference:
        return [crossed]
    if of_b[other] > of_a[face] + 0.1 * preference:
        return _on_face(b, a, other, OTHER_FACE, margin)
    return _on_face(a, b, face, FACE, margin)


def thickness(hull: Hull) -> float:
    """The least distance between a face and a corner [m]."""
    return float((hull.offsets - (hull.corners @ hull.normals.T).min(axis=0)).min())


def _edges(a: Hull, b: Hull) -> tuple[int, float, Vector, Vector] | None:
    """The nearest points of the two edges whose product separates best; None where none does."""
    u, w = a.ways, b.ways
    u, w = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (u, w))
    n = cross(u[:, None], w[None]).reshape(-1, 3)
    length = np.linalg.norm(n, axis=1)
    i, j = np.divmod(np.arange(len(n)), len(w))
    sound = np.flatnonzero(length > PARALLEL)
    n, i, j = n[sound] / length[sound, None], i[sound], j[sound]
    between = a.corners[a.edges[i, 0]] - b.corners[b.edges[j, 0]]
    n[n @ (a.corners.mean(axis=0) - b.corners.mean(axis=0)) < 0] *= -1
    apart = np.sum(n * between, axis=1)
    separation = (a.corners @ n.T).min(axis=0) - (b.corners @ n.T).max(axis=0)
    # only edges that look at each other
    tolerance = SAME + FLAT * np.abs(a.corners - b.corners[0]).max()
    facing = np.flatnonzero(apart <= separation + tolerance)
    if facing.size == 0:
        return None
    at = int(facing[np.argmax(separation[facing])])
    p, q, way = u[i[at]], w[j[at]], between[at]
    cosine = float(p @ q)
    s = (cosine * (q @ way) - p @ way) / (1 - cosine**2)
    t = (q @ way - cosine * (p @ way)) / (1 - cosine**2)
    one = a.corners[a.edges[i[at], 0]] + s * p
    two = b.corners[b.edges[j[at], 0]] + t * q
    feature = _feature(EDGES, int(i[at]), int(j[at]))
    return feature, float(n[at] @ (one - two)), 0.5 * (one + two), n[at]


def _on_face(hull: Hull, other: Hull, face: int, base: int, margin: float) -> Found:
    """Points on a face of a hull, beside the other's face that looks at it most."""
    n = hull.normals[face]
    opposite = int(np.argmin(other.normals @ n))
    corners = hull.corners[list(hull.faces[face])]
    beside = other.corners[list(other.faces[opposite])]
    u = corners[1] - corners[0]
    u = u / np.linalg.norm(u)
    frame = np.array([u, np.cross(n, u)])
    flat, rim = (beside - corners[0]) @ frame.T, (corners - corners[0]) @ frame.T
    m, steep = other.normals[opposite], float(other.normals[opposite] @ n)
    name = _feature(base, face, opposite)
    found: Found = []
    for feature, (x, y) in _shared(flat, rim):
        foot = corners[0] + x * frame[0] + y * frame[1]
        gap = (other.offsets[opposite] - float(m @ foot)) / steep
        if gap <= margin:
            outward = n if base == OTHER_FACE else -n
            found.append((name + feature, gap, foot + gap * n, outward))
    return found


def _feature(kind: int, i: int, j: int) -> int:
    """The first number of features of one face or edge with another."""
    return ((kind // 10_000 * MOST + i) * MOST + j) * 100 * MOST


def _shared(flat: Vector, rim: Vector) -> list[tuple[int, Vector]]:
    """Corners of the area that two convex polygons (p, 2), (r, 2) share, once each.

    Numbers: corners of the first from 0, of the second from 100, crossings from 200 on.
    """
    points = [(i, place) for i, place in enumerate(flat) if _inside(rim, place, SAME)]
    points += [(100 + i, place) for i, place in enumerate(rim) if _inside(flat, place, 0.0)]
    for i, (start, end) in enumerate(zip(flat, np.roll(flat, -1, axis=0), strict=True)):
        for j, (low, high) in enumerate(zip(rim, np.roll(rim, -1, axis=0), strict=True)):
            way, side, to = end - start, high - low, low - start
            turn = way[0] * side[1] - way[1] * side[0]
            if abs(turn) <= SAME * float(np.hypot(*way)):
                continue
            share = (to[0] * side[1] - to[1] * side[0]) / turn
            along = (to[0] * way[1] - to[1] * way[0]) / turn
            if 0 <= share <= 1 and 0 <= along <= 1:
                points.append((200 + 100 * i + j, start + share * way))
    alone: list[tuple[int, Vector]] = []
    for feature, place in points:
        if all(np.abs(place - kept).max() > SAME for _, kept in alone):
            alone.append((feature, place))
    return alone


def _inside(polygon: Vector, point: Vector, tolerance: float) -> bool:
    """Whether a point is inside a convex polygon (p, 2), whichever way it goes round."""
    ways, to = np.roll(polygon, -1, axis=0) - polygon, point - polygon
    turns = (ways[:, 0] * to[:, 1] - ways[:, 1] * to[:, 0]) / np.hypot(*ways.T)
    return bool((turns >= -tolerance).all() or (turns <= tolerance).all())
