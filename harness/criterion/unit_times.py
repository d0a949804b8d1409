"""Seconds of one factorization and one conjugate gradient iteration, from whole solves.

The clock is around a solve, not around its parts: reading it inside would cost more than a part of
a small QP does.  So the parts are found by least squares,

    time = other + t_QR · factorizations + t_IT · iterations + t_d · directions + t_w · changes,

over many solves, none of the coefficients negative.

1. Solves with the same four counts make a cell, and stand in it by their median, so that an
   interruption of a single solve does not matter.
2. A cell weighs as much as it has solves.
3. Small cells may still hold interruptions.  A cell further off than twice the typical deviation
   weighs less in proportion, and the fit is repeated (Huber's weights).

Sizes differ within a recording, so that the coefficients are averages over it.  Where a count is
a combination of the others in every cell (always one iteration per direction, say), what it costs
cannot be told apart, and is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np
import pandas as pd
from scipy.optimize import nnls

ROUNDS = 20
"""Fits with weights from the one before."""
FAR = 2.0
"""Deviations, in units of the median one, from which a cell loses weight."""
NEAR = 1e-3
"""[µs] Deviations below this are nothing."""
PARTS = ("qr_factorizations", "cg_iterations", "descent_directions", "working_set_changes")
"""Counts that the time of a solve is explained by."""


@dataclass(frozen=True)
class UnitTimes:
    """Seconds of each part.

    factorization, iteration, direction, change : for each one, NaN where not told apart
    other : of every solve
    explained : share of the variance between the cells that they explain, 1 at best
    """

    factorization: float
    iteration: float
    direction: float
    change: float
    other: float
    explained: float

    @property
    def threshold(self) -> float:
        """√(2 t_QR/t_IT)."""
        return sqrt(2 * self.ratio)

    @property
    def ratio(self) -> float:
        """t_QR/t_IT; NaN where either is unknown or was not seen to cost time."""
        known = self.factorization > 0 and self.iteration > 0
        return self.factorization / self.iteration if known else nan


def fit_unit_times(solves: Iterable[pd.DataFrame]) -> UnitTimes:
    """Fit to tables that hold `PARTS` and `runtime` [s], one row per solve.

    Raises ValueError without a solve.
    """
    rows = pd.concat(list(solves), ignore_index=True)
    if rows.empty:
        raise ValueError("no solves were given, so there is nothing to fit times to")
    cells = rows.groupby(list(PARTS), sort=True)["runtime"].agg(["median", "size"]).reset_index()
    X = np.column_stack([cells[list(PARTS)].to_numpy(float), np.ones(len(cells))])
    y, weights = 1e6 * cells["median"].to_numpy(float), cells["size"].to_numpy(float)
    sizes = weights
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        found, _ = nnls(X * root[:, None], y * root)
        deviation = np.abs(y - X @ found)
        far = max(FAR * float(np.median(np.repeat(deviation, sizes.astype(int)))), NEAR)
        weights = sizes * far / np.maximum(deviation, far)
    total = float(weights @ (y - np.average(y, weights=weights)) ** 2)
    rest = float(weights @ deviation**2)
    rank = np.linalg.matrix_rank(X)
    for part in range(len(PARTS)):
        if np.linalg.matrix_rank(np.delete(X, part, axis=1)) == rank:
            found[part] = np.nan
    qr, cg, direction, change, other = (1e-6 * float(value) for value in found)
    return UnitTimes(qr, cg, direction, change, other, 1.0 - rest / total if total else 1.0)
