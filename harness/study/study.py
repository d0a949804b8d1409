"""The whole study: record → replay → report, into one results folder that can be continued.

1. Each scene is recorded into RESULTS/recordings, unless a recording by the same code and with the
   same parameters is there.
2. The recordings are replayed through the backends; finished passes are kept
   (`harness.results.store`).
3. The report is written into RESULTS/report.

`QUICK` is the same with shorter motions, one pass and the fast backends: about a minute.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from harness.files.whole_files import write_whole
from harness.judging.facts import SETTINGS
from harness.machine.calibration import clock_facts
from harness.machine.kernels import compile_ahead
from harness.machine.machine import commit, library_versions, machine
from harness.names import METHOD, PAPER
from harness.passes.limits import TIME_LIMIT
from harness.passes.starts import STUDY_ARMS
from harness.processes.introduction import available, described, solver_version
from harness.progress import Progress
from harness.recordings.recording import Recording
from harness.results.store import Store
from harness.study.cluster import replayer
from harness.study.kept_recording import how_run, recording_in
from harness.study.record import record
from problems import scene as make_scene
from problems.scenes.labels import PAPER_SCENES, parse_label
from solvers.active_set.lotstedt import Lotstedt

PASS_SECONDS = 0.4
"""[s] of a pass over a scene of the paper, judging included, on average of all backends."""
VARIANTS = tuple(f"{PAPER}[{variant}]" for variant in Lotstedt.variants)
"""Variants of the paper's method that the study compares with it."""


@dataclass(frozen=True)
class StudyPlan:
    """What a study does.

    scenes : labels, such as "fig4" or "fig4,mu_I=0.8"
    until : where motions are cut off that would last longer [s]; None: nowhere
    solvers : names; empty: every backend that is installed, and the variants of the paper's method
    only_installed : leave out those of `solvers` whose package is absent
    """

    scenes: tuple[str, ...] = PAPER_SCENES
    until: float | None = None
    solvers: tuple[str, ...] = ()
    settings: tuple[str, ...] = SETTINGS
    arms: tuple[str, ...] = STUDY_ARMS
    repeats: int = 3
    time_limit: float = TIME_LIMIT
    slow_pass: float = 3.0
    only_installed: bool = False

    def named_solvers(self) -> tuple[str, ...]:
        """The solvers, written out."""
        if not self.solvers:
            return (*available(), *VARIANTS)
        if not self.only_installed:
            return self.solvers
        return tuple(name for name in self.solvers if described(name).available)

    @property
    def identity(self) -> str:
        """Eight hexadecimal digits that tell studies apart."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:8]


QUICK = StudyPlan(
    until=2.0,
    solvers=(
        *(METHOD, PAPER, "velocity", "pgs", "scipy_bvls", "osqp", "proxqp"),
        *("clarabel", "daqp", "quadprog", "piqp"),
    ),
    settings=("high",),
    repeats=1,
    only_installed=True,
)
"""About a minute on two cores."""


def estimate(plan: StudyPlan) -> str:
    """How much a study does, and how long that takes on two cores; "" of up to a minute."""
    runs = len(plan.scenes) * len(plan.settings) * len(plan.arms) * len(plan.named_solvers())
    minutes = round(runs * plan.repeats * PASS_SECONDS / 60)
    if minutes <= 1:
        return ""
    return (
        f"study: {_count(runs, 'run')} of {_count(plan.repeats, 'pass')}; some {minutes} minutes; "
        "interrupted, the same command continues"
    )


def _count(number: int, what: str) -> str:
    """A number of things, in words."""
    many = "" if number == 1 else "es" if what.endswith("s") else "s"
    return f"{number:,} {what}{many}"


def record_into(
    folder: Path, label: str, *, until: float | None = None, progress: Progress | None = None
) -> Recording:
    """The recording of a scene by our method, from `folder` if it is there and current.

    until : where its motion is cut off if it would last longer [s]; None: nowhere
    """
    name, parameters = parse_label(label)
    scene = make_scene(name, **parameters)
    end = None if until is None else min(until, scene.end_time)
    return recording_in(
        folder,
        scene,
        how_run(scene, until=end),
        lambda: record(scene, until=end, progress=progress),
    )


def run_study(
    plan: StudyPlan,
    results: Path,
    *,
    written: bytes | None = None,
    cluster: str | int | None = None,
    announce: Callable[[str], None] = lambda text: None,
    progress: Progress | None = None,
) -> list[Recording]:
    """Record and replay; the report is the command line's to call, since it is another package's.

    written : the file that the plan is from; a copy stays with the results, study.toml
    cluster : address of a Dask scheduler, or a number of workers to start here; None: neither
    announce : called with `estimate` before anything is run

    Raises ValueError for a plan without scenes or with unknown ones, before anything is written,
    and else as `record` and `replay` do.  Whatever was finished before an interruption is kept.
    """
    if not plan.scenes:
        raise ValueError("the study has no scenes; name some, or leave the option out")
    for label in plan.scenes:
        name, parameters = parse_label(label)
        make_scene(name, **parameters)
    announce(estimate(plan))
    solvers = plan.named_solvers()
    store = Store(results)
    store.write_study(
        {
            "machine": machine(),
            "clock": clock_facts()._asdict(),
            "libraries": library_versions(),
            "solvers": {name: solver_version(name) for name in solvers},
            "arguments": {**asdict(plan), "solvers": solvers},
            "study": plan.identity,
            "begun": datetime.now(UTC).date().isoformat(),
            "commit": commit(),
        }
    )
    if written is not None:
        write_whole(results / "study.toml", written)
    compile_ahead(tell=progress)
    recordings = [
        record_into(results / "recordings", label, until=plan.until, progress=progress)
        for label in plan.scenes
    ]
    with replayer(cluster) as replay:
        replay(
            recordings,
            solvers,
            plan.settings,
            plan.arms,
            results=results,
            repeats=plan.repeats,
            time_limit=plan.time_limit,
            slow_pass=plan.slow_pass,
            study=plan.identity,
            progress=progress,
        )
    return recordings
