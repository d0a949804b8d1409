"""Open-loop replay: every solver sees the identical recorded QPs, in order.

For each recording and each accuracy setting:

1. Pose the QPs with the accuracy of the setting; know their rank, scale and reference.
2. Line up the runs: each solver in each arm that it has (`harness.passes.starts`).
3. Go round all runs, one pass each, and round again until each has its repeats: what drifts on the
   machine drifts for all.  Each pass has a process of its own (`harness.processes.isolate`), which
   is warmed up before.  A run whose pass takes more than `slow_pass` seconds is not repeated, nor
   is one that has cost a process.  For a pass that something else on the machine has disturbed
   (`harness.machine.unrest`) another is taken, at most as many more as there are repeats.  The
   processors are kept awake meanwhile, where that is allowed (`harness.machine.awake`).
4. Every pass is judged: a row is that of its worst.  What a solver tells of its times is held
   against what is seen of them (`harness.passes.clocks`).  Every finished pass is stored at once.
5. In the end every shard is what was stored; one that somebody has altered is written anew.

A folder that holds some of it already is continued where it stopped (`harness.results.store`).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from harness.judging.facts import Facts, facts_of, setting_name, setting_names
from harness.judging.judge import Judgement, judge
from harness.machine.awake import AWAKE, awake
from harness.machine.calibration import calibrate
from harness.machine.machine import machine_label
from harness.passes.clocks import Asking, counted
from harness.passes.limits import MEMORY_LIMIT, TIME_LIMIT, Limits, Pass, Task, hard_limit
from harness.passes.measure import SEEN
from harness.passes.outcome import Outcome
from harness.passes.starts import ARMS, check_arm
from harness.passes.wire import TOLD
from harness.processes.cgroup import executor
from harness.processes.introduction import About, about, is_stranger
from harness.processes.isolate import Block, is_available
from harness.progress import Progress
from harness.recordings.recording import Recording, read_recording
from harness.results.store import COLUMNS, SPENT, TIMES, Shard, ShardKey, Store, read_results
from problems.qp import WorkCounts

DOUBT = "its own clock is not believed: ours, around the whole call, is used"
CALL = TIMES.index("call_time")
REPEATS, SLOW_PASS = 3, 10.0
"""Passes of a run, and seconds of one beyond which it is not repeated, if nothing else is said."""
WORST_LAST = (
    *("skipped", "verified", "undecided", "inaccurate", "claimed_wrong"),
    *("failed", "timeout", "crashed"),
)
"""Verdicts; a row has the worst of its passes."""
JUDGED = [entry.name for entry in fields(Judgement) if entry.name in COLUMNS]
"""What a row has of its judgement."""


@dataclass(eq=False)
class StoredRun:
    """A solver in one arm on one recording at one setting, and what has been stored of it.

    answers : the x that its rows have been judged by
    """

    key: ShardKey
    task: Task
    about: About
    shard: Shard | None
    answers: list[bytes] = field(default_factory=list)

    @property
    def passes(self) -> int:
        """Number of passes that are stored."""
        return 0 if self.shard is None else self.shard.passes.shape[0]


def is_done(shard: Shard | None, repeats: int = REPEATS, slow_pass: float = SLOW_PASS) -> bool:
    """Whether no pass is left to do; a disturbed one is left to whoever continues."""
    if shard is None:
        return False
    calls = shard.passes[:, :, CALL]
    quiet = sum(each.is_quiet for each in shard.unrest)
    return (
        quiet >= repeats
        or len(calls) >= 2 * repeats
        or float(np.nansum(calls[0])) > slow_pass
        or float(np.nanmax(calls, initial=0.0)) > hard_limit(shard.key.time_limit)
        or any(row["verdict"] == "crashed" for row in shard.rows)
    )


def replay(
    recordings: Recording | str | Path | Iterable[Recording | str | Path],
    solvers: Sequence[str],
    settings: Sequence[str] = ("paper",),
    arms: Sequence[str] = ARMS,
    *,
    results: str | Path | None = None,
    repeats: int = REPEATS,
    time_limit: float = TIME_LIMIT,
    memory_limit: float = MEMORY_LIMIT,
    slow_pass: float = SLOW_PASS,
    again: Sequence[str] = (),
    study: str = "",
    isolate: bool = True,
    timed: bool = True,
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Replay recordings through solvers; return the rows (`harness.results.store.COLUMNS`).

    recordings : one or more, or their paths
    solvers : names, such as "daqp" or "lotstedt[exact_qr]"
    settings : of "paper", "high", "default" (`harness.judging.facts`), or numbers such as "1e-6"
    arms : of `harness.passes.starts.EVERY_ARM`
    results : folder that is written to or continued; None: only the rows are returned
    repeats : timed passes of each run, disturbed ones aside;  time_limit : [s] per solve
    memory_limit : [GiB] that a solver may take
    slow_pass : [s] a run whose pass takes longer is not repeated
    again : of `solvers`, those of whom nothing that is stored counts any more
    isolate : whether each run has a process of its own, if the system can fork; without, there is
        no hard limit of time nor of memory, and a crash is the end
    timed : False for accuracy alone: without warm-up, and times compare with nothing
    progress : called with the name of a run and the QPs solved, of all

    Raises ValueError for unknown names, ImportError where a solver's package is absent, and
    StoreError where `results` holds something that may not be mixed with this.
    """
    settings = setting_names(settings)
    for arm in arms:
        check_arm(arm)
    if repeats < 1:
        raise ValueError(f"repeats = {repeats}; at least one pass is needed")
    if not time_limit > 0:
        raise ValueError(f"time_limit = {time_limit}; give a positive number of seconds")
    if not 0 < memory_limit < np.inf:
        raise ValueError(f"memory_limit = {memory_limit}; give a positive number of GiB")
    if isinstance(recordings, (Recording, str, Path)):
        recordings = [recordings]
    recordings = list(recordings)
    strangers = sorted(set(again) - set(solvers))
    if strangers:
        raise ValueError(f"again: {', '.join(strangers)} is not among the solvers that are asked")
    loaded = [r if isinstance(r, Recording) else read_recording(r) for r in recordings]
    given = [Path(each) for each in recordings if not isinstance(each, Recording)]
    limits = Limits(time_limit, memory_limit)
    with (
        tempfile.TemporaryDirectory() if results is None else nullcontext(results) as folder,
        awake() if timed else nullcontext(False) as is_awake,
    ):
        store = Store(folder)
        hidden = [store.folder / "recordings", store.folder / "solves", *given]
        where = machine_label() + (AWAKE if is_awake else "")
        blocks = [
            (
                recording,
                setting,
                _runs(store, recording, solvers, setting, arms, limits, again, where),
            )
            for recording in loaded
            for setting in settings
        ]
        store.refuse_mixture((run.key for _, _, runs in blocks for run in runs), again)
        how = How(repeats, slow_pass, limits, hidden, study, isolate, timed)
        _take_passes(store, blocks, how, progress)
        return read_results(folder)


