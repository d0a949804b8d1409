"""A QR per step for (4.8), or an old one with conjugate gradients: the table and its notes.

    criterion_minimum_norm      cost of each way, c s^r, the predicted and the best interval, errors

Its numbers are those of `harness.criterion.minimum_norm_ways`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

import pandas as pd

from harness.criterion.cost_model import optimal_interval
from harness.criterion.minimum_norm_ways import LOOSE, MinimumNormWays
from reports.parts.sentences import join
from reports.parts.table import Table, percent, scientific, short, whole

WRONG = 1e-6
"""An answer further than this from that of the SVD, relative to ‖λ‖, is no minimum-norm one."""
WAYS = ("QR per pass", "QR per step", "R anew", "R kept", "paper")
"""Columns of the table that hold flops."""


def minimum_norm_table(ways: Sequence[MinimumNormWays]) -> Table:
    """Flops, iterations and errors of both ways, by recording."""
    there = [one for one in ways if len(one.cases)]
    rows = [_row(one) for one in ways]
    return Table(
        name="criterion_minimum_norm",
        title="Minimum norm (4.8): a QR per step, or an old one with conjugate gradients",
        reading=(
            "QPs with redundant columns only, with the median of their columns k and rank; z is "
            "the share whose λ_R breaks a bound.  Means per QP in counted operations, A dense: "
            "the paper's QR of Aᵀ with Q₂ at every pass, or at every step and kept for its "
            "passes; conjugate gradients with R made anew at every QP, with R kept for best s "
            "QPs, and by the paper's threshold √(2 C_QR/C_IT), the next QP being factorized.  "
            "√ is that threshold, which is the interval for c = r = 1; c, r are fitted to "
            "iterations c s^r, s* follows from them; r < 0 counts as 0: never.  refused counts the "
            "QPs on which the kept R was given up (best s).  error is the worst ‖δλ‖/‖λ‖ against "
            "the SVD, of QR and of CG."
        ),
        data=pd.DataFrame(rows),
        formats={
            **dict.fromkeys(["QPs", *WAYS, "refused"], whole),
            "z": percent,
            **dict.fromkeys(["best s", "s*"], _interval),
            **dict.fromkeys(["k", "rank"], _interval),
            **dict.fromkeys(["√", "c", "r"], short),
            **dict.fromkeys(["error QR", "error CG"], scientific),
        },
        notes=_notes(there) + _absent(ways),
    )


def _row(one: MinimumNormWays) -> dict[str, Any]:
    if one.cases.empty:
        return {"scene": one.scene, "QPs": 0}
    best, growth, (C_QR, C_IT) = one.kept[one.best], one.growth, one.costs
    fitted = growth.prediction() if growth is not None else None
    return {
        "scene": one.scene,
        "QPs": len(one.cases),
        "k": one.cases["k"].median(),
        "rank": one.cases["rank"].median(),
        "z": float(one.cases["z"].mean()),
        **_costs(one),
        "best s": one.best,
        "√": (2 * C_QR / C_IT) ** 0.5,
        "c": None if growth is None else growth.c,
        "r": None if growth is None else growth.r,
        "s*": None if fitted is None else optimal_interval(C_QR, C_IT, *fitted),
        "refused": int((best["refused"] != "").sum()),
        "error QR": one.cases["error"].max(),
        "error CG": max(float(run["error"].max()) for run in (*one.kept.values(), one.paper)),
    }


def _costs(one: MinimumNormWays) -> dict[str, float]:
    means = (
        one.cases["per_pass"].mean(),
        one.cases["per_step"].mean(),
        one.kept[1]["flops"].mean(),
        one.kept[one.best]["flops"].mean(),
        one.paper["flops"].mean(),
    )
    return dict(zip(WAYS, map(float, means), strict=True))


def _notes(there: Sequence[MinimumNormWays]) -> list[str]:
    """Who wins, how often the old R fails, and what went wrong."""
    won: list[str] = []
    lost: list[str] = []
    for one in there:
        costs = _costs(one)
        ratio = costs["QR per step"] / costs["paper"]
        named = f"{one.scene} (k = {one.cases['k'].median():g}, {short(ratio)}×)"
        (won if ratio > 1 else lost).append(named)
    notes = []
    if won:
        notes.append(
            f"An old R by the paper's threshold is cheaper than a QR per step on {join(won)}."
        )
    if lost:
        notes.append(f"A QR per step is cheaper than an old R on {join(lost)}.")
    for one in there:
        refusals = one.paper.loc[one.paper["refused"] != "", "refused"].value_counts()
        left = int(one.paper["printed"].sum())
        if len(refusals):
            told = join([f"{why} {count}" for why, count in sorted(refusals.items())])
            notes.append(
                f"On {one.scene} the old R had to be given up in the middle of "
                f"{int(refusals.sum())} of {len(one.cases)} QPs ({told}); a new R "
                + ("then did." if not left else f"did in all but {left}.")
            )
        wrong = one.cases[one.cases["error"] > WRONG]
        if len(wrong):
            notes.append(
                f"On {one.scene} the QP for z is not solved at QP "
                f"{join([str(place) for place in wrong['place']])}: the paper's way is off by "
                f"{scientific(wrong['error'].max())} there."
            )
        worst = float(one.loose["error"].max())
        if worst > 10 * LOOSE:
            notes.append(
                f"Asked for {LOOSE:g}, conjugate gradients on {one.scene} miss it: an old R "
                f"underrates the error, which is up to {scientific(worst)}."
            )
    if there:
        notes.append(
            "The old R is our own reading of one sentence of the paper.  Operations are counted, "
            "not timed, and A is taken as dense; Coulomb's rows, which the stepper adds to "
            "(4.8), are left out of both ways."
        )
    return notes


def _absent(all_of_them: Sequence[MinimumNormWays]) -> list[str]:
    """What was not looked at."""
    none = [one.scene for one in all_of_them if not len(one.cases)]
    cut = [
        f"{one.scene} (the first {one.examined:,} of {one.calls:,} QPs)"
        for one in all_of_them
        if one.examined < one.calls
    ]
    notes = [f"{join(none)}: no QP with redundant columns was examined."] if none else []
    return notes + ([f"Cut, for its size: {join(cut)}."] if cut else [])


def _interval(value: Any) -> str:
    """A number of QPs or columns; ∞ is never."""
    return "never" if value == inf else f"{float(value):.3g}"
