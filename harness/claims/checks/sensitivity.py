"""How far a motion is from one that begins a little apart (§4: "reasonably insensitive")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from problems import Scene, scene, simulate
from problems.friction.rules import FrictionRule
from problems.stepping.run import Run
from solvers import make_solver

SEEDS = 8


def _run(made: Scene, friction: FrictionRule, until: float) -> Run:
    """A motion that does not end at rest."""
    return simulate(made, make_solver("glambda"), friction=friction, until=until,
                    keep_qps=False, rest_speed=1e-300)  # fmt: skip


@check
def amplified(label: str, friction: FrictionRule, size: float, until: float) -> float:
    """Largest |δq| at the end over `size`, by which x of the first body is moved at the start [1].

    The ends of both runs are at the same time, by constant steps.
    """
    made = scene(label)
    moved = made.q0.copy()
    moved[0, 0] += size
    ends = [_run(one, friction, until) for one in (made, replace(made, q0=moved))]
    return float(np.abs(ends[0].q[-1] - ends[1].q[-1]).max() / size)


def _moved(label: str, friction: FrictionRule, until: float, size: float, seed: int) -> Run:
    """The scene to `until`; each body begins by up to `size` further along x, drawn [m]."""
    made = scene(label)
    shift = np.random.default_rng(seed).uniform(-1.0, 1.0, len(made.q0))
    q0 = made.q0.copy()
    q0[:, 0] += size * shift / np.abs(shift).max()
    return _run(replace(made, q0=q0), friction, until)


@check
def exponent(
    label: str, friction: FrictionRule, until: float, least: float, most: float, seed: int = 1
) -> float:
    """p in |δq(until)| = C sizeᵖ, sizes from `least` to `most` [m], all bodies moved."""
    end = _moved(label, friction, until, 0.0, seed).q[-1]
    sizes = np.logspace(np.log10(least), np.log10(most), 6)
    far = [
        np.abs(_moved(label, friction, until, float(size), seed).q[-1] - end).max()
        for size in sizes
    ]
    return slope(sizes, far)


@check
def farthest(label: str, friction: FrictionRule, until: float) -> float:
    """Largest |δq(until)| [m] of motions whose bodies begin apart by 1e-12 … 1e-4 m."""
    end = _moved(label, friction, until, 0.0, 0).q[-1]
    return float(
        max(
            np.abs(_moved(label, friction, until, 10.0**-power, power).q[-1] - end).max()
            for power in range(12, 3, -1)
        )
    )


@check
def flips(label: str, friction: FrictionRule, until: float, size: float) -> float:
    """Of `SEEDS` motions whose bodies begin apart by `size` [m], those with other events."""
    kinds = [
        [event.kind for event in _moved(label, friction, until, by, seed).event_log]
        for seed, by in ((0, 0.0), *((seed, size) for seed in range(SEEDS)))
    ]
    return float(sum(other != kinds[0] for other in kinds[1:]))
