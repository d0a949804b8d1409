"""Cases in space: numbers of a run beside what mechanics says they are."""

from __future__ import annotations

from math import asin, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ellipk, ellipkinc

from harness.cases.bodies import Found, found, g, observed_order, run_of
from problems.qp import Vector
from problems.sequence import SolvesQPs
from problems.space.attitude import rotations
from problems.space.run import SpaceRun
from problems.space.scenes.top import precession

STEPS = (0.01, 0.005, 0.0025)


def flips(run: SpaceRun) -> Vector:
    """Times at which a free top turns over [s]: no spin is left about its middle axis.

    From a cubic through the four states around each change of sign.
    """
    R = rotations(run.poses[:, 0, 3:])
    spin = np.einsum("ni,ni->n", run.velocities[:, 0, 3:], R[:, :, 1])
    times = []
    for k in np.flatnonzero(np.sign(spin[1:-2]) != np.sign(spin[2:-1])) + 1:
        near = slice(k - 1, k + 3)
        roots = np.roots(np.polyfit(run.t[near] - run.t[k], spin[near], 3))
        real = roots[np.abs(roots.imag) < 1e-9].real
        times.append(
            run.t[k] + float(real[np.argmin(np.abs(real - (run.t[k + 1] - run.t[k]) / 2))])
        )
    return np.array(times)


class Flips(NamedTuple):
    """Of a free top that starts as `free_top` does [s]."""

    first: float
    interval: float


def euler_flips(
    spin: float, nudge: float, inertia: tuple[float, float, float] = (1.0, 2.0, 2.5)
) -> Flips:
    """By Euler's solution ω₂ = A sn(p t + u₀ | m), which falls to 0 at p t + u₀ = 2 K(m)."""
    J, omega = np.array(inertia), np.array([nudge, spin, nudge])
    L2, T2 = float((J * omega) @ (J * omega)), float(omega @ (J * omega))
    one, two, three = J if T2 * J[1] < L2 else J[::-1]
    fast, slow = (three - two) * (L2 - T2 * one), (two - one) * (T2 * three - L2)
    m, p = slow / fast, sqrt(fast / (one * two * three))
    peak = sqrt((T2 * three - L2) / (two * (three - two)))
    begin = ellipkinc(asin(spin / peak), m)
    return Flips((2 * ellipk(m) - begin) / p, 2 * ellipk(m) / p)


def precession_rate(run: SpaceRun) -> float:
    """Mean rate at which the centre of gravity goes round the vertical [rad/s]."""
    angle = np.unwrap(np.arctan2(run.poses[:, 0, 1], run.poses[:, 0, 0]))
    return float((angle[-1] - angle[0]) / run.t[-1])


def _runs(solver: SolvesQPs, name: str, **parameters: Any) -> list[SpaceRun]:
    return [run_of(solver, name, {"fixed_step": h}, **parameters) for h in STEPS]


def _ordered(quantity: str, values: list[float], exact: float) -> Found:
    """The last value, and the order of the errors."""
    order = observed_order([abs(value - exact) for value in values])
    return found(quantity, values[-1], exact, order)


def free_top(solver: SolvesQPs) -> list[Found]:
    """Energy, momentum, the first flip and the time between two."""
    exact, runs = euler_flips(6.0, 2.0), _runs(solver, "free_top", nudge=2.0, end_time=1.7)
    drift = [float(np.abs(run.energy / run.energy[0] - 1).max()) for run in runs]
    start = runs[-1].momenta[0, 0, 3:]
    turned = np.abs(runs[-1].momenta[:, 0, 3:] - start).max() / np.linalg.norm(start)
    firsts = [float(flips(run)[0]) for run in runs]
    longer = run_of(solver, "free_top", {"fixed_step": STEPS[-1]}, nudge=2.0, end_time=3.7)
    return [
        _ordered("greatest change of energy, relative", drift, 0.0),
        found("greatest change of angular momentum, relative", turned, 0.0),
        _ordered("first flip: (2K(m) − u₀)/p [s]", firsts, exact.first),
        found("time between flips: 2K(m)/p [s]", float(np.diff(flips(longer))[0]), exact.interval),
    ]


def heavy_top(solver: SolvesQPs) -> list[Found]:
    """The rate of steady precession."""
    rates = [precession_rate(run) for run in _runs(solver, "heavy_top", end_time=0.6)]
    exact = precession(40.0, 0.5, 1.0, 0.3, 0.1, 0.2, g)
    return [_ordered("rate of precession [rad/s]", rates, exact)]
