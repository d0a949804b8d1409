"""Rigid bodies in space: mass, principal moments of inertia, and a shape: sphere, box or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems.bodies.checks import check_number
from problems.qp import Vector

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Solid:
    """A rigid body; its axes are the principal ones, about its centre of gravity.

    mass [kg];  inertia : principal moments [kg·m²]
    radius : of a sphere [m];  sides : of a box [m];  neither: it touches nothing

    Raises ValueError, naming the field, for what is not positive, both shapes, or moments of which
    one exceeds the sum of the others.
    """

    mass: float
    inertia: Triple
    radius: float = 0.0
    sides: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_number("Solid", mass=self.mass, radius=self.radius)
        if not (self.mass > 0 and min(self.inertia) > 0):
            raise ValueError(f"Solid: mass = {self.mass:g}, inertia = {self.inertia}; be positive")
        if 2 * max(self.inertia) > sum(self.inertia) * (1 + 1e-12):
            raise ValueError(f"Solid: inertia = {self.inertia}; no body has such moments")
        if self.radius < 0 or min(self.sides) < 0 or 0 < np.count_nonzero(self.sides) < 3:
            raise ValueError(f"Solid: radius = {self.radius:g}, sides = {self.sides}; be positive")
        if self.radius and self.is_box:
            raise ValueError("Solid: it has a radius and sides; a body is a sphere or a box")

    @property
    def is_box(self) -> bool:
        return self.sides[0] > 0

    @property
    def reach(self) -> float:
        """Distance of the farthest point from the centre of gravity [m]."""
        return float(np.linalg.norm(self.sides)) / 2 if self.is_box else self.radius

    def corners(self) -> Vector:
        """Of a box, (8, 3) [m]: corner 4i + 2j + k has the signs of bits i, j, k along x, y, z."""
        return SIGNS * (0.5 * np.array(self.sides))


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
