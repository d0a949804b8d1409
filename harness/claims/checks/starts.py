"""A feasible start for the two forms of the step: multipliers (3.2), or velocities (3.4)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import qps_of, run_of

ROUNDING = 1e-12


@check
def feasible(form: Literal["multipliers", "velocities"], label: str = "fig2") -> float:
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
