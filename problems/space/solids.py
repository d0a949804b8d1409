"""Rigid bodies in space: mass, principal moments of inertia, and a shape.

A shape is a sphere, a box, a convex polyhedron or none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from problems.bodies.checks import check_number
from problems.qp import Vector
from problems.space.attitude import attitudes_of
from problems.space.hull import Hull

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Solid:
    """A rigid body; its axes are the principal ones, about its centre of gravity.

    mass [kg];  inertia : principal moments [kg·m²]
    radius : of a sphere [m];  sides : of a box [m];  points : corners of a convex polyhedron [m]
    (see `polyhedron`);  none of them: it touches nothing

    Raises ValueError, naming the field, for what is not positive, two shapes, moments of which one
    exceeds the sum of the others, or points that are no corners round the centre of gravity.
    """

    mass: float
    inertia: Triple
    radius: float = 0.0
    sides: Triple = (0.0, 0.0, 0.0)
    points: tuple[Triple, ...] = ()

    def __post_init__(self) -> None:
        check_number("Solid", mass=self.mass, radius=self.radius)
        if not (self.mass > 0 and min(self.inertia) > 0):
            raise ValueError(f"Solid: mass = {self.mass:g}, inertia = {self.inertia}; be positive")
        if 2 * max(self.inertia) > sum(self.inertia) * (1 + 1e-12):
            raise ValueError(f"Solid: inertia = {self.inertia}; no body has such moments")
        if self.radius < 0 or min(self.sides) < 0 or 0 < np.count_nonzero(self.sides) < 3:
            raise ValueError(f"Solid: radius = {self.radius:g}, sides = {self.sides}; be positive")
        if (self.radius > 0) + self.is_box + bool(self.points) > 1:
            raise ValueError("Solid: it has two of radius, sides and points; a body has one shape")
        if self.points and self.hull.offsets.min() <= 0:
            raise ValueError("Solid: points do not enclose the centre of gravity, (0, 0, 0)")

    @property
    def is_box(self) -> bool:
        return self.sides[0] > 0

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the centre of gravity [m]."""
        if self.points:
            return float(np.linalg.norm(self.points, axis=1).max())
        return float(np.linalg.norm(self.sides)) / 2 if self.is_box else self.radius

    def corners(self) -> Vector:
        """Of a box or a polyhedron, (c, 3) [m].

        Corner 4i + 2j + k of a box has the signs of bits i, j, k along x, y, z.
        """
        return np.array(self.points) if self.points else SIGNS * (0.5 * np.array(self.sides))

    @cached_property
    def hull(self) -> Hull:
        """Of a box or a polyhedron."""
        return Hull.of(self.corners())


SIGNS = np.array([(i, j, k) for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
"""(8, 3) of the corners of a box."""


def ball(radius: float, density: float = 1.0) -> Solid:
    """A homogeneous sphere;  density [kg/m³]."""
    mass = 4 / 3 * np.pi * radius**3 * density
    return Solid(mass, (0.4 * mass * radius**2,) * 3, radius=radius)


def block(a: float, b: float, c: float, density: float = 1.0) -> Solid:
    """A homogeneous box with sides a, b, c [m] along x, y, z;  density [kg/m³]."""
    mass = a * b * c * density
    x, y, z = (mass / 12 * (p * p + r * r) for p, r in ((b, c), (a, c), (a, b)))
    return Solid(mass, (x, y, z), sides=(a, b, c))


def polyhedron(points: ArrayLike, density: float = 1.0) -> tuple[Solid, Vector, Vector]:
    """A homogeneous convex polyhedron, and where it is.

    points : (c, 3) corners [m], in any axes;  density [kg/m³]

    Returns the body, whose own axes are the principal ones, and the centre (3,) [m] and attitude
    (4,) with which its corners are where they were given.

    Raises ValueError for points that are no corners of their hull, or span no volume.
    """
    corners = Hull.of(points).corners
    cells = corners[scipy.spatial.Delaunay(corners - corners.mean(axis=0)).simplices]
    volumes = np.abs(np.linalg.det(cells[:, 1:] - cells[:, :1])) / 6
    mass = density * float(volumes.sum())
    centre = volumes @ cells.mean(axis=1) / volumes.sum()
    own = cells - centre
    sums = own.sum(axis=1)
    second = np.einsum("t,tai,taj->ij", volumes, own, own) + np.einsum(
        "t,ti,tj->ij", volumes, sums, sums
    )
    second *= density / 20  # ∫ x xᵀ of a tetrahedron: V (Σ x_a x_aᵀ + Σ x_a Σ x_bᵀ) / 20
    axes = _principal(second)
    spread = np.einsum("ij,ik,kj->j", axes, second, axes)
    x, y, z = (float(spread.sum() - each) for each in spread)
    made = Solid(mass, (x, y, z), points=tuple(map(tuple, ((corners - centre) @ axes).tolist())))
    return made, centre, attitudes_of(axes)


def _principal(second: Vector) -> Vector:
    """Axes (3, 3), as columns, in which moments are diagonal: the given ones where they do.

    The largest component of the first two is positive, whatever LAPACK makes of their signs.
    """
    if np.abs(second - np.diag(np.diag(second))).max() <= 1e-12 * np.trace(second):
        return np.eye(3)
    _, axes = np.linalg.eigh(second)
    largest = np.abs(axes).round(6).argmax(axis=0)  # the first of those that rounding makes two
    axes = axes * np.sign(axes[largest, range(3)])
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return np.asarray(axes)
