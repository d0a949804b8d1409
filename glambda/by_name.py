"""What a user writes: scenes, models and solvers by name, the solver left out; rows by folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import harness
import problems
from harness.names import METHOD
from harness.recordings.recording import Recording
from problems.scenes import Scene, scene
from problems.stepping.run import Run
from solvers.base import Solver
from solvers.registry import make_solver

if TYPE_CHECKING:
    import pandas as pd

ENGINE = "mujoco:"


def simulate(motion: Scene | str, solver: Solver | str = METHOD, **options: Any) -> Run:
    """Simulate a scene, or the one of this name, with a solver, or the one of this name.

    options : those of `problems.simulate`: eps, until, friction, keep_qps, …

    Raises ValueError for an unknown name or a bad setting, ImportError for an absent package,
    SimulationError where the motion cannot go on.
    """
    return problems.simulate(_scene(motion), _solver(solver), **options)


def record(motion: Scene | str, solver: Solver | str = METHOD, **options: Any) -> Recording:
    """The recording of such a simulation: every QP of it, with a reference answer.

    motion : or "mujoco:NAME", a model of ours or the path of an MJCF file, whose QPs MuJoCo poses
        (`harness.engines.mujoco`); no solver is asked then
    options : those of `harness.record`, or of `record_mujoco`.  Raises what `simulate` does.
    """
    if isinstance(motion, str) and motion.startswith(ENGINE):
        from harness.engines.mujoco import record_mujoco

        return record_mujoco(motion.removeprefix(ENGINE), **options)
    return harness.record(_scene(motion), _solver(solver), **options)


def load_results(folder: str | Path) -> pd.DataFrame:
    """All rows of a results folder: `harness.results.store.COLUMNS`, and `verified` and `charged`.

    Raises ValueError where the folder holds none, or such as must not stand in one table.
    """
    from reports.rows.results import load_results as read_rows  # pandas, which takes half a second

    rows = read_rows(folder).everything
    if rows.empty:
        raise ValueError(f"{folder}: holds no solves; give a folder that a replay has written")
    return rows


def _scene(motion: Scene | str) -> Scene:
    return scene(motion) if isinstance(motion, str) else motion


def _solver(solver: Solver | str) -> Solver:
    return make_solver(solver) if isinstance(solver, str) else solver
