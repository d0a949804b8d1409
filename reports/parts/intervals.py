"""How sure a mean ratio, or a slope, is: resampling of the QPs of a sequence.

Successive QPs of a motion resemble each other, so that they are not so many independent samples.
They are resampled in stretches of `STRETCH`: with replacement, from every possible beginning, as
many as the sequence is long (the moving-block bootstrap, Künsch 1989).  Seeded: the same rows give
the same interval.  It knows nothing of what makes two processes differ that do the same: an arm of
a solver has one process, and runs of the same code differ by some per cent.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

STRETCH = 10
"""QPs that are resampled together."""
RESAMPLES = 1000
SURE = 0.95
"""Share of the resamples that an interval holds."""


class Interval(NamedTuple):
    """A geometric mean, and where `SURE` of the resamples lie."""

    mean: float
    low: float
    high: float


class Line(NamedTuple):
    """y = at_none + slope x by least squares, and where `SURE` of the slopes of resamples lie."""

    at_none: float
    slope: float
    low: float
    high: float


def line(x: ArrayLike, y: ArrayLike, seed: int = 0) -> Line:
    """Straight line through values in the order of their QPs; no slope where x does not vary."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    n = x.size
    if n == 0:
        return Line(np.nan, np.nan, np.nan, np.nan)
    stretch = min(STRETCH, n)
    columns = np.array([np.ones(n), x, y, x * x, x * y])
    around = np.concatenate([columns, columns[:, : stretch - 1]], axis=1)
    totals = np.concatenate([np.zeros((5, 1)), around.cumsum(axis=1)], axis=1)
    sums = totals[:, stretch:] - totals[:, :-stretch]
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, -(-n // stretch)))
    slopes = _slope(*sums[:, drawn].sum(axis=2))
    slope = float(_slope(*columns.sum(axis=1)))
    if np.isnan(slope):
        return Line(float(y.mean()), np.nan, np.nan, np.nan)
    low, high = np.nanquantile(slopes, [(1 - SURE) / 2, (1 + SURE) / 2])
    return Line(float(y.mean() - slope * x.mean()), slope, float(low), float(high))


def _slope(n: Any, x: Any, y: Any, xx: Any, xy: Any) -> Any:
    """Least squares from sums; NaN where x is the same everywhere."""
    spread = n * xx - x * x
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 1e-9 * n * xx, (n * xy - x * y) / spread, np.nan)


def geometric_mean(ratios: ArrayLike, seed: int = 0) -> Interval:
    """Geometric mean of ratios in the order of their QPs; NaN without any.

    A ratio that is not positive and finite, of a time too short for the clock, is left out.
    """
    ratios = np.asarray(ratios, float)
    logs = np.log(ratios[(ratios > 0) & np.isfinite(ratios)])
    n = logs.size
    if n == 0:
        return Interval(np.nan, np.nan, np.nan)
    stretch = min(STRETCH, n)
    sums = np.convolve(np.concatenate([logs, logs[: stretch - 1]]), np.ones(stretch), "valid")
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, -(-n // stretch)))
    means = sums[drawn].mean(axis=1) / stretch
    low, high = np.quantile(means, [(1 - SURE) / 2, (1 + SURE) / 2])
    return Interval(*np.exp([logs.mean(), low, high]).tolist())
