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

CREEP = 0.01
"""Speed below which a body does not go anywhere [m/s]."""


@check
def hexagon_speed(damping: float) -> float:
    """v_x of fig3 at t = 4.60 [m/s]."""
    return float(run_of("fig3", 4.6, damping=damping).v[-1, 0, 0])


@check
def parted(since: float) -> float:
    """Share of fig2's time points from `since` on at which body 1 goes right, 4 and 5 left."""
    run = run_of("fig2", 6.0)
    v = run.v[run.t >= since, :, 0]
    return float(np.mean((v[:, 0] > 0) & (v[:, 3] < 0) & (v[:, 4] < 0)))


@check
def slowest(bodies: int) -> float:
    """Least, over the time in which fig2's 1 goes right, 4 and 5 left, of the fastest's |v_x|, over
    the 2 m/s that body 2 starts with.

    bodies : 3, all of them; 1, body 1 only
    """
    v = run_of("fig2", 6.0).v[:, :, 0]
    moving = (v[:, 0] > CREEP) & (v[:, 3] < -CREEP) & (v[:, 4] < -CREEP)
    return float(np.abs(v[moving][:, [0, 3, 4][:bodies]]).max(axis=1).min() / 2.0)


@check
def impulses(mu_I: float) -> float:
    """Impulses of fig4 until it rests."""
    return float(run_of("fig4", 12.0, mu_I=mu_I).counts["impulses"])


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


@check
def possible(bodies: int, margin: float) -> float:
    """Constraints between a corner and an edge in a wall, over k² n(n−1) + k n of §5, k = 4.

    margin : of the broad phase [m]
    """
    made = scene("wall", bodies=bodies)
    geometry = Geometry(made.bodies, made.ground)
    _, part = geometry.near_corners(geometry.pose(made.q0.ravel()), margin)
    edges = np.where(part < geometry.n_moving, 4, 1)
    return float(edges.sum() / (16 * bodies * (bodies - 1) + 4 * bodies))
