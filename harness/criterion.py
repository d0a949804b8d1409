"""Measuring the refactorization criterion of Lötstedt 1984, §3.2, on a recording.

A_F is factorized now and then; in between, conjugate gradients work with the old R.  When should
it be factorized?  The rules that are compared:

    always, never   at every QP; only where there is no R, as after a restart
    s* paper        every s* QPs, s* = √(2 C_QR/C_IT), predicted with c = r = 1
    s* fitted       the same with c and r fitted
    paper           at once, in the middle of a QP, when a direction is not found in √(2 C_QR/C_IT)
                    iterations: the solver's own rule, as it is
    paper deferred  the same threshold, but the QP is finished with the old R, and the next one is
                    factorized: no iterations are thrown away
    fitted          as paper, with the threshold c s*^r of the fitted c and r
    online          when the average cost since the last factorization stops falling, with no
                    assumption on c and r (`harness.online_rule`)

What is done, for one recording:

1. The time-step, iteration and corrector QPs are solved in order, warm, as a replay does; a restart
   drops the start.  The first run factorizes always and tells the size of A_F and the descent
   directions of each QP; then come all fixed intervals.
2. C_QR and C_IT are counted from these sizes; c and r are fitted to the iterations of all runs,
   each QP at the age of its R (`harness.cost_model`).
3. The intervals predicted and the other rules are run.
4. All runs are repeated, in turn; the least time of each QP counts.  Seconds per factorization and
   per iteration are fitted to these times and the counts.
5. A and R are compared with what they were s steps earlier (`harness.drift`).

A cost is the mean of all counted operations, or of the time (setup and solve), over the QPs that
have a predecessor and a free column: what a restart costs is the same under every rule.  The regret
of a rule is its cost over that of the best fixed interval, less 1.  A rule that tells QPs apart can
beat every fixed interval; then it is negative.

`online` and `paper deferred` are run from outside: before each QP the harness hands the solver's
last solution either to the solver that keeps R or to one that gives it up.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.cost_model import (
    Criterion,
    Growth,
    criterion_of_sizes,
    fit_growth,
    optimal_interval,
    threshold,
)
from harness.drift import drift, predicted_exponent
from harness.online_rule import Cycle, average_stopped_falling, one_more
from harness.recording import Recording
from harness.threads import one_thread
from harness.unit_times import UnitTimes, fit_unit_times
from problems.qp import FREE, ContactQP, Solution
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.active_set.flops import cg_iteration_flops, qr_flops
from solvers.base import Solver

SWEEP = (1, 2, 3, 5, 8, 12, 18, 25, 40, 60, 100, inf)
"""Fixed intervals that are tried."""
NEVER = 10**9
"""As an interval of the solver: longer than any recording."""
RULES = (
    *("always", "never", "s* paper", "s* fitted"),
    *("paper", "paper deferred", "fitted", "online"),
)
"""The rules in the order of tables."""
BLOCK = 10
"""QPs in a row that are resampled together for the ranges of c and r."""
SLOW_PASS = 10.0
"""[s] A run that takes longer is not repeated."""
WARM_UP = 20
"""QPs that are solved before the clock matters."""

COUNTS = (
    *("descent_directions", "working_set_changes", "qr_factorizations", "qr_updates"),
    *("cg_iterations", "flops"),
)

Decision = Callable[[Cycle, float, float], bool]
"""(the cycle so far, C_QR, C_IT) → factorize at the next QP?"""
Progress = Callable[[str, float, float], None]
"""Called with what is being done, how much of it is done, and how much there is."""


class Link(NamedTuple):
    """A QP of the sequence: its place in the recording, and the restart that it follows."""

    place: int
    qp: ContactQP
    chain: int
    warm: bool


@dataclass(frozen=True)
class Rule:
    """When to factorize: by the solver's own settings, or by a decision after each QP.

    name : how it is called in tables
    options : of `make_solver("lotstedt", …)`
    decide : None for the solver's own rule
    interval : of a fixed interval, else None
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    decide: Decision | None = None
    interval: float | None = None


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
        `harness.unit_times`
    predicted : the intervals s* "paper" (c = r = 1), "fitted", and "time" (c = r = 1, measured
        costs);  inf: never
    sweep : runs of fixed intervals, by interval;  rules : runs by the names of `RULES`
    directions : (n,) descent directions of each QP where A_F is always factorized
    drift : see `harness.drift`;  exponent : r predicted from it, NaN where unknown
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

    repeats : timed runs of each rule; counts are those of any
    progress : called with the name of a rule, and the QPs solved, of all
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
        sizes = sweep[1].steps.loc[counted, ["m", "f"]].to_numpy()
        criterion = criterion_of_sizes(recording.scene, sizes)
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
            Rule("paper"),
            Rule("paper deferred", decide=beyond_threshold),
            _stopping_at(limit, int(sizes[:, 1].max())),
            Rule("online", decide=lambda cycle, C_QR, _: average_stopped_falling(cycle, C_QR)),
        ):
            rules[rule.name] = bench.first(rule)
        bench.repeat()
    runs = [sweep[s] for s in sorted(sweep)]
    times = fit_unit_times([run.steps[run.steps["counted"]] for run in bench.runs])
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


