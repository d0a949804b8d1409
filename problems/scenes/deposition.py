"""A loose heap of convex polygons that touch and do not overlap, laid down one after the other.

Each body is let down at a random place with a random angle among those that lie already, which do
not move:

    1. it falls straight down until it touches;
    2. it topples about that point, towards the side of its centre of gravity, until it touches
       again; while its centre is not above the ground between the two points, the point next to
       the centre is the new pivot;
    3. of a few such trials the one that lies lowest is kept.

So every body starts with one or two contacts under it, and later ones lean on it as well: what
Visscher and Bolsterli (Nature 239, 1972, 504–507) do with spheres.  The angle at which a corner
meets an edge has a closed form: at polar angle θ and distance r from the pivot it is at the line
n·y = b where r cos(θ ± α − ψ) = b, ψ the angle of n.  Contacts are flush to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from problems.bodies.bodies import Body
from problems.qp import Vector

TRIALS = 4
"""Places tried for each body; the lowest is kept."""
MAX_TRIALS = 200
"""Places tried before the heap is given up."""
MAX_PIVOTS = 8
"""Points that a body topples about before it is left as it is."""
SAME_POINT = 1e-9
"""Length [m] and angle that count as 0."""
OVERLAP_TOL = 1e-9
"""Depth [m] at which a trial is thrown away."""


class Segments(NamedTuple):
    """Edges from `start` to `end` (N, 2) [m] with unit normals (N, 2) that point outwards."""

    start: Vector
    end: Vector
    normal: Vector

    @classmethod
    def between(cls, start: Vector, end: Vector) -> Segments:
        side = end - start
        side = side / np.hypot(side[..., 0], side[..., 1])[..., None]
        return cls(start, end, np.stack([side[..., 1], -side[..., 0]], axis=-1))

    @classmethod
    def around(cls, corners: Vector) -> Segments:
        return cls.between(corners, np.roll(corners, -1, axis=0))


def heap_positions(bodies: Sequence[Body], width: float, rng: np.random.Generator) -> Vector:
    """Positions (n, 3) [m, m, rad] of a heap on the ground y = 0 between walls at x = ± width/2.

    bodies : of one convex part each

    Raises ValueError, with the number of the body, where one finds no place: the walls are too
    close.
    """
    heap = _Heap(bodies, width)
    for body in bodies:
        heap.add(_lowest_place(heap, body, rng))
    return heap.q


def _lowest_place(heap: _Heap, body: Body, rng: np.random.Generator) -> Vector:
    best, found = None, 0
    for _ in range(MAX_TRIALS):
        turn, where = rng.uniform(0.0, 2 * np.pi), rng.uniform()
        place = heap.settle(body, turn, where)
        if place is None:
            continue
        found += 1
        if best is None or place[1] < best[1]:
            best = place
        if found == TRIALS:
            break
    if best is None:
        raise ValueError(
            f"body {heap.count + 1} of the heap finds no place between walls {heap.width:g} m "
            "apart; take a greater width"
        )
    return best


class _Heap:
    """The bodies laid down so far: their edges in arrays padded by repeated edges."""

    def __init__(self, bodies: Sequence[Body], width: float):
        most = max(len(body.polygons[0]) for body in bodies)
        self.bodies, self.width, self.count = bodies, width, 0
        self.q = np.zeros((len(bodies), 3))
        self.radius = max(body.radius for body in bodies)
        self._edges = Segments(*(np.zeros((len(bodies), most, 2)) for _ in range(3)))
        self.top = 0.0
        high = 4 * self.radius * (len(bodies) + 2)
        left, right = -width / 2, width / 2
        self._bin = Segments.between(
            np.array([(right + high, 0.0), (left, 0.0), (right, high)]),
            np.array([(left - high, 0.0), (left, high), (right, 0.0)]),
        )

    def add(self, place: Vector) -> None:
        i = self.count
        corners = _placed(self.bodies[i], place)
        edges = Segments.around(corners)
        size = self._edges.start.shape[1]
        for array, values in zip(self._edges, edges, strict=True):
            array[i] = values[np.arange(size) % len(values)]
        self.q[i] = place
        self.top = max(self.top, float(corners[:, 1].max()))
        self.count += 1

    def settle(self, body: Body, turn: float, where: float) -> Vector | None:
        """Where a body comes to lie that is let down at `where` ∈ [0, 1] between the walls.

        None where it is too wide, topples over without support, or would overlap.
        """
        place = np.array([0.0, self.top + 3 * body.radius, turn])
        corners = _placed(body, place)
        left = -self.width / 2 - corners[:, 0].min()
        right = self.width / 2 - corners[:, 0].max()
        if left >= right:
            return None
        place[0] = left + where * (right - left)
        below = self._near(place, self.top + 4 * self.radius)
        depth, pivot = _fall(Segments.around(_placed(body, place)), below)
        place[1] -= depth
        near = self._near(place, 2 * self.radius)
        for _ in range(MAX_PIVOTS):
            side = float(place[0] - pivot[0])
            if abs(side) < SAME_POINT:
                break
            spin = -np.sign(side)
            angle, touched = _topple(Segments.around(_placed(body, place)), near, pivot, spin)
            arm = place[:2] - pivot
            level = np.arctan2(arm[1], abs(arm[0]))
            if angle > level:
                return None
            place[:2] = pivot + _turned(arm, spin * angle)
            place[2] += spin * angle
            if (touched[0] - place[0]) * (pivot[0] - place[0]) <= 0 or angle < SAME_POINT:
                break
            if abs(touched[0] - place[0]) < abs(pivot[0] - place[0]):
                pivot = touched
            near = self._near(place, 2 * self.radius)
        return place if self._is_free(body, place) else None

    def _near(self, place: Vector, reach: float) -> Segments:
        """Edges of the bin and of the bodies under or within `reach` of a place."""
        gap = np.abs(self.q[: self.count, :2] - place[:2])
        close = (gap[:, 0] <= 2 * self.radius + SAME_POINT) & (gap[:, 1] <= reach + SAME_POINT)
        return Segments(
            *(
                np.concatenate([wall, edges[: self.count][close].reshape(-1, 2)])
                for wall, edges in zip(self._bin, self._edges, strict=True)
            )
        )

    def _is_free(self, body: Body, place: Vector) -> bool:
        """Whether an edge separates the body, but for rounding, from each of the others."""
        own = Segments.around(_placed(body, place))
        outside = ((own.start[:, None] - self._bin.start) * self._bin.normal).sum(axis=2)
        if outside.min() < -OVERLAP_TOL:
            return False
        gap = np.abs(self.q[: self.count, :2] - place[:2])
        close = np.flatnonzero((gap <= 2 * self.radius).all(axis=1))
        start, normal = self._edges.start[close], self._edges.normal[close]
        theirs = ((own.start[:, None, None] - start) * normal).sum(axis=3).min(axis=0)
        ours = ((start[:, :, None] - own.start) * own.normal).sum(axis=3).min(axis=1)
        separation = np.maximum(theirs.max(axis=1), ours.max(axis=1))
        return bool((separation >= -OVERLAP_TOL).all())


def _turned(arm: Vector, angle: float) -> Vector:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * arm[..., 0] - s * arm[..., 1], s * arm[..., 0] + c * arm[..., 1]], axis=-1)


def _placed(body: Body, place: Vector) -> Vector:
    """Corners (c, 2) of a body at (x, y, φ)."""
    return place[:2] + _turned(body.polygons[0], float(place[2]))


def _fall(own: Segments, others: Segments) -> tuple[float, Vector]:
    """How far a body above the others falls, and the point (2,) that touches then."""
    down = _height_above(own.start, others).min(axis=1)
    up = _height_above(others.start * (1, -1), _flipped(own)).min(axis=1)
    corner, other = int(np.argmin(down)), int(np.argmin(up))
    if down[corner] <= up[other]:
        return float(down[corner]), own.start[corner] - (0.0, down[corner])
    return float(up[other]), others.start[other]


def _flipped(segments: Segments) -> Segments:
    """The picture turned upside down, in which a body that falls stands still and the others rise
    onto its lower edges."""
    return Segments(segments.end * (1, -1), segments.start * (1, -1), segments.normal * (1, -1))


def _height_above(points: Vector, segments: Segments) -> Vector:
    """Height of each point above each upper edge (P, N), inf where it is not above one."""
    x, (start, end) = points[:, :1], (segments.start, segments.end)
    upper = segments.normal[:, 1] > SAME_POINT
    over = upper & (x <= start[:, 0]) & (x >= end[:, 0])
    run = np.where(upper, end[:, 0] - start[:, 0], 1.0)
    level = start[:, 1] + (x - start[:, 0]) / run * (end[:, 1] - start[:, 1])
    return np.where(over, points[:, 1:] - level, np.inf)


def _topple(own: Segments, others: Segments, pivot: Vector, spin: float) -> tuple[float, Vector]:
    """Angle by which a body turns about `pivot` until it touches again, and where it does.

    spin : +1 counter-clockwise, −1 clockwise
    """
    mine = _meeting(own.start, others, pivot, spin).min(axis=1)
    yours = _meeting(others.start, own, pivot, -spin).min(axis=1)
    corner, other = int(np.argmin(mine)), int(np.argmin(yours))
    if mine[corner] <= yours[other]:
        angle = float(mine[corner])
        return angle, pivot + _turned(own.start[corner] - pivot, spin * angle)
    return float(yours[other]), others.start[other]


def _meeting(points: Vector, segments: Segments, pivot: Vector, spin: float) -> Vector:
    """Angle after which each point, turning about `pivot`, enters each edge (P, N); else 2π."""
    arm = points - pivot
    r = np.hypot(arm[:, 0], arm[:, 1])[:, None]
    b = ((segments.start - pivot) * segments.normal).sum(axis=1)
    reaches = (r > SAME_POINT) & (np.abs(b) <= r)
    ratio = np.divide(b, r, out=np.zeros(reaches.shape), where=reaches)
    psi = np.arctan2(segments.normal[:, 1], segments.normal[:, 0])
    theta = np.arctan2(arm[:, 1], arm[:, 0])[:, None]
    angle = np.mod(spin * (psi - theta) + np.arccos(ratio), 2 * np.pi)
    angle[angle > 2 * np.pi - SAME_POINT] = 0.0
    where = pivot + r[..., None] * np.stack(
        [np.cos(theta + spin * angle), np.sin(theta + spin * angle)], axis=-1
    )
    side = segments.end - segments.start
    length = np.hypot(side[:, 0], side[:, 1])
    along = ((where - segments.start) * side).sum(axis=2) / length
    reaches &= (along >= -SAME_POINT) & (along <= length + SAME_POINT)
    return np.where(reaches, angle, 2 * np.pi)
