"""What the paper tells of its examples, Painlevé's first step, figure 1, and counts of §5."""

from __future__ import annotations

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.bead import slope
from harness.claims.checks.motions import run_of
from harness.claims.painleve import first_steps
from harness.claims.stability import measured_run
from problems import scene
from problems.contacts.geometry import Geometry
from problems.friction.rules import FrictionRule
from solvers import make_solver


@check
def hexagon_speed(damping: float) -> float:
    """v_x of fig3 at t = 4.60 [m/s]."""
    return float(run_of("fig3", 4.6, damping=damping).v[-1, 0, 0])


@check
def energy_left(until: float) -> float:
    """Kinetic energy of fig3 in its last second, over its largest."""
    run = run_of("fig3", until)
    T = run.kinetic_energy()
    return float(T[run.t > run.t[-1] - 1.0].max() / T.max())


@check
def columns_at_rest(mu: float) -> float:
    """Columns of the last step's QP of fig4."""
    return float(next(qp.k for qp in reversed(run_of("fig4", 12.0, mu=mu).qps) if qp.accepted
                      and qp.kind in ("step", "corrector")))  # fmt: skip


@check
def doubling(order: int, K: float) -> float:
    """Largest size of an undamped run on the test equation in 200 steps over that in 100."""
    size = measured_run(make_solver("glambda"), order, 0.0, K).size
    return float(size.max() / size[:101].max())


@check
def first_step(rule: FrictionRule, of: str) -> float:
    """p in h^p, h → 0, of the "jump" in q̇ in the first step where Coulomb's law has no motion.

    of : "jump", or "force", by which the impulse without a collision would catch the rod
    """
    rows = first_steps(make_solver("glambda"), "none", rule, 1e-3)[2:]
    h = np.array([row["h"] for row in rows])
    found = np.array([row["jump"] if of == "jump" else row["catch"] / row["h"] for row in rows])
    return slope(h, found)


@check
def near_share(bodies: int, margin: float) -> float:
    """Pairs of a corner and a part that the broad phase leaves of a wall, of all k n² [1]."""
    made = scene("wall", bodies=bodies)
    geometry = Geometry(made.bodies, made.ground)
    corner, _ = geometry.near_corners(geometry.pose(made.q0.ravel()), margin)
    return corner.size / (4 * bodies**2)
