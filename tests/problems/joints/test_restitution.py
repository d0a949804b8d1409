"""Impacts that bounce: Newton's and Poisson's rule, and what becomes of the energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.bodies.bodies import box, disc
from solvers import make_solver


def run_of(made: Scene, **how: Any) -> Any:
    return simulate(made, make_solver("glambda"), keep_qps=False, **how)


def energy(run: Any) -> np.ndarray:
    mass = np.array([(body.mass, body.mass, body.inertia) for body in run.scene.bodies])
    return np.asarray(0.5 * (mass * run.v**2).sum(axis=(1, 2)))


def jumps(run: Any) -> np.ndarray:
    """Changes of the kinetic energy at impacts."""
    return np.diff(energy(run))[np.diff(run.t) == 0]


def thrown(seed: int, **more: Any) -> Scene:
    """Three boxes at random angles fall on the ground and on each other."""
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(-0.2, 0.2, 3), [0.9, 1.7, 2.5], rng.uniform(-1, 1, 3)])
    return Scene(
        bodies=(box(0.6, 0.3),) * 3, q0=q, v0=rng.uniform(-1, 1, (3, 3)), end_time=1.2, **more
    )


@pytest.mark.parametrize("rule", ["newton", "poisson"])
@pytest.mark.parametrize("e", [0.3, 1.0])
def test_a_ball_bounces_with_e(rule: Any, e: float) -> None:
    made = Scene(bodies=(disc(0.1),), q0=[(0, 0.6, 0)], v0=[(0, 0, 0)], restitution=e, end_time=0.4)
    run = run_of(made, restitution=rule)
    at = int(np.flatnonzero(np.diff(run.t) == 0)[0])
    assert run.v[at + 1, 0, 1] == pytest.approx(-e * run.v[at, 0, 1], rel=1e-9)


@pytest.mark.parametrize("rule", ["newton", "poisson"])
def test_two_discs_exchange_their_velocities(rule: Any) -> None:
    made = Scene(
        bodies=(disc(0.1), disc(0.1)), q0=[(0, 0, 0), (0.5, 0, 0)], v0=[(1, 0, 0), (0, 0, 0)],
        gravity=0.0, ground=(), restitution=1.0, end_time=0.5,
    )  # fmt: skip
    np.testing.assert_allclose(
        run_of(made, restitution=rule).v[-1], [(0, 0, 0), (1, 0, 0)], atol=1e-9
    )


def test_pairs_may_have_their_own() -> None:
    made = Scene(
        bodies=(box(0.4, 0.4),) * 2, q0=[(-1, 0.5, 0), (1, 0.5, 0)], v0=[(0, 0, 0)] * 2,
        restitution_pairs={(0, 2): 0.5}, end_time=0.3,
    )  # fmt: skip
    run = run_of(made)
    assert run.v[-1, 0, 1] == pytest.approx(0.0, abs=1e-9) and run.v[-1, 1, 1] > 0.5


@pytest.mark.parametrize("impulses", ["paper", "newton_coulomb"])
def test_poisson_s_rule_never_gains(impulses: Any) -> None:
    struck = 0
    for seed in range(12):
        pairs = {(0, 1): 0.9, (1, 2): 0.2}
        made = thrown(seed, mu=0.5, mu_I=0.5, restitution=0.6, restitution_pairs=pairs)
        gained = jumps(run_of(made, impulses=impulses))
        struck += gained.size
        assert gained.max() <= 1e-9
    assert struck > 50


def test_newton_s_rule_gains_with_friction() -> None:
    """A bar that falls on its corner, slipping backwards (Kane 1984): Newton's rule knows no
    friction."""
    gains = [
        jumps(run_of(thrown(seed, mu=0.5, mu_I=0.5, restitution=0.9), restitution="newton")).max()
        for seed in range(6)
    ]
    assert max(gains) > 1e-3


def test_what_bounces_comes_to_rest() -> None:
    run = run_of(scene("bounce"))
    assert np.abs(run.v[-1]).max() < 1e-9 and run.q[-1, 0, 1] == pytest.approx(0.1, abs=1e-5)
    assert 5 < sum(event.kind == "impulse" for event in run.event_log) < 20


def test_without_e_all_is_as_it_was() -> None:
    one = run_of(scene("fig2"), until=0.5)
    two = run_of(scene("fig2"), until=0.5, restitution="newton")
    np.testing.assert_array_equal(one.q, two.q)


@pytest.mark.parametrize("value", [-0.1, 1.5, np.nan])
def test_what_is_no_coefficient_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="restitution"):
        Scene(bodies=(box(1, 1),), q0=[(0, 1, 0)], v0=[(0, 0, 0)], restitution=value)
    with pytest.raises(ValueError, match="restitution_pairs"):
        Scene(
            bodies=(box(1, 1),), q0=[(0, 1, 0)], v0=[(0, 0, 0)], restitution_pairs={(0, 1): value}
        )