def sequence(recording: Recording) -> list[Link]:
    """The QPs that a warm start can serve, in order, with the restarts between them."""
    links: list[Link] = []
    chain = -1
    for place, qp in enumerate(recording.qps):
        if qp.kind not in WARM_KINDS:
            continue
        warm = bool(links) and not qp.restart
        chain += not warm
        links.append(Link(place, qp, chain, warm))
    return links


def fixed(interval: float) -> Rule:
    """Factorize every so many QPs; inf: never."""
    steps = NEVER if interval == inf else int(interval)
    return Rule(f"interval {interval:g}", {"interval": steps}, None, interval)


def beyond_threshold(cycle: Cycle, C_QR: float, C_IT: float) -> bool:
    """The last QP took more than √(2 C_QR/C_IT) iterations, rounded up as the solver does."""
    return cycle.last > ceil(sqrt(2 * C_QR / C_IT)) * C_IT


def _stopping_at(limit: float, largest: int) -> Rule:
    """The solver's rule with this threshold; one that conjugate gradients never reach is never."""
    if limit > 2 * largest:
        return Rule("fitted", {"interval": NEVER})
    return Rule("fitted", {"cg_limit": ceil(limit)})


def drive(
    links: Sequence[Link], rule: Rule, free: list[NDArray[np.int64]] | None = None
) -> pd.DataFrame:
    """Solve the sequence under a rule; the columns of `Run.steps`.

    free : receives the row_ids of the free columns of each QP
    """
    keep: Solver = make_solver("lotstedt", **rule.options)
    renew = keep
    if rule.decide is not None:
        keep = make_solver("lotstedt", interval=NEVER)
        renew = make_solver("lotstedt", interval=1)
    last: Solution | None = None
    cycle, age, due = Cycle(), 0, False
    rows = []
    for link in links:
        start = last if link.warm else None
        last = (renew if due else keep).solve(link.qp, start)
        work, timing = last.work, last.timing
        if work is None:
            raise ValueError("the paper's method returned no work counts")
        m, f = link.qp.m, int(np.count_nonzero(last.working_set == FREE))
        factorized = start is None or work.qr_factorizations > 0
        age = 0 if factorized else age + 1
        due = False
        if rule.decide is not None and f:
            C_QR, C_IT = qr_flops(m, f), cg_iteration_flops(m, f)
            cycle = one_more(cycle, factorized, work.cg_iterations, work.descent_directions, C_IT)
            due = rule.decide(cycle, C_QR, C_IT)
        if free is not None:
            free.append(last.row_id[last.working_set == FREE])
        counts = [getattr(work, name) for name in COUNTS]
        rows.append(
            (link.place, link.chain, link.warm, age, *counts, m, f, timing.setup + timing.solve)
        )
    columns = ["place", "chain", "warm", "age", *COUNTS, "m", "f", "runtime"]
    steps = pd.DataFrame(rows, columns=columns)
    return steps.astype({"warm": bool})


class _Bench:
    """Runs rules over one sequence, first once each and then again for their times."""

    def __init__(self, links: Sequence[Link], repeats: int, progress: Progress | None) -> None:
        self.links, self.repeats, self.progress = links, repeats, progress
        self.free: list[NDArray[np.int64]] = []
        self.counted: NDArray[np.bool_] | None = None
        self.runs: list[Run] = []
        self.done = 0

    def warm_up(self) -> None:
        """Let what is compiled or loaded at first use be compiled and loaded."""
        drive(self.links[:WARM_UP], Rule("warm-up"))

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
        for _ in range(self.repeats - 1):
            for run in self.runs:
                self._tell(run.rule.name)
                if run.steps["runtime"].sum() < SLOW_PASS:
                    again = drive(self.links, run.rule)["runtime"]
                    run.steps["runtime"] = np.fmin(run.steps["runtime"], again)

    def _tell(self, what: str) -> None:
        if self.progress is not None:
            total = self.repeats * (len(SWEEP) + 6)
            self.progress(what, min(self.done, total), total)
        self.done += 1


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
