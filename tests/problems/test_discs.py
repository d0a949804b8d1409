"""Discs: what they touch, and motions whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from problems import Run, Scene, scene, simulate
from problems.bodies.bodies import GROUND, Body, box, disc, polygon_body
from problems.bodies.path import Path
from problems.contacts.dips import dips
from problems.contacts.geometry import Geometry, HalfPlane
from problems.qp import NORMAL, TANGENT
from solvers import make_solver

G = 9.81
BODIES = (disc(0.4), box(1.0, 0.7), polygon_body([(0, 0), (2, 0), (1, 1.5)]), disc(0.3))
PLANE = HalfPlane((0.0, -1.0), (0.3, 1.0))
PAIRS = ((0, 1), (0, 2), (0, 3), (0, 4), (8, 1), (8, 2), (8, 4))
"""A disc's centre and another part: the box, the triangle, the other disc, the half plane."""

numbers = st.floats(-2.0, 2.0)
states = st.lists(numbers, min_size=12, max_size=12).map(np.array)


def simulated(made: Scene, **chosen) -> Run:
    return simulate(made, make_solver("glambda"), **chosen)


def distance(point: np.ndarray, polygon: np.ndarray) -> float:
    """Of a point from a convex polygon, below 0 inside: side by side, with no use of normals."""
    inside, least = True, np.inf
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        side, arm = b - a, point - a
        foot = np.clip(arm @ side / (side @ side), 0, 1) * side
        least = min(least, float(np.hypot(*(arm - foot))))
        inside &= side[0] * arm[1] - side[1] * arm[0] > 0
    return -least if inside else least


# --- geometry ------------------------------------------------------------------------------------


def test_mass_and_moment_of_inertia_of_a_disc() -> None:
    many = polygon_body([(np.cos(a), np.sin(a)) for a in 2 * np.pi * np.arange(2000) / 2000], 3.0)
    one = disc(1.0, 3.0)
    assert (one.mass, one.inertia) == pytest.approx((many.mass, many.inertia), rel=1e-5)
    assert one.radius == 1.0
    assert one.semi_axes == (1.0, 1.0)
    assert not box(1.0, 1.0).is_round


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_disc_needs_a_radius(radius: float) -> None:
    with pytest.raises(ValueError, match="radius"):
        disc(radius)


def test_a_disc_is_a_body_of_its_own() -> None:
    parts = (*box(1.0, 1.0).polygons, *disc(1.0).polygons)
    with pytest.raises(ValueError, match="a disc, which is a body of its own"):
        Body(parts, 1.0, 1.0)


@settings(max_examples=60, deadline=None)
@given(q=states)
def test_clearances_are_distances(q: np.ndarray) -> None:
    geometry = Geometry(BODIES, (PLANE,))
    pose = geometry.pose(q)
    found = geometry.clearance(pose, *np.array(PAIRS).T)
    for (corner, part), clearance in zip(PAIRS, found, strict=True):
        centre, radius = pose.corners[corner, :2], pose.corners[corner, 2]
        first, size = geometry.part_first[part], geometry.part_size[part]
        if part == 4:
            known = (centre - PLANE.point) @ PLANE.normal / np.hypot(*PLANE.normal)
        elif part == 3:
            known = np.hypot(*(centre - pose.corners[8, :2])) - 0.3
        else:
            known = distance(centre, pose.corners[first : first + size, :2])
        assert clearance == pytest.approx(known - radius, abs=1e-12)
        depth, place = geometry.overlap(pose, int(geometry.corner_part[corner]), part)
        assert depth == pytest.approx(-clearance, abs=1e-12)
        assert place[:2] == (corner, part)


@settings(max_examples=60, deadline=None)
@given(q=states, v=states)
def test_columns_are_derivatives(q: np.ndarray, v: np.ndarray) -> None:
    geometry, dt = Geometry(BODIES, (PLANE,)), 1e-6
    pose = geometry.pose(q)
    for corner, part in PAIRS:
        at = np.array([(corner, part, geometry.nearest(pose, corner, part))])
        columns = geometry.columns_at(pose, at)
        a, b = columns.bodies[0]
        centre, radius = pose.corners[corner, :2], pose.corners[corner, 2]
        if np.hypot(*(centre - pose.centres[b])) < 0.1:
            continue
        normal, tangent = columns.normal[0, :2], columns.tangent[0, :2]
        assert columns.phi[0] == pytest.approx(
            geometry.clearance(pose, np.array([corner]), np.array([part]))[0], abs=1e-12
        )

        def speed(entries, a=a, b=b) -> float:
            mine = entries[:3] @ v[3 * a : 3 * a + 3]
            return float(mine + (0.0 if b == GROUND else entries[3:] @ v[3 * b : 3 * b + 3]))

        phi = [geometry.columns_at(geometry.pose(q + s * v), at).phi[0] for s in (dt, -dt)]
        reach = columns.phi[0] + radius
        if reach > 0.05:  # nearer to a corner φ turns too fast for a difference
            assert speed(columns.normal[0]) == pytest.approx((phi[0] - phi[1]) / (2 * dt), abs=1e-6)
        point = centre - radius * normal

        def velocity(body: int, point=point) -> np.ndarray:
            if body == GROUND:
                return np.zeros(2)
            arm = point - q[3 * body : 3 * body + 2]
            return v[3 * body : 3 * body + 2] + v[3 * body + 2] * np.array([-arm[1], arm[0]])

        slip = tangent @ (velocity(a) - velocity(b))
        assert speed(columns.tangent[0]) == pytest.approx(slip, abs=1e-12)


