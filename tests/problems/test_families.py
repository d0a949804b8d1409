"""Families of scenes: they touch without overlap, are the same again, and move slowly."""

import numpy as np
import pytest

from problems import describe_scene, scene, scene_names, simulate
from problems.bodies.bodies import box, polygon_body
from problems.contacts.geometry import Geometry
from problems.scenes import deposition
from problems.scenes.calm import calm_scene
from problems.scenes.deposition import heap_positions
from problems.scenes.registry import FAMILIES, PAPER
from problems.stepping.events import TOUCH_TOL
from problems.stepping.stepper import Stepper, StepperOptions
from solvers import make_solver

NAMES = tuple(FAMILIES)
PILES = ("tower", "wall", "pyramid")
"""Families whose courses lie flat on each other."""


def started(made) -> Stepper:
    """A stepper at t = 0, which knows its contacts."""
    options = StepperOptions(eps=made.eps, drop_tol=made.eps, rest_speed=2 * made.eps)
    stepper = Stepper(made, make_solver("glambda"), options)
    stepper.start()
    return stepper


def contacts_of(made) -> int:
    return len(started(made).system.graph.normals)


def deepest(made) -> float:
    """Depth [m] of the deepest overlap."""
    geometry = Geometry(made.bodies, made.ground)
    pose = geometry.pose(made.q0.ravel())
    pairs = geometry.near_pairs(pose, 1e-3)
    return max((geometry.penetration(pose, pair) for pair in pairs), default=0.0)


def test_the_families_are_scenes_of_their_own_kind():
    assert set(NAMES) | set(PAPER) <= set(scene_names())
    assert not set(NAMES) & set(PAPER)
    for name in NAMES:
        summary, defaults = describe_scene(name)
        assert summary.startswith("Family: ")
        for parameter in ("bodies", "mu", "mu_I", "seed", "speed", "eps", "end_time", "gravity"):
            assert parameter in defaults


@pytest.mark.parametrize("bodies", [1, 2, 5, 37])
@pytest.mark.parametrize("name", NAMES)
def test_as_many_bodies_as_asked_for_none_of_which_overlap(name, bodies):
    made = scene(name, bodies=bodies)
    assert len(made.bodies) == bodies
    assert deepest(made) <= TOUCH_TOL / 10
    assert made.label == (f"{name},bodies={bodies}")