class How(NamedTuple):
    """How passes are taken, as `replay` is told.

    hidden : what no solver may read
    """

    repeats: int
    slow_pass: float
    limits: Limits
    hidden: list[Path]
    study: str
    isolate: bool
    timed: bool


def _take_passes(
    store: Store,
    blocks: Sequence[tuple[Recording, str, list[StoredRun]]],
    how: How,
    progress: Progress | None,
) -> None:
    """Take and store all passes that are left, and see to it that what is stored stays so.

    blocks : recordings at settings, with their runs
    """
    total = sum(len(recording.qps) * len(runs) * how.repeats for recording, _, runs in blocks)
    counter = _Counter(total, progress)
    facts: dict[str, list[Facts]] = {}
    clock = time.perf_counter
    for recording, setting, runs in blocks:
        store.add_recording(recording)
        if all(is_done(run.shard, how.repeats, how.slow_pass) for run in runs):
            counter.add("", len(recording.qps) * len(runs) * how.repeats)
            continue
        spent = dict.fromkeys(SPENT, 0.0)
        spent["replaying"] -= clock()
        if recording.digest not in facts:
            facts[recording.digest] = [facts_of(qp) for qp in recording.qps]
        who = executor() if how.isolate and is_available() else ""
        judged = _Judged(recording, setting, facts[recording.digest], how.study, who)
        block = Block(recording, judged.asked, how.limits, how.hidden, how.isolate, how.timed)
        for turn in range(2 * how.repeats):
            asked_in_this: set[str] = set()
            for run in runs:
                before = counter.done
                if run.passes <= turn and not is_done(run.shard, how.repeats, how.slow_pass):
                    pace = calibrate() if how.timed else np.nan
                    spent["in_passes"] -= clock()
                    arm = run.task.arm
                    asking = block.asking(arm, again=arm not in asked_in_this)
                    asked_in_this.add(arm)
                    if run.about.broken:
                        done = judged.none(run.about.reason)
                    else:
                        told = [partial(counter.add, run.key.name)] if turn < how.repeats else []
                        done = block.do_pass(run.task, *told)
                    spent["in_passes"] += clock()
                    if run.shard is None or done.is_final:
                        run.shard = judged.add(run, done, asking, pace)
                        store.save(run.shard)
                        spent["in_calls"] += float(np.nansum(run.shard.passes[-1, :, CALL]))
                if turn < how.repeats:
                    counter.add(run.key.name, before + len(recording.qps) - counter.done)
        spent["replaying"] += clock()
        store.add_spent(spent)
    for _, _, runs in blocks:
        for run in runs:
            if run.shard is not None:
                store.mend(run.shard)