def test_dips_agree_with_dense_samples() -> None:
    geometry, rng = Geometry(BODIES, (PLANE,)), np.random.default_rng(5)
    corner, part = np.array(PAIRS).T.copy()
    seen = 0
    for _ in range(40):
        path, h = Path(rng.normal(size=12), 3 * rng.normal(size=12), rng.normal(size=12)), 0.5
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


def test_two_discs_are_one_pair() -> None:
    geometry = Geometry((disc(0.5), disc(0.5), box(1.0, 1.0)), ())
    pose = geometry.pose(np.array([0, 0, 0, 1.0, 0, 0, 0.5, 1.0, 0]))
    corner, part = geometry.near_corners(pose, 0.3)
    found = set(zip(corner.tolist(), part.tolist(), strict=True))
    assert {(0, 1), (0, 2), (1, 2)} == found


# --- rolling and sliding -------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [5.0, 20.0, 50.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99, 1.01, 1.5])
def test_a_disc_rolls_down_a_slope_above_a_third_of_its_tangent(angle: float, share: float) -> None:
    s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    mu = share * np.tan(np.radians(angle)) / 3
    made = scene("rolling", angle=angle, mu=mu, eps=1e-4, end_time=0.5)
    run = simulated(made)
    speed = run.v[-1, 0, :2] @ (c, -s)
    known = 2 / 3 * G * s if share > 1 else G * (s - mu * c)
    # until it slips faster than ε it may stick, to the accuracy of ε
    near = made.eps
    assert speed == pytest.approx(known * run.t[-1], abs=near)
    spin = 2 / 3 * G * s if share > 1 else 2 * mu * G * c
    assert -run.v[-1, 0, 2] * 0.5 == pytest.approx(spin * run.t[-1], abs=near)
    assert np.abs(run.gaps[np.isfinite(run.gaps)]).max() < 1e-12


def test_a_thrown_disc_slides_and_then_rolls_at_two_thirds_of_its_speed() -> None:
    made = scene("bowling")
    run = simulated(made)
    known = 3.0 / (3 * 0.2 * G)
    stops = [event.t for event in run.event_log if event.kind == "slip_to_stick"]
    assert stops == pytest.approx([known], rel=1e-9)
    assert run.v[-1, 0, 0] == pytest.approx(2.0, rel=1e-9)
    assert run.v[-1, 0, 2] == pytest.approx(-2.0 / 0.2, rel=1e-9)
    x = 5 / 6 * 3.0 * known + 2.0 * (1.0 - known)  # v₀ t − ½ μ g t² while it slides
    assert run.q[-1, 0, 0] == pytest.approx(x, abs=made.eps)


# --- statics -------------------------------------------------------------------------------------


def forces(run: Run, kind: int) -> dict[tuple[int, int], float]:
    """{(body, body): λ} of the last step, normals or tangents."""
    at = max(i for i, qp in enumerate(run.qps) if qp.kind == "step" and qp.accepted)
    qp, x = run.qps[at], np.asarray(run.solutions[at].x)
    return {
        (int(row[0]), int(row[2])): float(value)
        for row, value in zip(qp.feature, x, strict=True)
        if row[4] == kind
    }


def pyramid(half: float, mu: float, walls: bool) -> tuple[Scene, float]:
    """Three discs of radius ½, the two below 2·`half` apart, and the angle of the centre lines."""
    alpha = float(np.arcsin(half))
    sides = (HalfPlane((-half - 0.5, 0.0), (1.0, 0.0)), HalfPlane((half + 0.5, 0.0), (-1.0, 0.0)))
    q0 = np.array([(-half, 0.5, 0.0), (half, 0.5, 0.0), (0.0, 0.5 + np.cos(alpha), 0.0)])
    ground = (HalfPlane(), *(sides if walls else ()))
    made = Scene((disc(0.5),) * 3, q0, np.zeros((3, 3)), ground=ground, mu=mu, end_time=0.1)
    return made, alpha


def test_a_pyramid_between_walls_bears_what_statics_says() -> None:
    made, alpha = pyramid(0.6, 0.0, walls=True)
    run, W = simulated(made), made.bodies[0].mass * G
    qp, x = run.qps[-1], np.asarray(run.solutions[-1].x)
    by_place = {tuple(row[[0, 2, 3]].tolist()): f for row, f in zip(qp.feature, x, strict=True)}
    N = W / (2 * np.cos(alpha))
    assert by_place[0, 2, 0] == pytest.approx(N, rel=1e-9)
    assert by_place[1, 2, 0] == pytest.approx(N, rel=1e-9)
    assert by_place[0, GROUND, 0] == pytest.approx(1.5 * W, rel=1e-9)
    assert by_place[1, GROUND, 0] == pytest.approx(1.5 * W, rel=1e-9)
    assert by_place[0, GROUND, 1] == pytest.approx(N * np.sin(alpha), rel=1e-9)
    assert by_place[1, GROUND, 2] == pytest.approx(N * np.sin(alpha), rel=1e-9)


