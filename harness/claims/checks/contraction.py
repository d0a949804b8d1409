"""Proposition 2: functional iteration (3.9) contracts by h c₁/α₀, also with friction (4.6)."""

from __future__ import annotations

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import evenly, qps_of, run_of
from problems import ContactQP, scene, simulate
from problems.qp import Vector
from solvers import make_solver

CASES, PAIRS = 15, 6
DRAG = 20.0
"""f = −DRAG M q̇ at small speeds, growing less than linearly; c₁ = DRAG [1/s]."""


def _next(qp: ContactQP, v: Vector) -> Vector:
    """q̇ of one pass of (3.9) from q̇ = v, with the drag added to the forces of the QP."""
    d = qp.d - DRAG * qp.D * np.tanh(v)
    posed = ContactQP(qp.A, d, qp.lower, qp.upper)
    x = np.asarray(make_solver("glambda", accuracy=1e-13).solve(posed).x)
    return np.asarray(qp.h / qp.alpha0 * (qp.A @ x + d) / qp.D)


@check
def worst(label: str, power: float = 1.0) -> float:
    """Largest ‖y₁ − y₀‖_M/‖x₁ − x₀‖_M over h c₁/α₀^power, from pairs near q̇_n of recorded steps."""
    qps = [qp for qp in qps_of(run_of(label, 1.5), "step") if qp.alpha0 > 1.4]
    rng, most = np.random.default_rng(0), 0.0
    for qp in evenly(qps, CASES):
        bound = qp.h * DRAG / qp.alpha0**power
        for _ in range(PAIRS):
            one, other = 0.1 * rng.standard_normal((2, qp.m))
            apart = np.linalg.norm(qp.D * (_next(qp, one) - _next(qp, other)))
            most = max(most, float(apart / np.linalg.norm(qp.D * (one - other)) / bound))
    return most


@check
def bounded(label: str, claimed_rate: float = 1.0) -> float:
    """Largest error of q̇⁽ʲ⁾ over the bound (3.14), j = 1 … 4, with ρ = claimed_rate · h c₁/α₀."""
    qps = [qp for qp in qps_of(run_of(label, 1.5), "step") if 0.01 < qp.h * DRAG / qp.alpha0 < 0.6]
    most = 0.0
    for qp in evenly(qps, CASES):
        passes = [np.zeros(qp.m)]
        for _ in range(60):
            passes.append(_next(qp, passes[-1]))
        rho = claimed_rate * qp.h * DRAG / qp.alpha0
        for j in range(1, 5):
            change = float(np.linalg.norm(qp.D * (passes[j] - passes[j - 1])))
            error = float(np.linalg.norm(qp.D * (passes[-1] - passes[j])))
            if change > 1e-9:
                most = max(most, error * (1 - rho) / (rho * change))
    return most


@check
def predicted(steps: int) -> float:
    """k in ‖q̇⁽¹⁾ − q̇⁽⁰⁾‖ = O(hᵏ) along the damper of fig3, so many steps of h from its start.

    It is read off d, which changes from the first pass to the second by D⁻¹ ∂f/∂q̇ (q̇⁽¹⁾ − q̇⁽⁰⁾).
    """
    lengths, changes = 0.02 / 2.0 ** np.arange(4), []
    for h in lengths:
        run = simulate(scene("fig3"), make_solver("glambda"), eps=1e-10, fixed_step=float(h),
                       until=float(steps * h if steps else 0.4), h_first=float(h))  # fmt: skip
        first = max(i for i, qp in enumerate(run.qps) if qp.kind == "step")
        changes.append(np.linalg.norm(run.qps[first + 1].d - run.qps[first].d))
    return slope(lengths, changes)
