"""Measuring the refactorization criterion of Lötstedt 1984, §3.2, on a recording.

A_F is factorized now and then; in between, conjugate gradients work with the old R.  When should
it be factorized?  The rules that are compared:

    exact QR        at every QP; where A is dense, (3.19) is solved with Q and R, and there are no
                    conjugate gradients at all
    always, never   at every QP; only where there is no R, as after a restart
    s* paper        every s* QPs, s* = √(2 C_QR/C_IT), predicted with c = r = 1
    s* fitted       the same with c and r fitted
    paper           at once, in the middle of a QP, when a direction is not found in √(2 C_QR/C_IT)
                    iterations, at every size
    paper deferred  the same threshold, but the QP is finished with the old R, and the next one is
                    factorized: no iterations are thrown away
    fitted          as paper, with the threshold c s*^r of the fitted c and r
    online          when the average cost since the last factorization stops falling, with no
                    assumption on c and r (`solvers.active_set.online_rule`)
    as shipped      the solver's default: A_F of today up to some tens of columns; beyond, online,
                    with x extrapolated

What is done, for one recording:

1. The time-step, iteration and corrector QPs are solved in order, warm, as a replay does; a restart
   drops the start.  The first run factorizes always and tells the size of A_F and the descent
   directions of each QP; then come all fixed intervals.
2. C_QR and C_IT are counted from these sizes; c and r are fitted to the iterations of all runs,
   each QP at the age of its R (`harness.criterion.cost_model`).
3. The intervals predicted and the other rules are run.
4. All runs are repeated, in turn, short ones more often; the least time of each QP counts.
   Seconds per factorization and per iteration are fitted to these times and the counts.
5. A and R are compared with what they were s steps earlier (`harness.criterion.column_drift`).

A cost is the mean of all counted operations, or of the time of the compiled call, over the QPs that
have a predecessor and a free column: what a restart costs is the same under every rule.  The regret
of a rule is its cost over that of the best fixed interval, less 1.  A rule that tells QPs apart can
beat every fixed interval; then it is negative.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil, inf

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.criterion.column_drift import drift, predicted_exponent
from harness.criterion.cost_model import (
    Criterion,
    Growth,
    criterion_of_costs,
    fit_growth,
    optimal_interval,
    threshold,
)
from harness.criterion.factor_rules import (
    Link,
    Rule,
    as_shipped,
    drive,
    exact,
    fixed,
    online,
    paper,
    paper_deferred,
    sequence,
    stopping_at,
)
from harness.criterion.unit_times import UnitTimes, fit_unit_times
from harness.machine.threads import one_thread
from harness.progress import Progress
from harness.recordings.recording import Recording
from solvers.active_set.unit_costs import UnitCosts

SWEEP = (1, 2, 3, 5, 8, 12, 18, 25, 40, 60, 100, inf)
"""Fixed intervals that are tried."""
RULES = (
    *("exact QR", "always", "never", "s* paper", "s* fitted"),
    *("paper", "paper deferred", "fitted", "online", "as shipped"),
)
"""The rules in the order of tables."""
BLOCK = 10
"""QPs in a row that are resampled together for the ranges of c and r."""
SLOW_PASS = 10.0
"""[s] A run that takes longer is not repeated."""
ENOUGH = 0.1
"""[s] A run that takes less is repeated until it has taken as much, …"""
MOST_TURNS = 20
"""… but no more often than this, unless asked for."""
WARM_UP = 20
"""QPs that are solved before the clock matters."""


@dataclass(eq=False)
class Run:
    """What came of one rule.

    steps : one row per QP of the sequence: place, chain, warm, age (QPs since the factorization),
        the work counts, m, f, counted (whether it counts in the means) and runtime [s]
    """

    rule: Rule
    steps: pd.DataFrame

    def mean(self, column: str, chosen: NDArray[np.bool_] | None = None) -> float:
        """Mean of a column over the counted QPs, or those `chosen` among all."""
        rows = self.steps["counted"].to_numpy() if chosen is None else chosen
        return float(self.steps.loc[rows, column].mean())

    @property
    def cost(self) -> float:
        """Counted operations per QP."""
        return self.mean("flops")

    @property
    def time(self) -> float:
        """Seconds per QP."""
        return self.mean("runtime")

    @property
    def cycle(self) -> float:
        """QPs per factorization, those at restarts included."""
        made = int((self.steps["age"] == 0).sum())
        return len(self.steps) / made if made else inf


@dataclass(frozen=True, eq=False)
class Measurement:
    """All that was measured on one recording.

    criterion : counted C_QR and C_IT;  growth : c and r, or None;  times : in seconds, see
        `harness.criterion.unit_times`
    predicted : the intervals s* "paper" (c = r = 1), "fitted", and "time" (c = r = 1, measured
        costs);  inf: never
    sweep : runs of fixed intervals, by interval;  rules : runs by the names of `RULES`
    directions : (n,) descent directions of each QP where A_F is always factorized
    drift : see `harness.criterion.column_drift`;  exponent : r predicted from it, NaN where unknown
    """

    scene: str
    digest: str
    criterion: Criterion
    growth: Growth | None
    times: UnitTimes
    predicted: Mapping[str, float]
    sweep: Sequence[Run]
    rules: Mapping[str, Run]
    directions: NDArray[np.int64]
    drift: pd.DataFrame
    exponent: float

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(n,) the QPs that means are taken over."""
        return self.sweep[0].steps["counted"].to_numpy()

    @property
    def chains(self) -> int:
        """Stretches between restarts."""
        return int(self.sweep[0].steps["chain"].nunique())

    def best(self, column: str = "flops", chosen: NDArray[np.bool_] | None = None) -> Run:
        """The cheapest fixed interval; the shortest of equals."""
        return min(self.sweep, key=lambda run: run.mean(column, chosen))

    def regret(
        self, rule: str, column: str = "flops", chosen: NDArray[np.bool_] | None = None
    ) -> float:
        """Cost of a rule over that of the best fixed interval, less 1."""
        best = self.best(column, chosen).mean(column, chosen)
        return self.rules[rule].mean(column, chosen) / best - 1.0


