"""How far times spread, and how sure their ratios are: the table beside the cost table.

The cost table has one number for a solver on a scene.  Here are the quartiles behind it, what its
passes differ by, and the ratio to the fastest with the range of its resamples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from reports.parts.intervals import SURE, geometric_mean
from reports.parts.table import Table, microseconds, percent, times, whole
from reports.rows.comparison import Comparison, compare
from reports.rows.results import ARMS, Results

QUARTILES = {"lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75}


def spread_table(results: Results, setting: str) -> Table:
    """Quartiles over the QPs, spread over the passes, ratio to the best with its range."""
    out: list[dict[str, Any]] = []
    for scene in results.scenes:
        for arm in ARMS:
            out += _rows(compare(results.rows, scene, setting, arm))
    data = pd.DataFrame(out)
    return Table(
        name="spread",
        key={"setting": setting},
        title="How far times spread",
        reading=(
            "Quartiles over the QPs of a scene, those of the cost table, in µs.  passes: the "
            "median over the QPs of the median pass over the best one; what exceeds 1 is the "
            "machine, not the QP.  ratio: geometric mean of the times over those of the fastest "
            "backend that was verified on every QP, QP by QP, whatever was verified, with the "
            f"range of {percent(SURE)} of resampled sequences.  Where a range holds 1, no order "
            "of the two is claimed."
        ),
        data=data,
        formats={
            "QPs": whole,
            **dict.fromkeys(QUARTILES, microseconds),
            **dict.fromkeys(["passes", "ratio", "from", "to"], times),
        },
    )


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    if not len(comparison.rows):
        return []
    summary = comparison.summary()
    runtimes = comparison.rows.pivot(index="problem", columns="solver", values="runtime")
    medians = comparison.rows.pivot(index="problem", columns="solver", values="runtime_median")
    best = summary.index[summary["best"]]
    out = []
    for solver in summary.index:
        runtime = runtimes[solver]
        ratio = geometric_mean(runtime / runtimes[best[0]]) if len(best) else (np.nan,) * 3
        out.append(
            {
                "scene": comparison.scene,
                "arm": comparison.arm,
                "solver": solver,
                "QPs": len(runtime),
                **{name: runtime.quantile(share) for name, share in QUARTILES.items()},
                "passes": float((medians[solver] / runtime).median()),
                **dict(zip(("ratio", "from", "to"), ratio, strict=True)),
            }
        )
    return out
