"""When to factorize anew: the paper's cost model, §3.2, from counts alone.

T calls of algorithm 2 with n factorizations cost, with s steps since the last one and c s^r
conjugate gradient iterations per call,

    C(n) = C_QR n + C_0 T + c C_IT T^{r+1} n^{−r}/(r + 1),

least at the interval s* = T/n* = ((r + 1)/r · C_QR/(c C_IT))^{1/(r+1)}.  So A_F is factorized anew
when a solve needs more than c s*^r iterations; for c = r = 1, the paper's choice, that is
√(2 C_QR/C_IT).  (The printed C(n) has n^{r+1} − n^{−r}; the printed optimum follows from the form
above.)

C_QR and C_IT are counted for A_F at the reference solution of each recorded QP, as the paper's
method counts its own work (`solvers.active_set.unit_costs`).  c and r are fitted to iterations that
were counted at known ages of R (`fit_growth`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, inf, nan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.recordings.recording import Recording
from problems.sequence import WARM_KINDS
from solvers.active_set.sparse.pattern import make_pattern
from solvers.active_set.unit_costs import UnitCosts, dense_costs, goes_sparse, sparse_costs

CLASS_RATIO = 1.5
"""Ages of R are gathered in classes, each reaching so many times further than the one before."""
FEWEST = 5
"""Fewest QPs of a class that its mean counts with."""
RESAMPLES = 400
"""Bootstrap resamples behind an interval of c and r."""


@dataclass(frozen=True)
class Criterion:
    """Counted costs of one recording and what the model makes of them.

    calls : T, QPs that continue a sequence and have a free column at their reference
    rows, free : medians of m and of the number f of columns of A_F
    C_QR, C_IT : means over the calls [flops]; 0 where there are no calls
    sparse : share of the calls that take the sparse path
    """

    scene: str
    calls: int
    rows: float
    free: float
    C_QR: float
    C_IT: float
    sparse: float = 0.0

    @property
    def threshold(self) -> float:
        """√(2 C_QR/C_IT): more iterations than this ask for a new factorization."""
        return threshold(self.C_QR, self.C_IT) if self.calls else 0.0

    @property
    def cost_per_call(self) -> float:
        """C(n*)/T − C_0 for c = r = 1 [flops]."""
        if not self.calls:
            return 0.0
        return cost_per_call(optimal_interval(self.C_QR, self.C_IT), self.C_QR, self.C_IT)


def optimal_interval(C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0) -> float:
    """s*: calls from one factorization to the next at which C(n) is least; inf for r = 0.

    Raises ValueError for costs or c that are not positive, or a negative r.
    """
    _check(C_QR, C_IT, c, r)
    if r == 0:
        return inf
    return float(((r + 1) / r * C_QR / (c * C_IT)) ** (1 / (r + 1)))


def threshold(C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0) -> float:
    """c s*^r: a solve that needs more iterations than this calls for a new factorization."""
    interval = optimal_interval(C_QR, C_IT, c, r)
    return inf if interval == inf else c * interval**r


def cost_per_call(
    interval: float, C_QR: float, C_IT: float, c: float = 1.0, r: float = 1.0, C_0: float = 0.0
) -> float:
    """C(n)/T for n = T/interval [flops]: C_QR/s + C_0 + c C_IT s^r/(r + 1).

    Raises ValueError for an interval that is not positive and as `optimal_interval` does.
    """
    _check(C_QR, C_IT, c, r)
    if not interval > 0:
        raise ValueError(f"interval = {interval}; it must be positive")
    if interval == inf:
        return C_0 + c * C_IT if r == 0 else inf
    return C_QR / interval + C_0 + c * C_IT * interval**r / (r + 1)


def criterion_of(recording: Recording) -> Criterion:
    """Count C_QR and C_IT over the time-step QPs of a recording.

    QPs without an accepted reference, or with no free column, are left out: no R is made for them.
    """
    costs, pattern = [], None
    for qp, reference in zip(recording.qps, recording.references, strict=True):
        if qp.kind not in WARM_KINDS or reference is None:
            continue
        free = (reference.x > qp.lower) & (reference.x < qp.upper)
        if not free.any():
            continue
        if goes_sparse(qp):
            if pattern is None or not pattern.fits(qp.A):
                pattern = make_pattern(qp.A)
            costs.append(sparse_costs(qp, free, pattern))
        else:
            # Columns that the free ones already span would be passive: R does not hold them.
            costs.append(dense_costs(qp.m, int(np.linalg.matrix_rank(qp.dense_A[:, free]))))
    return criterion_of_costs(recording.scene, costs)


def criterion_of_costs(scene: str, costs: Iterable[UnitCosts]) -> Criterion:
    """Mean C_QR and C_IT over calls of algorithm 2; those without a free column are left out."""
    table = np.array([one for one in costs if one.f > 0], dtype=np.float64)
    if not table.size:
        return Criterion(scene, 0, 0.0, 0.0, 0.0, 0.0)
    rows, columns, C_QR, C_IT, sparse = table.T
    return Criterion(
        scene=scene,
        calls=len(table),
        rows=float(np.median(rows)),
        free=float(np.median(columns)),
        C_QR=float(C_QR.mean()),
        C_IT=float(C_IT.mean()),
        sparse=float(sparse.mean()),
    )


@dataclass(frozen=True, eq=False)
class Growth:
    """Conjugate gradient iterations per call, c s^r, with s steps since the factorization.

    c, r : least squares on logarithms of the means below, every class with the same weight
    c_range, r_range : from the 5th to the 95th percentile over bootstrap resamples
    ages : (n,) mean logarithmic age of each class;  means : (n,) iterations per call
    counts : (n,) calls in each class
    """

    c: float
    r: float
    c_range: tuple[float, float]
    r_range: tuple[float, float]
    ages: NDArray[np.float64]
    means: NDArray[np.float64]
    counts: NDArray[np.int64]

    def prediction(self) -> tuple[float, float]:
        """(c, r) for the cost model, which knows no falling cost: r < 0 is r = 0 at the mean."""
        if self.r > 0:
            return self.c, self.r
        return float(np.average(self.means, weights=self.counts)), 0.0


def fit_growth(
    ages: ArrayLike, iterations: ArrayLike, blocks: ArrayLike, *, seed: int = 0
) -> Growth | None:
    """Fit c s^r to iterations (n,) counted at ages s (n,); None with fewer than two classes.

    blocks : (n,) number of the stretch of the motion that a call lies in.  Stretches, not calls,
        are resampled for the ranges: neighbours in time are alike, and so are several runs over
        the same stretch.

    Ages are gathered in classes of equal width in log s (1, 2, 3, 4-5, 6-8, …), so that no end of
    the range outweighs the other; classes of fewer than `FEWEST` calls, or in which no call needs
    an iteration, are left out.  Calls of age 0 are not part of it.
    """
    age, count = np.asarray(ages, dtype=np.int64), np.asarray(iterations, dtype=np.float64)
    used = age > 0
    age, count, block = age[used], count[used], np.asarray(blocks, dtype=np.int64)[used]
    if not age.size:
        return None
    member = np.searchsorted(_class_ends(int(age.max())), age)
    _, block = np.unique(block, return_inverse=True)
    shape = (int(block.max()) + 1, int(member.max()) + 1)
    # calls, iterations and Σ log s of every stretch in every class
    sums = np.zeros((3, *shape))
    for table, values in zip(sums, (np.ones(age.size), count, np.log(age)), strict=True):
        np.add.at(table, (block, member), values)
    calls, total, logs = sums.sum(axis=1)
    kept = (calls >= FEWEST) & (total > 0)
    if kept.sum() < 2:
        return None
    sums, calls, total, logs = sums[:, :, kept], calls[kept], total[kept], logs[kept]
    c, r = _power_law(logs / calls, total / calls)
    random = np.random.default_rng(seed)
    fits = []
    for weights in random.multinomial(shape[0], np.full(shape[0], 1 / shape[0]), RESAMPLES):
        n, cg, log_age = np.tensordot(weights, sums, axes=(0, 1))
        there = cg > 0
        if there.sum() >= 2:
            fits.append(_power_law(log_age[there] / n[there], cg[there] / n[there]))
    low, high = np.percentile(fits, [5, 95], axis=0) if fits else np.full((2, 2), nan)
    return Growth(
        c=c,
        r=r,
        c_range=(float(low[0]), float(high[0])),
        r_range=(float(low[1]), float(high[1])),
        ages=np.exp(logs / calls),
        means=total / calls,
        counts=calls.astype(np.int64),
    )


def _class_ends(oldest: int) -> list[int]:
    """Last age of each class: 1, 2, 3, 5, 8, 12, 18, …"""
    ends = [1]
    while ends[-1] < oldest:
        ends.append(max(ends[-1] + 1, round(CLASS_RATIO * ends[-1] + 1e-9)))
    return ends


def _power_law(log_s: NDArray[np.float64], means: NDArray[np.float64]) -> tuple[float, float]:
    """(c, r) of the line through (log s, log mean)."""
    r, log_c = np.polyfit(log_s, np.log(means), 1)
    return exp(float(log_c)), float(r)


def _check(C_QR: float, C_IT: float, c: float, r: float) -> None:
    if not (C_QR > 0 and C_IT > 0 and c > 0 and r >= 0):
        raise ValueError(
            f"C_QR = {C_QR}, C_IT = {C_IT}, c = {c} must be positive and r = {r} not negative"
        )
