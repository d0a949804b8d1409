"""Merits of multipliers (3.2) over velocities (3.4): a feasible start, one code for friction."""

from __future__ import annotations

from typing import Literal

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import evenly, qps_of, run_of
from harness.judging.facts import facts_of
from harness.judging.oracle import reference
from problems import ContactQP
from solvers import make_solver

Form = Literal["multipliers", "velocities"]
ROUNDING = 1e-12
CASES = 12


@check
def feasible(form: Form, label: str = "fig2") -> float:
    """Share of the QPs of steps for which the last answer is feasible as it is.

    multipliers : λ_{n−1} of the rows that are still there, 0 of new ones, meet the bounds
    velocities : q̇_{n−1} meets G_Nᵀ q̇ ≥ 0 with the columns at q_n
    """
    run = run_of(label, 4.0)
    known = {
        float(t): (v.ravel(), lam) for t, v, lam in zip(run.t, run.v, run.multipliers, strict=True)
    }
    met = []
    for qp in qps_of(run, "step"):
        before = qp.t - qp.h
        t = min(known, key=lambda time: abs(time - before))
        if abs(t - before) > ROUNDING * max(1.0, before):
            continue
        v, lam = known[t]
        if form == "velocities":
            speed = np.asarray(qp.A.T @ (qp.D * v)).ravel()
            met.append(bool((speed >= -ROUNDING * np.abs(qp.D * v).max()).all()))
        else:
            x = np.array([lam.get(int(row), 0.0) for row in qp.row_id])
            slack = ROUNDING * np.abs(x).max(initial=1.0)
            met.append(bool(((x >= qp.lower - slack) & (x <= qp.upper + slack)).all()))
    return float(np.mean(met))


@check
def one_code(form: Form) -> float:
    """Largest error of A x over the scale, on QPs without friction (fig2) and with (fig4, fig5).

    multipliers : algorithm 2, for which a friction row is one with two bounds
    velocities : (3.4) as printed, which has Gᵀ q̇ ≥ 0 and no place for a bound on a force
    """
    worst = 0.0
    for label in ("fig2", "fig4", "fig5"):
        qps = qps_of(run_of(label, 1.5), "step")
        for qp in evenly(qps, CASES):
            facts = facts_of(qp)
            known = reference(qp)
            assert known is not None
            solver = make_solver("lotstedt", accuracy=1e-10 * facts.scale)
            if form == "velocities":
                normal = np.isinf(qp.upper)
                A = qp.dense_A[:, normal]
                qp = ContactQP(A, qp.d, qp.lower[normal], qp.upper[normal])
                solver = make_solver("velocity")
            error = np.linalg.norm(qp.A @ np.asarray(solver.solve(qp).x) - known.Ax)
            worst = max(worst, float(error / facts.scale))
    return worst
