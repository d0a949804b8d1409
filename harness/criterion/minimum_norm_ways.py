"""Two ways to the minimum-norm multipliers (4.8), on the QPs of a recording.

Lötstedt 1984, §4.2: (4.8) "requires one QR decomposition per time-step", where old decompositions
with conjugate gradients might do.  Compared are

1. the paper's way (`problems.least_norm.minimum_norm`): the QR of Aᵀ and Q₂, at every pass of a
   step or once per step, for as long as A stays the same;
2. an old R and conjugate gradients (`harness.criterion.least_norm`), with R made anew every s QPs,
   or after a QP of more than √(2 C_QR/C_IT) iterations, as the paper does with A_F.

C_QR is the QR of Aᵀ without Q, C_IT an iteration of conjugate gradients, and iterations are fitted
by c s^r, s the age of R (`harness.criterion.cost_model`).  Work is counted by
`solvers.active_set.flops`, A dense.  The test for full column rank, and b, which A x + d leaves
behind, are common to all ways and not counted.  Coulomb's rows, our addition to (4.8), are left
out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.linalg as sla

from harness.criterion.cost_model import Growth, fit_growth, threshold
from harness.criterion.factor_rules import sequence
from harness.criterion.least_norm import ACCURACY, Decomposition, Members, decompose, least_norm
from harness.recordings.recording import Recording
from problems.least_norm.independence import RANK_TOL, surely_independent
from problems.least_norm.minimum_norm import minimum_norm
from problems.qp import ContactQP, Indices, Vector, positions_of
from problems.sequence import QPSequence
from solvers import make_solver
from solvers.active_set.flops import cg_iteration_flops, qr_flops

INTERVALS = (1, 2, 3, 5, 8, 12, 20, 40, inf)
"""QPs from one decomposition to the next that are tried."""
LOOSE = 1e-6
"""Another accuracy asked of λ, relative to ‖λ‖."""
BUDGET = 2e10
"""Operations that the QPs examined may take to be decomposed; the first that fit are."""

CASE_COLUMNS = (
    *("place", "m", "k", "rank", "z", "same_A"),
    *("per_pass", "per_step", "C_QR", "C_IT", "error"),
)
RUN_COLUMNS = (
    *("place", "chain", "age", "iterations", "rounds", "bounded", "decompositions", "refused"),
    *("printed", "order", "flops", "error"),
)


class Case(NamedTuple):
    """A QP with redundant columns.

    b : (m,) A λ*;  truth : (k,) the answer by the SVD;  z : whether a bound holds there
    printed : (k,) the answer of `problems.least_norm.minimum_norm`;  z_flops : of its QP for z
    """

    place: int
    chain: int
    qp: ContactQP
    b: Vector
    rank: int
    truth: Vector
    z: bool
    printed: Vector
    z_flops: int


@dataclass(frozen=True, eq=False)
class MinimumNormWays:
    """What was found on one recording.

    calls : QPs that a warm start can serve;  examined : how many of them were looked at
    cases : the rows of `case_rows`;  ways : those of `way_rows`
    """

    scene: str
    calls: int
    examined: int
    cases: pd.DataFrame
    ways: pd.DataFrame

    @property
    def kept(self) -> dict[float, pd.DataFrame]:
        """Rows by interval."""
        kept = self.ways[self.ways["way"] == "kept"]
        return {float(interval): run for interval, run in kept.groupby("interval")}

    @property
    def paper(self) -> pd.DataFrame:
        """Rows with the threshold √(2 C_QR/C_IT)."""
        return self.ways[self.ways["way"] == "paper"]

    @property
    def loose(self) -> pd.DataFrame:
        """The same, asked for `LOOSE`."""
        return self.ways[self.ways["way"] == "loose"]

    @property
    def costs(self) -> tuple[float, float]:
        """C_QR and C_IT, means over the cases [flops]."""
        return float(self.cases["C_QR"].mean()), float(self.cases["C_IT"].mean())

    @property
    def growth(self) -> Growth | None:
        """Of the iterations with the age of R."""
        ways = self.ways
        aged = ways[(ways["way"] == "kept") & (ways["age"] > 0) & ~ways["printed"]]
        return fit_growth(aged["age"], aged["iterations"], aged["chain"])

    @property
    def best(self) -> float:
        """The interval that cost least."""
        kept = self.kept
        return min(kept, key=lambda s: float(kept[s]["flops"].mean()))


def case_rows(cases: Sequence[Case]) -> pd.DataFrame:
    """The paper's way on QPs with redundant columns, one row each.

    Columns: place, m, k, rank, z (whether λ_R breaks a bound), same_A (whether A is that of the QP
    before), flops with a QR per pass and per step, C_QR, C_IT [flops], error against the SVD.
    """
    rows, before = [], None
    for case in cases:
        same = before is not None and _same_matrix(before.qp, case.qp)
        first, later = printed_flops(case)
        sizes = case.place, case.qp.m, case.qp.k, case.rank, case.z, same
        flops = first, later if same else first, *_unit_costs(case)
        rows.append((*sizes, *flops, _error(case, case.printed)))
        before = case
    return pd.DataFrame(rows, columns=list(CASE_COLUMNS))


def way_rows(cases: Sequence[Case]) -> pd.DataFrame:
    """Old decompositions on the same QPs, one row for each and way, interval as in `keep_old`.

    way : "kept", the decomposition for so many QPs; "paper", by the threshold √(2 C_QR/C_IT);
        "loose", the same asked for `LOOSE`
    """
    runs = [keep_old(cases, s).assign(way="kept", interval=s) for s in INTERVALS]
    for way, accuracy in (("paper", ACCURACY), ("loose", LOOSE)):
        run = keep_old(cases, inf, by_threshold=True, accuracy=accuracy)
        runs.append(run.assign(way=way, interval=inf))
    return pd.concat(runs, ignore_index=True)


def redundant(recording: Recording) -> tuple[int, int, list[Case]]:
    """QPs of the sequence, how many fit into `BUDGET`, and those with redundant columns."""
    links = sequence(recording)
    solver = make_solver("glambda")
    cases: list[Case] = []
    spent, examined = 0.0, 0
    for place, qp, chain, _ in links:
        spent += 20.0 * qp.m * qp.k * min(qp.m, qp.k)
        if spent > BUDGET:
            break
        examined += 1
        x = recording.solutions[place].x
        if x is None or surely_independent(qp.A) or not np.any(x):
            continue
        A = qp.dense_A
        sigma = sla.svdvals(A)
        rank = int((sigma > RANK_TOL * sigma[0]).sum())
        if rank == qp.k:
            continue
        x = np.clip(x, qp.lower, qp.upper)
        posed = QPSequence(solver)
        printed = minimum_norm(posed, qp, x, None)
        flops = sum(s.work.flops for s in posed.solutions if s.work is not None)
        today = least_norm(A, A @ x, qp.lower, qp.upper, decompose(A))
        truth, z = _by_svd(qp, A @ x, (printed, today.lam))
        cases.append(Case(place, chain, qp, A @ x, rank, truth, z, printed, flops))
    return len(links), examined, cases


def keep_old(
    cases: Sequence[Case],
    interval: float,
    *,
    by_threshold: bool = False,
    accuracy: float = ACCURACY,
) -> pd.DataFrame:
    """Solve all cases, decomposing every `interval` of them, or after √(2 C_QR/C_IT) iterations.

    A refused answer is sought again with today's R, then with X empty, then by the paper's way.
    One row per QP: place, chain, age of R, iterations, rounds, bounded (size of X), decompositions,
    refused (why the old R was given up, else ""), printed (whether nothing but the paper's way was
    left), order of R, flops, error.
    """
    kept: Decomposition | None = None
    last: tuple[Indices, Members] | None = None
    age, due, records = 0, True, []
    for case in cases:
        qp, A = case.qp, case.qp.dense_A
        C_QR, C_IT = _unit_costs(case)
        guess = None if last is None else _carried(qp, *last)
        attempts = [(True, guess)] if guess is None else [(True, guess), (True, None)]
        if kept is not None and not due and age + 1 < interval:
            attempts = [(False, guess), *attempts]
        age, flops, iterations, rounds, decompositions, why = age + 1, 0, 0, 0, 0, ""
        for fresh, start in attempts:
            if kept is None or (fresh and not decompositions):
                kept, age, decompositions, flops = decompose(A), 0, 1, flops + C_QR
            answer = least_norm(A, case.b, qp.lower, qp.upper, kept, start, accuracy)
            flops, iterations = flops + answer.flops, iterations + answer.iterations
            rounds, order = rounds + answer.rounds, kept.rows.size
            if not answer.refused:
                break
            why = why if fresh else answer.refused
        printed = bool(answer.refused)
        if printed:
            flops += printed_flops(case)[0]
        else:
            last = qp.row_id, answer.members
        due = by_threshold and iterations > threshold(C_QR, C_IT)
        bounded = int(np.count_nonzero(answer.members))
        error = _error(case, case.printed if printed else answer.lam)
        counts = age, iterations, rounds, bounded, decompositions, why, printed, order
        records.append((case.place, case.chain, *counts, flops, error))
    table: Any = pd.DataFrame(records, columns=list(RUN_COLUMNS))
    return table.astype({"printed": bool})


def printed_flops(case: Case) -> tuple[int, int]:
    """Flops of the paper's way with a QR, and with Q₂ of the pass before.

    The QR of Aᵀ; Q₂, by applying r reflectors to k − r columns; λ_R, the QP for z and Q₂ z.
    """
    m, k, r = case.qp.m, case.qp.k, case.rank
    decomposition = qr_flops(k, m) + (k - r) * (4 * k * r - 2 * r * r)
    rest = 4 * k * (k - r) + case.z_flops + (2 * k * (k - r) if case.z else 0)
    return decomposition + rest, rest


def _unit_costs(case: Case) -> tuple[int, int]:
    """C_QR of R alone and C_IT."""
    return qr_flops(case.qp.k, case.qp.m), cg_iteration_flops(case.qp.k, case.rank)


def _by_svd(qp: ContactQP, b: Vector, near: Sequence[Vector]) -> tuple[Vector, bool]:
    """The answer by pseudo-inverses, and whether a bound holds.

    Where one does, X is read off each of `near`; of what then meets (4.8)'s constraints, the least.
    """
    A = qp.dense_A
    lam = np.linalg.pinv(A, rcond=RANK_TOL) @ b
    slack = 1e-9 * float(np.abs(lam).max(initial=0.0))
    if (lam >= qp.lower - slack).all() and (lam <= qp.upper + slack).all():
        return lam, False
    found = []
    for guess in near:
        low, high = guess <= qp.lower + slack, guess >= qp.upper - slack
        lam = np.where(low, qp.lower, np.where(high, qp.upper, 0.0))
        free = ~(low | high)
        wanted = b - A[:, ~free] @ lam[~free]
        lam[free] = np.linalg.pinv(A[:, free], rcond=RANK_TOL) @ wanted
        outside = max(float((qp.lower - lam).max()), float((lam - qp.upper).max()), 0.0)
        miss = float(np.linalg.norm(A @ lam - b)) / float(np.linalg.norm(A)) + outside
        found.append((miss > 10 * slack, float(np.linalg.norm(lam)), lam))
    return min(found, key=lambda each: each[:2])[2], True


def _error(case: Case, lam: Vector) -> float:
    """‖λ − truth‖/‖truth‖."""
    size = float(np.linalg.norm(case.truth))
    return float(np.linalg.norm(lam - case.truth)) / (size or 1.0)


def _carried(qp: ContactQP, row_id: Indices, members: Members) -> Members:
    """The set X of an earlier QP, by row_id."""
    before = positions_of(qp.row_id, row_id)
    return np.where(before >= 0, members[before], 0).astype(np.int8)


def _same_matrix(one: ContactQP, two: ContactQP) -> bool:
    return np.array_equal(one.row_id, two.row_id) and np.array_equal(one.dense_A, two.dense_A)
