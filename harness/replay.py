"""Open-loop replay: every solver sees the identical recorded QPs, in order.

For each recording and each accuracy setting:

1. Pose the QPs with the accuracy of the setting; know their rank, scale and reference.
2. Line up the runs: each solver in each arm that it has (`harness.starts`).
3. Go round all runs, one pass each, and round again until each has its repeats: what drifts on the
   machine drifts for all.  A short warm-up comes before a run's first pass.  A run whose pass takes
   more than `slow_pass` seconds is not repeated.
4. The first pass is judged; the others only add times.  Every finished pass is stored at once.

A folder that holds some of it already is continued where it stopped (`harness.store`).
"""

from __future__ import annotations

import gc
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from harness.facts import Facts, facts_of, setting_name
from harness.judge import judge
from harness.machine import machine_label, solver_version
from harness.measure import Outcome, Watch, run_pass
from harness.record import Progress
from harness.recording import Recording, read_recording
from harness.starts import ARMS, has_arm
from harness.store import Shard, ShardKey, Store, read_results
from harness.threads import one_thread
from problems.qp import ContactQP, WorkCounts
from solvers import make_solver
from solvers.base import Solver
from solvers.registry import solver_class

WARM_UP = 1.0
"""Longest warm-up of a run [s]."""


@dataclass(eq=False)
class Run:
    """A solver in one arm on one recording at one setting, and what has been stored of it."""

    key: ShardKey
    solver: Solver
    shard: Shard | None
    warmed: bool = False

    @property
    def passes(self) -> int:
        """Number of passes that are stored."""
        return 0 if self.shard is None else self.shard.passes.shape[0]

    def is_done(self, repeats: int, slow_pass: float) -> bool:
        """Whether no pass is left to do."""
        if self.shard is None:
            return False
        longest = float(np.nansum(self.shard.passes[0, :, 3]))
        return self.passes >= repeats or longest > slow_pass


