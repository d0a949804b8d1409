"""Performance profiles: on what share of the QPs is a backend within a factor of the fastest?

Source: Dolan and Moré, "Benchmarking optimization software with performance profiles",
Mathematical Programming 91 (2002).

1. On each QP of the common set, divide every backend's time by the least time of those verified.
2. A solve that is not verified counts as never finished: its ratio is infinite.
3. ρ(τ) of a backend is the share of QPs on which its ratio is at most τ.

ρ(1) is the share of QPs on which it is the fastest, and ρ(∞) the share that it solves at all.  The
ranking of a profile holds for the set of backends that it was drawn for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from reports.parts.names import solver_order
from reports.rows.comparison import Comparison, compare, pool
from reports.rows.results import Results

CLOCK = 1e-9
"""Least time that a clock tells apart from none [s]."""


def ratios(comparisons: Sequence[Comparison]) -> pd.DataFrame:
    """Time over the least verified time: one row per QP, one column per backend.

    Only backends that are compared in every scene have a column.  A solve that is not verified is
    infinite; a QP that nobody solved is infinite for all, and counts against all.
    """
    rows = pool(comparisons)
    if rows.empty:
        return pd.DataFrame()
    columns = sorted(rows["solver"].unique(), key=solver_order)
    # A clock that did not tick must not make the others infinitely slower.
    ticked = rows["runtime"].clip(lower=CLOCK)
    finished = rows.assign(finished=np.where(rows["verified"], ticked, np.inf))
    table = finished.pivot(index="problem", columns="solver", values="finished")[columns]
    best = table.min(axis=1)
    # inf / inf is not a number, but here it means: not solved.
    return table.div(best, axis=0).fillna(np.inf)


def profile(table: pd.DataFrame, taus: Sequence[float]) -> pd.DataFrame:
    """ρ(τ) of every backend: one row per τ, one column per backend.

    table : what `ratios` returns
    """
    within = {
        solver: [float((table[solver] <= tau).mean()) for tau in taus] for solver in table.columns
    }
    return pd.DataFrame(within, index=pd.Index(list(taus), name="tau"))


def scene_ratios(results: Results, setting: str, arm: str) -> pd.DataFrame:
    """`ratios` over all scenes of a study at one setting."""
    return ratios([compare(results.rows, scene, setting, arm) for scene in results.scenes])
