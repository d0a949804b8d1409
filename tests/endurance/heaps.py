"""Random polygons dropped in a heap, a thousand times: does every simulation end, and end well?

    python -m tests.endurance.heaps                           1,000 scenes, on all cores
    python -m tests.endurance.heaps --count 50 --seed 7 --workers 1
    python -m tests.endurance.heaps --reproduce heaps/17.json       one that failed, again

Scene number i of a seed is a `rain` of 5 to 30 polygons whose size, spread, gaps, columns, walls,
speeds and end time (1 to 2 s) are drawn; every other one has friction, μ between 0.1 and 0.8, and
every eighth friction impulses, too.  A scene fails where

    error        the simulation ends with an exception, whatever its kind
    time         it takes more than `--limit` seconds of CPU time
    early        it ends before its end time
    overlap      any two parts overlap by more than 10 ε at any accepted time, by separating axes
    energy       T + V rises above an earlier value by more than 1e-3 of the energy of the motion:
                 the most by which V has fallen since the start, or T has reached

Failures are written to `--out`, one JSON file each, from which `--reproduce` makes the same run.
The exit code is 1 if there are any.  Times are CPU times; everything else is the same again on the
same machine.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from harness.motions.run_physics import overlap
from harness.progress import shown
from problems import Run, scene, simulate
from solvers import make_solver

DEEPEST = 10.0
"""Overlap that is allowed, over ε, which has the unit of a speed: in ε · 1 s."""
RISE = 1e-3
"""Rise of T + V that is allowed, relative to the energy of the motion."""
FAILURES = ("error", "time", "early", "overlap", "energy")
"""Ways to fail, see above."""
UNENDED = FAILURES[:3]
LIMIT = 300.0
"""Seconds of CPU time for one scene."""
AGAIN = 1.0
"""Seconds of CPU time after which it is told again that the time is over."""


@dataclass(frozen=True)
class Case:
    """A scene by name and parameters, and the settings of `simulate`."""

    scene: str
    parameters: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What came of a case: why it failed, if it did, and the figures of the run.

    depth : the deepest overlap over ε;  rise : of T + V, over the energy of the motion
    steps, rejected, impulses, events, jams : counts;  cpu : [s]
    """

    failure: str = ""
    detail: str = ""
    depth: float = 0.0
    rise: float = 0.0
    steps: int = 0
    rejected: int = 0
    impulses: int = 0
    events: int = 0
    jams: int = 0
    cpu: float = 0.0


class OutOfTime(BaseException):
    """A scene has used up its CPU time; not an `Exception`, which solvers are allowed to raise."""


def case(seed: int, number: int) -> Case:
    """Scene number `number` of a seed."""
    rng = np.random.default_rng([seed, number])
    mu = float(rng.uniform(0.1, 0.8))
    parameters: dict[str, Any] = {
        "bodies": int(rng.integers(5, 31)),
        "size": float(rng.uniform(0.25, 0.6)),
        "spread": float(rng.uniform(0.0, 0.7)),
        "gap": float(rng.uniform(0.02, 0.3)),
        "columns": int(rng.integers(2, 7)),
        "walls": bool(rng.integers(2)),
        "speed": float(rng.uniform(0.0, 1.0)),
        "spin": float(rng.uniform(0.0, 4.0)),
        "mu": mu if number % 2 else 0.0,
        "mu_I": mu if number % 8 == 7 else 0.0,
        "seed": int(rng.integers(2**31)),
        "end_time": float(rng.uniform(1.0, 2.0)),
    }
    return Case("rain", parameters)


def run_case(case: Case, limit: float = LIMIT) -> Outcome:
    """Simulate a case and examine the run."""
    gc.collect()  # a stepper is part of a cycle, and keeps megabytes
    start = time.process_time()
    try:
        with _cpu_time(limit):
            made = scene(case.scene, **case.parameters)
            run = simulate(made, make_solver("glambda"), keep_qps=False, **case.options)
    except (Exception, OutOfTime) as error:
        # compiled code may turn the interruption into an error of its own
        late = isinstance(error, OutOfTime) or isinstance(error.__cause__, OutOfTime)
        cpu = time.process_time() - start
        kind = "time" if late or cpu >= 0.9 * limit else "error"
        return Outcome(kind, f"{type(error).__name__}: {error}", cpu=cpu)
    end = case.options.get("until", made.end_time)
    return examined(run, end, time.process_time() - start)


def examined(run: Run, end: float, cpu: float) -> Outcome:
    """What a finished run is worth that was to end at time `end` [s]."""
    depth = float(overlap(run.scene, run.q).max()) / run.options["eps"]
    rise = energy_rise(run)
    kinds = Counter(event.kind for event in run.event_log)
    failure = detail = ""
    if run.t[-1] < end - 1e-6 and not kinds["rest"]:
        failure, detail = "early", f"it ended at t = {run.t[-1]:.6g} of {end:.6g}"
    elif not depth <= DEEPEST:
        failure, detail = "overlap", f"{depth:.3g} ε"
    elif not rise <= RISE:
        failure, detail = "energy", f"{rise:.3g} of the energy of the motion"
    return Outcome(
        failure,
        detail,
        max(0.0, depth),
        rise,
        run.counts["steps"],
        run.counts["rejected_steps"],
        run.counts["impulses"],
        len(run.event_log),
        kinds["jam"],
        cpu,
    )


def energy_rise(run: Run) -> float:
    """The most by which T + V has risen above an earlier value, over the energy of the motion."""
    kinetic, potential = run.kinetic_energy(), run.potential_energy()
    total = kinetic + potential
    motion = max(potential[0] - potential.min(), kinetic.max())
    return float((total - np.minimum.accumulate(total)).max() / max(motion, 1e-300))


