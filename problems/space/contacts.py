"""Points where bodies touch or are about to: gaps φ, points and normals of all near pairs.

A point has a key that it keeps along the motion: what touches what, and with which of its features.

    sphere, plane      the lowest point
    sphere, sphere     the point between the centres
    sphere, box        the nearest point of the box, or of a polyhedron
    box, plane         each corner, of a polyhedron, too
    box, box           `problems.space.box_box`
    polyhedra          `problems.space.hull`, also of one and a box
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from problems.bodies.bodies import GROUND
from problems.qp import Vector
from problems.space.attitude import rotations
from problems.space.box_box import BoxAt, box_box
from problems.space.hull import hull_hull
from problems.space.motion import Pose
from problems.space.scene import SpaceScene

Key = tuple[int, int, int]
"""The first body; the second one, or −1 − number of a plane; the features."""


class Point(NamedTuple):
    """A point of contact of body a with body b, or the ground.

    gap : φ [m];  place : (3,) [m];  normal : (3,) from b into a
    """

    key: Key
    a: int
    b: int
    gap: float
    place: Vector
    normal: Vector


class Near:
    """Finds the points of a scene."""

    def __init__(self, scene: SpaceScene) -> None:
        self.solids, self.planes = scene.solids, scene.planes
        self.reach = np.array([solid.reach for solid in scene.solids])

    def points(self, pose: Pose, margin: float) -> list[Point]:
        """All with gaps up to `margin` [m], in order of their keys."""
        R = rotations(pose.attitudes)
        found = [
            point
            for a, j in product(range(len(self.solids)), range(len(self.planes)))
            for point in self._on_plane(a, j, pose.centres[a], R[a], margin)
        ]
        for a, b in self._pairs(pose, margin):
            found += self._between(a, b, pose, R, margin)
        return sorted(found, key=lambda point: point.key)

    def _pairs(self, pose: Pose, margin: float) -> list[tuple[int, int]]:
        """Bodies whose enclosing spheres are within the margin."""
        if len(self.reach) == 1:
            return []
        far = 2 * float(self.reach.max()) + margin
        pairs = scipy.spatial.cKDTree(pose.centres).query_pairs(far, output_type="ndarray")
        apart = np.linalg.norm(pose.centres[pairs[:, 0]] - pose.centres[pairs[:, 1]], axis=1)
        near = apart <= self.reach[pairs].sum(axis=1) + margin
        touches = (self.reach[pairs] > 0).all(axis=1)
        return [(a, b) for a, b in sorted(pairs[near & touches].tolist())]

    def _on_plane(self, a: int, j: int, c: Vector, R: Vector, margin: float) -> list[Point]:
        plane, solid = self.planes[j], self.solids[a]
        n = np.array(plane.normal)
        height = float(n @ (c - plane.point))
        if solid.reach == 0 or height > solid.reach + margin:
            return []
        if solid.radius:
            place = c - solid.radius * n
            return [Point((a, -1 - j, 0), a, GROUND, height - solid.radius, place, n)]
        places = c + solid.corners() @ R.T
        gaps = (places - plane.point) @ n
        return [
            Point((a, -1 - j, i), a, GROUND, float(gaps[i]), places[i], n)
            for i in np.flatnonzero(gaps <= margin).tolist()
        ]

    def _between(self, a: int, b: int, pose: Pose, R: Vector, margin: float) -> list[Point]:
        one, two = self.solids[a], self.solids[b]
        if not (one.radius or two.radius):
            if one.is_box and two.is_box:
                first = BoxAt(pose.centres[a], R[a], 0.5 * np.array(one.sides))
                second = BoxAt(pose.centres[b], R[b], 0.5 * np.array(two.sides))
                found = box_box(first, second, margin)
            else:
                hulls = one.hull.at(pose.centres[a], R[a]), two.hull.at(pose.centres[b], R[b])
                found = hull_hull(*hulls, margin)
            return [Point((a, b, f), a, b, gap, place, n) for f, gap, place, n in found]
        if not one.radius:
            a, b, one, two = b, a, two, one
        centre = pose.centres[b]
        if two.points:
            centre = two.hull.at(centre, R[b]).nearest(pose.centres[a])
        elif two.is_box:
            half = 0.5 * np.array(two.sides)
            inside = R[b].T @ (pose.centres[a] - centre)
            centre = centre + R[b] @ np.clip(inside, -half, half)
        along = pose.centres[a] - centre
        distance = float(np.linalg.norm(along))
        gap = distance - one.radius - two.radius
        if gap > margin or distance == 0:
            return []
        n = along / distance
        return [Point((a, b, 0), a, b, gap, pose.centres[a] - one.radius * n, n)]
