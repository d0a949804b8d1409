"""Cundall's springs and dampers (`harness.peers.springs`), the paper's own foil.

Contacts are as stiff as the step allows, so that they harden with h.  It is this project's code in
NumPy: compare its errors, not its times.
"""

from __future__ import annotations

from typing import ClassVar

from harness.peers.base import Settings, Stepped, one_friction
from harness.peers.springs import SAFETY, SpringsAndDampers
from problems import Scene
from problems.qp import Vector


class Cundall(Stepped):
    package = "glambda"
    settings: ClassVar[Settings] = {"stock": {"damping": 0.5}, "critical": {"damping": 1.0}}
    model = "has contacts that are damped springs, as stiff as the step allows; not compiled"

    def __init__(self, scene: Scene, h: float, damping: float) -> None:
        super().__init__(h)
        one_friction(scene)  # what engines are not given, it is not given either
        lightest = min(body.mass for body in scene.bodies)
        stiffness = lightest * (2.0 * SAFETY / h) ** 2
        self.springs = SpringsAndDampers(scene, stiffness, damping=damping)

    def step(self) -> None:
        self.springs.step(self.h)

    def state(self) -> tuple[Vector, Vector]:
        return self.springs.q.reshape(-1, 3).copy(), self.springs.v.reshape(-1, 3).copy()
