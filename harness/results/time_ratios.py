"""By how much two studies differ in time, and how sure that is.

A *run* is a solver in an arm on a recording at a setting; each study has its times in several
passes.  The ratio of a run is the median over its QPs of

    least time of the QP over the passes of the second study / that of the first,

so that every QP is compared with itself.  All averages are of logarithms.

1. **The machine.** What all solvers share is a faster or slower machine and not their doing: the
   median over the packages of their median ratios, for each recording at a setting, which is
   replayed at a time of its own.  Ratios are told relative to it.  With fewer than
   `FEWEST_PACKAGES` packages it cannot be told apart, and is taken to be 1.
2. **What passes show.** QPs are not independent measurements: a pass that is disturbed is disturbed
   for many of them, and for the solvers next to it.  So passes are drawn anew, with replacement,
   the same for all runs of a recording at a setting, and so are stretches of `STRETCH` neighbouring
   QPs (moving blocks, Künsch 1989).  That gives a standard error of each relative ratio.
3. **What passes do not show.** All passes of a run are made by one process; another one has its
   memory elsewhere, and runs of the same code differ by that.  It shows in how far the runs of a
   solver lie apart: a variance τ² is added to all, such that the median of their (deviation /
   standard error)² is that of χ² with one degree of freedom (a random effect, DerSimonian and
   Laird 1986, but by a median).  τ is at least `LEAST_SPREAD`.
4. **Solvers.** The runs of one solver are pooled, weighted by their variances.
5. **Many comparisons.** The intervals are Student's, with as many degrees of freedom as τ has, and
   widened by Bonferroni's inequality: in `SURE` of the comparisons of a study with another like
   it, all of them hold the true ratio.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from harness.names import METHOD, is_own

SURE = 0.95
"""Share of the comparisons in which all intervals hold."""
STRETCH = 10
"""QPs that are drawn together."""
DRAWS = 200
FEWEST_PACKAGES = 3
"""Packages from which on what they share is the machine's."""
FEWEST_QPS = 10
"""A run with fewer QPs is not judged by its times."""
LEAST_SPREAD = 0.02
"""Least standard deviation of the logarithm of a ratio between runs of the same code."""


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """The times of a solver in both studies, [s], NaN for QPs that are not compared.

    place : what shares its passes and QPs with others: a recording at a setting
    before, after : (passes, n), the same QPs in the same order
    """

    solver: str
    place: Hashable
    before: NDArray[np.float64]
    after: NDArray[np.float64]

    @property
    def package(self) -> str:
        """What it shares its code with: our method and the paper's, and their variants, are one."""
        return METHOD if is_own(self.solver) else self.solver.partition("[")[0]


class Ratio(NamedTuple):
    """A ratio relative to that of the machine, with an interval; NaN where it is not judged."""

    ratio: float
    low: float
    high: float

    @property
    def slower(self) -> bool:
        """Whether the whole interval lies above 1."""
        return self.low > 1.0

    @property
    def faster(self) -> bool:
        """Whether the whole interval lies below 1."""
        return self.high < 1.0


@dataclass(frozen=True)
class TimeRatios:
    """The ratios of all runs, in the order given, and of the solvers.

    machine : the ratio that all share, median over the runs;  packages : how many they are
    spread : τ, standard deviation of the logarithm of a ratio beyond what passes show
    """

    machine: float
    packages: int
    spread: float
    runs: tuple[Ratio, ...]
    solvers: dict[str, Ratio]


