"""What it costs to refactorize at one interval or another, or by a rule: tables and their notes.

    criterion_costs      what a factorization and an iteration cost, counted and timed
    criterion_interval   intervals predicted, the best one found, and what the rules came to
    criterion_regret     what each rule costs over the best fixed interval, in operations
    criterion_time       the same in time
    criterion_runs       every run, for CSV

Their numbers are those of `harness.criterion.criterion`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, isnan
from typing import Any

import numpy as np
import pandas as pd

from harness.criterion.measurement import RULES, Measurement, Run
from reports.parts.sentences import join
from reports.parts.table import Table, microseconds, percent, short, whole

NOTABLE = 0.05
"""A regret above this is told in a note."""
MARGIN = {"flops": 0.005, "runtime": 0.03}
"""Differences below this are not told: ties, and the noise of times."""
CYCLES = 3
"""A stretch of fewer cycles than this says little of a rule."""
HEADS = {"exact QR": "exact", "paper deferred": "deferred", "as shipped": "shipped"}
"""How rules are called at the head of narrow columns, where not by their names."""
ADAPTIVE = {rule: HEADS.get(rule, rule) for rule in ("paper", "paper deferred", "fitted", "online")}
"""Rules that look at the iterations, and the heads of their columns."""


def costs_table(measured: Sequence[Measurement]) -> Table:
    """C_QR and C_IT, in operations and in time."""
    rows = []
    for one in measured:
        counted, times = one.criterion, one.times
        rows.append(
            {
                "scene": one.scene,
                "QPs": int(one.counted.sum()),
                "restarts": one.chains,
                "m": counted.rows,
                "f": counted.free,
                "C_QR": counted.C_QR,
                "C_IT": counted.C_IT,
                "C_QR/C_IT": counted.C_QR / counted.C_IT,
                "QR µs": times.factorization,
                "CG µs": times.iteration,
                "ratio in time": times.ratio,
                "explained": times.explained,
            }
        )
    return Table(
        name="criterion_costs",
        title="What a factorization and an iteration cost",
        reading=(
            "QPs are those with a predecessor and a free column; A_F has m rows and f columns "
            "(medians).  C_QR and C_IT are counted operations; the times are fitted to whole "
            "solves, of whose variance they explain the share in the last column, and a dash is "
            "a time that cannot be told apart."
        ),
        data=pd.DataFrame(rows),
        formats={
            **dict.fromkeys(["QPs", "restarts", "C_QR", "C_IT"], whole),
            **dict.fromkeys(["m", "f"], size),
            **dict.fromkeys(["C_QR/C_IT", "ratio in time"], _number),
            **dict.fromkeys(["QR µs", "CG µs"], microseconds),
            "explained": percent,
        },
        notes=_cost_notes(measured),
    )


def _cost_notes(measured: Sequence[Measurement]) -> list[str]:
    notes = []
    for one in measured:
        counted = one.criterion.C_QR / one.criterion.C_IT
        timed = one.times.ratio
        if isfinite(timed) and not 0.5 < timed / counted < 2:
            more = "more" if timed > counted else "less"
            factor = max(timed / counted, counted / timed)
            notes.append(
                f"On {one.scene} a factorization takes {short(timed)} times as long as an "
                f"iteration, {short(factor)} times {more} than the operations say."
            )
    return notes


def interval_table(measured: Sequence[Measurement]) -> Table:
    """Intervals predicted and found."""
    rows = []
    for one in measured:
        rows.append(
            {
                "scene": one.scene,
                "s* paper": one.predicted["paper"],
                "s* fitted": one.predicted["fitted"],
                "best": one.best().interval,
                "s* (time)": one.predicted["time"],
                "best (time)": one.best("runtime").interval,
                "longest": int(one.sweep[0].steps.groupby("chain").size().max()),
                **{head: one.rules[name].cycle for name, head in ADAPTIVE.items()},
            }
        )
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_interval",
        title="Intervals between factorizations",
        reading=(
            "QPs from one factorization to the next: predicted with c = r = 1, s* paper = "
            "√(2 C_QR/C_IT), and with the fitted c and r; the best of the intervals swept, by "
            "counted operations and by time (with s* paper from measured times before it); the "
            "longest stretch between restarts; and what the rules that look at iterations came to "
            "on average, restarts included."
        ),
        data=data,
        formats=dict.fromkeys(data.columns[1:], interval_text),
        notes=_interval_notes(data),
    )


def _interval_notes(data: pd.DataFrame) -> list[str]:
    """Recordings that are too short for what they are asked."""
    cycle = data["s* fitted"].where(np.isfinite(data["s* fitted"]), 0.0)
    short_ones = data.loc[CYCLES * cycle > data["longest"], "scene"]
    if not len(short_ones):
        return []
    return [
        f"On {join(list(short_ones))} no stretch between restarts holds {CYCLES} cycles of s* "
        "fitted, so that regrets there depend on where the stretches end."
    ]


def regret_table(measured: Sequence[Measurement], column: str) -> Table:
    """What each rule costs over the best fixed interval; `column` is "flops" or "runtime"."""
    timed = column == "runtime"
    rows = []
    for one in measured:
        best = one.best(column)
        rows.append(
            {
                "scene": one.scene,
                "best s": best.interval,
                "cost": best.mean(column),
                **{HEADS.get(rule, rule): one.regret(rule, column) for rule in RULES},
            }
        )
    what = "time" if timed else "counted operations"
    return Table(
        name="criterion_time" if timed else "criterion_regret",
        title=f"Regret of each rule, in {what}",
        reading=(
            f"cost is the mean per QP at the best fixed interval, in {'µs' if timed else what}; "
            "the rules stand with what they cost above it.  Below 0, a rule is better than every "
            "fixed interval.  exact factorizes every QP and, where A is dense, needs no conjugate "
            "gradients; always does with them; paper is the printed rule at once, in place of the "
            "iteration that would exceed √(2 C_QR/C_IT); deferred is the printed rule that "
            "finishes the QP and factorizes the next; fitted has the threshold of the fitted c and "
            "r; online stops when the average cost stops falling, and prices a factorization by "
            "its time; shipped is our own method, the default."
        ),
        data=pd.DataFrame(rows),
        formats={
            "best s": interval_text,
            "cost": microseconds if timed else whole,
            **{HEADS.get(rule, rule): signed_percent for rule in RULES},
        },
        notes=_regret_notes(measured, column),
    )


def _regret_notes(measured: Sequence[Measurement], column: str) -> list[str]:
    """Where a rule loses, and who has the least of it."""
    notes = []
    for one in measured:
        regrets = {rule: one.regret(rule, column) for rule in RULES}
        lost, kept = regrets["paper"], regrets["paper deferred"]
        if lost > NOTABLE:
            said = f"On {one.scene} paper costs {_percent(lost)} more than the best interval"
            if kept < 0.5 * lost:
                said += (
                    f", and {_percent(kept)} if the QP is finished first: most of the loss is "
                    "iterations that are thrown away"
                )
            notes.append(f"{said}.")
    without = [
        one.scene
        for one in measured
        if not one.criterion.sparse
        and one.rules["exact QR"].mean(column)
        < min(run.mean(column) for run in one.rules.values() if run.keeps_R)
    ]
    if without:
        notes.append(
            f"On {join(without)} a factorization at every QP, without conjugate gradients, is "
            "cheaper than every rule that keeps R."
        )
    worst = {rule: max(one.regret(rule, column) for one in measured) for rule in RULES}
    order = sorted(worst, key=worst.__getitem__)
    notes.append(
        "Largest regret of each rule, the smallest first: "
        + ", ".join(f"{rule} {_percent(worst[rule])}" for rule in order)
        + "."
    )
    beaten = [
        f"{one.scene} ({better}, by {_percent(gap)})"
        for one in measured
        for better, gap in [_better_than("online", one, column)]
        if gap > MARGIN[column]
    ]
    if beaten:
        notes.append(
            f"online is not the cheapest rule that keeps R and knows nothing ahead on "
            f"{join(beaten)}."
        )
    return notes


def _better_than(own: str, one: Measurement, column: str) -> tuple[str, float]:
    """The cheapest other rule that keeps R and needs no fit, and by how much of the cost of own."""
    others = [
        name
        for name, run in one.rules.items()
        if run.keeps_R and "fitted" not in name and name != own
    ]
    best = min(others, key=lambda rule: one.rules[rule].mean(column))
    return best, 1.0 - one.rules[best].mean(column) / one.rules[own].mean(column)


def runs_table(measured: Sequence[Measurement]) -> Table:
    """Every run: one row per recording and rule or interval."""
    rows = []
    for one in measured:
        ruled = [run for run in one.rules.values() if isnan(run.interval)]
        rows += [_run_row(one, run) for run in (*one.sweep, *ruled)]
    return Table(
        name="criterion_runs",
        title="Every run",
        reading="Means per counted QP; runtime in seconds.",
        data=pd.DataFrame(rows),
    )


def _run_row(one: Measurement, run: Run) -> dict[str, Any]:
    return {
        "scene": one.scene,
        "digest": one.digest,
        "rule": run.name,
        "interval": run.interval,
        "cycle": run.cycle,
        "qr_factorizations": run.mean("qr_factorizations"),
        "cg_iterations": run.mean("cg_iterations"),
        "flops": run.cost,
        "runtime": run.time,
    }


def interval_text(value: Any) -> str:
    """A number of QPs; ∞ is never."""
    return "never" if value == inf else short(value)


def size(value: Any) -> str:
    """A median of numbers of rows: 6, 7.5."""
    return f"{float(value):.3g}"


def _number(value: Any) -> str:
    return "∞" if value == inf else short(value)


def signed_percent(value: Any) -> str:
    """A regret: 0.123 → 12.3 %, −0.05 → −5.0 %."""
    share = round(100 * float(value), 1)
    return f"{share + 0.0:.1f} %".replace("-", "−")


def _percent(value: float) -> str:
    return "–" if isnan(value) else signed_percent(value)
