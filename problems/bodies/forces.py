"""Explicitly given forces f(q, q̇, t) of (2.1) and impulses F of (2.13).

A force is a frozen object with `add(f, q, v, t)`, which adds its share to f (3n,); it says whether
it depends on the velocity, which makes the step iterate (3.9), and at which times it jumps, where
the integration restarts.  One that is constant between its jumps may say so, with `constant`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from problems.bodies.bodies import GROUND
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
    """Linear axial spring and damper from a point of a body to an anchor (§3.4, fig. 3).

    body : index from 0;  point : in body coordinates [m]
    anchor : in coordinates of the body `other` [m]; by default in the inertial frame
    stiffness : [N/m];  damping : [N·s/m];  length : natural length [m]
    slack : whether it only pulls: a light elastic string

    Raises ValueError, naming the field, for what is not finite, or negative.
    """

    body: int
    point: tuple[float, float]
    anchor: tuple[float, float]
    stiffness: float
    damping: float
    length: float = 0.0
    jumps: tuple[float, ...] = ()
    other: int = GROUND
    slack: bool = False

    def __post_init__(self) -> None:
        check_body("SpringDamper", self.body)
        if self.other != GROUND:
            check_body("SpringDamper", self.other)
        check_numbers("SpringDamper", 2, point=self.point, anchor=self.anchor)
        coefficients = {"stiffness": self.stiffness, "damping": self.damping, "length": self.length}
        check_number("SpringDamper", 0.0, **coefficients)

    @property
    def velocity_dependent(self) -> bool:
        return self.damping != 0.0

    def _reach(self, q: Vector) -> tuple[Vector, Vector, Vector]:
        """The arms of point and anchor, from their centres of gravity, and point less anchor."""
        arm, centre = _arm(q, self.body, self.point)
        far, held = _arm(q, self.other, self.anchor)
        return arm, far, arm + (centre - (held + far))

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        arm, far, reach = self._reach(q)
        distance = float(np.hypot(*reach))
        if distance == 0.0 or (self.slack and distance <= self.length):
            return
        along = reach / distance
        i, speed = 3 * self.body, along @ _velocity(v, self.body, arm)
        if self.other != GROUND:
            speed = speed - along @ _velocity(v, self.other, far)
        pull = -(self.stiffness * (distance - self.length) + self.damping * speed) * along
        f[i : i + 2] += pull
        f[i + 2] += arm[0] * pull[1] - arm[1] * pull[0]
        if self.other != GROUND:
            j = 3 * self.other
            f[j : j + 2] -= pull
            f[j + 2] -= far[0] * pull[1] - far[1] * pull[0]

    def potential(self, q: Vector) -> float:
        stretch = float(np.hypot(*self._reach(q)[2])) - self.length
        return 0.0 if self.slack and stretch < 0 else 0.5 * self.stiffness * stretch * stretch


def _arm(q: Vector, body: int, point: tuple[float, float]) -> tuple[Vector, Vector]:
    """A point of a body from its centre of gravity, and where that is; both in the plane."""
    if body == GROUND:
        return np.array(point, dtype=np.float64), np.zeros(2)
    x, y, angle = q[3 * body : 3 * body + 3]
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]]), np.array([x, y])


def _velocity(v: Vector, body: int, arm: Vector) -> Vector:
    """That of a point at the end of an arm."""
    i = 3 * body
    moved: Vector = v[i : i + 2] + v[i + 2] * np.array([-arm[1], arm[0]])
    return moved


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
class Drive:
    """Force and moment on one body that go up and down as sin(2π frequency t + phase).

    value : (F_x, F_y, moment) at the most [N, N, N·m];  frequency [1/s];  phase [rad]

    Raises ValueError, naming the field, for what is not finite.
    """

    body: int
    value: tuple[float, float, float]
    frequency: float
    phase: float = 0.0
    velocity_dependent = False
    jumps: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_body("Drive", self.body)
        check_numbers("Drive", 3, value=self.value)
        check_number("Drive", frequency=self.frequency, phase=self.phase)

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        share = np.sin(2 * np.pi * self.frequency * t + self.phase)
        f[3 * self.body : 3 * self.body + 3] += share * np.array(self.value)

    def potential(self, q: Vector) -> float:
        return 0.0


@dataclass(frozen=True, eq=False)
class Switched:
    """A force that acts while a function of the state is positive: a motor that ends at x > 1.

    force : any other;  when : (q (n, 3), q̇ (n, 3), t [s]) → a number, continuous in the state

    The step ends where it changes its sign, see `problems.stepping.switches`.
    """

    force: Force
    when: Callable[[Vector, Vector, float], float]

    @property
    def body(self) -> int:
        return int(getattr(self.force, "body", 0))

    @property
    def velocity_dependent(self) -> bool:
        return self.force.velocity_dependent

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.force.jumps

    def value(self, q: Vector, v: Vector, t: float) -> float:
        """`when` at the state q, v (3n,)."""
        return float(self.when(q.reshape(-1, 3), v.reshape(-1, 3), t))

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        if self.value(q, v, t) > 0:
            self.force.add(f, q, v, t)

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
