"""Positions along a step."""

from __future__ import annotations

from dataclasses import dataclass

from problems.qp import Vector


@dataclass(frozen=True, eq=False)
class Path:
    """Positions along a step, q(h) = start + h velocity + h² curvature (3.1a)."""

    start: Vector
    velocity: Vector
    curvature: Vector

    @property
    def parts(self) -> tuple[Vector, Vector, Vector]:
        """start, velocity and curvature, as kernels take them."""
        return self.start, self.velocity, self.curvature

    def __call__(self, h: float) -> Vector:
        return self.start + h * (self.velocity + h * self.curvature)

    def rate(self, h: float) -> Vector:
        """dq/dh, the velocity of the polynomial (not q̇_n)."""
        return self.velocity + 2 * h * self.curvature
