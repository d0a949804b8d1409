"""How guessing the active set grows with the number of rows, beside algorithm 2.

Lötstedt 1984, end of §3.2: with one to three active constraints the multipliers can be had by
guessing which are 0, solving a linear system for the others, and trying another combination where
the signs are wrong; "this approach can be very slow for larger problems".

A set is one guess, with one linear system to solve; a descent direction of algorithm 2 is
one linear system too (3.19), so that both are counted in the same unit.  Guesses are taken by their
distance from a first one (`solvers.baselines.enumeration`): cold, the rows that least squares
without bounds leaves inside; warm, the recorded set of the QP before.  With t rows wrong in that
guess, some C(k, t) 2ᵗ sets come first: what matters is how good the guess is, and where a share of
k is wrong the sets grow as bᵏ.

Two kinds of QP are looked at, all rows that are not fixed counting as k:

1. those of recordings, where the guess is mostly right;
2. random ones, seeded: m = 3k/2 rows, columns of length 1 in random directions, every third column
   a friction row −½ ≤ x ≤ ½ and the others x ≥ 0, and d such that without bounds x would be normal
   with variance 1.  Here half of the rows end at a bound, and least squares tells some of them.

Every time is the least of `TURNS`, setup and solve; an enumeration of more than `SLOW` seconds is
not repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from harness.machine.threads import one_thread
from harness.names import METHOD
from harness.recordings.recording import Recording
from problems.qp import ContactQP, Solution
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.base import Unsupported

MOST_SETS = 10_000
"""Sets after which a QP is given up, which takes some tenths of a second."""
TOTAL_SETS = 200_000
"""Sets that may be tried on one recording and arm; of a longer one the first part is used."""
PER_SIZE = 16
"""Random QPs of each size."""
SIZES = (*range(1, 9), 10, 12, 14, 16, 20, 24, 28, 32)
"""Sizes of random QPs, up to the one where half are given up."""
MOST_ROWS = 32
"""Rows beyond which enumeration takes no QP."""
TURNS, SLOW = 3, 0.05

COLUMNS = ("arm", "k", "sets", "seconds", "directions", "method_seconds")


class Fit(NamedTuple):
    """What is multiplied by `base` for each further row: y = factor · baseᵏ."""

    factor: float
    base: float


def recorded(recording: Recording) -> pd.DataFrame:
    """Both methods on the QPs of a recording, cold and warm; one row per QP and arm.

    Columns: arm, k, sets (NaN: given up), seconds, directions and
    method_seconds of `glambda`.
    """
    frames = []
    with one_thread():
        for arm in ("cold", "warm"):
            starts = _starts(recording, arm == "warm")
            method = _method_runs(recording.qps, arm == "warm")
            rows, tried = [], 0
            for qp, start, counted in zip(recording.qps, starts, method, strict=True):
                k = moving(qp)
                if 0 < k <= MOST_ROWS and tried < TOTAL_SETS:
                    sets, seconds = _guess(qp, start)
                    tried += MOST_SETS if np.isnan(sets) else int(sets)
                    rows.append((arm, k, sets, seconds, *counted))
            frames.append(_frame(rows))
    return pd.concat(frames, ignore_index=True)


def randomly(sizes: Sequence[int] = SIZES) -> pd.DataFrame:
    """Both methods on random QPs, cold, size by size, until half of a size are given up."""
    rows = []
    with one_thread():
        for k in sizes:
            rng = np.random.default_rng(k)
            qps = [random_qp(k, rng) for _ in range(PER_SIZE)]
            given_up = 0
            for qp, counted in zip(qps, _method_runs(qps, False), strict=True):
                sets, seconds = _guess(qp, None)
                rows.append(("cold", k, sets, seconds, *counted))
                given_up += np.isnan(sets)
                if given_up >= PER_SIZE / 2:
                    return _frame(rows)
    return _frame(rows)


def random_qp(k: int, rng: np.random.Generator) -> ContactQP:
    """Item 2 of the module's list."""
    A = rng.standard_normal(((3 * k + 1) // 2, k))
    A /= np.linalg.norm(A, axis=0)
    friction = np.arange(k) % 3 == 2
    d = -A @ rng.standard_normal(k)
    return ContactQP(A, d, np.where(friction, -0.5, 0.0), np.where(friction, 0.5, np.inf))


def moving(qp: ContactQP) -> int:
    """Rows that are not fixed."""
    return int(np.count_nonzero(qp.lower < qp.upper))


def medians(rows: pd.DataFrame) -> pd.DataFrame:
    """Medians by k; a QP that was given up counts as more than any other, inf where half are."""
    return rows.fillna({"sets": inf, "seconds": inf}).groupby("k")[list(COLUMNS[2:])].median()


def fit_base(rows: pd.DataFrame, column: str) -> Fit:
    """Least squares on the logarithm of the median of each k; NaN with fewer than three of them."""
    values = medians(rows)
    values = values[np.isfinite(values["sets"]) & (values[column] > 0)]
    if len(values) < 3:
        return Fit(nan, nan)
    slope, log_factor = np.polyfit(values.index.to_numpy(float), np.log(values[column]), 1)
    return Fit(exp(float(log_factor)), exp(float(slope)))


def loses_from(rows: pd.DataFrame, own: str, other: str) -> int | None:
    """The least k from which on the median of `own` exceeds that of `other`, or None."""
    values = medians(rows)
    better = np.flatnonzero(values[own] <= values[other])
    first = better[-1] + 1 if better.size else 0
    return int(values.index[first]) if first < len(values) else None


def _guess(qp: ContactQP, start: Solution | None) -> tuple[float, float]:
    """(sets, seconds) of an enumeration; NaN sets where it is given up."""
    solver = make_solver("enumeration", max_guesses=MOST_SETS)
    sets, least = nan, inf
    for _ in range(TURNS):
        try:
            found = solver.solve(qp, start)
        except Unsupported:
            return nan, nan
        sets, taken = float(found.iterations), found.timing.setup + found.timing.solve
        least = min(least, taken)
        if taken > SLOW:
            break
    return sets, least


def _frame(rows: list[tuple[Any, ...]]) -> pd.DataFrame:
    """Numbers stay numbers where there is no row."""
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(
        {"k": int, **dict.fromkeys(COLUMNS[2:], float)}
    )


def _starts(recording: Recording, warm: bool) -> list[Solution | None]:
    """The recorded solution before each QP, of the same stretch; None for all where cold."""
    starts: list[Solution | None] = []
    last: Solution | None = None
    for qp, solution in zip(recording.qps, recording.solutions, strict=True):
        follows = qp.kind in WARM_KINDS
        if follows and qp.restart:
            last = None
        starts.append(last if warm and follows else None)
        if follows:
            last = solution
    return starts


def _method_runs(qps: Sequence[ContactQP], warm: bool) -> list[tuple[int, float]]:
    """(descent directions, seconds) of `glambda` on each QP, the least seconds of `TURNS` runs.

    QPs of more than `MOST_ROWS` are left out: (0, inf).
    """
    solver = make_solver(METHOD)
    directions, times = [0] * len(qps), np.full(len(qps), inf)
    for _ in range(TURNS):
        last: Solution | None = None
        for i, qp in enumerate(qps):
            follows = qp.kind in WARM_KINDS
            if (follows and qp.restart) or moving(qp) > MOST_ROWS:
                last = None
            if moving(qp) > MOST_ROWS:
                continue
            solution = solver.solve(qp, last if warm and follows else None)
            directions[i] = solution.iterations
            times[i] = min(times[i], solution.timing.setup + solution.timing.solve)
            if follows:
                last = solution
    return list(zip(directions, times.tolist(), strict=True))
