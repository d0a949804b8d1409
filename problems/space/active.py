"""The contacts that are active, from step to step: which join, leave, or are lost."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from problems.qp import Vector
from problems.space.contacts import Key, Near, Point
from problems.space.friction import Contact
from problems.space.motion import Pose
from problems.space.passes import gap_speeds
from problems.space.scene import SpaceScene
from problems.stepping.events import TOUCH_TOL

PARALLEL = 0.999
"""Cosine from which on two normals of a pair are of one contact."""
AJAR = 1e-4
"""An active contact that opens slowly is dropped at this gap over the size of its bodies, …"""
OPENING = 0.1
"""… if it opens faster than this much of `drop_tol`."""
MARGIN = 0.05
"""How far points are looked for, over the size of a body."""


class Carried(NamedTuple):
    """The active contacts at the end of a step.

    contacts : that go on;  lost : those that are no more;  joined : points that join them
    """

    contacts: list[Contact]
    lost: list[Contact]
    joined: list[Point]


@final
class Active:
    """Active contacts by key.

    levels : φ at which a contact that was dropped counts as touching, below 0, by key [m]
    """

    def __init__(self, scene: SpaceScene, drop_tol: float) -> None:
        self.near, self.mu, self.drop_tol = Near(scene), scene.mu, drop_tol
        sizes = [reach for reach in self.near.reach if reach > 0]
        self.size = min(sizes, default=1.0)
        self.by_key: dict[Key, Contact] = {}
        self.levels: dict[Key, float] = {}
        self._made = 0
        self._seen: tuple[Pose, list[Point]] | None = None

    @property
    def contacts(self) -> list[Contact]:
        return list(self.by_key.values())

    def points(self, pose: Pose) -> list[Point]:
        """All that are near; those of the last pose that was asked about are kept."""
        if self._seen is None or not all(map(np.array_equal, pose, self._seen[0])):
            self._seen = pose, self.near.points(pose, MARGIN * self.size)
        return self._seen[1]

    def new(self, point: Point) -> Contact:
        """A contact that is not active yet."""
        self._made += 1
        return Contact(self._made - 1, point, self.mu)

    def take(self, contact: Contact) -> bool:
        """Make a contact active; whether it was not."""
        key = contact.point.key
        joins = key not in self.by_key
        self.by_key[key] = contact
        self.levels.pop(key, None)
        return joins

    def insert(self, point: Point) -> None:
        """Make a point an active contact."""
        self.take(self.new(point))

    def remove(self, contact: Contact) -> None:
        key, gap = contact.point.key, contact.point.gap
        del self.by_key[key]
        if gap < 0:
            self.levels[key] = gap

    def clearance(self, point: Point) -> float:
        """φ beyond its level [m]; a level is forgotten where the gap has opened."""
        if point.gap > AJAR * self.size:
            self.levels.pop(point.key, None)
        return point.gap - self.levels.get(point.key, 0.0)

    def carry(self, pose: Pose, guess: Vector) -> Carried:
        """Where active contacts are at a pose; points that lie on what touches already join.

        guess : (6n,) v there
        """
        points = {point.key: point for point in self.points(pose)}
        for key, contact in self.by_key.items():
            if key in points:
                contact.point = points[key]
        lost = [contact for key, contact in self.by_key.items() if key not in points]
        others = [p for key, p in points.items() if key not in self.by_key and self._lies_on(p)]
        speeds = self.speeds(others, pose, guess)
        joined = [p for p, v in zip(others, speeds, strict=True) if abs(v) <= self.drop_tol]
        return Carried([c for c in self.contacts if c not in lost], lost, joined)

    def _lies_on(self, point: Point) -> bool:
        """Whether a point is where its bodies touch already."""
        near = abs(self.clearance(point)) <= 0.1 * AJAR * self.size
        return near and any(
            contact.point.key[:2] == point.key[:2]
            and float(contact.point.normal @ point.normal) > PARALLEL
            for contact in self.by_key.values()
        )

    def speeds(self, points: list[Point], pose: Pose, v: Vector) -> Vector:
        """Gap speeds (N,) [m/s]."""
        return gap_speeds([Contact(0, point, 0.0) for point in points], pose, v)

    def touching(self, pose: Pose, skip: set[Key], level: float) -> list[Point]:
        """Inactive points whose clearance is not above a level, or `TOUCH_TOL` [m]."""
        return [
            point
            for point in self._inactive(pose, skip)
            if self.clearance(point) <= max(level, TOUCH_TOL)
        ]

    def approaching(
        self, points: list[Point], pose: Pose, v: Vector, slowest: float
    ) -> list[Point]:
        """Those that approach faster than `slowest` [m/s]."""
        speeds = self.speeds(points, pose, v)
        return [p for p, speed in zip(points, speeds, strict=True) if speed < -slowest]

    def least_clearance(self, pose: Pose, skip: set[Key]) -> float:
        """Of inactive points, at most the margin [m]."""
        free = map(self.clearance, self._inactive(pose, skip))
        return min(free, default=MARGIN * self.size)

    def _inactive(self, pose: Pose, skip: set[Key]) -> list[Point]:
        return [p for p in self.points(pose) if p.key not in self.by_key and p.key not in skip]

    def separating(self, contacts: list[Contact], speeds: Vector) -> list[Contact]:
        """Step 4: which contacts leave."""
        gaps = np.array([contact.point.gap for contact in contacts])
        ajar = (gaps > AJAR * self.size) & (speeds > OPENING * self.drop_tol)
        leaving = np.flatnonzero((speeds > self.drop_tol) | ajar)
        return [contacts[i] for i in leaving]
