"""This project's stepper, with our method in the loop, measured as its peers are.

It chooses its steps for an ε; its states between them are had by cubic interpolation.  What it
takes to build the scene is measured by runs of no steps and not counted, as with the peers.
Impacts are Newton's and Coulomb's with the friction coefficient of the scene, as the peers' are,
not the paper's.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from math import sqrt
from typing import Any, ClassVar

from harness.motions.hermite import hermite
from harness.peers.base import Motion, Peer, Settings
from harness.peers.in_space import rate, state_of, velocity
from problems import scene, simulate
from problems.qp import Vector
from problems.space.attitude import rotations
from problems.space.run import SpaceRun
from problems.stepping.run import Run
from solvers import make_solver

NO_TIME = 1e-9
"""A run that ends here takes no step [s]."""
BUILDS = 3
"""Such runs, the shortest of which counts: one that is disturbed outlasts a short motion."""
SHORT = 0.02
"""CPU time of a run below which the difference of single runs would be noise [s] …"""
PAIRS = 20
"""… and runs of each kind whose least times are subtracted then."""
FIRST_STEP, LARGEST_STEP = 1e-3, 0.02
"""Stock bounds of the step [s]."""
SHARE, LARGEST_BOUND = 0.3, 0.05
"""Bound of the step over √ε, and its own [s]."""
COLLIDED, RESTED = 0.3, 0.01
"""When boxes have fallen on each other, and when a tower has rested for two steps [s]."""
REST_EPS = 1e-9
"""ε of fixed steps."""
BOUNDED = f"h ≤ {SHARE:g} √ε"
"""The setting whose finest run is the reference: its steps are short even where its estimate of the
error has nothing to go by, as before a contact lets go."""


class Glambda(Peer):
    package = "glambda"
    settings: ClassVar[Settings] = {"stock": {}, BOUNDED: {"bounded": True}}
    model = "takes contacts as rigid; impacts are Newton's without restitution and Coulomb's"
    swept = "ε"
    resolutions = (3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    middling = (1e-3, 1e-4)
    resting: ClassVar[Settings] = {"fixed step": {"fixed": True}}
    own: ClassVar[dict[str, Any]] = {"impulses": "newton_coulomb"}

    def __init__(
        self, scene: Any, resolution: float, bounded: bool = False, fixed: bool = False
    ) -> None:
        self.scene, self.solver = replace(scene, mu_I=scene.mu), make_solver("glambda")
        longest = min(SHARE * sqrt(resolution), LARGEST_BOUND) if bounded else LARGEST_STEP
        self.options: dict[str, Any] = {"keep_qps": False, **self.own}
        self.options |= (
            {"eps": REST_EPS, "fixed_step": resolution}
            if fixed
            else {"eps": resolution, "h_max": longest, "h_first": min(FIRST_STEP, longest)}
        )

    @classmethod
    def prepare(cls) -> None:
        """Have the kernels compiled, which a pass on a new machine would be charged with."""
        moving, resting = cls.first()
        cls(moving, 1e-3)._timed(COLLIDED)
        cls(resting, RESTED / 2, fixed=True)._timed(RESTED)

    @staticmethod
    def first() -> tuple[Any, Any]:
        """Scenes that have everything compiled: one that collides, and a high tower."""
        return scene("fig4"), scene("tower", bodies=100, speed=0.0, mu=0.5)

    def run(self, times: Sequence[float]) -> Motion:
        building = min(self._timed(NO_TIME)[0] for _ in range(BUILDS))
        spent, run = self._timed(times[-1])
        for _ in range(PAIRS if spent < SHORT else 0):
            building = min(building, self._timed(NO_TIME)[0])
            spent = min(spent, self._timed(times[-1])[0])
        return Motion(*self._states(run, times), spent - building, run.counts["steps"])

    def _states(self, run: Any, times: Sequence[float]) -> tuple[Vector, Vector]:
        return hermite(run.t, run.q, run.v, times)

    def _timed(self, until: float) -> tuple[float, Run | SpaceRun]:
        start = time.process_time_ns()
        run = simulate(self.scene, self.solver, until=until, **self.options)
        return 1e-9 * (time.process_time_ns() - start), run


class GlambdaInSpace(Glambda):
    """Slides do not end within a step there, and nothing of the stepping itself is compiled."""

    in_space = True
    own: ClassVar[dict[str, Any]] = {}

    @staticmethod
    def first() -> tuple[Any, Any]:
        return scene("skid"), scene("space_tower", bodies=20)

    def _states(self, run: SpaceRun, times: Sequence[float]) -> tuple[Vector, Vector]:
        shape = run.poses.shape[:2]
        R = rotations(run.poses[..., 3:].reshape(-1, 4)).reshape(*shape, 3, 3)
        q = state_of(run.poses[..., :3], R)
        found, derivative = hermite(run.t, q, rate(q, run.velocities), times)
        return found, velocity(found, derivative)
