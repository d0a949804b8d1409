"""Measuring the refactorization criterion of Lötstedt 1984, §3.2, on a recording.

A_F is factorized now and then; in between, conjugate gradients work with the old R.  When should
it be factorized?  The rules that are compared:

    exact QR        at every QP; where A is dense, (3.19) is solved with Q and R, and there are no
                    conjugate gradients at all
    always, never   at every QP; only where there is no R, as after a restart
    s* paper        every s* QPs, s* = √(2 C_QR/C_IT), predicted with c = r = 1
    s* fitted       the same with c and r fitted
    paper           the printed rule at once: in the middle of a QP, in place of the iteration of a
                    direction that would exceed √(2 C_QR/C_IT)
    paper deferred  the printed rule, but the QP is finished with the old R, and the next one is
                    factorized: no iterations are thrown away
    fitted          as paper, with the threshold c s*^r of the fitted c and r
    online          when the average cost since the last factorization stops falling, with no
                    assumption on c and r (`solvers.active_set.online_rule`)
    as shipped      our own method, the default: A_F of today up to some tens of columns; beyond,
                    online, with x extrapolated

What is done, for one recording (`rule_runs`), of which the rows are stored:

1. The time-step, iteration and corrector QPs are solved in order, warm, as a replay does; a restart
   drops the start.  The first run factorizes always and tells the size of A_F and the descent
   directions of each QP; then come all fixed intervals.
2. C_QR and C_IT are counted from these sizes; c and r are fitted to the iterations of all runs,
   each QP at the age of its R (`harness.criterion.cost_model`).
3. The intervals predicted and the other rules are run.
4. All runs are repeated, in turn, short ones more often; the least time of each QP counts.
   Seconds per factorization and per iteration are fitted to these times and the counts.
5. A and R are compared with what they were s steps earlier (`moves`).

What their rows say of the criterion is in `harness.criterion.measurement`.

A cost is the mean of all counted operations, or of the time of the compiled call, over the QPs that
have a predecessor and a free column: what a restart costs is the same under every rule.  The regret
of a rule is its cost over that of the best fixed interval, less 1.  A rule that tells QPs apart can
beat every fixed interval; then it is negative.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import ceil, inf, nan

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.criterion.column_drift import drift
from harness.criterion.cost_model import threshold
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
from harness.criterion.measurement import Run, prediction
from harness.machine.threads import one_thread
from harness.recordings.recording import Recording

SWEEP = (1, 2, 3, 5, 8, 12, 18, 25, 40, 60, 100, inf)
"""Fixed intervals that are tried."""
SLOW_PASS = 10.0
"""[s] A run that takes longer is not repeated."""
ENOUGH = 0.1
"""[s] A run that takes less is repeated until it has taken as much, …"""
MOST_TURNS = 20
"""… but no more often than this, unless asked for."""
WARM_UP = 20
"""QPs that are solved before the clock matters."""


def rule_runs(recording: Recording, repeats: int = 5) -> pd.DataFrame:
    """Run every rule on a recording; no rows where no QP starts warm with a free column.

    repeats : fewest timed runs of each rule

    Columns: rule, interval (NaN for a rule that has none), keeps_R; swept, whether the interval is
    one of `SWEEP`; those of `drive`; counted, whether the QP counts in the means.  One row per rule
    and QP of the sequence.
    """
    links = sequence(recording)
    longest = int(np.bincount([link.chain for link in links]).max()) if links else 0
    bench = _Bench(links, repeats)
    with _undisturbed():
        drive(links[:WARM_UP], paper())  # what is compiled or loaded at first use
        # from the longest stretch on, every interval is the same: never
        for s in SWEEP:
            if s == inf or s < longest:
                bench.first(fixed(s), swept=True)
        first = bench.runs[0]
        if not first.counted.any():
            return pd.DataFrame()
        known = prediction(recording.scene, bench.runs)
        for name in known.intervals:
            if known.whole(name) not in [run.interval for run in bench.runs]:
                bench.first(fixed(known.whole(name)))
        limit = threshold(known.criterion.C_QR, known.criterion.C_IT, known.c, known.r)
        largest = int(first.steps.loc[first.counted, "f"].max())
        for rule in (
            exact(),
            paper(),
            paper_deferred(),
            stopping_at(limit, largest),
            online(),
            as_shipped(),
        ):
            bench.first(rule)
        bench.repeat()
    return pd.concat([run.steps for run in bench.runs], ignore_index=True)


def moves(recording: Recording) -> pd.DataFrame:
    """How far A moves, see `harness.criterion.column_drift.drift`, where A_F is always new."""
    links = sequence(recording)
    free: list[NDArray[np.int64]] = []
    with one_thread():
        drive(links, fixed(1), free)
    return drift([link.qp for link in links], [link.chain for link in links], free)


class _Bench:
    """Runs rules over one sequence, first once each and then again for their times."""

    def __init__(self, links: Sequence[Link], repeats: int) -> None:
        self.links, self.repeats = links, repeats
        self.rules: list[Rule] = []
        self.runs: list[Run] = []

    def first(self, rule: Rule, swept: bool = False) -> None:
        """Run a rule for its counts, and once for its times."""
        steps = drive(self.links, rule)
        counted = self.runs[0].counted if self.runs else steps["warm"] & (steps["f"] > 0)
        interval = nan if rule.interval is None else rule.interval
        told = {"rule": rule.name, "interval": interval, "keeps_R": rule.keeps_R, "swept": swept}
        self.rules.append(rule)
        self.runs.append(Run(steps.assign(counted=counted, **told)))

    def repeat(self) -> None:
        """Run everything again, in turn, and keep the least time of each QP."""
        turns = [self._turns(float(run.steps["runtime"].sum())) for run in self.runs]
        for turn in range(max(turns)):
            for rule, run, wanted in zip(self.rules, self.runs, turns, strict=True):
                if turn < wanted:
                    again = drive(self.links, rule)["runtime"]
                    run.steps["runtime"] = np.fmin(run.steps["runtime"], again)

    def _turns(self, seconds: float) -> int:
        """How often a run of so many seconds is repeated."""
        if seconds > SLOW_PASS:
            return 0
        return max(self.repeats - 1, min(MOST_TURNS, ceil(ENOUGH / max(seconds, 1e-9))))


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
