"""A bead that slides on a curve: algorithm 1 with one contact in plain NumPy, and its exact motion.

    m q̈ = f(t) + n λ_N + t λ_F,   φ = (y − s(x))/√(1 + s'²),   s(x) = −½ κ x²

with the unit normal n and tangent t at x.  While the bead slides to the right, q̇ = w t, so that

    λ_N = −f·n + m n'·…:   λ_N = m w² k(x) − f·n,   m ẇ = f·t − μ λ_N,   ẋ = w/√(1 + s'²)

with the curvature k = s''/(1 + s'²)^{3/2}, which is negative on a hill.  (4.1) to (4.5) are stepped
with constant h, order r = 1, 2, 3, from exact values; for the sliding friction −μ λ_* the rule of
λ_* is a parameter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from problems.qp import Vector

AB = {1: (1.0,), 2: (1.5, -0.5), 3: (23 / 12, -16 / 12, 5 / 12)}
"""β_i of AB-r, newest first."""
BDF = {1: (1.0, -1.0), 2: (1.5, -2.0, 0.5), 3: (11 / 6, -3.0, 1.5, -1 / 3)}
"""α_0, α_1, … of BDF-r."""
RULES: dict[str, Callable[[float, float], float]] = {
    "(4.2)": lambda last, before: 2 * last - before,
    "(4.3)": lambda last, before: last,
    "(4.2), wrong sign": lambda last, before: before,
}
"""λ_* from λ_{n−1} and λ_{n−2}, w = 1."""

Force = Callable[[float], Vector]


class Bead(NamedTuple):
    """m = 1 [kg] on y = −½ κ x²; μ; f(t) (2,) [N]; x and speed at t = 0 [m, m/s]."""

    kappa: float
    mu: float
    force: Force
    x: float = 0.0
    speed: float = 1.0

    def frame(self, x: float) -> tuple[Vector, Vector, float]:
        """Normal, tangent and curvature at x."""
        slope = -self.kappa * x
        size = np.hypot(1.0, slope)
        normal, tangent = np.array([-slope, 1.0]) / size, np.array([1.0, slope]) / size
        return normal, tangent, float(-self.kappa / size**3)

    def gap(self, q: Vector) -> float:
        """φ [m]."""
        return float((q[1] + 0.5 * self.kappa * q[0] ** 2) / np.hypot(1.0, self.kappa * q[0]))

    def load(self, t: float, x: float, w: float) -> float:
        """λ_N of the sliding bead [N]; negative where it cannot be kept on the curve."""
        normal, _, bend = self.frame(x)
        return float(w * w * bend - self.force(t) @ normal)


class Motion(NamedTuple):
    """q, q̇ (n, 2) and λ_N (n,) at times t (n,)."""

    t: Vector
    q: Vector
    v: Vector
    lam: Vector


def exact(bead: Bead, times: Vector, leaves: bool = False) -> Motion:
    """The motion at these times, to rounding; it flies from where λ_N = 0, if it `leaves`."""

    def rate(t: float, z: Vector) -> Vector:
        _, tangent, _ = bead.frame(z[0])
        return np.array([z[1] * tangent[0], bead.force(t) @ tangent - bead.mu * bead.load(t, *z)])

    def lifts(t: float, z: Vector) -> float:
        return bead.load(t, *z)

    lifts.terminal, lifts.direction = leaves, -1  # type: ignore[attr-defined]
    first, last = min(0.0, times[0]), times[-1]
    tight = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-15, "dense_output": True}
    start = [bead.x, bead.speed]
    ahead = solve_ivp(rate, (0.0, last), start, events=lifts, **tight)
    behind = solve_ivp(rate, (0.0, first), start, **tight) if first < 0 else ahead
    off = float(ahead.t[-1]) if leaves else np.inf
    q, v, lam = np.zeros((len(times), 2)), np.zeros((len(times), 2)), np.zeros(len(times))
    for i, t in enumerate(times):
        z = (behind if t < 0 else ahead).sol(min(t, off))
        q[i], v[i] = (z[0], -0.5 * bead.kappa * z[0] ** 2), z[1] * bead.frame(z[0])[1]
        if t <= off:
            lam[i] = bead.load(t, *z)
        else:  # the force is linear in t
            f, late = bead.force(off), t - off
            grows = bead.force(off + 1.0) - f
            q[i] = q[i] + late * (v[i] + late * (f / 2 + late * grows / 6))
            v[i] = v[i] + late * (f + late * grows / 2)
    return Motion(times, q, v, lam)


def leaves_at(bead: Bead, until: float) -> float:
    """When λ_N = 0 is reached [s].  Raises ValueError where it is not."""

    def load(t: float) -> float:
        return float(exact(bead, np.array([0.0, t])).lam[-1])

    return float(brentq(load, 1e-3, until, xtol=1e-13))


def step(
    bead: Bead, past: Motion, h: float, order: int, rule: str = ""
) -> tuple[Vector, Vector, float, float]:
    """q_n, q̇_n, λ_N and λ_* from the last `order` values (two of λ); rule "" for λ_* = λ_N."""
    q = past.q[-1] + h * sum(b * past.v[-1 - i] for i, b in enumerate(AB[order]))
    t, alpha = past.t[-1] + h, BDF[order]
    normal, tangent, _ = bead.frame(q[0])
    c = h * bead.force(t) - sum(a * past.v[-i] for i, a in enumerate(alpha) if i)
    star = max(0.0, RULES[rule](past.lam[-1], past.lam[-2])) if rule else np.nan
    if rule:
        c = c - h * bead.mu * star * tangent
        pushed = normal
    else:
        pushed = normal - bead.mu * tangent
    lam = max(0.0, -float(normal @ c) / (h * float(normal @ pushed)))
    return q, (c + h * lam * pushed) / alpha[0], lam, star


def march(bead: Bead, h: float, steps: int, order: int, rule: str = "") -> Motion:
    """Steps from exact values at t = 0, −h, …"""
    past = exact(bead, h * np.arange(-3.0, 1.0))
    t, q, v, lam = (list(part) for part in past)
    for _ in range(steps):
        last = Motion(*(np.array(part[-4:]) for part in (t, q, v, lam)))
        found = step(bead, last, h, order, rule)
        for part, value in zip((t, q, v, lam), (t[-1] + h, *found), strict=False):
            part.append(value)
    return Motion(*(np.array(part[3:]) for part in (t, q, v, lam)))


def slope(h: Any, error: Any) -> float:
    """p in error = C hᵖ, by least squares on logarithms."""
    return float(np.polyfit(np.log(h), np.log(error), 1)[0])
