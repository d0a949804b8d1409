"""Stacks of boxes rest, every backend finds the same Gλ of their QPs; where boxes touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from problems import scene, simulate
from problems.qp import ContactQP
from problems.space import Plane, Solid, SpaceScene, ball, block
from problems.space.attitude import UPRIGHT, attitude, rotations
from problems.space.box_box import BoxAt, box_box
from solvers import make_solver
from tests.fakes.crooked import Right

BACKENDS = ("glambda", "lotstedt", "daqp", "quadprog", "piqp", "clarabel", "highs", "scipy_bvls")


def test_a_tower_of_ten_rests_for_a_hundred_steps():
    found = simulate(scene("space_tower"), make_solver("glambda"), fixed_step=0.01, until=1.0)
    assert found.counts["steps"] == 100 and not found.event_log
    assert np.abs(found.poses - found.poses[0]).max() < 1e-9
    assert found.reactions[1:, :, 2] == pytest.approx(9.81, abs=1e-6)


def test_a_pyramid_of_thirty_rests():
    found = simulate(scene("space_pyramid"), make_solver("glambda"), fixed_step=0.01, until=0.05)
    assert found.poses.shape[1] == 30 and not found.event_log
    assert np.abs(found.poses - found.poses[0]).max() < 1e-10
    assert found.counts["unsettled"] == 0


@dataclass(frozen=True)
class AtACorner(Right):
    """Of all x with the right force, one at a corner of their set, in a direction by chance."""

    def answer(self, qp: ContactQP) -> Any:
        x = super().answer(qp)
        if qp.kind == "minimum_norm":
            return x
        way, A = np.random.default_rng(1).normal(size=qp.k), qp.dense_A
        bounds = np.column_stack([qp.lower, qp.upper])
        found = linprog(way, A_eq=A, b_eq=A @ x, bounds=bounds, method="highs-ds")
        return np.clip(found.x, qp.lower, qp.upper) if found.status == 0 else x


def test_a_tower_rests_whichever_x_of_the_same_force_a_solver_returns():
    found = simulate(scene("space_tower", bodies=3), AtACorner(), fixed_step=0.01, until=0.03)
    assert not found.event_log and found.counts["unsettled"] == 0  # none slips: all loads are least
    assert found.reactions[1:, :, 2] == pytest.approx(9.81, abs=1e-6)


def test_every_backend_finds_the_same_force():
    scenes = scene("space_tower", bodies=3), scene("skid", faces=8, spin=1.0), scene("bowl")
    runs = [simulate(each, make_solver("glambda"), fixed_step=0.01, until=0.03) for each in scenes]
    for qp in (qp for run in runs for qp in run.qps if qp.kind != "minimum_norm"):
        asked = qp.with_accuracy(1e-8)
        answers = [qp.dense_A @ make_solver(name).solve(asked).x for name in BACKENDS]
        scale = max(1.0, float(np.linalg.norm(answers[0])))
        for Ax in answers[1:]:
            np.testing.assert_allclose(Ax, answers[0], rtol=0, atol=1e-6 * scale)


def fallen(solid: Solid, *places: tuple[float, float, float], **options: float) -> SpaceScene:
    n = len(places)
    return SpaceScene(
        solids=(solid,) * n,
        centres=np.array(places),
        attitudes=np.tile(UPRIGHT, (n, 1)),
        v0=np.zeros((n, 6)),
        **options,
    )


def test_a_ball_hits_another_at_the_time_that_it_should_and_passes_its_momentum_on():
    made = fallen(ball(0.5), (0.0, 0.0, 3.0), (0.0, 0.0, 0.5))
    found = simulate(made, make_solver("glambda"), fixed_step=0.02, until=0.6)
    hit = next(event.t for event in found.event_log if event.kind == "impulse")
    assert hit == pytest.approx(np.sqrt(2 * 1.5 / 9.81), abs=2e-3)
    assert np.abs(found.velocities[-1]).max() < 1e-9  # no bounce: both rest on each other


def test_a_box_slides_off_another_and_falls():
    made = fallen(block(1.0, 1.0, 1.0), (0.0, 0.0, 0.5), (0.6, 0.0, 1.5))
    found = simulate(made, make_solver("glambda"), eps=1e-4, until=1.2)
    assert found.poses[-1, 1, 2] < 1.2  # its centre was beyond the edge
    assert found.gaps.min() > -1e-3
    assert (np.diff(found.energy) < 1e-3 * found.energy[0]).all()


def test_an_impact_never_adds_energy_with_friction_either():
    made = SpaceScene(
        solids=(block(1.0, 0.6, 0.4),),
        centres=np.array([[0.0, 0.0, 1.0]]),
        attitudes=attitude((1.0, 2.0, 0.5), 0.7)[None],
        v0=np.array([[1.0, 0.5, 0.0, 1.0, 0.0, 2.0]]),
        mu=0.3,
        mu_I=0.5,
        eps=1e-4,
    )
    found = simulate(made, make_solver("glambda"), until=0.7)
    jumps = np.flatnonzero(np.diff(found.t) == 0)
    assert len(jumps) > 1
    assert (np.diff(found.energy)[jumps] < 1e-9).all()
    assert found.gaps.min() > -1e-3


def unit(centre: tuple[float, float, float], angle: float = 0.0) -> BoxAt:
    R = rotations(attitude((0.0, 0.0, 1.0), angle)[None])[0]
    return BoxAt(np.array(centre), R, np.full(3, 0.5))


@pytest.mark.parametrize(
    ("shift", "angle", "points"), [(0.0, 0.0, 4), (0.3, 0.0, 4), (0.0, 0.6, 8)]
)
def test_a_face_on_a_face_touches_at_the_corners_of_what_they_share(shift, angle, points):
    found = box_box(unit((shift, 0.2 * shift, 1.0), angle), unit((0.0, 0.0, 0.0)), 0.01)
    assert len(found) == points
    for _, gap, place, normal in found:
        assert gap == pytest.approx(0.0, abs=1e-12) and place[2] == pytest.approx(0.5)
        np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=1e-12)
        assert np.abs(place[:2]).max() <= 0.5 + 1e-9


def test_an_edge_on_an_edge_touches_at_one_point():
    top = rotations(attitude((1.0, 0.0, 0.0), np.pi / 4)[None])[0]
    below = rotations(attitude((0.0, 1.0, 0.0), np.pi / 4)[None])[0]
    high = BoxAt(np.array([0.1, 0.0, 2 * np.sqrt(0.5) + 1e-3]), top, np.full(3, 0.5))
    ((_, gap, place, normal),) = box_box(high, BoxAt(np.zeros(3), below, np.full(3, 0.5)), 0.01)
    assert gap == pytest.approx(1e-3, abs=1e-12)
    np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(place, (0.0, 0.0, np.sqrt(0.5) + 5e-4), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Solid(0.0, (1.0, 1.0, 1.0)), "mass"),
        (lambda: Solid(1.0, (1.0, 1.0, 3.0)), "no body has such moments"),
        (
            lambda: Solid(1.0, (1.0, 1.0, 1.0), radius=1.0, sides=(1.0, 1.0, 1.0)),
            "a body has one shape",
        ),
        (lambda: Plane(normal=(0.0, 0.0, 0.0)), "normal"),
        (lambda: fallen(ball(0.5), (0.0, 0.0, 1.0), faces=5), "faces"),
        (lambda: fallen(ball(0.5), (0.0, 0.0, np.nan)), "centres"),
        (lambda: fallen(ball(0.5), (0.0, 0.0, 1.0), mu=-1.0), "mu"),
        (lambda: scene("space_pyramid", gap=2.0), "gap"),
    ],
)
def test_what_is_no_scene_is_refused(make, words: str):
    with pytest.raises(ValueError, match=words):
        make()


def test_bodies_that_overlap_and_options_of_the_plane_are_refused():
    solver = make_solver("glambda")
    with pytest.raises(ValueError, match=r"body 1 and the ground overlap by 0.1 m"):
        simulate(fallen(ball(0.5), (0.0, 0.0, 0.4)), solver)
    with pytest.raises(ValueError, match="of scenes in the plane"):
        simulate(scene("bowl"), solver, friction="paper")