def time_ratios(runs: Sequence[ComparedRun], seed: int = 0) -> TimeRatios:
    """Compare the times of two studies (module's list); the same times give the same answer."""
    logs = [(_log(run.before), _log(run.after)) for run in runs]
    compared = [np.flatnonzero(np.isfinite(_of_qps(*pair))) for pair in logs]
    judged = [i for i, qps in enumerate(compared) if len(qps) >= FEWEST_QPS]
    ratios = [Ratio(np.nan, np.nan, np.nan)] * len(runs)
    if not judged:
        return TimeRatios(1.0, 0, np.nan, tuple(ratios), {})
    chosen = [runs[i] for i in judged]
    sides = [tuple(side[:, compared[i]] for side in logs[i]) for i in judged]
    solvers = np.array([run.solver for run in chosen])
    names = list(dict.fromkeys(solvers.tolist()))

    found = np.array([np.median(_of_qps(*pair)) for pair in sides])
    machine = _machine(found, chosen)
    relative = found - machine
    draws = _drawn(chosen, sides, np.random.default_rng(seed))
    variance = (draws - _machine(draws, chosen)).var(axis=0)
    spread = max(_excess(relative, variance, solvers), LEAST_SPREAD)
    variance += spread**2
    freedom = max(len(chosen) - len(names), 1)
    width = float(stats.t(freedom).isf((1 - SURE) / 2 / (len(chosen) + len(names))))

    def ratio(which: Any) -> Ratio:
        weights = 1.0 / variance[which]
        middle = (weights * relative[which]).sum() / weights.sum()
        half = width / np.sqrt(weights.sum())
        return Ratio(*np.exp([middle, middle - half, middle + half]).tolist())

    for at, i in enumerate(judged):
        ratios[i] = ratio([at])
    return TimeRatios(
        machine=float(np.exp(np.median(machine))),
        packages=len({run.package for run in chosen}),
        spread=spread,
        runs=tuple(ratios),
        solvers={name: ratio(solvers == name) for name in names},
    )


def _log(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithms; NaN where there is no time."""
    return np.log(np.where(times > 0, times, np.nan))


def _of_qps(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, n) logarithms of the ratios of the QPs, from (…, passes, n)."""
    return after.min(axis=-2) - before.min(axis=-2)


def _machine(logs: NDArray[np.float64], runs: Sequence[ComparedRun]) -> NDArray[np.float64]:
    """(…, runs) logarithms of the ratio that all packages share where and when a run was made."""
    shared = np.zeros(logs.shape)
    for place in {run.place for run in runs}:
        packages: dict[str, list[int]] = {}
        for i, run in enumerate(runs):
            if run.place == place:
                packages.setdefault(run.package, []).append(i)
        if len(packages) >= FEWEST_PACKAGES:
            medians = [np.median(logs[..., mine], axis=-1) for mine in packages.values()]
            here = [i for mine in packages.values() for i in mine]
            shared[..., here] = np.median(medians, axis=0)[..., None]
    return shared


def _drawn(
    runs: Sequence[ComparedRun],
    sides: Sequence[tuple[NDArray[np.float64], ...]],
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """(DRAWS, runs) logarithms of the ratios, from passes and QPs that are drawn anew."""
    most: dict[Hashable, int] = {}
    for run in runs:
        most[run.place] = max(most.get(run.place, 0), *run.before.shape, *run.after.shape)
    drawn = {place: rng.random((3, DRAWS, size)) for place, size in most.items()}
    logs = []
    for run, pair in zip(runs, sides, strict=True):
        *passes, stretches = drawn[run.place]
        n = pair[0].shape[1]
        starts = (stretches[:, : -(-n // STRETCH)] * n).astype(int)
        qps = (starts[:, :, None] + np.arange(STRETCH)).reshape(DRAWS, -1)[:, :n] % n
        some = [
            side[(chosen[:, : len(side)] * len(side)).astype(int)]
            for chosen, side in zip(passes, pair, strict=True)
        ]
        logs.append(np.median(np.take_along_axis(_of_qps(*some), qps, axis=1), axis=1))
    return np.array(logs).T


def _excess(
    logs: NDArray[np.float64], variance: NDArray[np.float64], solvers: NDArray[np.str_]
) -> float:
    """τ such that the median of deviation² / (variance + τ²) is that of χ².

    A run deviates from the mean of its solver's, so that the change of a solver is no spread; a
    run that is its solver's only one, from the median of all.
    """
    deviation = logs - np.median(logs)
    for name in np.unique(solvers):
        mine = solvers == name
        count = mine.sum()
        if count > 1:
            deviation[mine] = logs[mine] - np.mean(logs[mine])
            deviation[mine] *= np.sqrt(count / (count - 1))
    usual = stats.chi2(1).median()

    def surplus(spread: float) -> float:
        return float(np.median(deviation**2 / np.maximum(variance + spread**2, 1e-30)) - usual)

    largest = float(np.abs(deviation).max()) / np.sqrt(usual)
    if surplus(0.0) <= 0.0 or largest == 0.0:
        return 0.0
    return float(optimize.brentq(surplus, 0.0, largest))
