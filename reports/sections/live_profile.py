"""The times behind a performance profile, for a page that draws it again for some backends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from reports.parts.names import solver_order
from reports.sections.profiles import CLOCK

MOST = 300_000
"""Times that a page holds; of more, QPs are left out evenly."""


def live_profile(rows: pd.DataFrame) -> dict[str, Any] | None:
    """Backends, and for each its times [ns] on the common QPs, 0 where it is not verified.

    rows : of compared runs (`reports.rows.comparison.pool`)
    """
    if rows.empty:
        return None
    ticked = rows["runtime"].clip(lower=CLOCK).where(rows["verified"], 0.0)
    table = rows.assign(time=ticked).pivot(index="problem", columns="solver", values="time")
    solvers = sorted(table.columns, key=solver_order)
    every = -(-table.size // MOST)
    kept = table[solvers].fillna(0.0).iloc[::every]
    times = np.round(1e9 * kept.to_numpy()).astype(int)
    return {
        "solvers": [str(name) for name in solvers],
        "times": times.T.tolist(),
        "every": every,
        "qps": len(kept),
    }
