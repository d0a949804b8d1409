"""How little changes from step to step (§3.2): A, Aᵀd, what an old R is worth, and who leaves J_N.

Algorithm 2 starts from the last multipliers and the last R, since "the objective function does not
vary much".  Measured on motions of constant h, at one time, and on runs with error control.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import run_of
from problems import ContactQP, scene, simulate
from problems.qp import Indices, Vector, positions_of
from solvers import make_solver

LENGTHS = 0.02 / 2.0 ** np.arange(5)
"""h [s]."""
AGES = 2 ** np.arange(5)
"""Steps since the factorization."""


def _steps(label: str, h: float, until: float) -> list[ContactQP]:
    """The QPs of a motion with constant h."""
    run = simulate(scene(label), make_solver("glambda"), fixed_step=h, until=until)
    return [qp for qp in run.qps if qp.kind == "step"]


@check
def change(of: Literal["A", "Atd"], label: str, apart: float = 0.0) -> float:
    """Order in h of the change of A, or of Aᵀd, relative to it, from one QP to the next at t = 0.1.

    apart : [s] between the QPs, in place of one step
    """
    changes = []
    for h in LENGTHS:
        qps = _steps(label, float(h), 0.1)
        before, after = qps[-1 - max(1, round(apart / h))], qps[-1]
        one, two = (qp.dense_A if of == "A" else qp.A.T @ qp.d for qp in (before, after))
        changes.append(float(np.linalg.norm(two - one) / np.linalg.norm(one)))
    return slope(LENGTHS, changes)


@check
def condition(of: Literal["AR", "A"]) -> float:
    """p in cond − 1 = C s^p of A_F R⁻¹ ("AR"), R of s steps ago, or of A_F itself ("A"); fig2."""
    run = simulate(scene("fig2"), make_solver("glambda"), fixed_step=0.0025, until=0.2)
    last = run.qps[-1]
    free = last.row_id[np.asarray(run.solutions[-1].x) > 0.0]
    first = run.qps[-1 - int(AGES[-1])]
    R = np.linalg.qr(_columns(first, free), mode="r")
    found = []
    for age in AGES:
        A = _columns(run.qps[-1 - int(AGES[-1]) + int(age)], free)
        conditioned = A if of == "A" else solve_triangular(R, A.T, trans="T").T
        found.append(float(np.linalg.cond(conditioned)) - 1.0)
    return slope(AGES, found)


def _columns(qp: ContactQP, rows: Indices) -> Vector:
    return np.asarray(qp.dense_A[:, positions_of(rows, qp.row_id)])


@check
def dropped(label: str, mu_I: float, within: float = np.inf) -> float:
    """Share of the normal multipliers that a step leaves in X whose constraint then leaves J_N.

    The others are freed by a later step.  A multiplier counts once, however long it is in X.
    within : steps after which it must be gone
    """
    run = run_of(label, 4.0, mu_I=mu_I)
    since: dict[int, int] = {}
    gone, ended = 0, 0
    for qp, solution in zip(run.qps, run.solutions, strict=True):
        if not qp.accepted or qp.kind not in ("step", "corrector"):
            continue
        at_zero = (np.asarray(solution.x) <= qp.lower) & np.isinf(qp.upper)
        there = dict(zip(qp.row_id.tolist(), at_zero.tolist(), strict=True))
        for row in list(since):
            if not there.get(row, False):
                gone += since.pop(row) <= within and row not in there
                ended += 1
        for row, is_zero in there.items():
            if is_zero:
                since[row] = since.get(row, 0) + 1
    return gone / ended
