"""Which runs are compared with which, on which QPs, and by what mean.

The traps that this module exists to avoid: a mean in which a wrong answer scores as a fast one; a
mean over different QPs for different solvers; a shift that swallows the times it should protect.

1. A *run* is a solver in one arm.  In the comparison `cold` every solver runs cold.  In `warm` it
   runs as it would in a simulation: warm where it has a warm arm, else cold.
2. A run that skipped more than `SKIP_LIMIT` of a scene's QPs (a method for few contacts only, or
   an unfinished replay) is left out and listed with its reason; the others are compared.
3. Means run over the QPs that no compared run skipped, less those of free flight, which have no
   multiplier and so nothing to solve: the common set.
4. A row that is not verified is charged the time limit, whatever the solver claimed.
5. The mean is the shifted geometric mean exp(mean(log(t + s))) − s with s = `SHIFT`, far below the
   times measured, so that it does not turn into an arithmetic mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from reports.parts.names import solver_order
from reports.rows.results import ARMS

SHIFT = 1e-6
"""Shift of the geometric means [s]."""

SKIP_LIMIT = 0.1
"""Share of a scene's QPs beyond which a run that skipped them is left out of its comparison."""


@dataclass(frozen=True)
class LeftOut:
    """A run that is not compared: how many of the scene's QPs it has solved, and why no more."""

    solver: str
    solved: int
    of: int
    reason: str


@dataclass(frozen=True)
class Comparison:
    """Runs of one scene at one setting, on their common QPs.

    arm : "cold" or "warm"
    rows : the rows of the compared runs on the common set
    qps, common : QPs of the scene with something to solve, and those that no compared run skipped
    without_warm : solvers that have no warm arm and stand with their cold one
    left_out : runs that are not compared
    machines : where the times were measured; only one machine's rows are kept
    """

    scene: str
    setting: str
    arm: str
    rows: pd.DataFrame
    qps: int
    common: int
    without_warm: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    machines: tuple[str, ...]

    @property
    def solvers(self) -> list[str]:
        """The compared solvers, our method first, then the paper's and its variants."""
        return sorted(self.rows["solver"].unique(), key=solver_order)

    def summary(self) -> pd.DataFrame:
        """`summarise` of its rows, by the median."""
        return summarise(self.rows)


def summarise(rows: pd.DataFrame, by: str = "median") -> pd.DataFrame:
    """One row per solver: `median` and `mean` [s], `verified` share, `best`, `ratio` to the best.

    rows : of compared runs on common QPs, with a column `charged`
    by : "median" or "mean", what the best is chosen by and the ratio is of

    `median` is of the runtimes as measured; `mean` is the shifted geometric mean of the charged
    ones.  `best` marks the fastest solver among those verified on every QP, and `ratio` is its
    multiple; NaN where no solver is verified on every QP.
    """
    grouped = rows.groupby("solver")
    table = pd.DataFrame(
        {
            "median": grouped["runtime"].median(),
            "mean": grouped["charged"].apply(shifted_geometric_mean),
            "verified": grouped["verified"].mean(),
        }
    )
    table = table.loc[sorted(table.index, key=solver_order)]
    sound = table.loc[table["verified"] == 1.0, by]
    best = sound.idxmin() if len(sound) else None
    table["best"] = table.index == best
    table["ratio"] = table[by] / sound[best] if best is not None else np.nan
    return table


def pool(comparisons: Sequence[Comparison]) -> pd.DataFrame:
    """Rows of several scenes together, of the solvers that are compared in every one of them."""
    filled = [comparison for comparison in comparisons if len(comparison.rows)]
    if not filled:
        return pd.DataFrame(columns=["problem", "solver", "runtime", "charged", "verified"])
    shared = set.intersection(*(set(comparison.solvers) for comparison in filled))
    rows = pd.concat([comparison.rows for comparison in filled], ignore_index=True)
    return rows[rows["solver"].isin(shared)]


def shifted_geometric_mean(times: ArrayLike, shift: float = SHIFT) -> float:
    """exp(mean(log(t + shift))) − shift [s]; NaN without times."""
    values = np.asarray(times, float)
    if values.size == 0:
        return float("nan")
    return float(np.exp(np.mean(np.log(values + shift))) - shift)


def compare(rows: pd.DataFrame, scene: str, setting: str, arm: str) -> Comparison:
    """Compare all runs of one scene at one setting, cold or as in a simulation (module's list).

    rows : prepared rows, see `reports.rows.results.prepare`

    Raises ValueError for an unknown arm.  A comparison without rows is empty, not an error.
    """
    if arm not in ARMS:
        raise ValueError(f"arm {arm!r} is unknown; choose one of {', '.join(ARMS)}")
    part = rows[(rows["scene"] == scene) & (rows["settings"] == setting) & (rows["k"] > 0)]
    part, without_warm = _runs(part, arm)
    machines = part["machine"].astype(str).value_counts(sort=True)
    names = tuple(sorted(machines.index, key=lambda name: (-machines[name], name)))
    if len(names) > 1:
        part = part[part["machine"].astype(str) == names[0]]
    everything = part["problem"].unique()
    left_out, skipped = [], set()
    for solver, mine in part.groupby("solver"):
        done = mine[~mine["skipped"]]
        gone = set(everything) - set(done["problem"])
        if len(gone) > SKIP_LIMIT * len(everything):
            texts = mine.loc[mine["skipped"], "status_text"].astype(str)
            reason = texts.mode().iloc[0] if len(texts) else "not replayed to the end"
            left_out.append(LeftOut(str(solver), len(done), len(everything), reason))
        else:
            skipped |= gone
    part = part[~part["solver"].isin([entry.solver for entry in left_out])]
    part = part[~part["problem"].isin(skipped)]
    return Comparison(
        scene=scene,
        setting=setting,
        arm=arm,
        rows=part,
        qps=len(everything),
        common=int(part["problem"].nunique()),
        without_warm=tuple(without_warm),
        left_out=tuple(sorted(left_out, key=lambda entry: solver_order(entry.solver))),
        machines=names,
    )


def _runs(part: pd.DataFrame, arm: str) -> tuple[pd.DataFrame, list[str]]:
    """Rows that stand for each solver in this comparison, and who stands with its cold arm."""
    if arm == "cold" or not (part["arm"] == "warm").any():
        return part[part["arm"] == arm], []
    warm = set(part.loc[part["arm"] == "warm", "solver"])
    without = sorted(set(part["solver"]) - warm, key=solver_order)
    stands = (part["arm"] == "warm") | (part["solver"].isin(without) & (part["arm"] == "cold"))
    return part[stands], without
