"""What the simulation of a network leaves behind: currents, charges, voltages, and its QPs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.networks.network import Network
from problems.qp import ContactQP, Solution, Vector
from problems.stepping.run import Event, Simulated

if TYPE_CHECKING:
    import pandas as pd

NETWORK_EVENTS = ("blocks", "conducts", "switch")
"""Kinds of `event_log`: a diode stops or begins to conduct; a source or a switch jumps."""


@dataclass(frozen=True, eq=False, repr=False)
class NetworkRun(Simulated):
    """Outcome of `problems.networks.stepper.simulate`.

    t : (n,) [s] accepted times
    currents, charges : (n, b) of the branches [A], [C]
    potentials : (n, nodes) of the nodes from 1 on [V], NaN at t = 0
    diode_voltages : (n, b) λ of (6.2) [V], 0 for a branch without a diode, NaN at t = 0
    event_log, qps, solutions, counts, options : as those of `problems.Run`
    """

    scene: Network
    t: Vector
    currents: Vector
    charges: Vector
    potentials: Vector
    diode_voltages: Vector
    event_log: list[Event]
    qps: list[ContactQP]
    solutions: list[Solution]
    counts: dict[str, int]
    options: dict[str, Any]

    def _sizes(self) -> dict[str, Any]:
        return {
            "t": f"{self.t[-1]:.4g} s",
            "currents": len(self.scene.branches),
            "steps": self.counts["steps"],
            "events": len(self.event_log),
            "QPs kept": len(self.qps),
        }

    @property
    def q(self) -> Vector:
        """(n, 0, 3): there are no bodies, and a recording says so."""
        return np.zeros((len(self.t), 0, 3))

    v = q

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """One row per accepted step: t, i of every branch, u of every node."""
        import pandas as pd

        columns = {
            f"i {name}": i for name, i in zip(self.scene.names(), self.currents.T, strict=True)
        }
        columns |= {f"u {node}": u for node, u in enumerate(self.potentials.T, start=1)}
        return pd.DataFrame({"t": self.t, **columns})
