"""Complementarity of positions, (2.18) with BDF-r for q and q̇, beside that of velocities (2.6b).

The bead of `harness.claims.checks.bead` without friction.  A step by (2.18) is a nonlinear problem
in q_n, q̇_n and λ_n,

    α₀ q_n = h q̇_n − Σ α_i q_{n−i},   α₀ q̇_n = h (f + n(q_n) λ_n) − Σ α_i q̇_{n−i},   φ(q_n) = 0

which is solved by Newton's method; by (2.6b) one linear problem gives λ_n.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import AB, BDF, Bead, Motion, exact, march, slope
from problems.qp import Vector

Form = Literal["position", "velocity"]
BEAD = Bead(kappa=0.5, mu=0.0, force=lambda t: np.array([1.0 + t, -9.81]))
END = 0.5
MOST_ITERATIONS, CONVERGED = 20, 1e-13


def _step(past: Motion, h: float, order: int, gap: float = 0.0) -> tuple[Motion, int]:
    """The motion with one more time point, at which φ = gap, and the linear problems solved."""
    alpha, t = BDF[order], past.t[-1] + h
    q_past, v_past = (
        -sum(a * part[-i] for i, a in enumerate(alpha) if i) for part in (past.q, past.v)
    )
    share = h / alpha[0]

    def moved(q: Vector, lam: float) -> Vector:
        normal, _, _ = BEAD.frame(q[0])
        v = share * (BEAD.force(t) + normal * lam) + v_past / alpha[0]
        return np.append(q - share * v - q_past / alpha[0], BEAD.gap(q) - gap)

    z, iterations = np.append(past.q[-1] + h * past.v[-1], past.lam[-1] * share**2), 0
    while iterations < MOST_ITERATIONS:  # λ h²/α₀² is an unknown of the size of q
        value = moved(z[:2], z[2] / share**2)
        columns = [
            (moved((z + e)[:2], (z + e)[2] / share**2) - moved((z - e)[:2], (z - e)[2] / share**2))
            / 2e-6
            for e in 1e-6 * np.eye(3)
        ]
        change = np.linalg.solve(np.array(columns).T, value)
        z, iterations = z - change, iterations + 1
        if np.abs(change).max() < CONVERGED:
            break
    q, lam = z[:2], z[2] / share**2
    v = (q - q_past / alpha[0]) / share
    parts = (
        np.append(part, [value], axis=0) for part, value in zip(past, (t, q, v, lam), strict=True)
    )
    return Motion(*parts), iterations


def _moved(form: Form, h: float, order: int = 2) -> tuple[Motion, float]:
    """The motion from exact values to `END`, and linear problems per step."""
    steps = round(END / h)
    if form == "velocity":
        return march(BEAD, h, steps, order), 1.0
    motion, solves = exact(BEAD, h * np.arange(-3.0, 1.0)), 0
    for _ in range(steps):
        motion, more = _step(motion, h, order)
        solves += more
    return motion, solves / steps


@check
def drift(form: Form) -> float:
    """The largest |φ(q_n)| with h = 1/100 [m]."""
    return max(abs(BEAD.gap(q)) for q in _moved(form, 0.01)[0].q)


@check
def linear_problems(form: Form) -> float:
    """Linear problems per step, h = 1/100."""
    return _moved(form, 0.01)[1]


@check
def order_of_velocity(form: Form, order: int = 2) -> float:
    """p in the error O(hᵖ) of q̇ at the end."""
    steps = [1 / 40, 1 / 80, 1 / 160, 1 / 320]
    ends = exact(BEAD, np.array([0.0, END])).v[-1]
    return slope(steps, [np.linalg.norm(_moved(form, h, order)[0].v[-1] - ends) for h in steps])


@check
def sensitivity(form: Form, size: float = 1e-6) -> float:
    """p in |δλ| = C h^−p where the constraint of one step is off by `size` [m, m/s]."""
    steps, changes = np.array([1 / 40, 1 / 80, 1 / 160, 1 / 320]), []
    for h in steps:
        past = exact(BEAD, h * np.arange(-3.0, 1.0))
        on, off = (
            _step(past, h, 2, by)[0].lam[-1] if form == "position" else _pushed(past, h, by)
            for by in (0.0, size)
        )
        changes.append(abs(off - on))
    return -slope(steps, changes)


def _pushed(past: Motion, h: float, speed: float) -> float:
    """λ_n of (2.6b), q_n by AB-2, with n·q̇_n = `speed` [m/s]."""
    alpha, q = BDF[2], past.q[-1] + h * sum(b * past.v[-1 - i] for i, b in enumerate(AB[2]))
    normal, _, _ = BEAD.frame(q[0])
    c = h * BEAD.force(past.t[-1] + h) - sum(a * past.v[-i] for i, a in enumerate(alpha) if i)
    return float((alpha[0] * speed - normal @ c) / h)
