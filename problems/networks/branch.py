"""A branch of a network: inductance, resistance, capacitance, source, diode, switch in series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from problems.bodies.checks import check_number
from problems.networks.sources import Constant, Source

NO_SOURCE = Constant(0.0)


@dataclass(frozen=True)
class Branch:
    """What lies between two nodes, all in series; its current flows from `start` to `end`.

    start, end : nodes, 0 is the ground, whose potential is 0
    L [H], R [Ω], C [F] : at least one of them, C = ∞ for none
    source : the voltage that drives the current [V]
    diode : whether there is an ideal diode, which lets the current through from start to end only
    switch : an ideal switch, closed while its value is positive, or None
    current, voltage : at t = 0, of the inductance [A] and of the capacitance [V]

        L di/dt + R i + q/C = u_start − u_end + source + λ,    dq/dt = i                  (6.2)
        diode:  i ≥ 0, λ ≥ 0, λ i = 0        open switch:  i = 0

    A branch from a node to itself is a loop.

    Raises ValueError, naming the field, for what is negative or not finite, and for a branch
    without L, R and C.
    """

    start: int
    end: int
    L: float = 0.0
    R: float = 0.0
    C: float = np.inf
    source: Source = NO_SOURCE
    diode: bool = False
    switch: Source | None = None
    current: float = 0.0
    voltage: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        what = f"Branch {self.name}".rstrip()
        check_number(what, 0.0, L=self.L, R=self.R)
        check_number(what, current=self.current, voltage=self.voltage)
        if not self.C > 0:
            raise ValueError(f"{what}: C = {self.C!r}; it must be positive, or inf for none")
        if min(self.start, self.end) < 0:
            raise ValueError(f"{what}: from node {self.start} to {self.end}; both count from 0")
        if self.L == 0 and self.R == 0 and np.isinf(self.C):
            raise ValueError(
                f"{what}: L = 0, R = 0 and no C; give it a small R, without which its current is "
                "not determined"
            )
        if self.voltage and np.isinf(self.C):
            raise ValueError(
                f"{what}: voltage = {self.voltage!r}; it is that of C, and there is none"
            )
