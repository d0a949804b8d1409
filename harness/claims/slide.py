"""A corner that slides on level ground, in closed form: its gain, its force, how it catches.

The body's centre of gravity is at −r from the corner.  With the columns g_N = (0, 1, r_x),
g_F = (1, 0, −r_y) and

    a = g_NᵀM⁻¹g_N,  b = g_NᵀM⁻¹g_F,  c = g_FᵀM⁻¹g_F,   B = −g − ω² r_y

the gap acceleration is B + (1 − γ) a λ with the gain γ = −μ s b/a, s against the slip.  Steady
sliding needs λ = −B/((1 − γ) a) ≥ 0; γ ≥ 1 and B < 0 leave none.  What remains possible there is an
impulse without a collision (Lecornu 1905), which ends the slip at once:

    [a b; b c] (Λ_N, Λ_F) = (0, −g_Fᵀq̇),   |Λ_F|/Λ_N = a/|b| ≤ μ  exactly where γ ≥ 1

The lagged rules turn λ_n = −B/a + γ λ_* into a recurrence.  By (4.3) its errors grow by γ per step,
by (4.2) with constant steps by the larger root of ζ² = γ(2ζ − 1), ζ = γ ± √(γ² − γ), which exceeds
1 for γ > 1 and for γ < −1/3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from problems import Scene, scene
from problems.qp import Vector

STEEPEST = float(np.arctan(2.0))
"""The angle at which the gain of a thin rod is largest, 3 μ/4 [rad]."""


@dataclass(frozen=True, eq=False)
class Slide:
    """A body whose corner slides on level ground; mass [kg], inertia [kg·m²], gravity [m/s²].

    arm : (2,) r, from the centre of gravity to the corner [m];  v : (3,) q̇ [m/s, m/s, rad/s]
    """

    mass: float
    inertia: float
    arm: Vector
    v: Vector
    mu: float
    gravity: float

    @property
    def slip(self) -> float:
        """g_Fᵀq̇ [m/s], along x."""
        return float(self.v[0] - self.v[2] * self.arm[1])

    @cached_property
    def compliance(self) -> Vector:
        """[[a, b], [b, c]] [1/kg]."""
        G = np.array([[0.0, 1.0], [1.0, 0.0], [self.arm[0], -self.arm[1]]])
        return G.T @ (G / self.masses[:, None])

    @property
    def masses(self) -> Vector:
        """Diagonal of M (3,)."""
        return np.array([self.mass, self.mass, self.inertia])

    @property
    def gain(self) -> float:
        """γ."""
        (a, b), _ = self.compliance
        return float(self.mu * np.sign(self.slip) * b / a)

    @property
    def free(self) -> float:
        """B, the gap acceleration without a contact force [m/s²]."""
        return float(-self.gravity - self.v[2] ** 2 * self.arm[1])

    @property
    def steady(self) -> float:
        """λ with which the corner would go on sliding [N]; where it is negative, it cannot."""
        return float(-self.free / (self.compliance[0, 0] * (1 - self.gain)))

    @property
    def catch(self) -> Vector:
        """Jump in q̇ (3,) of the impulse without a collision that ends the slip."""
        normal, tangential = np.linalg.solve(self.compliance, [0.0, -self.slip])
        torque = self.arm[0] * normal - self.arm[1] * tangential
        return np.array([tangential, normal, torque]) / self.masses

    def norm(self, v: Vector) -> float:
        """‖v‖_M of one body."""
        return float(np.sqrt(self.masses @ np.square(v)))


def slide_of(made: Scene, q: Vector, v: Vector) -> Slide:
    """The lowest corner of body 1 at q, q̇ (3,), of a side on the ground the one that leads."""
    body = made.bodies[0]
    c, s = np.cos(q[2]), np.sin(q[2])
    corners = np.concatenate(body.polygons) @ np.array([[c, s], [-s, c]])
    leading = corners[:, 0] * np.sign(v[0])
    lowest = corners[np.lexsort((-leading, np.round(corners[:, 1], 9)))[0]]
    return Slide(body.mass, body.inertia, lowest, v, made.mu, made.gravity)


def growth(gain: float, rule: str = "(4.2)") -> float:
    """Factor per step by which an error in λ grows with constant steps, by (4.2) or (4.3)."""
    if rule == "(4.3)":
        return abs(gain)
    return float(np.abs(np.roots([1.0, -2 * gain, gain])).max())


def rod_of_gain(gain: float, slip: float = 1.0) -> Scene:
    """The rod at its steepest with this gain: μ from |γ|, trailing where γ < 0."""
    unit = scene("painleve", angle=STEEPEST, mu=1.0)
    mu = abs(gain) / slide_of(unit, unit.q0[0], unit.v0[0]).gain
    return scene("painleve", angle=STEEPEST, mu=mu, slip=np.copysign(slip, gain))
