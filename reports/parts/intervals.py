"""How sure a mean ratio is: resampling of the QPs of a sequence.

Successive QPs of a motion resemble each other, so that they are not so many independent samples.
They are resampled in stretches of `STRETCH`: with replacement, from every possible beginning, as
many as the sequence is long (the moving-block bootstrap, Künsch 1989).  Seeded: the same rows give
the same interval.  It knows nothing of what makes two processes differ that do the same: an arm of
a solver has one process, and runs of the same code differ by some per cent.
"""

from __future__ import annotations

from typing import NamedTuple

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
