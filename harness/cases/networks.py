"""Cases of networks: numbers of a run beside their closed solutions."""

from __future__ import annotations

from math import atan2, exp, hypot, pi, sin, tan
from typing import Any

import numpy as np
from scipy.optimize import brentq

from harness.cases.bodies import Found, found, observed_order, run_of
from problems.networks.run import NetworkRun
from problems.sequence import SolvesQPs

OMEGA = 2 * pi * 50.0


def _mean(run: NetworkRun, values: Any) -> float:
    """Over time, of values at the ends of steps."""
    return float(np.diff(run.t) @ values[1:] / run.t[-1])


def half_wave(solver: SolvesQPs) -> list[Found]:
    """The extinction angle β of a resistance and an inductance: sin(β − φ) + sin φ e^(−β/tan φ)."""
    phi = atan2(OMEGA * 0.05, 10.0)
    beta = float(
        brentq(lambda b: sin(b - phi) + sin(phi) * exp(-b / tan(phi)), 1.01 * pi, 1.99 * pi)
    )
    angles = []
    for h in (1e-4, 5e-5, 2.5e-5):
        run = run_of(solver, "half_wave", {"fixed_step": h}, end_time=0.019)
        angles.append(next(OMEGA * e.t for e in run.event_log if e.kind == "blocks"))
    order = observed_order([abs(angle - beta) for angle in angles])
    return [found("extinction angle [rad]", angles[-1], beta, order)]


def bridge(solver: SolvesQPs) -> list[Found]:
    """Current of a bridge with a large inductance, and the exact one after one half wave."""
    level = 200 / pi / 10.003
    run = run_of(solver, "bridge", {}, L=50.0, current=level, end_time=0.04)
    rows = [found("mean current, L = 50 H: 2V/(πR) [A]", _mean(run, run.currents[:, 5]), level)]
    R, L = 10.003, 0.5
    Z, phi = hypot(R, OMEGA * L), atan2(OMEGA * L, R)
    exact = 100 / Z * sin(pi - phi) + (6.0 + 100 / Z * sin(phi)) * exp(-R * 0.01 / L)
    ends = [
        run_of(solver, "bridge", {"fixed_step": h, "until": 0.01}).currents[-1, 5]
        for h in (1e-4, 5e-5, 2.5e-5)
    ]
    order = observed_order([abs(end - exact) for end in ends])
    return [*rows, found("current after a half wave [A]", ends[-1], exact, order)]


def boost(solver: SolvesQPs) -> list[Found]:
    """Output of the converter in continuous conduction, nearly without losses."""
    rows = []
    for duty in (0.3, 0.5, 0.7):
        level = 12 / (1 - duty)
        run = run_of(
            solver, "boost", {"until": 2e-3}, duty=duty, L_R=1e-4, device_R=1e-4,
            C=2e-3, output=level, current=level / 20 / (1 - duty),
        )  # fmt: skip
        rows.append(
            found(f"output, duty {duty:g}: V/(1 − D) [V]", _mean(run, run.potentials[:, 1]), level)
        )
    return rows
