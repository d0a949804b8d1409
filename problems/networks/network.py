"""A network as a scene: what `problems.simulate` starts from where there are no bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from problems.networks.branch import Branch
from problems.qp import Vector
from problems.short import Short


class State(NamedTuple):
    """Currents [A], charges [C], and di/dt of the inductances [A/s], (b,) each."""

    i: Vector
    q: Vector
    a: Vector


@dataclass(frozen=True, eq=False, repr=False)
class Network(Short):
    """Branches between nodes.

    branches : numbered from 1 in everything that people read
    h_max : longest step [s]; a diode that blocks lets nothing happen, and h would grow across
        what its source does meanwhile
    eps : ε of (3.5): the local error of the charges in the norm of the inductances is at most ε h
    end_time : [s]
    name, parameters : the function that made it and all its named parameters

    Raises ValueError, naming the field, for no branch, a node that no branch leaves and enters, or
    times that are not positive.
    """

    branches: tuple[Branch, ...]
    h_max: float
    eps: float = 1e-3
    end_time: float = 1.0
    name: str = "network"
    label: str = ""
    parameters: Mapping[str, float | int | bool | str] = field(default_factory=dict)

    bodies = ()
    gravity = 0.0

    def __post_init__(self) -> None:
        if not self.branches:
            raise ValueError("branches is empty; a network needs at least one")
        for name in ("h_max", "eps", "end_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value!r}; it must be a positive number")
        ends = [node for branch in self.branches for node in (branch.start, branch.end)]
        for node in range(max(ends) + 1):
            if ends.count(node) < 2:
                raise ValueError(
                    f"branches: {ends.count(node)} end at node {node}; a current needs a way in "
                    "and one out"
                )
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def _title(self) -> str:
        return self.label

    def _sizes(self) -> dict[str, Any]:
        diodes = sum(branch.diode for branch in self.branches)
        return {
            "currents": len(self.branches),
            "nodes": self.incidence().shape[1],
            "diodes": diodes,
            "end": f"{self.end_time:g} s",
        }

    def names(self) -> list[str]:
        """What branches are called: by name, or number."""
        return [branch.name or str(i) for i, branch in enumerate(self.branches, start=1)]

    def array(self, name: str) -> Vector:
        """A field of all branches, (b,)."""
        return np.array([getattr(branch, name) for branch in self.branches], dtype=np.float64)

    def start(self) -> State:
        """Currents and charges at t = 0; di/dt is not known."""
        C = self.array("C")
        q = np.where(np.isfinite(C), C, 0.0) * self.array("voltage")
        return State(self.array("current"), q, np.zeros(len(C)))

    def incidence(self) -> Vector:
        """G of the nodes but the ground, (b, n): 1 where a branch leaves one, −1 where it enters.

        Kirchhoff's law of currents is Gᵀ i = 0, and its multipliers are the potentials u.
        """
        last = max(max(branch.start, branch.end) for branch in self.branches)
        G = np.zeros((len(self.branches), last + 1))
        for row, branch in enumerate(self.branches):
            G[row, branch.start] += 1.0
            G[row, branch.end] -= 1.0
        return G[:, 1:]

    def voltages(self, t: float) -> Vector:
        """Of the sources at t, before a jump there, (b,) [V]."""
        return np.array([branch.source.value(t) for branch in self.branches])

    def open_switches(self, t: float) -> Vector:
        """Which branches have a switch that is open at t, before a jump there, (b,) bool."""
        return np.array(
            [branch.switch is not None and branch.switch.value(t) <= 0 for branch in self.branches]
        )

    def jumps(self, end: float) -> list[float]:
        """Times in (0, end) at which a source or a switch jumps, ascending."""
        of_time = (s for b in self.branches for s in (b.source, b.switch) if s is not None)
        return sorted({time for each in of_time for time in each.jumps(end)})

    def mu_between(self, a: int, b: int) -> float:
        """No friction."""
        return 0.0
