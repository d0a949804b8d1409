"""Friction in space: no direction is better than another, and slip and spin end together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from problems import scene, simulate
from problems.space import SpaceScene, ball
from problems.space.attitude import attitude
from problems.space.contacts import Point
from problems.space.friction import Contact, State, cone, share_of
from problems.space.run import SpaceRun
from solvers import make_solver


def run(name: str, h: float = 0.01, **parameters: float) -> SpaceRun:
    return simulate(scene(name, **parameters), make_solver("glambda"), fixed_step=h)


@pytest.mark.parametrize("heading", [0.0, 0.35, 0.8])
def test_a_box_slides_down_the_steepest_line_wherever_that_is(heading: float):
    found = run("slope", heading=heading, end_time=0.5)
    way = found.poses[-1, 0, :3] - found.poses[0, 0, :3]
    assert np.arctan2(way[1], way[0]) == pytest.approx(heading, abs=1e-6)
    exact = 0.5 * 9.81 * (np.sin(0.4) - 0.2 * np.cos(0.4)) * 0.5**2
    assert np.linalg.norm(way) == pytest.approx(exact, abs=3e-4)  # two steps of first order
    assert found.gaps.min() > -1e-10 and found.counts["unsettled"] == 0


def test_a_polygon_draws_a_box_aside_and_the_disc_does_not():
    aside = {}
    for faces in (0, 4, 8, 16):
        x, y = run("skid", faces=faces, speed=1.0, end_time=0.3).poses[-1, 0, :2]
        aside[faces] = abs(y * np.cos(0.35) - x * np.sin(0.35)) / np.hypot(x, y)
    assert aside[0] < 1e-12
    assert aside[4] > 0.1 > aside[8] > 0.01 and 0.1 > aside[16] > 0.01


def test_a_ball_rolls_at_five_sevenths_of_its_speed_and_keeps_its_direction():
    found = run("bowl", heading=1.1, end_time=0.4)
    v = found.velocities[-1, 0]
    np.testing.assert_allclose(v[:2], 10 / 7 * np.array([np.cos(1.1), np.sin(1.1)]), atol=1e-13)
    np.testing.assert_allclose(v[3:5], 2 * np.array([-v[1], v[0]]), atol=1e-13)
    assert [event.kind for event in found.event_log] == ["slip_to_stick"]


def test_slip_and_spin_of_a_box_end_in_the_same_step():
    found = run("skid", spin=4.0, speed=1.5, mu=0.3, height=0.1, heading=0.0, end_time=0.75)
    slip, spin = np.hypot(*found.velocities[:, 0, :2].T), np.abs(found.velocities[:, 0, 5])
    # a step before they are above 5e-3, and at its end what the QP's accuracy leaves of them
    assert int(np.argmax(slip < 1e-5)) == int(np.argmax(spin < 1e-5)) > 0
    assert found.velocities[-1] == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(found.energy) < 1e-12).all()


def test_forces_stay_within_the_cone_and_against_the_slip():
    found = run("skid", spin=4.0, speed=1.5, mu=0.3, height=0.1, end_time=0.2)
    force = found.reactions[1:, 0, :3]
    assert (np.hypot(*force[:, :2].T) <= 0.3 * force[:, 2] * (1 + 1e-6)).all()
    works = np.sum(found.reactions[1:, 0] * found.velocities[1:, 0], axis=1)
    assert (works < 0).all()


def test_corners_of_a_polygon_lie_on_the_disc():
    contact = Contact(0, Point((0, -1, 0), 0, -1, 0.0, np.zeros(3), np.array([0.6, 0.0, 0.8])), 0.5)
    for faces in (4, 8, 16):
        t = contact.directions(faces) * share_of(faces)
        signs = np.array(np.meshgrid(*[(-1, 1)] * len(t))).reshape(len(t), -1).T
        assert np.linalg.norm(signs @ t, axis=1).max() == pytest.approx(1.0)
        np.testing.assert_allclose(t @ contact.point.normal, 0.0, atol=1e-15)


def test_generators_of_impulses_are_on_the_cone():
    n = np.array([0.0, 0.6, 0.8])
    V = cone(n, 0.5, 8)
    np.testing.assert_allclose(V @ n, 1.0)
    np.testing.assert_allclose(np.linalg.norm(V - n, axis=1), 0.5)
    np.testing.assert_allclose(V.sum(axis=0), 8 * n, atol=1e-14)


def test_a_contact_changes_its_state_where_its_force_was_wrong():
    contact = Contact(0, Point((0, -1, 0), 0, -1, 0.0, np.zeros(3), np.array([0, 0, 1.0])), 0.5)
    assert contact.revise(np.array([3.0, 4.0, 0.0]), 4.0, 1e-6)
    assert contact.state is State.BEGINS
    np.testing.assert_allclose(contact.way, (-0.6, -0.8, 0.0))
    assert not contact.revise(np.array([1.0, 0.0, 0.0]), 4.0, 1e-6)  # not back in the same step
    contact.state = State.SLIDES
    assert contact.revise(np.array([1.0, 0.0, 0.0]), 4.0, 1e-6)
    assert contact.state is State.STICKS


@pytest.mark.parametrize("angle", [0.1, 0.7, 2.0])
def test_an_impact_slides_along_a_round_cone(angle: float) -> None:
    """A ball's slip is braked against its own direction; the impulse of (2.14) in closed form."""
    mu, speed = 0.3, 2.0
    thrown = SpaceScene(
        solids=(ball(0.5),),
        centres=np.array([[0.0, 0.0, 0.5]]),
        attitudes=np.array([attitude((0, 0, 1), 0.0)]),
        v0=np.array([[speed * np.cos(angle), speed * np.sin(angle), -1.0, 0.0, 0.0, 0.0]]),
        mu=mu,
        mu_I=mu,
        gravity=0.0,
        end_time=0.01,
    )
    edge = np.array([-mu * np.cos(angle), -mu * np.sin(angle), 1.0])
    before = thrown.v0[0, :3]
    expected = before - (before @ edge) / (1 + 3.5 * mu**2) * edge
    eight = simulate(replace(thrown, faces=8), make_solver("glambda"), until=0.002)
    run = simulate(thrown, make_solver("glambda"), until=0.002)
    assert np.linalg.norm(run.velocities[-1, 0, :3] - expected) < 1e-6
    assert np.linalg.norm(eight.velocities[-1, 0, :3] - expected) > 1e-3
    assert sum(qp.kind == "impulse" and qp.accepted for qp in run.qps) == 1


def test_an_impact_without_friction_is_one_qp() -> None:
    """Its cones are normals: nothing of them is to be refined, where answers have noise, either."""
    run = simulate(scene("stones", mu=0.0), make_solver("osqp"), until=0.3)
    impulses = [qp for qp in run.qps if qp.kind == "impulse"]
    assert run.counts["impulses"] > 0
    assert sum(qp.accepted for qp in impulses) == run.counts["impulses"]
    assert len(impulses) < 2 * run.counts["impulses"]
