"""Simulate and record as a user writes it: scenes and solvers by name, the solver left out."""

from __future__ import annotations

from typing import Any

import harness
import problems
from harness.names import METHOD
from harness.recordings.recording import Recording
from problems.scenes import Scene, scene
from problems.stepping.run import Run
from solvers.base import Solver
from solvers.registry import make_solver


def simulate(motion: Scene | str, solver: Solver | str = METHOD, **options: Any) -> Run:
    """Simulate a scene, or the one of this name, with a solver, or the one of this name.

    options : those of `problems.simulate`: eps, until, friction, keep_qps, …

    Raises ValueError for an unknown name or a bad setting, ImportError for an absent package,
    SimulationError where the motion cannot go on.
    """
    return problems.simulate(_scene(motion), _solver(solver), **options)


def record(motion: Scene | str, solver: Solver | str = METHOD, **options: Any) -> Recording:
    """The recording of such a simulation: every QP of it, with a reference answer.

    options : those of `harness.record`.  Raises what `simulate` does.
    """
    return harness.record(_scene(motion), _solver(solver), **options)


def _scene(motion: Scene | str) -> Scene:
    return scene(motion) if isinstance(motion, str) else motion


def _solver(solver: Solver | str) -> Solver:
    return make_solver(solver) if isinstance(solver, str) else solver