def reproduce(
    recording: Recording, solver: str, setting: str, arm: str, index: int
) -> dict[str, Any]:
    """Solve and judge QP `index` as the replay does; a warm arm replays what leads up to it.

    It is done in our own process, where a debugger can follow, and where a crash is a crash.
    Raises ValueError for an index that the recording does not have.
    """
    if not 0 <= index < len(recording.qps):
        raise ValueError(
            f"{recording.scene} has the QPs 0 to {len(recording.qps) - 1}; not {index}"
        )
    setting = setting_name(setting)
    leading = recording.qps if arm == "shuffled" else recording.qps[: index + 1]
    part = replace(recording, qps=tuple(leading))
    judged = _Judged(part, setting, [facts_of(qp) for qp in leading])
    block = Block(part, judged.asked, Limits(float("inf"), 0.0), isolate=False)
    done = block.do_pass(Task(solver, tuple(_options(setting).items()), arm))
    times = counted(done.times, block.asking(arm), is_stranger(solver)).times
    build, setup, solve, call, charged, inside = times[index]
    return {
        **judged.row(index, done.outcomes[index]),
        "solver": solver,
        "settings": setting,
        "arm": arm,
        "runtime": call if np.isnan(setup + solve) else setup + solve + charged,
        "build_time": build,
        "setup_time": setup,
        "solve_time": solve,
        "call_time": call,
        "charged_time": charged,
        "inside_time": inside,
        "x": done.outcomes[index].x,
    }


