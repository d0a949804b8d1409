"""Other engines on scenes in space: that each is given the scene as it is, and what is measured.

An engine that is absent is skipped, with the reason.  No time is asserted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from harness.peers import IN_SPACE, OURS, describe_engine, engine_class, takes
from harness.peers.base import Peer
from harness.peers.campaign import runs_of
from harness.peers.in_space import first_state, frame_of, rate, rotation, slabs, state_of, velocity
from harness.peers.observe import energy, moved, observe, penetration
from harness.peers.ours import GlambdaInSpace
from harness.peers.tasks import DEFAULT, Task, digest_of, tasks_of
from problems import scene
from problems.space.attitude import attitude, rotations, turned
from problems.space.scene import SpaceScene
from problems.space.solids import Solid, block

GOOD = {
    "mujoco": ("harder, RK4", 1 / 3840),
    "dart": ("NSGS, 1000 sweeps", 1 / 1920),
    "drake": ("lagged, corners 0.1 mm", 1 / 1920),
    "bullet": ("1000 iterations", 1 / 960),
    OURS: ("stock", 1e-4),
}
"""A setting of each engine, and a step or accuracy, at which it is good to some thousandths."""
FEW_THOUSANDTHS = 6e-3

every_engine = pytest.mark.parametrize("engine", IN_SPACE)


def made(engine: str, given: SpaceScene) -> Peer:
    """The scene in an engine, in its good setting; skips where the engine is absent."""
    info = describe_engine(engine)
    if not info.available:
        pytest.skip(info.reason)
    cls, (setting, resolution) = engine_class(engine, in_space=True), GOOD[engine]
    return cls(given, resolution, **cls.settings[setting])


def one(solid: Solid, z: float, **fields: Any) -> SpaceScene:
    """A body above the ground, askew."""
    start = {
        "centres": np.array([[0.3, -0.2, z]]),
        "attitudes": attitude((1, 2, 3), 0.5)[None],
        "v0": np.array([[1.0, 2.0, 3.0, 1.5, -2.0, 0.7]]),
    }
    return SpaceScene(solids=(solid,), **{**start, **fields})


# --- engines are given the scene as it is ---------------------------------------------------------


def test_every_engine_has_a_good_setting() -> None:
    assert set(GOOD) == set(IN_SPACE)


@every_engine
def test_free_flight_of_a_body_with_three_moments_of_inertia(engine: str) -> None:
    thrown = one(block(1.0, 0.6, 0.3), 10.0)
    motion, ours = (
        made(engine, thrown).run([0.1, 0.3]),
        GlambdaInSpace(thrown, 1e-6).run([0.1, 0.3]),
    )
    t = np.array([[0.1], [0.3]])
    exact = [0.3, -0.2, 10.0] + t * [1.0, 2.0, 3.0] - 4.905 * t**2 * [0, 0, 1]
    np.testing.assert_allclose(motion.q[:, 0, :3], exact, atol=FEW_THOUSANDTHS)
    np.testing.assert_allclose(motion.q, ours.q, atol=FEW_THOUSANDTHS)
    np.testing.assert_allclose(motion.v, ours.v, atol=0.02)
    assert motion.steps > 0 and motion.cpu > 0


@every_engine
def test_a_ball_slides_until_it_rolls_at_five_sevenths(engine: str) -> None:
    motion = made(engine, scene("bowl", speed=2.0, mu=0.3, heading=0.35)).run([0.1, 1.0])
    ends = 2 * 2.0 / (7 * 0.3 * 9.81)  # [s] when it rolls
    slid = 2.0 * 0.1 - 0.5 * 0.3 * 9.81 * 0.1**2
    gone = 2.0 * ends - 0.5 * 0.3 * 9.81 * ends**2 + 2.0 * 5 / 7 * (1.0 - ends)
    along = np.array([np.cos(0.35), np.sin(0.35), 0.0])
    expected = np.array([slid, gone])[:, None] * along + [0.0, 0.0, 0.5]
    np.testing.assert_allclose(motion.q[:, 0, :3], expected, atol=FEW_THOUSANDTHS)


@every_engine
def test_a_ball_rolls_down_a_slope(engine: str) -> None:
    rolling = scene("bowl", speed=0.0, angle=0.3)
    motion = made(engine, rolling).run([0.5])
    way = 0.5 * 5 / 7 * 9.81 * np.sin(0.3) * 0.5**2 * np.array([np.cos(0.3), 0.0, -np.sin(0.3)])
    np.testing.assert_allclose(motion.q[0, 0, :3] - rolling.centres[0], way, atol=FEW_THOUSANDTHS)


@every_engine
def test_boxes_stand_on_each_other(engine: str) -> None:
    standing = scene("space_tower", bodies=2)
    motion = made(engine, standing).run([0.1])
    drift, turn = moved(standing, motion.q[-1])
    assert max(drift) < FEW_THOUSANDTHS and max(turn) < FEW_THOUSANDTHS
    assert penetration(standing, motion.q) < FEW_THOUSANDTHS


@every_engine
@pytest.mark.parametrize("given", [scene("heavy_top"), one(Solid(1.0, (1.0, 1.0, 1.0)), 1.0)])
def test_what_engines_cannot_be_given_is_refused(engine: str, given: SpaceScene) -> None:
    if engine != OURS:
        with pytest.raises(ValueError, match="balls and boxes"):
            made(engine, given)


# --- what is asked and measured -------------------------------------------------------------------


def test_engines_are_asked_what_they_take() -> None:
    assert takes(OURS, in_space=True) and takes(OURS, in_space=False)
    assert takes("bullet", in_space=True) and not takes("bullet", in_space=False)
    assert list(runs_of("pymunk", Task("motion", "bowl", 0.5))) == []
    with pytest.raises(ValueError, match="'pymunk' takes no scenes in space"):
        engine_class("pymunk", in_space=True)


def test_the_default_tasks_in_space() -> None:
    tasks = [task for task in tasks_of(DEFAULT) if task.in_space]
    assert {task.kind for task in tasks} == {"motion", "whole", "rest"}
    assert len([task for task in tasks if task.kind == "rest"]) >= 3  # that have an exponent


def test_another_scene_in_space_is_another_start() -> None:
    ball_on_ground, other = scene("bowl"), scene("bowl", radius=0.4)
    assert digest_of(ball_on_ground) == digest_of(scene("bowl", end_time=0.5))
    assert digest_of(ball_on_ground) != digest_of(other)
    assert digest_of(ball_on_ground) != digest_of(scene("bowl", angle=1e-9))


def test_states_are_told_apart_and_differentiated() -> None:
    e, omega = attitude((1, -2, 0.5), 0.7)[None], np.array([[0.4, -1.0, 2.0]])
    state = state_of(np.array([[1.0, 2.0, 3.0]]), rotations(e))
    v = np.hstack([[[0.1, 0.2, 0.3]], omega])
    h = 1e-6
    later = state_of(np.array([[1.0, 2.0, 3.0]]) + h * v[:, :3], rotations(turned(e, h * omega)))
    np.testing.assert_allclose((later - state) / h, rate(state, v), atol=1e-5)
    np.testing.assert_allclose(velocity(state, rate(state, v)), v, atol=1e-14)
    np.testing.assert_array_equal(rotation(state), rotations(e))


def test_energy_overlap_and_drift_are_those_of_the_bodies() -> None:
    solid = block(1.0, 2.0, 3.0, density=2.0)
    spun = one(solid, 1.4, attitudes=attitude((0, 0, 1), np.pi / 2)[None])
    state = first_state(spun)[None]
    x, y, z = solid.inertia
    turning = y * 1.5**2 + x * 2.0**2 + z * 0.7**2  # its axes are turned by a quarter
    kinetic = 0.5 * solid.mass * (1 + 4 + 9) + 0.5 * turning
    expected = kinetic + 9.81 * solid.mass * 1.4
    assert energy(spun, state, spun.v0[None])[0] == pytest.approx(expected)
    assert penetration(spun, state) == pytest.approx(0.1)
    away = spun.centres + np.array([0.1, 0.0, -0.3])
    later = state_of(away, rotations(attitude((0, 0, 1), 2.0)[None]))
    drift, turn = moved(spun, later)
    assert drift == pytest.approx([0.3]) and turn == pytest.approx([2.0 - np.pi / 2])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.0, -1.0), (1, 0, 0)])
def test_the_ground_of_an_engine_has_its_surface_on_the_plane(normal: Any) -> None:
    R = frame_of(normal)
    np.testing.assert_allclose(R[:, 2], normal, atol=1e-12)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    ((centre, size, axes),) = slabs(scene("bowl", angle=0.3))
    top = centre + 0.5 * size[2] * axes[:, 2]
    np.testing.assert_allclose(top, 0.0, atol=1e-12)
    assert size[0] > 40


def test_a_tower_in_space_is_observed() -> None:
    task = Task("rest", "space_tower,bodies=2", 0.05)
    found = observe(GlambdaInSpace, {"fixed": True}, 1 / 240, task, lambda _: None)
    assert max(found["drift"]) < 1e-9 and len(found["turn"]) == 2
