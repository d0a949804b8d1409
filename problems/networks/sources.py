"""Voltages and switches as functions of time: what they are at t, and when they jump.

At a jump itself the value is still the one before it, as with a `Load`: a step ends there, and the
next begins with the value after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, isfinite, pi, sin
from typing import Protocol


class Source(Protocol):
    """A function of time [s]."""

    def value(self, t: float) -> float:
        """At t, before a jump there [V]."""

    def jumps(self, end: float) -> list[float]:
        """Times in (0, end) at which it jumps, ascending."""


@dataclass(frozen=True)
class Constant:
    """A constant voltage [V]."""

    level: float

    def value(self, t: float) -> float:
        return self.level

    def jumps(self, end: float) -> list[float]:
        return []


@dataclass(frozen=True)
class Sine:
    """amplitude · sin(2π frequency t + phase) [V], [Hz], [rad]."""

    amplitude: float
    frequency: float
    phase: float = 0.0

    def value(self, t: float) -> float:
        return self.amplitude * sin(2 * pi * self.frequency * t + self.phase)

    def jumps(self, end: float) -> list[float]:
        return []


@dataclass(frozen=True)
class Pulses:
    """`high` over the first `duty` of every period [s], `low` over the rest; of a switch: 1, 0.

    Raises ValueError, naming the field, for a period that is not positive or a duty that is no
    share of it.
    """

    period: float
    duty: float
    high: float = 1.0
    low: float = 0.0

    def __post_init__(self) -> None:
        if not (isfinite(self.period) and self.period > 0):
            raise ValueError(f"Pulses: period = {self.period!r}; it must be a positive time")
        if not 0 < self.duty < 1:
            raise ValueError(f"Pulses: duty = {self.duty!r}; it must lie between 0 and 1")

    def edge(self, number: int) -> float:
        """Time of a jump [s]: up for even numbers, down for odd ones."""
        whole, odd = divmod(number, 2)
        return (whole + odd * self.duty) * self.period

    def value(self, t: float) -> float:
        number = 2 * floor(t / self.period)  # to rounding: of the last edge before t
        while self.edge(number) >= t:
            number -= 1
        while self.edge(number + 1) < t:
            number += 1
        return self.low if number % 2 else self.high

    def jumps(self, end: float) -> list[float]:
        edges = (self.edge(number) for number in range(1, 2 * floor(end / self.period) + 3))
        return [edge for edge in edges if edge < end]
