"""How good the norms and ranks are that algorithm 2 trusts, on the QPs of a recording.

Lötstedt 1984, §3.2, takes three things for granted:

1. ‖R⁻¹‖ is estimated, from below (Cline, Moler, Stewart and Wilkinson 1979), and divides ε₀ in
   (3.20) and in ε₁.  An estimate that is too small by a factor makes both too loose by it.
2. The rank of A_F is determined after Karasalo (1974), whose bound on σ_min is from below.
3. R may be an earlier one, and so may its ‖R⁻¹‖; A_F of today has another.

Each is held against singular values.  All columns are scaled to length 1, as the method does, and
factorized by its own kernel.  "Free" are the columns of the multipliers that lie between their
bounds in the recorded solution, F and the passive ones; "all" are all columns of A.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.linalg
import scipy.sparse as sp

from harness.criterion.column_drift import AGES
from harness.criterion.factor_rules import Link, sequence
from harness.judging.facts import RANK_TOL
from harness.recordings.recording import Recording
from problems.qp import FREE, PASSIVE, ContactQP, Indices, Solution, Vector, positions_of
from solvers.active_set.factorization import inverse_norm_estimate, karasalo_bound, qr_factorize
from solvers.active_set.workspace import LANES, N_FLOAT_ROWS, F, make_workspace

BUDGET = 2e10
"""Operations that each of the two tables may take; QPs are sampled evenly to fit."""
FEWEST = 4
"""Samples below which nothing is said."""
SAMPLES = 200
"""Pairs of QPs sampled for each age."""

NORM_COLUMNS = (
    *("place", "kind", "columns", "n", "rank", "qr_rank", "karasalo_rank", "last", "next"),
    *("inverse", "estimate", "bound"),
)
AGE_COLUMNS = ("age", "place", "n", "then", "estimate_then", "today")


class Factor(NamedTuple):
    """The method's factorization of some columns.

    R : (order, order), order the rank that it decides
    estimate : of ‖R⁻¹‖;  bound : Karasalo's on σ_min of R, NaN for order 0
    karasalo_rank : the largest leading part of R whose bound exceeds `RANK_TOL`
    """

    R: Vector
    estimate: float
    bound: float
    karasalo_rank: int

    @property
    def order(self) -> int:
        """Columns that are independent."""
        return int(self.R.shape[0])

    @property
    def inverse_norm(self) -> float:
        """‖R⁻¹‖₂, by singular values; 1 for order 0, as the estimate has it."""
        return 1.0 / float(scipy.linalg.svdvals(self.R)[-1]) if self.order else 1.0


def factor(B: Vector) -> Factor:
    """Factorize the columns of B (m, n), of length 1 or 0, with the method's own kernels."""
    m, n = B.shape
    room = make_workspace(m, n)
    room.S[:], room.I[:] = 0.0, 0
    room.S[N_FLOAT_ROWS : N_FLOAT_ROWS + n, :m] = B.T
    room.I[F, :n] = np.arange(n)
    padded = -(-m // LANES) * LANES
    order = qr_factorize(room.S, room.I, m, padded, n, 0)
    first = N_FLOAT_ROWS + 2 * room.n
    R = np.triu(room.S[first : first + order, :order].T)
    trusted = order
    while trusted and karasalo_bound(room.S, trusted) <= RANK_TOL:
        trusted -= 1
    return Factor(
        R=R,
        estimate=float(inverse_norm_estimate(room.S, order)),
        bound=float(karasalo_bound(room.S, order)) if order else float("nan"),
        karasalo_rank=trusted,
    )


def norms(recording: Recording) -> pd.DataFrame:
    """Every QP, or as many as `BUDGET` allows, with its free and with all columns.

    One row per QP and choice of columns ("free", "all"): its place and kind, n columns, rank by the
    SVD (σ > `RANK_TOL` σ_max), by the method's QR and by Karasalo's bound alone, last and next (the
    least σ/σ_max that the QR counts, and the largest that it does not, 0 where it counts all),
    inverse (the true ‖R⁻¹‖), estimate, bound.
    """
    qps = recording.qps
    cost = 20 * max((qp.m * qp.k**2 for qp in qps), default=0)
    rows = []
    for place in _evenly(np.arange(len(qps)), cost, max(len(qps), FEWEST)):
        qp, solution = qps[place], recording.solutions[place]
        every = np.arange(qp.k)
        for columns, chosen in (("free", _between(solution)), ("all", every)):
            if not chosen.size or solution.x is None:
                continue
            B = unit_columns(qp, chosen)
            sigma = scipy.linalg.svdvals(B)
            found = factor(B)
            relative = sigma / max(sigma[0], 1e-300)
            last = float(relative[found.order - 1]) if found.order else float("nan")
            beyond = float(relative[found.order]) if found.order < sigma.size else 0.0
            rank = int((relative > RANK_TOL).sum())
            ranks = rank, found.order, found.karasalo_rank, last, beyond
            sizes = found.inverse_norm, found.estimate, found.bound
            rows.append((place, qp.kind, columns, chosen.size, *ranks, *sizes))
    return pd.DataFrame(rows, columns=list(NORM_COLUMNS))


def ages(recording: Recording) -> pd.DataFrame:
    """Pairs of QPs of one stretch between restarts, sampled evenly for each age.

    One row per pair, age QPs apart: the place of the later one, n columns, ‖R⁻¹‖ then, its estimate
    then, and ‖R⁻¹‖ of the same columns today; NaN where the columns depended on each other then, or
    do today.  Both this and `norms` give no rows where A is too large.
    """
    links = sequence(recording)
    cost = 40 * max((link.qp.m * link.qp.k**2 for link in links), default=0) * len(AGES)
    rows = []
    for age in AGES:
        later = np.array([i for i in range(age, len(links)) if _one_stretch(links, i - age, i)])
        for i in _evenly(later, cost, SAMPLES):
            old, new = links[i - age], links[i]
            solution = recording.solutions[new.place]
            wanted = np.flatnonzero(solution.working_set == FREE)
            before = positions_of(new.qp.row_id[wanted], old.qp.row_id)
            wanted, before = wanted[before >= 0], before[before >= 0]
            if not wanted.size:
                continue
            then = factor(unit_columns(old.qp, before))
            today = factor(unit_columns(new.qp, wanted))
            if then.order < before.size or today.order < wanted.size:
                norms_found = (float("nan"),) * 3
            else:
                norms_found = (then.inverse_norm, then.estimate, today.inverse_norm)
            rows.append((age, new.place, wanted.size, *norms_found))
    return pd.DataFrame(rows, columns=list(AGE_COLUMNS))


def unit_columns(qp: ContactQP, columns: Indices) -> Vector:
    """Dense columns of A at these positions, scaled to length 1; a zero column stays.  (m, n)"""
    chosen: Any = qp.A[:, columns]
    B = np.asarray(chosen.toarray() if sp.issparse(chosen) else chosen)
    lengths = np.linalg.norm(B, axis=0)
    return np.asarray(B / np.where(lengths > 0, lengths, 1.0))


def _between(solution: Solution) -> Indices:
    """Positions of the multipliers between their bounds."""
    return np.flatnonzero(np.isin(solution.working_set, (FREE, PASSIVE)))


def _one_stretch(links: Sequence[Link], first: int, last: int) -> bool:
    return links[first].chain == links[last].chain


def _evenly(places: Indices, cost: float, most: int) -> Indices:
    """At most `most` of the places, evenly spread; none where `BUDGET` has no room for FEWEST."""
    samples = most if not cost else min(most, int(BUDGET / cost))
    if samples < FEWEST or not len(places):
        return places[:0]
    return places[np.unique(np.linspace(0, len(places) - 1, samples).astype(int))]
