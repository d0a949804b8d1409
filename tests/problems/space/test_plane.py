"""A scene of the plane, extruded: the same motion and the same Gλ in space, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from problems import Scene, simulate
from problems.bodies.bodies import Body, box, disc
from problems.space import Solid, SpaceScene, block
from problems.space.attitude import attitude
from solvers import make_solver

BOX = box(1.0, 0.5), block(1.0, 1.0, 0.5)
DISC = disc(0.5), Solid(disc(0.5).mass, (disc(0.5).inertia,) * 3, radius=0.5)


@pytest.mark.parametrize(
    ("pair", "q", "v", "mu", "until"),
    [
        (BOX, (0.0, 0.25, 0.0), (2.0, 0.0, 0.0), 0.3, 0.2),
        (BOX, (0.0, 0.8, 0.3), (0.5, 0.0, 0.4), 0.0, 0.45),
        (DISC, (0.0, 0.5, 0.0), (1.0, 0.0, 0.0), 0.3, 0.15),
    ],
    ids=["sliding box", "box falls on a corner, then on its side", "disc that slides, then rolls"],
)
def test_the_motion_and_the_forces_are_those_of_the_plane(
    pair: tuple[Body, Solid],
    q: tuple[float, float, float],
    v: tuple[float, float, float],
    mu: float,
    until: float,
):
    (body, solid), solver = pair, make_solver("glambda")
    scene = Scene(bodies=(body,), q0=np.array([q]), v0=np.array([v]), mu=mu, eps=1e-6)
    flat = simulate(scene, solver, fixed_step=0.01, until=until, stops="held")
    made = SpaceScene(
        solids=(solid,),
        centres=np.array([(q[0], 0.0, q[1])]),
        attitudes=attitude((0.0, -1.0, 0.0), q[2])[None],
        v0=np.array([(v[0], 0.0, v[1], 0.0, -v[2], 0.0)]),
        mu=mu,
        eps=1e-6,
    )
    deep = simulate(made, solver, fixed_step=0.01, until=until)
    np.testing.assert_allclose(deep.t, flat.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(deep.poses[:, 0, [0, 2]], flat.q[:, 0, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(deep.velocities[:, 0, [0, 2]], flat.v[:, 0, :2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(-deep.velocities[:, 0, 4], flat.v[:, 0, 2], rtol=0, atol=1e-11)
    steps = np.flatnonzero(np.diff(flat.t) > 0) + 1
    borne = [force_of(flat, i) for i in steps]
    np.testing.assert_allclose(deep.reactions[steps, 0, 2], borne, rtol=0, atol=1e-9)


def force_of(run, i: int) -> float:
    """Σ λ_N of a body on level ground [N]: normals have the least numbers."""
    stretch = next(s for s in run.stretches if s.t[0] <= run.t[i] <= s.t[-1] and len(s.t))
    at = int(np.searchsorted(stretch.t, run.t[i]))
    return float(stretch.lam[at, : stretch.normal_ids.size].sum())
