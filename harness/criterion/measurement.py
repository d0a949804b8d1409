"""What runs of the rules say of the criterion, from their rows (`harness.criterion.criterion`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.criterion.column_drift import predicted_exponent
from harness.criterion.cost_model import (
    Criterion,
    Growth,
    criterion_of_costs,
    fit_growth,
    optimal_interval,
)
from harness.criterion.unit_times import UnitTimes, fit_unit_times
from solvers.active_set.unit_costs import UnitCosts

RULES = (
    *("exact QR", "always", "never", "s* paper", "s* fitted"),
    *("paper", "paper deferred", "fitted", "online", "as shipped"),
)
"""The rules in the order of tables."""
BLOCK = 10
"""QPs in a row that are resampled together for the ranges of c and r."""


@dataclass(eq=False)
class Run:
    """What came of one rule: its rows in `harness.criterion.criterion.rule_runs`."""

    steps: pd.DataFrame

    @property
    def name(self) -> str:
        """Of the rule."""
        return str(self.steps["rule"].iloc[0])

    @property
    def interval(self) -> float:
        """NaN for a rule that has none."""
        return float(self.steps["interval"].iloc[0])

    @property
    def keeps_R(self) -> bool:
        """Whether conjugate gradients work with an R at every size."""
        return bool(self.steps["keeps_R"].iloc[0])

    @property
    def counted(self) -> pd.Series:
        """(n,) the QPs that means are taken over."""
        return self.steps["counted"]

    def mean(self, column: str, chosen: NDArray[np.bool_] | None = None) -> float:
        """Mean of a column over the counted QPs, or those `chosen` among all."""
        rows = self.counted.to_numpy() if chosen is None else chosen
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


class Prediction(NamedTuple):
    """What the cost model says, from runs of fixed intervals.

    criterion : counted C_QR and C_IT;  growth : c and r, or None
    c, r : those for the model, where iterations do not fall with age
    longest : QPs of the longest stretch between restarts
    """

    criterion: Criterion
    growth: Growth | None
    c: float
    r: float
    longest: int

    @property
    def intervals(self) -> dict[str, float]:
        """s* "paper" (c = r = 1) and "fitted"."""
        C_QR, C_IT = self.criterion.C_QR, self.criterion.C_IT
        return {
            "paper": optimal_interval(C_QR, C_IT),
            "fitted": optimal_interval(C_QR, C_IT, self.c, self.r),
        }

    def whole(self, name: str) -> float:
        """s* as it can be run: a number of QPs, inf from the longest stretch on."""
        s = self.intervals[name]
        return max(1, round(s)) if s < self.longest else inf


def prediction(scene: str, swept: Sequence[Run]) -> Prediction:
    """C_QR, C_IT, c and r of runs of fixed intervals, of which the first factorizes always."""
    steps = swept[0].steps
    sizes = steps.loc[steps["counted"], list(UnitCosts._fields)]
    costs = map(UnitCosts._make, sizes.itertuples(index=False))
    growth = growth_of(swept)
    c, r = growth.prediction() if growth is not None else (1.0, 0.0)
    longest = int(steps["chain"].value_counts().max())
    return Prediction(criterion_of_costs(scene, costs), growth, c, r, longest)


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
        return self.sweep[0].counted.to_numpy()

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


def measurements(runs: pd.DataFrame, drift: pd.DataFrame) -> list[Measurement]:
    """What the rows of all recordings say, those of `rule_runs` and `moves`, by recording.

    Raises ValueError where there is no row: nothing starts warm.
    """
    if runs.empty:
        raise ValueError(
            "no QP of these recordings starts warm with a free column, so there is no criterion "
            "to measure; record a longer motion"
        )
    return [
        _measurement(part, drift[drift["digest"] == digest].drop(columns=["scene", "digest"]))
        for digest, part in runs.groupby("digest", sort=False)
    ]


def _measurement(rows: pd.DataFrame, drift: pd.DataFrame) -> Measurement:
    groups = rows.groupby("rule", sort=False)
    runs = [Run(part.reset_index(drop=True)) for _, part in groups]
    sweep = {run.interval: run for run in runs if not np.isnan(run.interval)}
    scene = str(rows["scene"].iloc[0])
    known = prediction(scene, [run for run in runs if run.steps["swept"].all()])
    named = {run.name: run for run in runs} | {"always": sweep[1], "never": sweep[inf]}
    named |= {f"s* {name}": sweep[known.whole(name)] for name in known.intervals}
    kept = [run for run in runs if run.keeps_R]
    times = fit_unit_times([run.steps[run.counted] for run in kept])
    return Measurement(
        scene=scene,
        digest=str(rows["digest"].iloc[0]),
        criterion=known.criterion,
        growth=known.growth,
        times=times,
        predicted={**known.intervals, "time": times.threshold},
        sweep=[sweep[s] for s in sorted(sweep)],
        rules={name: named[name] for name in RULES},
        directions=sweep[1].steps["descent_directions"].to_numpy(),
        drift=drift.reset_index(drop=True),
        exponent=predicted_exponent(drift),
    )


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
