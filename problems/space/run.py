"""What a simulation in space leaves behind: poses, velocities, reactions, events, and its QPs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from problems.qp import ContactQP, Solution, Vector
from problems.space.discs import DiscQP
from problems.space.motion import Mass
from problems.space.scene import SpaceScene
from problems.stepping.run import Event, Simulated

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class SpaceRun(Simulated):
    """Outcome of `problems.space.stepper.simulate`.

    t : (n,) [s] accepted times; a time stands twice where an impulse changed the velocities
    poses : (n, bodies, 7) centre [m] and attitude;  velocities : (n, bodies, 6) [m/s, rad/s]
    reactions : (n, bodies, 6) G λ, forces and moments of all constraints [N, N·m]; 0 at t = 0
    gaps : (n,) the least φ of the active constraints [m], inf where there are none
    event_log, qps, solutions, counts, options : as those of `problems.Run`; an event `join` is a
        point of contact more of bodies that touch already
    discs : of each accepted step with Coulomb's discs, the QP with them that it has solved by
        bounds alone, and its x; none where QPs are not kept
    """

    scene: SpaceScene
    t: Vector
    poses: Vector
    velocities: Vector
    reactions: Vector
    gaps: Vector
    event_log: list[Event]
    qps: list[ContactQP]
    solutions: list[Solution]
    counts: dict[str, int]
    options: dict[str, Any]
    discs: list[tuple[DiscQP, Vector]] = field(default_factory=list)

    def _sizes(self) -> dict[str, Any]:
        return {
            "t": f"{self.t[-1]:.4g} s",
            "bodies": len(self.scene.solids),
            "steps": self.counts["steps"],
            "events": len(self.event_log),
            "QPs kept": len(self.qps),
        }

    @property
    def q(self) -> Vector:
        """(n, 0, 3): there are no bodies of the plane, and a recording says so."""
        return np.zeros((len(self.t), 0, 3))

    v = q

    @cached_property
    def momenta(self) -> Vector:
        """(n, bodies, 6) momentum, and angular momentum about each centre."""
        return np.array([self._mass(i).momentum(v.ravel()) for i, v in enumerate(self.velocities)]
                        ).reshape(self.velocities.shape)  # fmt: skip

    @cached_property
    def energy(self) -> Vector:
        """(n,) T + V [J]; V is 0 at z = 0."""
        kinetic = 0.5 * np.sum(self.momenta * self.velocities, axis=(1, 2))
        masses = np.array([solid.mass for solid in self.scene.solids])
        return np.asarray(kinetic + self.scene.gravity * self.poses[:, :, 2] @ masses)

    def _mass(self, i: int) -> Mass:
        return Mass(self.scene.solids, self.poses[i, :, 3:])

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """One row per accepted step and body: t, body (from 1), pose and velocities."""
        import pandas as pd

        n, bodies, _ = self.poses.shape
        table = np.concatenate([self.poses, self.velocities], axis=2).reshape(n * bodies, 13)
        names = ["x", "y", "z", "e0", "e1", "e2", "e3", "vx", "vy", "vz", "wx", "wy", "wz"]
        frame = pd.DataFrame(table, columns=names)
        frame.insert(0, "body", np.tile(np.arange(1, bodies + 1), n))
        frame.insert(0, "t", np.repeat(self.t, bodies))
        return frame