@pytest.mark.parametrize("name", NAMES)
def test_the_seed_alone_decides(name):
    one, two, other = (scene(name, bodies=12, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.q0, two.q0)
    np.testing.assert_array_equal(one.v0, two.v0)
    assert (one.v0 != other.v0).any()


@pytest.mark.parametrize("name", NAMES)
def test_the_start_is_slow_or_at_rest(name):
    moving, resting = scene(name, speed=0.02), scene(name, speed=0.0)
    speeds = np.abs(moving.v0)
    assert 0.01 <= speeds.max() <= 0.02
    assert speeds[:, 2].max() == 0.0
    assert not resting.v0.any()
    np.testing.assert_array_equal(moving.q0, resting.q0)


@pytest.mark.parametrize("name", PILES)
def test_courses_slide_in_turns_to_the_right_and_to_the_left(name):
    made = scene(name, bodies=10, speed=0.02)
    course = np.round(made.q0[:, 1] - 0.5)
    assert (made.v0[:, 0] * (-1) ** course >= 0.01).all()


def test_a_tower_has_two_contacts_on_every_level():
    assert contacts_of(scene("tower", bodies=9)) == 18
    assert contacts_of(scene("tower", bodies=9, jitter=0.0)) == 18


def test_a_leaning_tower_stands_on_one_corner():
    made = scene("tower", bodies=6, lean=0.01)
    assert contacts_of(made) == 11
    np.testing.assert_allclose(made.q0[:, 2], -0.01)
    along = np.array([np.cos(0.01), -np.sin(0.01)])
    np.testing.assert_allclose(np.abs(made.v0[:, :2] @ along), np.hypot(*made.v0[:, :2].T))


def test_a_wall_in_running_bond():
    # four courses of 2, 3 (two halves), 2, 3 bricks; a whole brick lies on two, with two points on
    # each, a half brick on one
    made = scene("wall", bodies=10, row=2)
    widths = [float(np.ptp(body.polygons[0][:, 0])) for body in made.bodies]
    np.testing.assert_allclose(widths, [2, 2, 0.975, 2, 0.975, 2, 2, 0.975, 2, 0.975])
    ends = made.q0[:, 0] + np.array(widths) / 2
    np.testing.assert_allclose(ends[[1, 4, 6, 9]], ends[1], atol=1e-15)
    assert contacts_of(made) == 2 * 2 + (2 + 4 + 2) + 2 * 4 + (2 + 4 + 2)


def test_a_pyramid_has_one_brick_fewer_in_each_course():
    made = scene("pyramid", bodies=10)
    _, counts = np.unique(made.q0[:, 1], return_counts=True)
    np.testing.assert_array_equal(counts, [4, 3, 2, 1])
    x = made.q0[:, 0]
    np.testing.assert_allclose(x[4:7], (x[0:3] + x[1:4]) / 2)
    np.testing.assert_allclose(x[9], (x[7] + x[8]) / 2)
    assert contacts_of(made) == 2 * 4 + 4 * 6


def test_flush_sides_touch_and_carry_nothing_at_rest():
    made = scene("wall", bodies=7, row=3, gap=0.0, speed=0.0)
    assert deepest(made) <= 1e-12
    assert contacts_of(made) > contacts_of(scene("wall", bodies=7, row=3, speed=0.0))


@pytest.mark.parametrize("name", PILES)
def test_without_friction_a_pile_slides_on_and_does_not_fall(name):
    made = calm_scene(name, bodies=11)
    run = simulate(made, make_solver("glambda"))
    assert run.t[-1] == pytest.approx(made.end_time)
    assert run.event_log == []
    np.testing.assert_allclose(run.v[-1], made.v0, atol=1e-6)
    assert np.abs(run.q[-1, :, 1:] - made.q0[:, 1:]).max() < 1e-6
    first, last = run.qps[0].dense_A, run.qps[-1].dense_A
    assert 1e-4 < np.abs(last - first).max() < 1e-1


@pytest.mark.parametrize("name", PILES)
def test_with_friction_a_pile_comes_to_rest(name):
    run = simulate(calm_scene(name, bodies=6, mu=0.4), make_solver("glambda"), until=0.1)
    assert np.abs(run.v[-1]).max() < 1e-4
    assert np.abs(run.q[-1] - run.q[0]).max() < 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_by_default_it_collapses(name):
    made = scene(name)
    run = simulate(made, make_solver("glambda"), keep_qps=False)
    assert run.t[-1] == pytest.approx(made.end_time)
    fallen = run.q[0, :, 1] - run.q[-1, :, 1]
    assert fallen.max() > 1.0
    assert np.abs(run.q[-1, :, 2] - run.q[0, :, 2]).max() > 0.5
    energy = run.kinetic_energy() + run.potential_energy()
    assert energy[-1] < 0.95 * energy[0]


def test_a_calm_scene_is_what_its_parameters_say():
    assert calm_scene("heap").label == "heap,room=0.0,end_time=0.2"
    assert calm_scene("tower", speed=0.5, end_time=1.0).label == "tower,speed=0.5,end_time=1.0"
    assert calm_scene("fig4").label == "fig4"


def test_a_leaning_tower_with_friction_tips_slowly_as_one():
    made = scene("tower", bodies=6, lean=0.02, mu=0.6, speed=0.0)
    run = simulate(made, make_solver("glambda"), until=0.1)
    turned = run.q[-1, :, 2] - run.q[0, :, 2]
    assert np.ptp(run.q[:, 0, 2]) > 1e-4
    np.testing.assert_allclose(turned, turned[0], rtol=1e-2)


def test_every_body_of_a_heap_touches_what_is_under_it():
    made = scene("heap", bodies=60, seed=1)
    stepper = started(made)
    assert len(stepper.system.graph.normals) >= 80
    assert all(stepper.system.graph.of_body.get(body) for body in range(60))
    gaps = Geometry(made.bodies, made.ground)
    pose = gaps.pose(made.q0.ravel())
    assert pose.corners[:, 1].min() > -TOUCH_TOL
    left, right = made.ground[1].point[0], made.ground[2].point[0]
    assert pose.corners[:, 0].min() > left - TOUCH_TOL
    assert pose.corners[:, 0].max() < right + TOUCH_TOL


def test_a_heap_settles_under_gravity():
    run = simulate(scene("heap", bodies=6), make_solver("glambda"), until=0.05)
    total = run.kinetic_energy() + run.potential_energy()
    assert run.potential_energy()[-1] < run.potential_energy()[0]
    assert total.max() <= total[0] * (1 + 1e-4)


def test_a_box_let_down_alone_comes_to_lie_flat():
    q = heap_positions([box(1.0, 1.0)], 10.0, np.random.default_rng(0))
    assert q[0, 1] == pytest.approx(0.5, abs=1e-12)
    quarter = np.mod(q[0, 2], np.pi / 2)
    assert min(quarter, np.pi / 2 - quarter) == pytest.approx(0.0, abs=1e-12)


def test_a_triangle_topples_onto_the_box_beside_it():
    # the centre of the last body lies between the points that hold it, or two surfaces block it
    bodies = [box(1.0, 1.0), polygon_body([(0, 0), (2, 0), (1.6, 0.4)])]
    for seed in range(20):
        q = heap_positions(bodies, 3.2, np.random.default_rng(seed))
        geometry = Geometry(bodies, scene("heap", bodies=1, width=3.2).ground)
        pose = geometry.pose(q.ravel())
        pairs = geometry.near_pairs(pose, 1e-6)
        depths = [geometry.penetration(pose, pair) for pair in pairs]
        assert max(depths) <= 1e-9
        touching = [pair for pair, depth in zip(pairs, depths, strict=True) if depth > -1e-9]
        assert any(1 in pair for pair in touching)


def filled() -> float:
    """Which part of a heap is bodies."""
    made = scene("heap", bodies=80)
    area = sum(body.mass for body in made.bodies)
    corners = Geometry(made.bodies, made.ground).pose(made.q0.ravel()).corners
    width = made.ground[2].point[0] - made.ground[1].point[0]
    return area / (width * corners[:, 1].max())


def test_more_trials_than_one_are_what_makes_a_heap_dense(monkeypatch):
    dense = filled()
    monkeypatch.setattr(deposition, "TRIALS", 1)
    assert dense > 0.5 and filled() < 0.9 * dense


@pytest.mark.parametrize("name", NAMES)
def test_a_large_one_is_built_and_its_first_qp_posed(name):
    made = scene(name, bodies=400, mu=0.3)
    stepper = started(made)
    assert len(stepper.system.graph.normals) >= 400
    assert len(stepper.system.graph.frictions) >= 350


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("tower", {"bodies": 0}, "bodies = 0"),
        ("tower", {"seed": -1}, "seed = -1"),
        ("tower", {"jitter": 0.5}, "jitter = 0.5"),
        ("wall", {"gap": 1.0}, "gap = 1"),
        ("wall", {"gap": -0.1}, "gap = -0.1"),
        ("wall", {"row": -1}, "row = -1"),
        ("wall", {"height": -1.0}, "needs positive sides"),
        ("pyramid", {"gap": 1.5}, "gap = 1.5"),
        ("heap", {"corners": 2}, "corners = 2"),
        ("heap", {"spread": 1.0}, "spread = 1"),
        ("heap", {"width": 0.3}, "body 1 of the heap finds no place between walls 0.3 m"),
        ("heap", {"speed": -1.0}, "speed = -1"),
    ],
)
def test_bad_parameters_are_refused(name, parameters, words):
    with pytest.raises(ValueError, match=words):
        scene(name, **parameters)
