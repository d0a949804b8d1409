"""The closed loop: every backend drives every scene, and the motions are compared.

An open loop hands all solvers the same QPs.  Here each solver's answers make its own next QPs, so
that what matters is the motion.  For each scene there are

    the reference   exact QPs (`harness.motions.in_loop.EXACT`) at ε/`FINER`;  its own error is
                    known from the check, the same at a ten times larger ε: to the second order of
                    the methods the global error is proportional to ε, so that the reference's is a
                    ninth of the difference between the two
    the twin        exact QPs at the scene's ε: what is left is the error of ε
    the loops       each solver at each setting, and sloppy solvers (`harness.motions.in_loop`) over
                    a sweep of accuracies

`drop_tol` and the speed of rest are the same in all of them, so that the reference is the limit of
the very motion that is simulated.  A loop's error is judged up to `common`: the last impact before
the twin or the check separates from the reference, for from then on even exact QPs miss it.

Each loop runs in a process of its own, which has a time limit and may die (`isolated_loops`); a
finished one is kept at once (`loop_store`), and the same command continues.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from harness.files.folder_lock import sole_writer
from harness.judging.facts import SETTINGS
from harness.motions.in_loop import EXACT, SLOPPY, check_backend
from harness.motions.isolated_loops import run_isolated
from harness.motions.loop import Loop, LoopResult
from harness.motions.loop_store import load_loop
from harness.motions.motion_error import Motion, PoseError, match_events, pose_error
from harness.names import METHOD
from harness.processes.introduction import available
from harness.progress import Progress
from problems import scene as make_scene
from problems.scenes.labels import PAPER_SCENES, parse_label

SWEEP = ("1e-4x", "1e-3x", "0.01x", "0.1x", "1x", "10x", "100x", "1000x", "1e4x")
"""Accuracies of the sloppy solvers."""
FINER, CHECK = 1000.0, 100.0
"""ε over that of the reference, and over that of its check."""
TIME_LIMIT = 300.0
"""[s] of a loop; the reference has `FINER_TIME` of them."""
FINER_TIME = 10.0

NAN = float("nan")


@dataclass(frozen=True)
class LoopPlan:
    """What is run.

    scenes : labels;  solvers : names; empty: every backend that is installed
    settings : of `solvers`;  sweep : settings of the sloppy solvers; empty: none of them
    until : end of the motions [s], None: each scene's own;  eps : ε, None: each scene's own
    time_limit : [s] of wall time of a loop;  workers : processes at a time
    finer, check : `FINER`, `CHECK`
    """

    scenes: tuple[str, ...] = PAPER_SCENES
    solvers: tuple[str, ...] = ()
    settings: tuple[str, ...] = SETTINGS
    sweep: tuple[str, ...] = SWEEP
    until: float | None = None
    eps: float | None = None
    time_limit: float = TIME_LIMIT
    workers: int = 1
    finer: float = FINER
    check: float = CHECK

    def __post_init__(self) -> None:
        if not self.scenes:
            raise ValueError("there are no scenes; name some, or leave them out")
        for solver in self.named_solvers():
            for setting in self.settings:
                check_backend(solver, setting)
        for setting in self.sweep:
            check_backend(SLOPPY[0], setting)
        for name in ("until", "eps", "time_limit"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ValueError(f"{name} = {value}; give a positive number")
        if self.workers < 1:
            raise ValueError(f"workers = {self.workers}; there must be at least one")
        if not 1 < self.check < self.finer:
            raise ValueError(f"check = {self.check} must lie between 1 and finer = {self.finer}")

    def named_solvers(self) -> tuple[str, ...]:
        """The solvers, written out."""
        return self.solvers or tuple(available())

    def campaigns(self) -> list[Campaign]:
        """The loops of each scene.  Raises ValueError for an unknown scene."""
        return [self._campaign(label) for label in self.scenes]

    def _campaign(self, label: str) -> Campaign:
        name, parameters = parse_label(label)
        scene = make_scene(name, **parameters)
        eps = scene.eps if self.eps is None else self.eps
        twin = Loop(
            scene=scene.label,
            solver=METHOD,
            setting=EXACT,
            eps=eps,
            drop_tol=eps,
            rest_speed=2 * eps,
            until=scene.end_time if self.until is None else self.until,
            time_limit=self.time_limit,
        )
        patience = FINER_TIME * self.time_limit
        wanted = [(solver, setting) for solver in self.named_solvers() for setting in self.settings]
        wanted += [(solver, setting) for solver in SLOPPY for setting in self.sweep]
        return Campaign(
            reference=replace(twin, eps=eps / self.finer, time_limit=patience),
            check=replace(twin, eps=eps / self.check, time_limit=patience),
            twin=twin,
            loops=tuple(replace(twin, solver=s, setting=a) for s, a in wanted if (s, a) != _EXACT),
        )


_EXACT = (METHOD, EXACT)


@dataclass(frozen=True)
class Campaign:
    """All loops of one scene; see the module."""

    reference: Loop
    check: Loop
    twin: Loop
    loops: tuple[Loop, ...]

    @property
    def all(self) -> tuple[Loop, ...]:
        """Every loop, the long ones first."""
        return self.reference, self.check, self.twin, *self.loops


def close_loops(
    plan: LoopPlan, folder: str | Path, *, progress: Progress | None = None
) -> list[Findings]:
    """Run what is not in the folder yet, and compare.

    Raises ValueError and ImportError for unknown or absent names, StoreError where the folder holds
    results of other code or parameters, and Locked where another process writes into it.
    """
    folder = Path(folder)
    campaigns = plan.campaigns()
    with sole_writer(folder, "loops"):
        results = {loop: load_loop(folder, loop) for campaign in campaigns for loop in campaign.all}
        missing = [loop for loop, result in results.items() if result is None]
        done = len(results) - len(missing)
        run_isolated(missing, folder, plan.workers, done, progress)
        results |= {loop: load_loop(folder, loop) for loop in missing}
    return [findings(campaign, results) for campaign in campaigns]


# --- comparison ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Findings:
    """One scene: what its loops are worth.

    common : [s] up to which loops are judged;  first_impact : [s] of the reference
    reference, check, twin : see the module;  check_error, twin_error : against the reference
    rows : one row per loop, see `_row`;  results : by (solver, setting), the twin among them
    """

    scene: str
    eps: float
    until: float
    common: float
    first_impact: float
    reference: LoopResult
    check: LoopResult
    twin: LoopResult
    check_error: PoseError
    twin_error: PoseError
    rows: pd.DataFrame
    results: Mapping[tuple[str, str], LoopResult]


def findings(campaign: Campaign, results: Mapping[Loop, LoopResult | None]) -> Findings:
    """Compare the loops of a scene.

    Raises ValueError where the reference, its check or the twin did not finish.
    """
    known, motions = [], []
    for what, loop in zip(("reference", "check", "twin"), campaign.all[:3], strict=True):
        result = results[loop]
        if result is None or result.verdict != "finished" or result.motion is None:
            why = "was not run" if result is None else f"{result.verdict}: {result.reason}"
            raise ValueError(
                f"{loop.scene}: the {what} (exact QPs, ε = {loop.eps:g}) did not finish "
                f"({why}); give a larger --eps, an earlier --until or a longer --time-limit"
            )
        known.append(result)
        motions.append(result.motion)
    reference, check, twin = known
    errors = [pose_error(motion, motions[0]) for motion in motions[1:]]
    common = _common(reference.reached, motions[0], errors)
    first = min(motions[0].first_impact, common)
    loops = {(r.loop.solver, r.loop.setting): r for r in _present(results, campaign.loops)}
    every = {_EXACT: twin, **loops}
    rows = [_row(result, reference, twin, first, common) for result in every.values()]
    return Findings(
        scene=campaign.twin.scene,
        eps=campaign.twin.eps,
        until=campaign.twin.until,
        common=common,
        first_impact=first,
        reference=reference,
        check=check,
        twin=twin,
        check_error=errors[0],
        twin_error=errors[1],
        rows=pd.DataFrame(rows),
        results=every,
    )


def _common(end: float, reference: Motion, errors: Sequence[PoseError]) -> float:
    """Until when loops are judged [s]: the last impact before the first separation, or the end."""
    apart = min([end, *(error.apart for error in errors if not np.isnan(error.apart))])
    if apart == end:
        return end
    impacts = [event.t for event in reference.events if event.kind == "impulse"]
    return max((t for t in impacts if t < apart), default=apart)


def _present(results: Mapping[Loop, LoopResult | None], loops: Iterable[Loop]) -> list[LoopResult]:
    return [result for loop in loops if (result := results.get(loop)) is not None]


def _row(
    result: LoopResult, reference: LoopResult, twin: LoopResult, first: float, common: float
) -> dict[str, Any]:
    """One loop.

    solver, setting, verdict, reason, reached
    error_first, error, error_end, rms, rms_end : pose error [m] up to the first impact, up to
        `common`, to the end;  apart : when it separates from the reference [s]
    from_twin : largest distance to the motion of exact QPs at the same ε, up to `common` [m]
    matched, missing, extra, event_error, mismatch : restarting events up to `common`
        (`harness.motions.motion_error.EventMatch`)
    and the measures of `run_loop`; with `energy_end`, final T + V less the reference's [J]
    """
    row: dict[str, Any] = {
        "scene": result.loop.scene,
        "solver": result.loop.solver,
        "setting": result.loop.setting,
        "verdict": result.verdict,
        "reason": result.reason,
        "reached": result.reached,
    }
    motion = result.motion
    if motion is not None and reference.motion is not None and twin.motion is not None:
        error = pose_error(motion, reference.motion)
        row |= {
            "error_first": error.largest(first),
            "error": error.largest(common),
            "error_end": error.largest(),
            "rms": error.rms(common),
            "rms_end": error.rms(),
            "apart": error.apart,
            "from_twin": pose_error(motion, twin.motion).largest(common),
        }
        until = min(common, result.reached)
        match = match_events(motion.events, reference.motion.events, until)
        row |= {
            "matched": match.matched,
            "missing": match.missing,
            "extra": match.extra,
            "event_error": match.largest,
            "mismatch": match.mismatch,
        }
        finished = result.verdict == "finished"
        drift = result.measures["final_energy"] - reference.measures["final_energy"]
        row["energy_end"] = drift if finished else NAN
    return {**row, **result.measures}
