"""Ellipses: what they touch, and motions whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from problems import Run, Scene, scene, simulate
from problems.bodies.bodies import GROUND, Body, box, disc, ellipse, polygon_body
from problems.bodies.path import Path
from problems.bodies.shapes import ellipse_point
from problems.contacts.dips import dips
from problems.contacts.geometry import Geometry, HalfPlane
from solvers import make_solver

G = 9.81
SHAPES = (
    ellipse(0.8, 0.2),
    ellipse(0.5, 0.4),
    disc(0.3),
    box(1.0, 0.7),
    polygon_body([(0, 0), (2, 0), (0.2, 0.3)]),
    polygon_body([(0, 0), (0.2, 0), (0.1, 0.15)]),
)
PAIRS = [
    (SHAPES[i], SHAPES[j])
    for i in range(3)
    for j in range(i + 1, 6)
    if SHAPES[i].semi_axes[0] > SHAPES[i].semi_axes[1]
]
"""An ellipse and something else: an ellipse, a disc, a box and two sharp triangles."""
DENSE = 3000


def simulated(made: Scene, **chosen) -> Run:
    return simulate(made, make_solver("glambda"), **chosen)


def outline(body: Body, pose: np.ndarray) -> np.ndarray:
    """Points of the boundary in the plane: corners, or `DENSE` points of what is round."""
    if body.is_round:
        turn = 2 * np.pi / DENSE * np.arange(DENSE)
        local = np.column_stack([np.cos(turn), np.sin(turn)]) * body.semi_axes
    else:
        local = body.polygons[0]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return local @ np.array([[c, s], [-s, c]]) + pose[:2]


def apart(one: np.ndarray, other: np.ndarray) -> tuple[float, np.ndarray]:
    """Signed distance of two convex outlines, and its axis: the best of all separating axes."""
    angle, width = 0.0, np.pi
    for _ in range(3):
        angles = angle + width * np.linspace(-1, 1, 721)
        axes = np.array([np.cos(angles), np.sin(angles)])
        gaps = (one @ axes).min(axis=0) - (other @ axes).max(axis=0)
        best = int(gaps.argmax())
        angle, width = angles[best], width / 100
    return float(gaps[best]), axes[:, best]


def states(pair: tuple[Body, Body], seed: int) -> list[tuple[np.ndarray, float]]:
    """(q, φ) of poses with gaps φ from −1 mm to 1 m, by the outlines."""
    rng = np.random.default_rng(seed)
    found = []
    for gap in (1.0, 0.1, 1e-2, 1e-4, -1e-3):
        q = np.concatenate([(*rng.uniform(-1, 1, 2), rng.uniform(-4, 4)) for _ in range(2)])
        for _ in range(2):  # as the axis turns with the shift the second is for precision
            known, axis = apart(outline(pair[0], q[:3]), outline(pair[1], q[3:]))
            q[:2] += (gap - known) * axis
        found.append((q, apart(outline(pair[0], q[:3]), outline(pair[1], q[3:]))[0]))
    return found


# --- shape ---------------------------------------------------------------------------------------


def test_mass_and_moment_of_inertia_of_an_ellipse() -> None:
    turn = 2 * np.pi * np.arange(2000) / 2000
    many = polygon_body(np.column_stack([2 * np.cos(turn), np.sin(turn)]), 3.0)
    one = ellipse(2.0, 1.0, 3.0)
    assert (one.mass, one.inertia) == pytest.approx((many.mass, many.inertia), rel=1e-5)
    assert one.semi_axes == (2.0, 1.0)
    assert one.radius == 2.0
    assert disc(0.5).semi_axes == (0.5, 0.5)
    assert box(1.0, 1.0).semi_axes == (0.0, 0.0)


@pytest.mark.parametrize(
    ("a", "b"), [(1.0, 2.0), (1.0, 0.0), (np.nan, 1.0), (np.inf, 1.0), (1.0, -1.0), (2.0, np.nan)]
)
def test_semi_axes_that_are_none_are_refused(a: float, b: float) -> None:
    with pytest.raises(ValueError, match="a at least b"):
        ellipse(a, b)
    with pytest.raises(ValueError, match="an ellipse"):
        Body((np.array([(a, 0.0), (0.0, b)]),), 1.0, 1.0)


def test_an_ellipse_is_a_body_of_its_own() -> None:
    parts = (*box(1.0, 1.0).polygons, *ellipse(1.0, 0.5).polygons)
    with pytest.raises(ValueError, match="or an ellipse"):
        Body(parts, 1.0, 1.0)
    with pytest.raises(ValueError, match="or an ellipse"):
        Body((np.array([(1.0, 0.1), (0.0, 0.5)]),), 1.0, 1.0)


def test_the_point_that_is_farthest_is_on_the_periphery() -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    rim = np.column_stack([0.8 * np.cos(turn), 0.2 * np.sin(turn)])
    for direction in np.random.default_rng(0).normal(size=(20, 2)):
        point = ellipse_point(0.8, 0.2, direction)
        assert (point / (0.8, 0.2)) @ (point / (0.8, 0.2)) == pytest.approx(1.0)
        assert point @ direction >= (rim @ direction).max()


# --- geometry ------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("seed", range(4))
def test_clearances_are_distances(pair: tuple[Body, Body], seed: int) -> None:
    geometry = Geometry(pair, ())
    for q, known in states(pair, seed):
        pose = geometry.pose(q)
        found = geometry.clearance(pose, np.array([0]), np.array([1]))[0]
        assert found == pytest.approx(known, abs=5e-6)  # what is round is sampled
        depth, place = geometry.overlap(pose, 0, 1)
        assert (depth, *place[:2]) == (-found, 0, 1)
        columns = geometry.columns_at(pose, np.array([place]))
        assert columns.phi[0] == pytest.approx(found, abs=1e-12)
        assert -1e-9 <= columns.along[0] <= columns.length[0] + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_clearances_from_a_half_plane_are_distances(seed: int) -> None:
    plane = HalfPlane((0.0, -1.0), (0.3, 1.0))
    geometry, q = Geometry(SHAPES[:1], (plane,)), np.random.default_rng(seed).normal(size=3)
    axis = np.array(plane.normal) / np.hypot(*plane.normal)
    known = ((outline(SHAPES[0], q) - plane.point) @ axis).min()
    found = geometry.clearance(geometry.pose(q), np.array([0]), np.array([1]))[0]
    assert found == pytest.approx(known, abs=2e-6)


@pytest.mark.parametrize("pair", [*PAIRS, (SHAPES[0], None)])
@pytest.mark.parametrize("seed", range(3))
def test_columns_are_derivatives(pair: tuple[Body, Body | None], seed: int) -> None:
    bodies = tuple(body for body in pair if body is not None)
    planes = () if len(bodies) == 2 else (HalfPlane((0.0, -1.0), (0.3, 1.0)),)
    geometry, rng, dt = Geometry(bodies, planes), np.random.default_rng(seed), 1e-6
    poses = states(bodies, seed) if len(bodies) == 2 else [(rng.normal(size=3), 0.0)]
    for q, _ in poses:
        v, pose = rng.normal(size=q.size), geometry.pose(q)
        at = np.array([(0, 1, geometry.nearest(pose, 0, 1))])
        columns = geometry.columns_at(pose, at)
        a, b = columns.bodies[0]

        def speed(entries, a=a, b=b, v=v) -> float:
            mine = entries[:3] @ v[3 * a : 3 * a + 3]
            return float(mine + (0.0 if b == GROUND else entries[3:] @ v[3 * b : 3 * b + 3]))

        phi = [geometry.columns_at(geometry.pose(q + s * v), at).phi[0] for s in (dt, -dt)]
        assert speed(columns.normal[0]) == pytest.approx((phi[0] - phi[1]) / (2 * dt), abs=1e-5)
        point = geometry.touched(pose, 0, columns.normal[0, :2])

        def velocity(body: int, point=point, q=q, v=v) -> np.ndarray:
            if body == GROUND:
                return np.zeros(2)
            arm = point - q[3 * body : 3 * body + 2]
            return v[3 * body : 3 * body + 2] + v[3 * body + 2] * np.array([-arm[1], arm[0]])

        slip = columns.tangent[0, :2] @ (velocity(a) - velocity(b))
        assert speed(columns.tangent[0]) == pytest.approx(slip, abs=1e-12)


def test_an_ellipse_with_equal_axes_is_a_disc() -> None:
    others = SHAPES[2:]
    one, two = (
        Geometry((body, *others), (HalfPlane(),)) for body in (ellipse(0.4, 0.4), disc(0.4))
    )
    q = np.random.default_rng(1).normal(size=3 * (1 + len(others)))
    parts = np.arange(1, 2 + len(others))
    zero = np.zeros_like(parts)
    poses = one.pose(q), two.pose(q)
    found = one.clearance(poses[0], zero, parts)
    np.testing.assert_array_equal(found, two.clearance(poses[1], zero, parts))
    for part in parts.tolist():
        columns = [
            g.columns_at(pose, np.array([(0, part, g.nearest(pose, 0, part))]))
            for g, pose in zip((one, two), poses, strict=True)
        ]
        for mine, yours in zip(*columns, strict=True):
            np.testing.assert_array_equal(mine, yours)


def test_an_ellipse_that_is_almost_a_disc_touches_as_one() -> None:
    others = SHAPES[2:]
    bodies = ellipse(0.4, 0.4 * (1 - 1e-9)), disc(0.4)
    one, two = (Geometry((body, *others), (HalfPlane(),)) for body in bodies)
    parts = np.arange(1, 2 + len(others))
    for q in np.random.default_rng(2).normal(size=(20, 3 * (1 + len(others)))):
        found, known = (g.clearance(g.pose(q), np.zeros_like(parts), parts) for g in (one, two))
        near = known > -0.2  # a disc's centre inside a polygon is measured otherwise
        np.testing.assert_allclose(found[near], known[near], atol=1e-8)


def test_dips_agree_with_dense_samples() -> None:
    geometry, rng = (
        Geometry(SHAPES, (HalfPlane((0.0, -1.0), (0.3, 1.0)),)),
        np.random.default_rng(5),
    )
    first = geometry.part_first
    pairs = [(first[i], j) for i in range(3) for j in range(i + 1, 7)]
    corner, part = np.array(pairs).T.copy()
    seen, h, n = 0, 0.5, geometry.n_bodies
    for _ in range(25):
        velocity = 3 * rng.normal(size=(n, 3)) * (1, 1, 3)  # they spin fast
        path = Path(rng.normal(size=3 * n), velocity.ravel(), rng.normal(size=3 * n))
        poses = [geometry.pose(path(t)) for t in np.linspace(0.0, h, 301)]
        gaps = np.array([geometry.clearance(pose, corner, part) for pose in poses])
        floor = np.minimum(0.0, np.minimum(gaps[0], gaps[-1]))
        _, ends = dips(geometry, path, h, corner, part, floor)
        deep = gaps.min(axis=0) < floor - 1e-8
        seen += int(deep.sum())
        assert np.isfinite(ends[deep]).all()
        for i in np.flatnonzero(np.isfinite(ends)):
            there = geometry.pose(path(ends[i]))
            assert geometry.clearance(there, corner[i : i + 1], part[i : i + 1])[0] < floor[i]
    assert seen > 20


def test_near_pairs_are_found_by_their_boxes() -> None:
    tall = np.array([0, 0, np.pi / 2, 0.45, -0.1, np.pi / 2, 0, 1.65, np.pi / 2])
    geometry = Geometry((ellipse(0.8, 0.2),) * 3, (HalfPlane((0.0, -1.2)),))
    pose = geometry.pose(tall)
    assert geometry.near_pairs(pose, 0.06) == [(0, 1), (0, 2)]
    assert (0, 3) in geometry.near_pairs(pose, 0.41)
    assert (0, 3) not in geometry.near_pairs(pose, 0.39)
    corner, part = geometry.near_corners(pose, 0.06)
    found = sorted(zip(corner.tolist(), part.tolist(), strict=True))
    assert found == [(0, 1), (0, 2)]


# --- motions -------------------------------------------------------------------------------------


def test_a_spinning_ellipse_hits_a_corner_that_it_would_have_passed() -> None:
    """Its tip is in the way of the corner within a step of almost half a turn, not at its ends."""
    bodies = (box(1.0, 1.0, 1e4), ellipse(0.5, 0.1))
    q0 = np.array([(0.0, 0.0, 0.0), (0.85, 0.85, -np.pi / 4)])
    v0 = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 30.0)])
    run = simulated(Scene(bodies, q0, v0, ground=(), gravity=0.0, end_time=0.2), fixed_step=0.1)
    met = [event.t for event in run.event_log if event.kind == "impulse"]
    assert met
    assert met[0] < 0.1
    geometry = Geometry(bodies, ())
    at = geometry.pose(run.q[int(np.searchsorted(run.t, met[0]))].ravel())
    assert abs(geometry.clearance(at, np.array([4]), np.array([0]))[0]) < 1e-6


def test_a_rocking_ellipse_keeps_its_energy() -> None:
    made = scene("rocking", eps=1e-4)
    run = simulated(made)
    total = run.kinetic_energy() + run.potential_energy()
    assert np.abs(total - total[0]).max() < 5e-3 * run.kinetic_energy().max()
    assert {event.kind for event in run.event_log} <= {"slip_to_stick"}
    assert run.kinetic_energy().max() > 0.1 * total[0]


def rolled_over(eps: float) -> Run:
    """An ellipse that slides along the top of a heavy box without friction, over its corner."""
    bodies = (box(2.0, 1.0, 20.0), ellipse(0.4, 0.2))
    q0 = np.array([(0.0, 0.5, 0.0), (0.4, 1.2, 0.0)])
    v0 = np.array([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    return simulated(Scene(bodies, q0, v0, eps=eps, end_time=2.0))


def test_an_ellipse_goes_on_from_an_edge_to_its_corner() -> None:
    errors = []
    for eps in (1e-3, 1e-4):
        run = rolled_over(eps)
        told = [event for event in run.event_log if event.kind in ("roll_over", "drop")]
        assert [event.kind for event in told] == ["roll_over", "drop"]
        assert told[0].t == pytest.approx(1.2, abs=1e-2)  # 0.6 m at 0.5 m/s
        assert "corner 2" in told[0].detail
        until = run.t <= told[1].t
        total = (run.kinetic_energy() + run.potential_energy())[until]
        errors.append(np.abs(total - total[0]).max() / run.kinetic_energy()[until].max())
        assert run.gaps[np.isfinite(run.gaps)].min() > -eps
    assert errors[0] < 3e-2
    assert errors[1] < errors[0] / 5


def test_pebbles_come_down_without_an_overlap_or_a_gain_of_energy() -> None:
    from harness.motions.run_physics import physics_of

    run = simulated(scene("pebbles", pebbles=6, end_time=0.8))
    facts = physics_of(run)
    assert facts["overlap"] < 1e-3
    assert facts["gained_at_impulses"] < 1e-9
    assert facts["approach"] < 1e-6
    touched = {(int(row[0]), int(row[2])) for qp in run.qps for row in qp.feature}
    assert any(one > 0 and two > 0 for one, two in touched), "pebbles touch pebbles"
    assert any(0 in pair for pair in touched), "and the wedge"
    assert not [event for event in run.event_log if event.kind == "overlap"]
