"""Runs of engines over their steps and settings, kept as they finish.

    FOLDER/runs/<hash>.json     one run: what was asked, of which versions, on which machine; what
                                came of it

1. One engine after the other, in a process of its own (`harness.peers.worker`), task by task,
   coarse steps first.
2. A run that is there already is not repeated, unless it did not end within a shorter limit.
   Another version, machine or scene is another run; stale ones lie there and are not read.
3. Where a pass took more than the limit, finer ones of the setting are not tried; the row says so.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from harness.files.folder_lock import sole_writer
from harness.files.json_file import read_json, sealed_json
from harness.files.plain_files import Unreadable
from harness.files.whole_files import write_whole
from harness.machine.machine import machine_label
from harness.peers import (
    NAMES,
    OURS,
    EngineInfo,
    describe_engine,
    engine_class,
    engine_version,
    takes,
)
from harness.peers.tasks import DEFAULT, Task, digest_of, tasks_of
from harness.peers.worker import Worker
from harness.progress import Progress

LIMIT = 60.0
"""Time that one pass may take [s]."""


@dataclass(frozen=True)
class Plan:
    """What is run.

    scenes : as for `harness.peers.tasks.tasks_of`;  engines : names; empty: all that are there
    limit : time that one pass may take [s]

    The project's own stepper is always among the engines: its finest run is the reference.
    """

    scenes: tuple[str, ...] = DEFAULT
    engines: tuple[str, ...] = ()
    limit: float = LIMIT

    def __post_init__(self) -> None:
        if not self.limit > 0:
            raise ValueError(f"limit = {self.limit}; give a positive number of seconds")
        for name in self.engines:
            found = describe_engine(name)
            if not found.available:
                raise ValueError(f"engine {name!r} is not installed: {found.reason}")

    def described(self) -> list[EngineInfo]:
        """The engines that are meant, ours first."""
        names = dict.fromkeys((OURS, *(self.engines or NAMES)))
        return [describe_engine(name) for name in names]


@dataclass(frozen=True)
class Run:
    """One run that is wanted: what distinguishes it from others.

    start : digest of the scene that the engine is given
    """

    engine: str
    setting: str
    swept: str
    resolution: float
    task: Task
    start: str
    version: str
    machine: str

    def path(self, folder: Path) -> Path:
        """Where its outcome is kept."""
        text = json.dumps(asdict(self), sort_keys=True)
        return folder / "runs" / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.json"


Outcome = dict[str, Any]


def run_campaign(
    plan: Plan, folder: str | Path, *, progress: Progress | None = None
) -> list[tuple[Run, Outcome]]:
    """Run what is missing in `folder`; all runs of the plan with their outcomes.

    An outcome has status ("done", "failed", "crashed", "timeout" or "skipped") and reason, and if
    it is done what `harness.peers.observe.observe` returns.

    Raises Locked where another process runs a campaign into the folder.
    """
    folder = Path(folder)
    tasks = tasks_of(plan.scenes)
    engines = [info.name for info in plan.described() if info.available]
    wanted = {
        engine: [run for task in tasks for run in runs_of(engine, task)] for engine in engines
    }
    total = float(sum(map(len, wanted.values())))
    done: list[tuple[Run, Outcome]] = []
    with sole_writer(folder, "runs"):
        for engine, runs in wanted.items():
            with Worker(engine) as worker:
                for run in runs:
                    if progress is not None:
                        what = f"{engine}, {run.setting}, {run.swept} = {run.resolution:.2g}: "
                        progress(what + run.task.name, float(len(done)), total)
                    done.append((run, _outcome(run, done, worker, folder, plan.limit)))
    return done


def runs_of(engine: str, task: Task) -> Iterator[Run]:
    """Everything that is asked of an engine in a task, setting by setting, coarse steps first.

    Nothing, where it takes no scenes in space, or none in the plane.
    """
    if not takes(engine, task.in_space):
        return
    cls = engine_class(engine, task.in_space)
    resting = task.kind == "rest"
    settings = cls.resting if resting and cls.resting is not None else cls.settings
    resolutions: Sequence[float] = (
        (cls.rest,) if resting else cls.middling if task.kind == "whole" else cls.resolutions
    )
    swept = "h" if settings is cls.resting else cls.swept
    where = digest_of(task.start()), engine_version(engine, cls), machine_label()
    for setting in settings:
        for resolution in resolutions:
            yield Run(engine, setting, swept, resolution, task, *where)


def _outcome(
    run: Run, done: list[tuple[Run, Outcome]], worker: Worker, folder: Path, limit: float
) -> Outcome:
    """The outcome of a run, from the folder if it is there."""
    kept = _kept(run, folder, limit)
    if kept is not None:
        return kept
    if _coarser_was_too_slow(run, done):
        outcome: Outcome = {"status": "skipped", "reason": "a coarser step took too long"}
    else:
        cls = engine_class(run.engine, run.task.in_space)
        options = {**cls.settings, **(cls.resting or {})}[run.setting]
        outcome = worker.run(run.task, dict(options), run.resolution, limit)
    outcome = {**outcome, "limit": limit}
    write_whole(run.path(folder), sealed_json({**asdict(run), **outcome}))
    return outcome


def _coarser_was_too_slow(run: Run, done: list[tuple[Run, Outcome]]) -> bool:
    if not done:
        return False
    before, outcome = done[-1]
    same = (before.task, before.engine, before.setting) == (run.task, run.engine, run.setting)
    return same and outcome["status"] in ("timeout", "skipped")


def _kept(run: Run, folder: Path, limit: float) -> Outcome | None:
    """What is stored of a run, unless more time is allowed now to one that had too little.

    What is damaged, or of another run under this one's name, is made anew.
    """
    try:
        kept: Outcome = read_json(run.path(folder), must_be_sealed=True)
    except (FileNotFoundError, Unreadable):
        return None
    asked = json.loads(json.dumps(asdict(run)))
    if not {*asked, "status", "limit"} <= {*kept} or asked != {name: kept[name] for name in asked}:
        return None
    ended = kept["status"] not in ("timeout", "skipped")
    return kept if ended or kept["limit"] >= limit else None