class _Counter:
    """Tells the progress callback how many QPs of all are done."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.progress = 0, total, progress

    def add(self, what: str, count: int) -> None:
        self.done += count
        if self.progress is not None:
            self.progress(what, self.done, self.total)


class _Judged:
    """What passes over one recording at one setting are worth."""

    def __init__(
        self,
        recording: Recording,
        setting: str,
        facts: list[Facts],
        study: str = "",
        executor: str = "",
    ) -> None:
        self.recording, self.setting, self.facts = recording, setting, facts
        self.study, self.executor = study, executor
        self.asked = [f.asked(setting) for f in facts]

    def add(self, run: StoredRun, done: Pass, asking: Asking, pace: float) -> Shard:
        """The shard of a run, grown by a pass.

        pace : [s] of the calibration before the pass
        """
        found, doubted = counted(done.times, asking, is_stranger(run.task.solver))
        times = np.column_stack([found, np.full(len(found), pace)])[None]
        answers = [_bits(outcome) for outcome in done.outcomes]
        if run.shard is None:
            rows, unrest = [self.row(i, outcome) for i, outcome in enumerate(done.outcomes)], []
        else:
            rows, unrest = [dict(row) for row in run.shard.rows], list(run.shard.unrest)
            times = np.concatenate([run.shard.passes, times])
            for i, outcome in enumerate(done.outcomes):
                if not run.answers or answers[i] != run.answers[i]:
                    rows[i] = max(rows[i], self.row(i, outcome), key=_badness)
        run.answers = run.answers or answers
        for i in doubted:
            said = rows[i]["status_text"].removesuffix(DOUBT).removesuffix("; ")
            rows[i]["status_text"] = f"{said}; {DOUBT}" if said else DOUBT
        return Shard(run.key, rows, times, [*unrest, done.unrest], self.study)

    def none(self, why: str) -> Pass:
        """A pass of who cannot be asked."""
        count = len(self.facts)
        nothing = np.full((count, len(TOLD) + len(SEEN)), np.nan)
        return Pass([Outcome("crashed", status_text=why)] * count, nothing)

    def row(self, index: int, outcome: Outcome) -> dict[str, Any]:
        """Columns of one solve, but for its times and what the shard's key says."""
        facts = self.facts[index]
        qp = facts.qp
        work = dict.fromkeys(WorkCounts.__dataclass_fields__)
        if outcome.work is not None:
            work = asdict(outcome.work)
        row: dict[str, Any] = {
            "problem": f"{self.recording.scene}/{index:06d}",
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
            "asked": self.asked[index],
            "scale": facts.scale,
            "warm_started": outcome.warm_started,
            "after_restart": outcome.after_restart,
            "executor": self.executor,
        }
        known = self.recording.references[index]
        row["proof"] = "" if known is None else known.proof
        if outcome.verdict == "skipped":
            return {**row, "verdict": "skipped"}
        judgement = judge(
            qp,
            outcome.x,
            found=outcome.found,
            asked=row["asked"],
            reference=known,
            facts=facts,
            seek_reference=False,
            mu=self.recording.mu[index],
        )
        row |= {name: getattr(judgement, name) for name in JUDGED}
        if outcome.verdict is not None:
            row["verdict"] = outcome.verdict
        return row


def _bits(outcome: Outcome) -> bytes:
    """What tells two answers apart."""
    x = b"" if outcome.x is None else outcome.x.tobytes()
    return f"{outcome.verdict} {outcome.status} {outcome.found} ".encode() + x


def _badness(row: Mapping[str, Any]) -> int:
    return WORST_LAST.index(row["verdict"])


def _runs(
    store: Store,
    recording: Recording,
    solvers: Sequence[str],
    setting: str,
    arms: Sequence[str],
    limits: Limits,
    again: Sequence[str],
    machine: str,
) -> list[StoredRun]:
    """The runs of one recording at one setting, with what the store has of them."""
    runs = []
    options = _options(setting)
    for name in solvers:
        known = about(name, **options)  # raises here rather than in a process
        for arm in arms:
            if arm not in known.arms and not known.broken:
                continue
            key = ShardKey(
                scene=recording.scene,
                recording_digest=recording.digest,
                solver=name,
                settings=setting,
                arm=arm,
                versions=known.version,
                machine=machine,
                time_limit=limits.time,
                memory_limit=limits.memory,
            )
            task = Task(name, tuple(options.items()), arm)
            stored = None if name in again else store.load(key)
            runs.append(StoredRun(key, task, known, stored))
    return runs


def _options(setting: str) -> dict[str, Any]:
    """Options of a solver: its accuracy is that of each QP, but for the package's own defaults."""
    return {"accuracy": "default"} if setting == "default" else {}