def replay(
    recordings: Recording | str | Path | Iterable[Recording | str | Path],
    solvers: Sequence[str],
    settings: Sequence[str] = ("paper",),
    arms: Sequence[str] = ARMS,
    *,
    results: str | Path | None = None,
    repeats: int = 3,
    time_limit: float = 1.0,
    slow_pass: float = 10.0,
    study: str = "",
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Replay recordings through solvers; return the rows (`harness.store.COLUMNS`).

    recordings : one or more, or their paths
    solvers : names, such as "daqp" or "lotstedt[exact_qr]"
    settings : of "paper", "high", "default" (`harness.facts`), or numbers such as "1e-6"
    arms : of `harness.starts.EVERY_ARM`
    results : folder that is written to or continued; None: only the rows are returned
    repeats : timed passes of each run;  time_limit : [s] per solve
    slow_pass : [s] a run whose pass takes longer is not repeated
    progress : called with the name of a run and the QPs solved, of all

    Raises ValueError for unknown names, ImportError where a solver's package is absent, and
    StoreError where `results` holds something that may not be mixed with this.
    """
    settings = list(dict.fromkeys(setting_name(setting) for setting in settings))
    for name in solvers:
        for arm in arms:
            has_arm(solver_class(name), arm)  # raises for an unknown one
    if repeats < 1:
        raise ValueError(f"repeats = {repeats}; at least one pass is needed")
    if not time_limit > 0:
        raise ValueError(f"time_limit = {time_limit}; give a positive number of seconds")
    if isinstance(recordings, (Recording, str, Path)):
        recordings = [recordings]
    loaded = [r if isinstance(r, Recording) else read_recording(r) for r in recordings]
    if results is None:
        with tempfile.TemporaryDirectory() as folder:
            return replay(
                loaded,
                solvers,
                settings,
                arms,
                results=folder,
                repeats=repeats,
                time_limit=time_limit,
                slow_pass=slow_pass,
                study=study,
                progress=progress,
            )
    store = Store(results)
    blocks = [
        (recording, setting, _runs(store, recording, solvers, setting, arms, time_limit))
        for recording in loaded
        for setting in settings
    ]
    total = sum(len(recording.qps) * len(runs) * repeats for recording, _, runs in blocks)
    counter = _Counter(total, progress)
    facts: dict[str, list[Facts]] = {}
    for recording, setting, runs in blocks:
        store.add_recording(recording)
        if all(run.is_done(repeats, slow_pass) for run in runs):
            counter.add("", len(recording.qps) * len(runs) * repeats)
            continue
        if recording.digest not in facts:
            facts[recording.digest] = [facts_of(qp) for qp in recording.qps]
        block = _Block(recording, setting, facts[recording.digest], time_limit, study)
        with one_thread(), _prepared_is_no_litter():
            for turn in range(repeats):
                for run in runs:
                    before = counter.done
                    if run.passes <= turn and not run.is_done(repeats, slow_pass):
                        store.save(block.do_pass(run, partial(counter.add, run.key.name)))
                    counter.add(run.key.name, before + len(recording.qps) - counter.done)
    return read_results(results)


def reproduce(
    recording: Recording, solver: str, setting: str, arm: str, index: int
) -> dict[str, Any]:
    """Solve and judge QP `index` as the replay does; a warm arm replays what leads up to it.

    Raises ValueError for an index that the recording does not have.
    """
    if not 0 <= index < len(recording.qps):
        raise ValueError(
            f"{recording.scene} has the QPs 0 to {len(recording.qps) - 1}; not {index}"
        )
    setting = setting_name(setting)
    leading = recording.qps if arm == "shuffled" else recording.qps[: index + 1]
    facts = [facts_of(qp) for qp in leading]
    posed = [_posed(f, setting) for f in facts]
    outcomes, times = run_pass(
        _make(solver, setting), posed, arm=arm, references=recording.references
    )
    row = _row(recording, setting, index, facts[index], outcomes[index])
    build, setup, solve, call = times[index]
    return {
        **row,
        "solver": solver,
        "settings": setting,
        "arm": arm,
        "runtime": setup + solve,
        "build_time": build,
        "setup_time": setup,
        "solve_time": solve,
        "call_time": call,
        "x": outcomes[index].x,
    }


@contextmanager
def _prepared_is_no_litter() -> Iterator[None]:
    """Spare the garbage collector from looking through all QPs before every pass."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class _Counter:
    """Tells the progress callback how many QPs of all are done."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.progress = 0, total, progress

    def add(self, what: str, count: int) -> None:
        self.done += count
        if self.progress is not None:
            self.progress(what, self.done, self.total)


class _Teller(Watch):
    """Tells how many QPs more are done, now and then."""

    def __init__(self, advance: Callable[[int], None]) -> None:
        self.advance, self.count = advance, 0

    def end(self, index: int, outcome: Outcome, times: np.ndarray) -> None:
        self.count += 1
        if self.count % 32 == 0:
            self.advance(32)


class _Block:
    """One recording at one setting: the QPs as posed to every solver."""

    def __init__(
        self, recording: Recording, setting: str, facts: list[Facts], limit: float, study: str
    ) -> None:
        self.recording, self.setting, self.facts = recording, setting, facts
        self.time_limit, self.study = limit, study
        self.posed = [_posed(f, setting) for f in facts]

    def do_pass(self, run: Run, advance: Callable[[int], None]) -> Shard:
        """One more pass of `run`; its shard grows by it and is returned."""
        one_pass = partial(
            run_pass,
            run.solver,
            self.posed,
            arm=run.key.arm,
            references=self.recording.references,
            time_limit=self.time_limit,
        )
        if not run.warmed:
            one_pass(budget=WARM_UP)
            run.warmed = True
        outcomes, times = one_pass(watch=_Teller(advance))
        if run.shard is None:
            rows: Sequence[Mapping[str, Any]] = [
                _row(self.recording, self.setting, i, self.facts[i], outcome)
                for i, outcome in enumerate(outcomes)
            ]
            passes = times[None]
        else:
            rows = run.shard.rows
            passes = np.concatenate([run.shard.passes, times[None]])
        run.shard = Shard(run.key, rows, passes, self.study)
        return run.shard


def _runs(
    store: Store,
    recording: Recording,
    solvers: Sequence[str],
    setting: str,
    arms: Sequence[str],
    time_limit: float,
) -> list[Run]:
    """The runs of one recording at one setting, with what the store has of them."""
    runs = []
    for name in solvers:
        for arm in arms:
            if not has_arm(solver_class(name), arm):
                continue
            key = ShardKey(
                scene=recording.scene,
                recording_digest=recording.digest,
                solver=name,
                settings=setting,
                arm=arm,
                versions=solver_version(name),
                machine=machine_label(),
                time_limit=time_limit,
            )
            runs.append(Run(key, _make(name, setting), store.load(key)))
    return runs


def _make(name: str, setting: str) -> Solver:
    return make_solver(name, accuracy="default") if setting == "default" else make_solver(name)


def _posed(facts: Facts, setting: str) -> ContactQP:
    """The QP with the accuracy that the setting asks for."""
    if setting == "paper":
        return facts.qp
    return facts.qp.with_accuracy(facts.asked(setting))


def _row(
    recording: Recording, setting: str, index: int, facts: Facts, outcome: Outcome
) -> dict[str, Any]:
    """Columns of one solve, but for its times and what the shard's key says."""
    qp = facts.qp
    work = dict.fromkeys(WorkCounts.__dataclass_fields__)
    if outcome.work is not None:
        work = asdict(outcome.work)
    row: dict[str, Any] = {
        "problem": f"{recording.scene}/{index:06d}",
        "found": outcome.found,
        "step": index,
        "kind": qp.kind,
        "accepted": qp.accepted,
        "restart": qp.restart,
        "t": qp.t,
        "m": qp.m,
        "k": qp.k,
        "rank": facts.rank,
        "status": outcome.status,
        "status_text": outcome.status_text,
        "iterations": outcome.iterations,
        **work,
        "asked": facts.asked(setting),
        "scale": facts.scale,
        "warm_started": outcome.warm_started,
        "after_restart": outcome.after_restart,
    }
    if outcome.verdict == "skipped":
        return {**row, "verdict": "skipped"}
    judgement = judge(
        qp,
        outcome.x,
        found=outcome.found,
        asked=row["asked"],
        reference=recording.references[index],
        facts=facts,
        seek_reference=False,
    )
    for name in (
        *("verdict", "primal_residual", "dual_residual", "duality_gap"),
        *("glambda_error", "eps0_ratio", "error_bound", "objective_error", "lambda_distance"),
    ):
        row[name] = getattr(judgement, name)
    if outcome.verdict is not None:
        row["verdict"] = outcome.verdict
    return row
