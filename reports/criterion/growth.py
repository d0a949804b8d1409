"""Why iterations grow with the age of R as they do, and whether one direction is enough: tables.

    criterion_growth     iterations against the age of R, c s^r, and what κ predicts
    criterion_premise    is (3.19) solved once per step, and what where it is not
    criterion_age        how far A and A_F R_old⁻¹ have moved at each age

Their numbers are those of `harness.criterion.criterion` and `harness.criterion.column_drift`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
import pandas as pd

from harness.criterion.measurement import Measurement
from reports.criterion.intervals import ADAPTIVE, signed_percent, size
from reports.parts.sentences import join
from reports.parts.table import Table, percent, short, whole

LINEAR = 1.0
"""The paper's exponent."""
FEW = 1 / 3
"""Share of the singular values that counts as few."""


def growth_table(measured: Sequence[Measurement]) -> Table:
    """c and r per recording, with what the condition of A_F R_old⁻¹ predicts."""
    rows = []
    for one in measured:
        growth, steps = one.growth, one.rules["never"].steps
        older = steps[steps["counted"] & (steps["age"] > 0)]
        each = older["cg_iterations"] / older["descent_directions"].clip(lower=1)
        row: dict[str, Any] = {"scene": one.scene}
        if growth is None:
            row |= dict.fromkeys(["c", "c from", "c to", "r", "r from", "r to"], nan)
        else:
            (c_low, c_high), (r_low, r_high) = growth.c_range, growth.r_range
            row |= {"c": growth.c, "c from": c_low, "c to": c_high}
            row |= {"r": growth.r, "r from": r_low, "r to": r_high}
        row |= {
            "r by κ": one.exponent,
            "most CG": each.max() if len(each) else nan,
            "f": one.criterion.free,
            "off": one.drift["outlying"].max() if len(one.drift) else nan,
        }
        rows.append(row)
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_growth",
        title="Conjugate gradient iterations against the age of R",
        reading=(
            "c s^r is fitted to the mean iterations per QP, s QPs after the factorization; the "
            "ranges hold 90 % of bootstrap resamples of stretches of the motion.  r by κ is how "
            "the bound on the iterations from κ = cond(A_F R_old⁻¹) alone would grow.  most CG is "
            "the largest number of iterations for one direction, if A_F is never factorized anew; "
            "f the columns of A_F; off the singular values of A_F R_old⁻¹ that are more than 10 % "
            "from 1, at the age that has most (median)."
        ),
        data=data,
        formats={
            **dict.fromkeys(data.columns[1:4], short),
            **dict.fromkeys(data.columns[4:8], _exponent),
            **dict.fromkeys(["most CG", "f", "off"], size),
        },
        notes=_growth_notes(measured),
    )


def _growth_notes(measured: Sequence[Measurement]) -> list[str]:
    known = [one for one in measured if one.growth is not None]
    if not known:
        return []
    linear = [one.scene for one in known if _range(one)[0] <= LINEAR <= _range(one)[1]]
    values = [one.growth.r for one in known if one.growth is not None]
    notes = [
        f"r is {short(min(values))} to {short(max(values))}; the paper's r = 1 is "
        + (f"within the range on {join(linear)} only." if linear else "outside every range.")
    ]
    slower = [one for one in known if one.exponent > 1.5 * max(_range(one)[1], 0.05)]
    if slower:
        few = [
            one.scene for one in slower if one.drift["outlying"].max() <= FEW * one.criterion.free
        ]
        notes.append(
            f"Iterations grow more slowly than κ allows on {join([one.scene for one in slower])}"
            + (
                f"; on {join(few)} few singular values of A_F R_old⁻¹ leave 1, and κ tells only of "
                "the extremes."
                if few
                else "."
            )
        )
    at_once = []
    for one in known:
        assert one.growth is not None
        limit = one.criterion.threshold
        if one.growth.means[0] >= limit:
            at_once.append(f"{one.scene} ({short(one.growth.means[0])} against {short(limit)})")
    if at_once:
        notes.append(
            "One step after a factorization a QP already needs no fewer iterations than "
            f"√(2 C_QR/C_IT) on {join(at_once)}."
        )
    return notes


def _range(one: Measurement) -> tuple[float, float]:
    return one.growth.r_range if one.growth is not None else (nan, nan)


def premise_table(measured: Sequence[Measurement]) -> Table:
    """Descent directions per QP, and regret where there are several."""
    rows = []
    for one in measured:
        counted, directions = one.counted, one.directions
        several = counted & (directions > 1)
        single = counted & (directions <= 1)
        flops = one.rules["paper"].steps["flops"].to_numpy()
        row: dict[str, Any] = {
            "scene": one.scene,
            "none": float(np.mean(directions[counted] == 0)),
            "one": float(np.mean(directions[counted] == 1)),
            "several": float(np.mean(directions[counted] > 1)),
            "cost": float(flops[several].sum() / flops[counted].sum()),
        }
        for rule in ("paper", "paper deferred", "online"):
            for chosen, sign in ((single, "≤ 1"), (several, "> 1")):
                column = f"{ADAPTIVE[rule]} {sign}"
                row[column] = one.regret(rule, chosen=chosen) if chosen.any() else nan
        rows.append(row)
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_premise",
        title="Is (3.19) solved once per step?",
        reading=(
            "Share of the QPs that need no descent direction, one, and several, as counted where "
            "A_F is factorized at every QP; cost, the share of the operations of the paper's rule "
            "that the last take; and the regret in operations on the QPs of up to one direction "
            "(≤ 1) and on those of several (> 1), each against the fixed interval that is best for "
            "them."
        ),
        data=data,
        formats={
            **dict.fromkeys(["none", "one", "several", "cost"], percent),
            **dict.fromkeys(data.columns[5:], signed_percent),
        },
    )


def age_table(measured: Sequence[Measurement]) -> Table:
    """How A and A_F R_old⁻¹ move with age, beside the iterations counted."""
    parts = []
    for one in measured:
        table = one.drift.copy()
        table.insert(0, "scene", one.scene)
        if one.growth is not None and len(table):
            table["iterations"] = np.exp(
                np.interp(np.log(table["age"]), np.log(one.growth.ages), np.log(one.growth.means))
            )
        parts.append(table)
    data = pd.concat(parts, ignore_index=True).drop(columns="effort")
    data = data.rename(columns={"age": "s", "moved": "‖A_n − A_{n−s}‖/‖A_n‖", "condition": "κ"})
    data = data.rename(columns={"condition_high": "κ, 90 %", "outlying": "off"})
    missing = [one.scene for one in measured if not len(one.drift)]
    notes = [f"{join(missing)}: A is too large, or the stretches too short, to sample."]
    return Table(
        name="criterion_age",
        title="What s steps do to A and to R as a preconditioner",
        reading=(
            "Medians over sampled pairs of QPs s steps apart: the change of A (Frobenius norm, "
            "common columns), κ = cond(A_F R_old⁻¹), its 90th percentile, and off, the singular "
            "values of A_F R_old⁻¹ more than 10 % from 1.  iterations are the counted means per QP."
        ),
        data=data,
        formats={
            **dict.fromkeys(["s", "samples"], whole),
            **dict.fromkeys(data.columns[3:], short),
        },
        notes=notes if missing else [],
    )


def _exponent(value: Any) -> str:
    return f"{round(float(value), 2) + 0.0:.2f}"
