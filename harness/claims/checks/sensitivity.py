"""How far a motion is from one that begins a little apart (§4: "reasonably insensitive")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from harness.claims.checking import check
from problems import scene, simulate
from problems.friction.rules import FrictionRule
from solvers import make_solver


@check
def amplified(label: str, friction: FrictionRule, size: float, until: float) -> float:
    """Largest |δq| at the end over `size`, by which x of the first body is moved at the start [1].

    The ends of both runs are at the same time, by constant steps.
    """
    made, solver = scene(label), make_solver("glambda")
    moved = made.q0.copy()
    moved[0, 0] += size
    ends = [
        simulate(one, solver, friction=friction, until=until, keep_qps=False, rest_speed=1e-300)
        for one in (made, replace(made, q0=moved))
    ]
    return float(np.abs(ends[0].q[-1] - ends[1].q[-1]).max() / size)
