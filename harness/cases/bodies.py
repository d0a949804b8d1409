"""Cases of bodies: numbers of a run beside what mechanics says they are."""

from __future__ import annotations

from collections.abc import Callable
from math import asin, atan, cos, exp, hypot, log2, sin, sqrt, tan
from typing import Any

import numpy as np

from problems import Run, scene, simulate
from problems.sequence import SolvesQPs

g = 9.81
MOVED = 1e-3
"""What moves faster than this at the end does not stand [m/s]."""
BISECTIONS = 8
Found = dict[str, Any]
"""quantity, value, expected and, where it was observed, order."""


def run_of(solver: SolvesQPs, name: str, how: dict[str, Any], **parameters: Any) -> Any:
    """A run, of bodies or of a network, without its QPs."""
    return simulate(scene(name, **parameters), solver, keep_qps=False, **how)


def found(quantity: str, value: float, expected: float, order: float = np.nan) -> Found:
    return {
        "quantity": quantity,
        "value": float(value),
        "expected": float(expected),
        "order": order,
    }


def observed_order(errors: list[float]) -> float:
    """From the errors at steps that were halved each time."""
    return log2(errors[0] / errors[-1]) / (len(errors) - 1)


def threshold(stands: Callable[[float], bool], falls_at: float, stands_at: float) -> float:
    """Where a scene begins to stand, by bisection; NaN where the ends do not enclose it."""
    if stands(falls_at) or not stands(stands_at):
        return np.nan
    for _ in range(BISECTIONS):
        middle = 0.5 * (falls_at + stands_at)
        if stands(middle):
            stands_at = middle
        else:
            falls_at = middle
    return 0.5 * (falls_at + stands_at)


def still(run: Run) -> bool:
    return float(np.abs(run.v[-1]).max()) < MOVED


def ramp(solver: SolvesQPs) -> list[Found]:
    """μ–θ grid: the threshold at each slope, and how far the block slides below it."""
    rows = []
    for angle in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6):

        def stands(mu: float, angle: float = angle) -> bool:
            return still(run_of(solver, "ramp", {"until": 0.3}, angle=angle, mu=mu))

        at = threshold(stands, 0.8 * tan(angle), 1.2 * tan(angle))
        rows.append(found(f"θ at which μ = tan {angle:g} holds", atan(at), angle))
        mu = 0.5 * tan(angle)
        run = run_of(solver, "ramp", {}, angle=angle, mu=mu)
        way = hypot(*(run.q[-1, 0, :2] - run.q[0, 0, :2]))
        rows.append(
            found(
                f"way in 1 s at θ = {angle:g}, μ = tan θ/2 [m]",
                way,
                0.5 * g * (sin(angle) - mu * cos(angle)),
            )
        )
    return rows


def braking(solver: SolvesQPs) -> list[Found]:
    """Stopping distances, and a cube that must not lift."""
    rows = []
    for speed, mu in ((2.0, 0.3), (6.0, 0.5), (6.0, 0.9)):
        run = run_of(solver, "braking", {}, speed=speed, mu=mu)
        what = f"at {speed:g} m/s, μ = {mu:g}"
        rows.append(found(f"way to rest {what} [m]", run.q[-1, 0, 0], speed**2 / (2 * mu * g)))
        rows.append(found(f"greatest lift {what} [m]", np.abs(run.q[:, 0, 1] - 0.5).max(), 0.0))
    return rows


def mass_ratio(solver: SolvesQPs) -> list[Found]:
    """A heavy box rests on a light one."""
    return [
        found(
            f"greatest speed in 1 s, ratio {ratio:,} [m/s]",
            np.abs(run_of(solver, "mass_ratio", {}, ratio=ratio).v).max(),
            0.0,
        )
        for ratio in (1, 10, 100, 1_000, 10_000)
    ]


def arch(solver: SolvesQPs) -> list[Found]:
    """Least thickness of a half circle."""
    rows = []
    for stones in (19, 39):

        def stands(thickness: float, stones: int = stones) -> bool:
            return still(run_of(solver, "arch", {}, stones=stones, thickness=thickness))

        at = threshold(stands, 0.09, 0.13)
        rows.append(found(f"least t/R of {stones} stones", at, 0.1075))
    return rows


def cards(solver: SolvesQPs) -> list[Found]:
    """Least friction of two cards."""
    rows = []
    for lean in (0.2, 0.4, 0.6):

        def stands(mu: float, lean: float = lean) -> bool:
            return still(run_of(solver, "cards", {}, lean=lean, mu=mu))

        at = threshold(stands, 0.25 * tan(lean), 0.75 * tan(lean))
        lever = 0.5 * sin(lean) - 0.75 * 0.01 / cos(lean)
        rows.append(found(f"least μ at a lean of {lean:g}", at, lever / cos(lean)))
    return rows


def dominoes(solver: SolvesQPs) -> list[Found]:
    """Angle and spin at which the first domino strikes the second."""
    angle = asin(0.5)
    drop = 0.5 * (1 - cos(angle)) - 0.1 * sin(angle)
    spin = sqrt(1.5**2 + 2 * g * drop / ((0.2**2 + 1.0) / 3))
    runs = [run_of(solver, "dominoes", {"until": 0.5, "fixed_step": h}) for h in (4e-3, 2e-3, 1e-3)]
    struck = [_at_first_impulse(run) for run in runs]
    errors = [[abs(-s[0] - angle) for s in struck], [abs(-s[1] - spin) for s in struck]]
    return [
        found("angle at the impact [rad]", -struck[-1][0], angle, observed_order(errors[0])),
        found("spin before it [rad/s]", -struck[-1][1], spin, observed_order(errors[1])),
    ]


def _at_first_impulse(run: Run) -> tuple[float, float]:
    """φ and ω of the first body before the first impact after t = 0."""
    t = next(event.t for event in run.event_log if event.kind == "impulse" and event.t > 0)
    k = int(np.searchsorted(run.t, t))
    return float(run.q[k, 0, 2]), float(run.v[k, 0, 2])


def sunk(solver: SolvesQPs) -> list[Found]:
    """What is left of an overlap of 0.5 mm, and how fast the box is lifted."""
    rows = []
    for rule, left in (("none", 5e-4), ("baumgarte", 5e-4 * exp(-5.0)), ("projection", 0.0)):
        run = run_of(solver, "sunk", {"drift": rule})
        rows.append(found(f"overlap after 0.5 s, {rule} [m]", 0.5 - run.q[-1, 0, 1], left))
    fastest = np.abs(run_of(solver, "sunk", {"drift": "baumgarte"}).v).max()
    return [*rows, found("fastest, baumgarte: depth/τ [m/s]", fastest, 5e-4 / 0.1)]