def test_a_pyramid_that_friction_holds_bears_what_statics_says() -> None:
    made, alpha = pyramid(0.55, 0.5, walls=False)
    run, W = simulated(made), made.bodies[0].mass * G
    assert np.abs(run.v[-1]).max() < 1e-9
    normal, tangent = forces(run, NORMAL), forces(run, TANGENT)
    for body in (0, 1):
        assert normal[body, 2] == pytest.approx(W / 2, rel=1e-6)
        assert normal[body, GROUND] == pytest.approx(1.5 * W, rel=1e-6)
        for other in (2, GROUND):
            known = W / 2 * np.tan(alpha / 2)
            assert abs(tangent[body, other]) == pytest.approx(known, rel=1e-6)


def test_a_pyramid_falls_apart_symmetrically() -> None:
    run = simulated(scene("discs", rows=3, mu=0.0, end_time=0.4))
    q = run.q[-1]
    mirror = q[[2, 1, 0, 4, 3, 5]] * (-1.0, 1.0, -1.0)
    np.testing.assert_allclose(q, mirror, atol=1e-6)
    assert q[-1, 1] < run.q[0, -1, 1] - 0.05


# --- impulses and corners ------------------------------------------------------------------------


def test_discs_that_meet_centrally_go_on_together() -> None:
    bodies = (disc(0.5), disc(0.25))
    q0 = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)])
    v0 = np.array([(3.0, 0.0, 0.0), (-1.0, 0.0, 0.0)])
    run = simulated(Scene(bodies, q0, v0, ground=(), gravity=0.0, end_time=1.0))
    m = np.array([body.mass for body in bodies])
    assert m @ run.v[-1, :, 0] == pytest.approx(m @ v0[:, 0], rel=1e-12)
    np.testing.assert_allclose(run.v[-1, :, 0], m @ v0[:, 0] / m.sum(), rtol=1e-12)
    meets = [event.t for event in run.event_log if event.kind == "impulse"]
    assert meets == pytest.approx([1.25 / 4.0], abs=1e-7)


def over_the_edge(eps: float, **chosen) -> Run:
    return simulated(scene("wheel_edge", mu=0.0, velocity=0.4, eps=eps, end_time=1.9, **chosen))


def test_a_disc_that_slides_over_a_corner_keeps_its_energy() -> None:
    """Until it falls off: then nothing but the corner has touched it."""
    errors = []
    for eps in (1e-3, 1e-4):
        run = over_the_edge(eps)
        kinds = [event.kind for event in run.event_log]
        assert "roll_over" in kinds
        off = next(e.t for e in run.event_log if e.kind == "drop" and "corner" in e.detail)
        until = run.t <= off
        total = (run.kinetic_energy() + run.potential_energy())[until]
        errors.append(np.abs(total - total[0]).max() / run.kinetic_energy()[until].max())
        assert run.gaps[np.isfinite(run.gaps)].min() > -eps
    assert errors[0] < 3e-2
    assert errors[1] < errors[0] / 5


def test_a_disc_leaves_a_corner_where_theory_says() -> None:
    """Without friction and from rest above the corner at cos θ = ⅔; with v₀ at ⅔ + v₀²/(3 g ρ).

    The box is so heavy that it hardly moves.
    """
    v, radius = 0.4, 0.3
    run = over_the_edge(1e-5, weight=1e6)
    off = next(e.t for e in run.event_log if e.kind == "drop" and "corner" in e.detail)
    at = int(np.searchsorted(run.t, off))
    corner = run.q[at, 0, :2] + (1.0, 0.5)
    arm = run.q[at, 1, :2] - corner
    assert arm[1] / np.hypot(*arm) == pytest.approx(2 / 3 + v * v / (3 * G * radius), abs=2e-3)


def test_a_disc_comes_back_from_a_corner_to_the_edge() -> None:
    """Its centre is pushed over the corner, and a force that sets in there pushes it back."""
    from problems.bodies.forces import Load

    made = scene("wheel_edge", mu=0.0, velocity=0.5, end_time=2.2, weight=1e4)
    weight = made.bodies[1].mass * G
    back = Load(1, (-1.5 * weight, -weight, 0.0), start=1.22)
    run = simulated(Scene(made.bodies, made.q0, made.v0, forces=(back,), eps=1e-4, end_time=1.6))
    rolls = [event.detail for event in run.event_log if event.kind == "roll_over"]
    assert len(rolls) == 2
    assert "edge 2" in rolls[0]
    assert "corner 2" in rolls[1]
    assert run.q[-1, 1, 1] == pytest.approx(1.3, abs=1e-3)
    assert not [event for event in run.event_log if event.kind == "overlap"]