@contextmanager
def _cpu_time(limit: float) -> Iterator[None]:
    """Raises `OutOfTime` in the block once it has used so many seconds of CPU time."""

    def stop(number: int, frame: object) -> None:
        raise OutOfTime(f"no end after {limit:g} s of CPU time")

    before = signal.signal(signal.SIGPROF, stop)
    # again and again: what is raised in a callback of compiled code is lost
    signal.setitimer(signal.ITIMER_PROF, limit, AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


# --- many of them --------------------------------------------------------------------------------


def run_all(
    seed: int, numbers: Sequence[int], workers: int, limit: float, folder: Path, console: Console
) -> dict[int, Outcome]:
    """The outcome of every scene, in the order of their numbers; failures are saved in `folder`.

    An interrupt (Ctrl-C) ends it with those that are done.
    """
    outcomes: dict[int, Outcome] = {}
    with ProcessPoolExecutor(workers) as pool, shown("heaps", console) as tell:
        pending = {pool.submit(run_case, case(seed, i), limit): i for i in numbers}
        for done in _until_interrupted(as_completed(pending), pool):
            number, outcome = pending[done], done.result()
            outcomes[number] = outcome
            if outcome.failure:
                path = save(folder, number, case(seed, number), outcome)
                console.print(f"{path}: {outcome.failure}: {outcome.detail}", highlight=False)
            failed = sum(bool(outcome.failure) for outcome in outcomes.values())
            tell(f"{failed} failed", len(outcomes), len(numbers))
    return {number: outcomes[number] for number in sorted(outcomes)}


def _until_interrupted(done: Iterator[Future], pool: ProcessPoolExecutor) -> Iterator[Future]:
    try:
        yield from done
    except KeyboardInterrupt:
        pool.shutdown(wait=False, cancel_futures=True)


def save(folder: Path, number: int, case: Case, outcome: Outcome) -> Path:
    """Write down how to run a case again, and what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{number}.json"
    path.write_text(json.dumps(asdict(case) | {"outcome": asdict(outcome)}, indent=2) + "\n")
    return path


def load(path: Path) -> Case:
    """The case of a file; ValueError where there is none in it."""
    try:
        stored = json.loads(path.read_text())
        return Case(stored["scene"], dict(stored["parameters"]), dict(stored["options"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path}: no case of this benchmark ({error}); give a file that it has written"
        ) from None


GROUPS: dict[str, Callable[[int], bool]] = {
    "all": lambda i: True,
    "μ = 0": lambda i: i % 2 == 0,
    "μ > 0, μ_I = 0": lambda i: i % 2 == 1 and i % 8 != 7,
    "μ = μ_I > 0": lambda i: i % 8 == 7,
}
"""Which scenes have which kind of friction."""


def table_of(outcomes: dict[int, Outcome]) -> Table:
    """A column for all scenes, and for each kind of friction."""
    groups = {
        name: [outcome for i, outcome in outcomes.items() if belongs(i)]
        for name, belongs in GROUPS.items()
    }
    groups = {name: rows for name, rows in groups.items() if rows}
    table = Table("", *groups)
    lines: dict[str, Callable[[list[Outcome]], str]] = {
        "scenes": lambda rows: f"{len(rows):,}",
        "ended": lambda rows: f"{sum(r.failure not in UNENDED for r in rows):,}",
        "worst overlap / ε": lambda rows: f"{max(r.depth for r in rows):.3g}",
        "worst rise of T + V": lambda rows: f"{max(r.rise for r in rows):.1e}",
        "events": lambda rows: f"{sum(r.events for r in rows):,}",
        "impulses": lambda rows: f"{sum(r.impulses for r in rows):,}",
        "jams": lambda rows: f"{sum(r.jams for r in rows):,}",
        "steps": lambda rows: f"{sum(r.steps for r in rows):,}",
        "rejected": lambda rows: f"{sum(r.rejected for r in rows):,}",
        "µs per step": lambda rows: f"{1e6 * _seconds_per_step(rows):.0f}",
    }
    for title, cell in lines.items():
        table.add_row(title, *(cell(rows) for rows in groups.values()))
    for kind in FAILURES:
        counts = [sum(r.failure == kind for r in rows) for rows in groups.values()]
        table.add_row(f"failed: {kind}", *(str(count) for count in counts))
    return table


def _seconds_per_step(rows: list[Outcome]) -> float:
    """CPU time per accepted step, impulses included, of the scenes that ended."""
    return sum(r.cpu for r in rows if r.steps) / max(1, sum(r.steps for r in rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the scenes and print what came of them; 1 if any has failed."""
    parser = argparse.ArgumentParser(description="Random polygons dropped in a heap.")
    parser.add_argument("--count", type=int, default=1000, help="scenes")
    parser.add_argument("--from", dest="first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--limit", type=float, default=LIMIT, help="CPU seconds for one scene")
    parser.add_argument("--out", type=Path, default=Path("heaps"), help="folder for failures")
    parser.add_argument("--reproduce", type=Path, help="a file of a scene that failed")
    chosen = parser.parse_args(arguments)
    console = Console()
    if chosen.reproduce is not None:
        try:
            again = load(chosen.reproduce)
        except ValueError as error:
            parser.error(str(error))
        outcome = run_case(again, chosen.limit)
        for name, value in asdict(outcome).items():
            console.print(f"{name:10s} {value}", highlight=False)
        return int(bool(outcome.failure))
    numbers = range(chosen.first, chosen.first + chosen.count)
    outcomes = run_all(chosen.seed, numbers, chosen.workers, chosen.limit, chosen.out, console)
    console.print(table_of(outcomes))
    return int(any(outcome.failure for outcome in outcomes.values()))


if __name__ == "__main__":
    raise SystemExit(main())