def measure(
    recording: Recording, *, repeats: int = 5, progress: Progress | None = None
) -> Measurement | None:
    """Measure the criterion on a recording; None where no QP of it starts warm with a free column.

    repeats : fewest timed runs of each rule
    progress : called with the name of a rule and the part of the work that is done, of 1
    """
    links = sequence(recording)
    longest = int(np.bincount([link.chain for link in links]).max()) if links else 0
    bench = _Bench(links, repeats, progress)
    # From the longest stretch on, every interval is the same: never.
    intervals = [s for s in SWEEP if s == inf or s < longest]
    with _undisturbed():
        bench.warm_up()
        sweep = {s: bench.first(fixed(s)) for s in intervals}
        counted = sweep[1].steps["counted"] if 1 in sweep else pd.Series(dtype=bool)
        if not counted.any():
            return None
        sizes = sweep[1].steps.loc[counted, list(UnitCosts._fields)]
        criterion = criterion_of_costs(
            recording.scene, map(UnitCosts._make, sizes.itertuples(index=False))
        )
        C_QR, C_IT = criterion.C_QR, criterion.C_IT
        growth = growth_of(list(sweep.values()))
        c, r = growth.prediction() if growth is not None else (1.0, 0.0)
        predicted = {
            "paper": optimal_interval(C_QR, C_IT),
            "fitted": optimal_interval(C_QR, C_IT, c, r),
        }
        rules: dict[str, Run] = {"always": sweep[1], "never": sweep[inf]}
        for name, s in predicted.items():
            s = max(1, round(s)) if s < longest else inf
            if s not in sweep:
                sweep[s] = bench.first(fixed(s))
            rules[f"s* {name}"] = sweep[s]
        limit = threshold(C_QR, C_IT, c, r)
        for rule in (
            exact(),
            paper(),
            paper_deferred(),
            stopping_at(limit, int(sizes["f"].max())),
            online(),
            as_shipped(),
        ):
            rules[rule.name] = bench.first(rule)
        bench.repeat()
    runs = [sweep[s] for s in sorted(sweep)]
    times = bench.unit_times()
    qps, chains = [link.qp for link in links], [link.chain for link in links]
    if progress is not None:
        progress("how far A moves", 1.0, 1.0)
    moved = drift(qps, chains, bench.free)
    return Measurement(
        scene=recording.scene,
        digest=recording.digest,
        criterion=criterion,
        growth=growth,
        times=times,
        predicted={**predicted, "time": times.threshold},
        sweep=runs,
        rules={name: rules[name] for name in RULES},
        directions=sweep[1].steps["descent_directions"].to_numpy(),
        drift=moved,
        exponent=predicted_exponent(moved),
    )


