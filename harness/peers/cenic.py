"""CENIC, Drake's integrator for contact with control of the error: steps as long as it allows.

It is asked for an accuracy, not for a step.  Contacts are Drake's springs at the corners, of two
stiffnesses: soft ones overlap, hard ones cost steps.
"""

from __future__ import annotations

from typing import ClassVar

from pydrake.systems.analysis import ApplySimulatorConfig, SimulatorConfig

from harness.peers.base import Settings
from harness.peers.drake import Drake
from problems import Scene

CONTINUOUS = 0.0
"""Time step of a plant that an integrator moves on."""
LONGEST = 0.1
"""Longest step [s]."""


class Cenic(Drake):
    settings: ClassVar[Settings] = {
        "1e6 N/m": {"stiffness": 1e6},
        "1e8 N/m": {"stiffness": 1e8},
    }
    model = "has contacts that are damped springs, at corners that are rounded by 0.1 mm"
    swept = "accuracy"
    resolutions = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    middling = (1e-3, 1e-5)
    rest = 1e-5

    def __init__(self, scene: Scene, accuracy: float, stiffness: float) -> None:
        super().__init__(scene, CONTINUOUS, corner=1e-4, stiffness=stiffness)
        config = SimulatorConfig(
            integration_scheme="cenic",
            accuracy=accuracy,
            max_step_size=LONGEST,
            use_error_control=True,
        )
        ApplySimulatorConfig(config, self.simulator)
        self.simulator.Initialize()

    def advance(self, t: float) -> None:
        self.simulator.AdvanceTo(t)
        self.steps = self.simulator.get_integrator().get_num_steps_taken()
