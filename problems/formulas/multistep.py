"""The linear multistep methods of §3.1: AB-r for positions, BDF-r for velocities, r = 1, 2.

Both are used with variable steps, w = h_n / h_{n−1}:

    AB-1    q_n = q_{n−1} + h q̇_{n−1}
    AB-2    q_n = q_{n−1} + h [(1 + w/2) q̇_{n−1} − (w/2) q̇_{n−2}]
    BDF-1   q̇_n − q̇_{n−1} = h q̈_n
    BDF-2   (1+2w)/(1+w) q̇_n − (1+w) q̇_{n−1} + w²/(1+w) q̇_{n−2} = h q̈_n

AB-2 is a polynomial of degree 2 in h, so events of position are located without solving a QP.

This differs from the paper: 1. the formulas and the error constants of (3.5) are those of variable
steps, because the paper prints none; 2. growth is limited to `GROWTH`, below the 1 + √2 at which
BDF-2 loses zero-stability, and h to `h_max`, because in free fall the estimate of AB-2 is 0.

The functions of numbers alone are also compiled, into `problems.stepping.quiet_steps`; so they
call nothing that is not.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt

import numpy as np

from problems.bodies.path import Path
from problems.qp import Vector

GROWTH = 2.0
"""Largest h_n / h_{n−1}; after a step that was cut short, over the length that it was to have."""
TOO_MUCH = 4.0
"""A step is redone when its error turns out to be more than this many ε, …"""
REDONE = 3
"""… so many times: the error does not vanish with h where q̈ jumps."""
SHORTEST_STEP = 1e-9
"""Steps shorter than this are not taken: an event there happens at t_{n−1} [s]."""
STOP_TRIALS = 8
"""Trials of a step by interpolation for where contacts stop; then it is halved: q̇ may jump."""
SAFETY = 0.9
"""Fraction of the step that (3.5) would allow."""
FIRST_RATE = 0.5
"""ρ of (3.14) that is assumed until two passes have shown it."""


class History:
    """Steps since the last restart: (h, q̇, q̈) of the newest two, newest first.

    `order` is that of the next step: 1 for the two steps after a restart, then `highest` (§3.1).
    """

    def __init__(self, v: Vector, highest: int = 2):
        self.highest = highest
        self.restart(v)

    def restart(self, v: Vector) -> None:
        """Forget everything but the velocity (3n,), after a jump in q̇ or q̈."""
        self.v, self.v_before = v, v
        self.a: list[Vector] = []
        self.h = 0.0
        self.steps = 0

    def push(self, h: float, v: Vector, a: Vector) -> None:
        """Record an accepted step of length h with the new q̇ and q̈."""
        self.v_before, self.v = self.v, v
        self.a = [a, *self.a[:1]]
        self.h = h
        self.steps += 1

    def resume(self, v: Vector, v_before: Vector, a: list[Vector], h: float, steps: int) -> None:
        """Go on from steps that were taken elsewhere."""
        self.v, self.v_before, self.a, self.h, self.steps = v, v_before, a, h, steps

    @property
    def order(self) -> int:
        return 1 if self.steps < 2 else self.highest

    def path(self, q: Vector) -> Path:
        """AB-r from q (3.1a)."""
        if self.order == 1:
            return Path(q, self.v, np.zeros_like(q))
        return Path(q, self.v, (self.v - self.v_before) / (2 * self.h))

    def bdf(self, h: float) -> tuple[float, Vector]:
        """α₀ and b_n = −Σ_{i≥1} α_i q̇_{n−i} of BDF-r with step h (3.1b)."""
        if self.order == 1:
            return 1.0, self.v
        alpha0, newest, before = second_order_bdf(h / self.h)
        return alpha0, newest * self.v - before * self.v_before

    def predict(self, h: float) -> Vector:
        """q̇_n⁽⁰⁾ for (3.9): q̇_{n−1}, AB-1 or AB-2 on q̈, by what is available."""
        if not self.a:
            return self.v
        if len(self.a) == 1:
            return self.v + h * self.a[0]
        w = h / self.h
        return self.v + h * ((1 + w / 2) * self.a[0] - w / 2 * self.a[1])

    def largest_step(self, eps: float, norm: Callable[[Vector], float]) -> float:
        """Largest h whose local error in q_n meets (3.5), ‖ℓ_n‖_M ≤ h ε; inf where it is 0.

        AB-1: ℓ = ½h² q̈.  AB-2: ℓ = h² (h/6 + h_{n−1}/4) q⃛, q⃛ ≈ (q̈_{n−1} − q̈_{n−2})/h_{n−1}.
        Needs at least one step since the restart.
        """
        if self.order == 1:
            return first_order_step(norm(self.a[0]), eps)
        return second_order_step(norm(self.a[0] - self.a[1]) / self.h, self.h, eps)

    def error(self, h: float, a: Vector, norm: Callable[[Vector], float]) -> float:
        """‖ℓ_n‖_M / h of (3.5) after a step of length h that found q̈_n = a; 0 for AB-1."""
        return second_order_error(norm(a - self.a[0]), h, self.h) if self.order == 2 else 0.0


def second_order_bdf(w: float) -> tuple[float, float, float]:
    """α₀, −α₁ and α₂ of BDF-2 (3.1b), w = h_n/h_{n−1}."""
    return (1 + 2 * w) / (1 + w), 1 + w, w * w / (1 + w)


def first_order_step(acceleration: float, eps: float) -> float:
    """Largest h of AB-1 with ½h²‖q̈‖_M ≤ h ε (3.5)."""
    return 2 * eps / acceleration if acceleration > 0 else inf


def second_order_step(jerk: float, h_before: float, eps: float) -> float:
    """Largest h of AB-2 with h² (h/6 + h_{n−1}/4) ‖q⃛‖_M ≤ h ε (3.5)."""
    if jerk == 0:
        return inf
    half = 0.75 * h_before
    return sqrt(half * half + 6 * eps / jerk) - half


def second_order_error(change: float, h: float, h_before: float) -> float:
    """‖ℓ_n‖_M / h of (3.5) for AB-2, from `change` = ‖q̈_n − q̈_{n−1}‖_M after the step.

    With q⃛ ≈ (q̈_n − q̈_{n−1})/h, which knows of a force that has set in on the way.
    """
    return (h / 6 + h_before / 4) * change


def next_length(h_last: float, steps: int, allowed: float, h_max: float) -> float:
    """Step 1: h where (3.5) allows `allowed`, `steps` after a restart; the old one right after."""
    h = min(h_last if steps == 0 else GROWTH * h_last, h_max)
    if steps > 0:
        h = min(h, SAFETY * allowed)
    return max(h, 10 * SHORTEST_STEP)


def first_redone_length(h: float, allowed: float) -> float:
    """A shorter h where a first step is longer than (3.5) turns out to allow; else ∞."""
    return SAFETY * allowed if h > allowed else inf


def redone_length(h: float, error: float, eps: float) -> float:
    """A shorter h where the error of (3.5) turns out `TOO_MUCH` times too large; else ∞."""
    return max(h / 5, SAFETY * h * sqrt(eps / error)) if error > TOO_MUCH * eps else inf


def asked_accuracy(eps: float, iterates: bool) -> float:
    """ε₀ of (3.13): a tenth of ε, and of that a tenth where passes are repeated."""
    return (0.01 if iterates else 0.1) * eps


def iteration_error(rate: float, behind: float, ahead: float, rounding: float) -> float:
    """Bound of what all further passes would change (3.14).

    behind : ‖·‖_M that this pass has changed, of which the next changes ρ times as much
    ahead : ‖·‖_M that the next is known to change;  rate : ρ < 1
    rounding : of one pass, (h/α₀) ε₀
    """
    return (rate * behind + ahead + rounding) / (1 - rate)
