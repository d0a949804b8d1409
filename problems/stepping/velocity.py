"""Step 2 of algorithm 1, q̇_n and λ_n at a given q_n, once it has been taken.

It is taken by the passes of `problems.friction.passes`, begun by `problems.stepping.steps`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.contacts.assembly import Assembly
from problems.qp import Vector


class VelocityStep(NamedTuple):
    """What a step of length h to t found: q, q̇, q̈ (3n,), λ_N (N,), λ_F (F,), its `Assembly`.

    gap_speed (N,), slip_speed (F,) : G_Nᵀq̇, without what closes gaps (`drift`), and G_Fᵀq̇
    at_bound : (F,) whether a friction force is proportional to λ_*
    settled : whether the passes came to an end by (3.14); else this is the last one
    """

    t: float
    h: float
    q: Vector
    v: Vector
    a: Vector
    lam_N: Vector
    lam_F: Vector
    gap_speed: Vector
    slip_speed: Vector
    at_bound: NDArray[np.bool_]
    assembly: Assembly
    passes: int
    settled: bool = True
