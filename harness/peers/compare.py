"""Errors of motions against a fine reference, orders, and the least time for an accuracy.

The reference of a motion is the finest run of our own stepper, in the setting whose steps shrink
with √ε; its own error is estimated by the distance of the next coarser run, which is larger.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from harness.peers import OURS
from harness.peers.campaign import Outcome, Run
from harness.peers.ours import BOUNDED
from harness.peers.tasks import Task
from problems.qp import Vector

TARGETS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Errors of the pose that are asked for [m or rad]."""
ABOVE_REFERENCE = 3.0
"""Errors below this many times the reference's own are not told apart from it."""
COARSE = 0.1
"""Errors above this have no order."""


class Reference(NamedTuple):
    """Poses and energies of a motion, and the error of the poses as estimated."""

    q: Vector
    energy: Vector
    error: float


class Order(NamedTuple):
    """p in error ~ (mean step)^p over `points` runs."""

    p: float
    points: int


def table_of(runs: Iterable[tuple[Run, Outcome]]) -> pd.DataFrame:
    """One row per run.

    kind, scene, until, task;  engine, setting, swept, resolution;  status, reason
    cpu [s], steps, step : mean length [s];  cpu_step : CPU time of one [s];  repeats
    error : largest distance of a coordinate of a pose from the reference at any time compared
    bodies : of a scene at rest
    kept_error : the largest error of this run and of all finer ones of its setting
    reference_error : the reference's own;  is_reference
    energy_error, gain : over the energy at the start;  penetration [m];  drift, top : largest, and
    of the last body [m];  turn [rad];  NaN where the task has no such thing

    Rows are in the order of the tasks, and for each in that of the engines.
    """
    runs = list(runs)
    tasks = list(dict.fromkeys(run.task for run, _ in runs))
    runs.sort(key=lambda each: tasks.index(each[0].task))
    references = _references(runs)
    rows = []
    for run, outcome in runs:
        row: dict[str, Any] = {
            "kind": run.task.kind, "scene": run.task.scene, "until": run.task.until,
            "task": run.task.name, "engine": run.engine, "setting": run.setting,
            "swept": run.swept, "resolution": run.resolution, "version": run.version,
            "status": outcome["status"], "reason": outcome["reason"], "is_reference": False,
        }  # fmt: skip
        if outcome["status"] == "done":
            row |= {name: outcome[name] for name in ("cpu", "steps", "repeats", "penetration")}
            row["step"] = run.task.until / max(1, outcome["steps"])
            row["cpu_step"] = outcome["cpu"] / max(1, outcome["steps"])
            if run.task.kind == "whole":
                row["gain"] = outcome["gain"]
            if run.task.kind == "rest":
                row["bodies"] = len(run.task.start().v0)
                row |= {"drift": max(outcome["drift"]), "top": outcome["drift"][-1]}
                row["turn"] = max(outcome["turn"])
            if run.task in references:
                reference = references[run.task]
                row["error"] = _distance(outcome["q"], reference.q)
                row["energy_error"] = _distance(outcome["energy"], reference.energy)
                row["reference_error"] = reference.error
                row["is_reference"] = row["error"] == 0.0
        rows.append(row)
    columns = ["cpu", "steps", "repeats", "step", "cpu_step", "error", "kept_error"]
    columns += ["reference_error"]
    columns += ["penetration", "energy_error", "gain", "drift", "top", "turn", "bodies"]
    frame = pd.DataFrame(rows)
    if "error" in frame.columns:
        finest_first = frame.sort_values("resolution", kind="stable")
        each = finest_first.groupby(["task", "engine", "setting"], sort=False)
        frame["kept_error"] = each["error"].cummax()
    return frame.reindex(columns=[*frame.columns, *(c for c in columns if c not in frame.columns)])


def _distance(a: Any, b: Vector) -> float:
    return float(np.abs(np.array(a) - b).max())


def _references(runs: list[tuple[Run, Outcome]]) -> dict[Task, Reference]:
    """Of each motion whose two finest runs of ours are there."""
    found = {}
    for task in dict.fromkeys(run.task for run, _ in runs if run.task.kind == "motion"):
        fine = [
            (run.resolution, outcome)
            for run, outcome in runs
            if (run.task, run.engine, run.setting) == (task, OURS, BOUNDED)
            and outcome["status"] == "done"
        ]
        if len(fine) >= 2:
            (_, finest), (_, next_finest) = sorted(fine, key=lambda each: each[0])[:2]
            q = np.array(finest["q"])
            found[task] = Reference(q, np.array(finest["energy"]), _distance(next_finest["q"], q))
    return found


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """Motions that ended and have an error, but for the reference itself."""
    return rows[(rows["kind"] == "motion") & rows["error"].notna() & ~rows["is_reference"]]


def order_of(rows: pd.DataFrame) -> Order | None:
    """Fit error ~ (mean step)^p to the runs of one setting; None for fewer than three of them."""
    clear = (rows["error"] > ABOVE_REFERENCE * rows["reference_error"]) & (rows["error"] < COARSE)
    step, error = rows.loc[clear, "step"].to_numpy(), rows.loc[clear, "error"].to_numpy()
    if len(error) < 3 or np.ptp(np.log(step)) == 0:
        return None
    return Order(float(np.polyfit(np.log(step), np.log(error), 1)[0]), len(error))


def cheapest(rows: pd.DataFrame, target: float, error: str = "kept_error") -> pd.Series | None:
    """The run of least CPU time among those whose `error` is at most `target`; None for none."""
    good = rows[rows[error] <= target]
    return good.loc[good["cpu"].idxmin()] if len(good) else None


def frontier(rows: pd.DataFrame) -> pd.DataFrame:
    """The runs that no other beats in both CPU time and error, by ascending CPU time."""
    ordered = rows.sort_values(["cpu", "error"])
    return ordered[ordered["error"] < ordered["error"].cummin().shift(fill_value=np.inf)]
