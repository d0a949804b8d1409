"""Candidates: pairs (corner, part) that are near each other, φ > 0 in the paper's words (§5).

They are found by the broad phase, with a margin, so that the list stays valid until something has
moved by half of it.  A candidate that is not an active constraint is *free* to collide.  It may
carry a *reference level*: where a contact was dropped with φ < 0 (drift is proportional to ε), the
corner collides on φ − level, else it would never do so.
"""

from __future__ import annotations

import numpy as np

from problems.contacts.broad_phase import free_pairs
from problems.contacts.geometry import CONTACT_TOL, Geometry
from problems.contacts.path_kernels import largest_motion, sink_levels
from problems.qp import Indices, Vector

MARGINS = ((8, 4.0), (30, 1.0), (np.inf, 0.25))
"""Up to so many bodies, the margin over the shortest edge: of few, to look at more candidates is
cheaper than to list them more often."""
NO_PLACES = np.zeros((0, 3), np.int64)


class Candidates:
    """corner, part, level, free (L,) of all near pairs; levels are ≤ 0.

    listed_at : (3n,) the position that they were found at;  margin : how near is near [m]
    pairs : (P, 2) the parts that they are of, each pair once
    """

    def __init__(self, geometry: Geometry):
        self.geometry = geometry
        shortest = float(geometry.contact_tol.min()) / CONTACT_TOL
        self.margin = shortest * next(m for most, m in MARGINS if geometry.n_bodies <= most)
        self.listed_at = np.full(3 * geometry.n_bodies, np.inf)
        self.corner, self.part = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.level, self.free = np.zeros(0), np.zeros(0, bool)
        self.pairs = np.zeros((0, 2), np.int64)

    def outdated(self, moved: float) -> bool:
        """Whether the list is too old for a body that has moved so far since it was made [m]."""
        return not moved <= self.margin / 2

    def cover(self, before: Vector, after: Vector, active: Indices) -> None:
        """Renew the list where it does not hold all that may touch between q `before` and `after`.

        active : (N, 3) the places of J_N, whose corner and part are not free
        """
        if self.outdated(largest_motion(self.listed_at, after, self.geometry.radius)):
            reach = 2.5 * largest_motion(before, after, self.geometry.radius)
            self._list(before, max(self.margin, reach))
            self.occupy(active)

    def renew(self, q: Vector, active: Indices) -> None:
        """Renew the list at q (3n,) where half of what it holds for is used up."""
        if self.outdated(2 * largest_motion(self.listed_at, q, self.geometry.radius)):
            self._list(q, self.margin)
            self.occupy(active)

    def occupy(self, active: Indices) -> None:
        """All are free but the places (N, 3) of J_N."""
        self.free = free_pairs(self.corner, self.part, active, self.geometry.corner_body.size)

    def set_level(self, corner: int, part: int, level: float) -> None:
        """Give a pair a reference level, 0 for none."""
        at = np.flatnonzero((self.corner == corner) & (self.part == part))
        if at.size:
            self.level[at] = level
        elif level < 0:
            self.corner, self.part = np.append(self.corner, corner), np.append(self.part, part)
            self.level, self.free = np.append(self.level, level), np.append(self.free, True)

    def levels(self) -> dict[tuple[int, int], float]:
        """{(corner, part): level} of those below 0."""
        below = np.flatnonzero(self.level < 0)
        pairs = zip(self.corner[below].tolist(), self.part[below].tolist(), strict=True)
        return dict(zip(pairs, self.level[below].tolist(), strict=True))

    def note_clearances(self, clearance: Vector) -> None:
        """Follow corners that were let in without a contact: their levels sink with them.

        clearance : (L,) [m];  a level is forgotten once its corner is far outside.
        """
        sink_levels(clearance, self.free, self.level)

    def take_as_touching(self, q: Vector, deepest: float) -> None:
        """Give corners that are inside a part at q (3n,), by more than `deepest` [m], a level."""
        self.cover(q, q, NO_PLACES)
        clearance = self.geometry.clearance(self.geometry.pose(q), self.corner, self.part)
        self.level = np.where(clearance < -deepest, clearance, self.level)

    def _list(self, q: Vector, margin: float) -> None:
        levels = self.levels()
        self.corner, self.part = self.geometry.near_corners(self.geometry.pose(q), margin)
        self.level, self.free = np.zeros(self.corner.size), np.ones(self.corner.size, bool)
        self.listed_at = q
        parts = np.sort([self.geometry.corner_part[self.corner], self.part], axis=0)
        number = len(self.geometry.part_body)
        self.pairs = np.column_stack(np.divmod(np.unique(parts[0] * number + parts[1]), number))
        for pair, level in levels.items():
            self.set_level(*pair, level)
