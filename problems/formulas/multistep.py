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

The functions of numbers alone are compiled into `problems.stepping.steps` and
`problems.formulas.step_kernels`, so they call nothing that is not.
"""

from __future__ import annotations

from math import inf, sqrt

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
    """Steps since the last restart: h of the newest, q̇ of the newest two, q̈ newest first.

    The two steps after a restart are of order 1 (§3.1).
    """

    def __init__(self, v: Vector):
        self.restart(v)

    def restart(self, v: Vector) -> None:
        """Forget everything but the velocity (3n,), after a jump in q̇ or q̈."""
        self.v, self.v_before = v, v
        self.a: list[Vector] = []
        self.h = 0.0
        self.steps = 0

    def resume(self, v: Vector, v_before: Vector, a: list[Vector], h: float, steps: int) -> None:
        """Go on from steps that have been taken."""
        self.v, self.v_before, self.a, self.h, self.steps = v, v_before, a, h, steps


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