def measure_all(
    recordings: Sequence[Recording], *, repeats: int = 5, progress: Progress | None = None
) -> list[Measurement]:
    """Measure the criterion on recordings; those on which nothing starts warm are left out.

    Raises ValueError where nothing is left.
    """
    total = sum(len(recording.qps) for recording in recordings)
    done, measured = 0, []
    for recording in recordings:

        def tell(
            what: str, part: float, of: float, recording: Recording = recording, done: int = done
        ) -> None:
            if progress is not None:
                share = len(recording.qps) * part / of
                progress(f"{recording.scene}: {what}", done + share, total)

        found = measure(recording, repeats=repeats, progress=tell)
        if found is not None:
            measured.append(found)
        done += len(recording.qps)
    if not measured:
        raise ValueError(
            "no QP of these recordings starts warm with a free column, so there is no criterion "
            "to measure; record a longer motion"
        )
    return measured


class _Bench:
    """Runs rules over one sequence, first once each and then again for their times."""

    def __init__(self, links: Sequence[Link], repeats: int, progress: Progress | None) -> None:
        self.links, self.repeats, self.progress = links, repeats, progress
        self.free: list[NDArray[np.int64]] = []
        self.counted: NDArray[np.bool_] | None = None
        self.runs: list[Run] = []

    def warm_up(self) -> None:
        """Let what is compiled or loaded at first use be compiled and loaded."""
        drive(self.links[:WARM_UP], paper())

    def first(self, rule: Rule) -> Run:
        """Run a rule for its counts, and once for its times."""
        self._tell(rule.name)
        if self.counted is None:
            steps = drive(self.links, rule, self.free)
            self.counted = (steps["warm"] & (steps["f"] > 0)).to_numpy()
        else:
            steps = drive(self.links, rule)
        steps["counted"] = self.counted
        run = Run(rule, steps)
        self.runs.append(run)
        return run

    def repeat(self) -> None:
        """Run everything again, in turn, and keep the least time of each QP."""
        turns = [self._turns(float(run.steps["runtime"].sum())) for run in self.runs]
        for turn in range(max(turns, default=0)):
            self._tell(f"times, turn {turn + 1}", turn / max(turns))
            for run, wanted in zip(self.runs, turns, strict=True):
                if turn < wanted:
                    again = drive(self.links, run.rule)["runtime"]
                    run.steps["runtime"] = np.fmin(run.steps["runtime"], again)

    def _turns(self, seconds: float) -> int:
        """How often a run of so many seconds is repeated."""
        if seconds > SLOW_PASS:
            return 0
        return max(self.repeats - 1, min(MOST_TURNS, ceil(ENOUGH / max(seconds, 1e-9))))

    def unit_times(self) -> UnitTimes:
        """Seconds per factorization and iteration, from all runs so far that keep R."""
        return fit_unit_times(
            [run.steps[run.steps["counted"]] for run in self.runs if run.rule.keeps_R]
        )

    def _tell(self, what: str, repeated: float = 0.0) -> None:
        """The first runs are the first half of the bar, their repetition the second."""
        if self.progress is not None:
            share = min(1.0, len(self.runs) / (len(SWEEP) + 8))
            self.progress(what, 0.5 * (share + repeated), 1.0)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """One thread, and no garbage collection between two clock reads."""
    gc.collect()
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        with one_thread():
            yield
    finally:
        if was_enabled:
            gc.enable()


def growth_of(runs: Sequence[Run]) -> Growth | None:
    """Fit c s^r to the counted QPs of all runs that were not factorized in that QP."""
    ages, iterations, blocks = [], [], []
    for run in runs:
        steps = run.steps
        # a stretch begins at a restart, and is cut every BLOCK QPs
        within = steps.groupby("chain").cumcount() // BLOCK
        block = steps["chain"] * (int(within.max()) + 1) + within
        used = steps["counted"] & (steps["age"] > 0)
        ages.append(steps.loc[used, "age"])
        iterations.append(steps.loc[used, "cg_iterations"])
        blocks.append(block[used])
    return fit_growth(np.concatenate(ages), np.concatenate(iterations), np.concatenate(blocks))
