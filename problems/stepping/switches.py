"""Forces that begin and end where a function of the state changes its sign (§3.1).

A step is taken with each of them as it was at t_{n−1}.  Where a function changes its sign on the
path to q_n, with q̇ extrapolated, the step ends there, and the integration restarts with the force
on its other side: a jump in q̈ as at a time that is known beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from problems.bodies.forces import Force, Switched
from problems.bodies.path import Path
from problems.qp import Vector
from problems.stepping.events import Crossings, locate_zero


@dataclass
class _Held:
    """A switched force that acts, or does not, until `flip`."""

    switched: Switched
    acts: bool
    constant = False

    @property
    def velocity_dependent(self) -> bool:
        return self.switched.velocity_dependent

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.switched.jumps

    def add(self, f: Vector, q: Vector, v: Vector, t: float) -> None:
        if self.acts:
            self.switched.force.add(f, q, v, t)

    def potential(self, q: Vector) -> float:
        return 0.0

    def margin(self, q: Vector, v: Vector, t: float) -> float:
        """Positive where the force is on the side on which it is held."""
        value = self.switched.value(q, v, t)
        return value if self.acts else -value


class Switches:
    """The forces of a run that switch.

    held : all forces, those that switch on the side on which they are
    """

    def __init__(self, forces: Sequence[Force], q: Vector, v: Vector):
        self.held = tuple(
            _Held(force, force.value(q, v, 0.0) > 0) if isinstance(force, Switched) else force
            for force in forces
        )
        self._switching = [force for force in self.held if isinstance(force, _Held)]

    def __bool__(self) -> bool:
        return bool(self._switching)

    def crossings(self, path: Path, t: float, h: float) -> Crossings:
        """Where forces come to switch on a path to h that begins at time t, and their numbers."""
        found: Crossings = []
        for number, held in enumerate(self._switching):

            def margin(step: float, held: _Held = held) -> float:
                return held.margin(path(step), path.rate(step), t + step)

            before, after = margin(0.0), margin(h)
            if after < 0:
                found.append((locate_zero(margin, h, before, after) if before > 0 else 0.0, number))
        return found

    def flip(self, number: int) -> str:
        """From now on the force acts if it did not, and the other way round; what is to be said."""
        held = self._switching[number]
        held.acts = not held.acts
        return f"{type(held.switched.force).__name__} {'begins' if held.acts else 'ends'}"
