"""Explicitly given forces f(q, q̇, t) of (2.1) and impulses F of (2.13).

A force is a frozen object with `add(f, q, v, t)`, which adds its share to f (3n,); it says whether
it depends on the velocity, which makes the step iterate (3.9), and at which times it jumps, where
the integration restarts.  One that is constant between its jumps may say so, with `constant`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from problems.bodies.checks import check_body, check_number, check_numbers
from problems.qp import Vector


class Force(Protocol):
    """What the stepper needs to know of a force."""

    @property
    def velocity_dependent(self) -> bool: ...

    @property
    def jumps(self) -> tuple[float, ...]: ...

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        """Add the force at (q, v, t) to f (3n,) [N, N, N·m per body]."""

    def potential(self, q: Vector) -> float:
        """Potential energy [J]; 0 for a force that has none."""


@dataclass(frozen=True, eq=False)
class Gravity:
    """f_y = −m g on every body; masses (n,) [kg], g [m/s²]."""

    masses: Vector
    g: float
    velocity_dependent = False
    constant = True
    jumps: tuple[float, ...] = ()

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        f[1::3] -= self.masses * self.g

    def potential(self, q: Vector) -> float:
        return float(self.g * self.masses @ q[1::3])


@dataclass(frozen=True)
class SpringDamper:
    """Linear axial spring and damper between a point of a body and a fixed anchor (§3.4, fig. 3).

    body : index from 0;  point : in body coordinates [m];  anchor : in the inertial frame [m]
    stiffness : [N/m];  damping : [N·s/m];  length : natural length [m]

    Raises ValueError, naming the field, for what is not finite, or negative.
    """

    body: int
    point: tuple[float, float]
    anchor: tuple[float, float]
    stiffness: float
    damping: float
    length: float = 0.0
    jumps: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_body("SpringDamper", self.body)
        check_numbers("SpringDamper", 2, point=self.point, anchor=self.anchor)
        coefficients = {"stiffness": self.stiffness, "damping": self.damping, "length": self.length}
        check_number("SpringDamper", 0.0, **coefficients)

    @property
    def velocity_dependent(self) -> bool:
        return self.damping != 0.0

    def _reach(self, q: Vector) -> tuple[Vector, Vector]:
        x, y, angle = q[3 * self.body : 3 * self.body + 3]
        c, s = np.cos(angle), np.sin(angle)
        arm = np.array(
            [c * self.point[0] - s * self.point[1], s * self.point[0] + c * self.point[1]]
        )
        return arm, arm + np.array([x - self.anchor[0], y - self.anchor[1]])

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        i = 3 * self.body
        arm, reach = self._reach(q)
        distance = float(np.hypot(*reach))
        if distance == 0.0:
            return
        along = reach / distance
        speed = along @ (v[i : i + 2] + v[i + 2] * np.array([-arm[1], arm[0]]))
        pull = -(self.stiffness * (distance - self.length) + self.damping * speed) * along
        f[i : i + 2] += pull
        f[i + 2] += arm[0] * pull[1] - arm[1] * pull[0]

    def potential(self, q: Vector) -> float:
        stretch = float(np.hypot(*self._reach(q)[1])) - self.length
        return 0.5 * self.stiffness * stretch * stretch


@dataclass(frozen=True)
class Load:
    """Constant force and moment on one body from `start` to `end`; it jumps at both.

    value : (F_x, F_y, moment) [N, N, N·m]

    Raises ValueError, naming the field, for what is not finite, and for end ≤ start.
    """

    body: int
    value: tuple[float, float, float]
    start: float = 0.0
    end: float = np.inf
    velocity_dependent = False
    constant = True

    def __post_init__(self) -> None:
        check_body("Load", self.body)
        check_numbers("Load", 3, value=self.value)
        check_number("Load", start=self.start)
        if not self.end > self.start:
            raise ValueError(f"Load: end = {self.end!r}; it must be after start = {self.start!r}")

    @property
    def jumps(self) -> tuple[float, ...]:
        return tuple(time for time in (self.start, self.end) if 0 < time < np.inf)

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        if self.start < t <= self.end:
            f[3 * self.body : 3 * self.body + 3] += self.value

    def potential(self, q: Vector) -> float:
        return 0.0


@dataclass(frozen=True)
class Impulse:
    """External impulse F of (2.13) on one body at time t: (F_x, F_y, moment) [N·s, N·s, N·m·s].

    Raises ValueError, naming the field, for what is not finite, and for t < 0.
    """

    t: float
    body: int
    value: tuple[float, float, float]

    def __post_init__(self) -> None:
        check_number("Impulse", 0.0, t=self.t)
        check_body("Impulse", self.body)
        check_numbers("Impulse", 3, value=self.value)
