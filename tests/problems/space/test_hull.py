"""Convex polyhedra in space: mass, contacts beside those of boxes, and motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from harness.recordings.recording import read_recording
from harness.study.study import record_into
from problems import scene, simulate
from problems.space.attitude import rotations
from problems.space.contacts import Near, Point
from problems.space.hull import MOST, Hull
from problems.space.motion import Pose
from problems.space.scene import SpaceScene
from problems.space.solids import Solid, ball, block, polyhedron
from reports.motions.player import write_player
from reports.motions.space import View, plot_space
from solvers import make_solver

TETRAHEDRON = [(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)]
OCTAHEDRON = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def as_hull(box: Solid) -> Solid:
    """The same body, told by its corners."""
    points = tuple((float(x), float(y), float(z)) for x, y, z in box.corners())
    return replace(box, sides=(0.0, 0.0, 0.0), points=points)


def contacts(pair: Sequence[Solid], centres: np.ndarray, attitudes: np.ndarray) -> list[Point]:
    still = SpaceScene(tuple(pair), centres, attitudes, np.zeros((len(pair), 6)), planes=())
    return Near(still).points(Pose(centres, attitudes), 0.3)


# --- the hull and the mass ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "faces", "edges", "sides"),
    [(TETRAHEDRON, 4, 6, {3}), (OCTAHEDRON, 8, 12, {3}), (block(1, 2, 3).corners(), 6, 12, {4})],
)
def test_faces_and_edges(points: Sequence, faces: int, edges: int, sides: set[int]) -> None:
    hull = Hull.of(points)
    assert (len(hull.faces), len(hull.edges)) == (faces, edges)
    assert set(map(len, hull.faces)) == sides
    for face, n, offset in zip(hull.faces, hull.normals, hull.offsets, strict=True):
        a, b, c = hull.corners[list(face[:3])]
        assert np.cross(b - a, c - a) @ n > 0  # round the outer normal
        np.testing.assert_allclose(hull.corners[list(face)] @ n, offset, atol=1e-12)
        assert (hull.corners @ n <= offset + 1e-12).all()


def test_mass_and_moments_of_a_box_and_of_a_tetrahedron() -> None:
    box, centre, turned = polyhedron(block(1, 2, 3).corners() + np.array([5, 6, 7]), 2.0)
    assert box.mass == pytest.approx(12.0)
    np.testing.assert_allclose(box.inertia, block(1, 2, 3, 2.0).inertia)
    np.testing.assert_allclose(centre, [5, 6, 7])
    np.testing.assert_allclose(turned, [1, 0, 0, 0])  # its own axes are principal
    regular, _, _ = polyhedron(TETRAHEDRON)
    assert regular.mass == pytest.approx(8 / 3)
    np.testing.assert_allclose(regular.inertia, 8 / 3 * 8 / 20)  # m a²/20, a² = 8


def test_corners_are_where_they_were_given() -> None:
    rng = np.random.default_rng(3)
    way = rng.normal(size=(12, 3))
    points = way / np.linalg.norm(way, axis=1, keepdims=True) * [1.0, 0.7, 0.4] + [1, 2, 3]
    stone, centre, turned = polyhedron(points)
    np.testing.assert_allclose(centre + stone.corners() @ rotations(turned[None])[0].T, points)
    inside = rng.uniform(-1, 1, size=(200_000, 3))
    inside = inside[(inside @ stone.hull.normals.T <= stone.hull.offsets).all(axis=1)]
    assert stone.mass == pytest.approx(8 * len(inside) / 200_000, rel=0.02)
    squares = (inside**2).mean(axis=0)
    np.testing.assert_allclose(stone.inertia, stone.mass * (squares.sum() - squares), rtol=0.03)
    np.testing.assert_allclose(inside.mean(axis=0), 0.0, atol=0.01)


def test_axes_do_not_hang_on_the_signs_that_lapack_chooses(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.random.default_rng(5).normal(size=(9, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    solid, _, turned = polyhedron(points)
    axes_of = np.linalg.eigh
    for signs in ([-1, 1, 1], [1, -1, -1], [-1, -1, -1]):
        monkeypatch.setattr(np.linalg, "eigh", lambda A, s=signs: (0, axes_of(A)[1] * s))
        same, _, as_well = polyhedron(points)
        assert same == solid and (as_well == turned).all()


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (TETRAHEDRON[:3], "span no volume"),
        ([*TETRAHEDRON, (0.1, 0.0, 0.0)], "point 4 is no corner"),
        ([(x, y, 0.0) for x, y, _ in TETRAHEDRON], "span no volume"),
        ([*TETRAHEDRON[:3], (np.nan, 0.0, 0.0)], "span no volume"),
        (np.random.default_rng(0).normal(size=(400, 3)), "no corner|the most"),
    ],
)
def test_points_that_are_no_corners_are_refused(points: Sequence, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        polyhedron(points)


def test_too_many_edges_are_refused() -> None:
    way = np.random.default_rng(0).normal(size=(MOST // 2, 3))
    with pytest.raises(ValueError, match="edges; 300 are the most"):
        Hull.of(way / np.linalg.norm(way, axis=1, keepdims=True))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"radius": 1.0}, "two of radius"),
        ({"sides": (1.0, 1.0, 1.0)}, "two of radius"),
        ({"points": tuple((x + 2, y, z) for x, y, z in TETRAHEDRON)}, "centre of gravity"),
    ],
)
def test_a_solid_says_which_field_is_wrong(fields: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Solid(1.0, (1.0, 1.0, 1.0), **{"points": tuple(TETRAHEDRON), **fields})


# --- contacts, beside those of boxes --------------------------------------------------------------


def test_two_hulls_touch_as_two_boxes_do() -> None:
    rng, touched = np.random.default_rng(1), 0
    for _ in range(80):
        boxes = [block(*rng.uniform(0.3, 1.5, 3)) for _ in range(2)]
        centres = np.array([[0.0, 0.0, 0.0], 0.8 * rng.normal(size=3)])
        attitudes = rng.normal(size=(2, 4))
        attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
        expected = contacts(boxes, centres, attitudes)
        for pair in (list(map(as_hull, boxes)), [as_hull(boxes[0]), boxes[1]]):
            found = contacts(pair, centres, attitudes)
            assert len(found) == len(expected)
            for one in expected:
                other = min(found, key=lambda p: float(np.abs(p.place - one.place).max()))
                assert other.gap == pytest.approx(one.gap, abs=1e-9)
                np.testing.assert_allclose(other.normal, one.normal, atol=1e-9)
        touched += bool(expected)
    assert touched > 20


def test_a_ball_touches_a_hull_as_a_box() -> None:
    rng, touched = np.random.default_rng(2), 0
    for _ in range(60):
        box, round_ = block(*rng.uniform(0.5, 1.5, 3)), ball(0.4)
        way = rng.normal(size=3)
        centres = np.array([[0.0, 0.0, 0.0], 1.2 * way / np.linalg.norm(way)])
        attitudes = rng.normal(size=(2, 4))
        attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
        expected = contacts([box, round_], centres, attitudes)
        found = contacts([as_hull(box), round_], centres, attitudes)
        assert [p.gap for p in found] == pytest.approx([p.gap for p in expected], abs=1e-9)
        for one, other in zip(expected, found, strict=True):
            np.testing.assert_allclose(other.place, one.place, atol=1e-9)
            np.testing.assert_allclose(other.normal, one.normal, atol=1e-9)
        touched += bool(expected)
    assert touched > 20


# --- motions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", [("space_tower", {"bodies": 3}), ("slope", {"speed": 1.0})])
def test_boxes_told_by_their_corners_move_as_boxes(label: tuple[str, dict]) -> None:
    boxes = scene(label[0], **label[1])
    hulls = replace(boxes, solids=tuple(map(as_hull, boxes.solids)))
    solver = make_solver("glambda")
    one, other = (simulate(each, solver, until=0.2, keep_qps=False) for each in (boxes, hulls))
    assert one.counts == other.counts
    np.testing.assert_allclose(one.poses[-1], other.poses[-1], atol=1e-12)


def test_an_octahedron_slides_on_its_face_as_coulomb_says() -> None:
    solid, _, turned = polyhedron(OCTAHEDRON)
    lowest = solid.hull.at(np.zeros(3), rotations(turned[None])[0])
    n = lowest.normals[0]
    axis = np.cross(n, [0, 0, -1.0])
    angle = np.arctan2(np.linalg.norm(axis), -n[2])
    half = np.append(np.cos(angle / 2), np.sin(angle / 2) * axis / np.linalg.norm(axis))
    still = scene("skid", mu=0.3)
    sliding = replace(
        still,
        solids=(solid,),
        attitudes=half[None],
        centres=np.array([[0.0, 0.0, 1 / np.sqrt(3)]]),
        v0=np.array([[2.0, 1.0, 0.0, 0.0, 0.0, 0.0]]),
    )
    run = simulate(sliding, make_solver("glambda"), until=0.3, eps=1e-6, keep_qps=False)
    speed = np.linalg.norm(run.velocities[-1, 0, :3])
    assert speed == pytest.approx(np.sqrt(5) - 0.3 * 9.81 * 0.3, abs=1e-6)
    assert np.abs(run.velocities[-1, 0, 3:]).max() < 1e-6


@pytest.mark.parametrize(("seed", "bodies", "mu"), [(2, 1, 0.5), (2, 2, 0.0)])
def test_stones_fall_without_a_gain_and_without_overlap(seed: int, bodies: int, mu: float) -> None:
    falling = scene("stones", bodies=bodies, seed=seed, mu=mu)
    run = simulate(falling, make_solver("glambda"), keep_qps=False)
    assert run.t[-1] == pytest.approx(falling.end_time)
    near = Near(falling)
    gaps = [p.gap for pose in run.poses for p in near.points(Pose(pose[:, :3], pose[:, 3:]), 0.0)]
    assert min(gaps, default=0.0) > -10 * falling.eps
    rise = (run.energy - np.minimum.accumulate(run.energy)).max()
    assert rise < 1e-3 * np.ptp(run.energy)


def test_stones_are_recorded_and_drawn(tmp_path: Path) -> None:
    made = record_into(tmp_path, "stones,bodies=2,mu=0.0", until=0.35)
    again = read_recording(next(tmp_path.glob("*.h5")))
    assert again.space is not None and made.space is not None
    assert again.space.bodies() == scene("stones", bodies=2, mu=0.0).solids
    assert again.digest == made.digest
    view = View.of(again)
    assert view is not None
    assert plot_space(view, tmp_path / "stones.png").stat().st_size > 10_000
    page = write_player(again, tmp_path / "stones.html").read_text()
    assert '"faces"' in page
