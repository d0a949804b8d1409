"""Springs and dampers at the contacts, against what is known of them in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from harness.peers.springs import SpringsAndDampers
from problems import Scene, scene, simulate
from problems.bodies.bodies import box
from problems.scenes.calm import calm_scene
from solvers import make_solver

WIDTH, HEIGHT = 2.0, 1.0


def box_on_ground(speed: float = 0.0, mu: float = 0.0) -> Scene:
    return Scene(
        bodies=(box(WIDTH, HEIGHT),),
        q0=np.array([[0.0, HEIGHT / 2, 0.0]]),
        v0=np.array([[speed, 0.0, 0.0]]),
        mu=mu,
    )


def run(springs: SpringsAndDampers, until: float) -> None:
    steps = int(np.ceil(until / springs.largest_step))
    for _ in range(steps):
        springs.step(until / steps)


def test_a_box_rests_as_deep_as_its_weight_presses_two_springs() -> None:
    springs = SpringsAndDampers(box_on_ground(), stiffness=1e4)
    run(springs, 3.0)
    weight = WIDTH * HEIGHT * 9.81
    assert HEIGHT / 2 - springs.q[1] == pytest.approx(weight / 2e4, rel=1e-6)
    assert abs(springs.q[2]) < 1e-12
    assert springs.kinetic_energy() < 1e-12


def test_a_sliding_box_stops_where_coulomb_says() -> None:
    springs = SpringsAndDampers(box_on_ground(speed=2.0, mu=0.5), stiffness=1e6)
    run(springs, 1.0)
    assert springs.q[0] == pytest.approx(2.0**2 / (2 * 0.5 * 9.81), rel=5e-3)
    assert abs(springs.v[0]) < 1e-2


def test_stiffer_springs_come_closer_to_rigid_contact() -> None:
    solver = make_solver("glambda")
    rigid = simulate(scene("fig2"), solver, eps=1e-4, until=0.4).q[-1].ravel()
    errors = []
    for stiffness in (1e4, 1e5, 1e6):
        springs = SpringsAndDampers(scene("fig2"), stiffness)
        run(springs, 0.4)
        errors.append(float(np.abs(springs.q - rigid).max()))
    assert errors[1] < 0.3 * errors[0] and errors[2] < 0.5 * errors[1]


def test_aligned_boxes_are_pushed_along_their_normal_only() -> None:
    springs = SpringsAndDampers(calm_scene("tower", bodies=3), stiffness=1e5)
    before = springs.q.copy()
    run(springs, 0.2)
    assert np.abs(springs.q - before)[1::3].max() > 1e-5
    assert np.abs(springs.q - before).max() < 1e-2


@pytest.mark.parametrize("wrong", [{"stiffness": 0.0}, {"stiffness": 1e4, "damping": -1.0}])
def test_wrong_springs_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"stiffness|damping"):
        SpringsAndDampers(box_on_ground(), **wrong)
