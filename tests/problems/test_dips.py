"""Corners that cut off a tip within one step are found, wherever they do it; others are not."""

import numpy as np
import pytest

from problems.bodies.bodies import box, polygon_body
from problems.bodies.path import Path
from problems.contacts.constraint_graph import ConstraintGraph
from problems.contacts.dips import dips
from problems.contacts.geometry import Geometry, HalfPlane
from problems.stepping.events import look_ahead

THORN = polygon_body([(0.0, 0.0), (1.0, -0.1), (1.0, 0.1)])
"""A sharp tip at the left end, 2/3 to the left of the centre of gravity."""


def passing(gap: float, spin: float = 0.0) -> tuple[Geometry, Path]:
    """A box falls 1 m past the tip of a thorn in a second, its right side `gap` away from it."""
    bodies = (THORN, box(1.0, 1.0))
    geometry = Geometry(bodies, (HalfPlane((0.0, -9.0)),))
    start = np.array([2 / 3, 0.0, 0.0, -0.5 - gap, 1.2, 0.0])
    return geometry, Path(start, np.array([0, 0, spin, 0, -1.0, 0]), np.zeros(6))


def found(geometry: Geometry, path: Path, h: float) -> dict[tuple[int, int], tuple[float, float]]:
    corner = np.array([0, 1, 2, 3, 4, 5, 6], dtype=np.int64)
    part = np.array([1, 1, 1, 0, 0, 0, 0], dtype=np.int64)
    ends = [geometry.clearance(geometry.pose(path(step)), corner, part) for step in (0.0, h)]
    start, end = dips(geometry, path, h, corner, part, np.minimum(0.0, np.minimum(*ends)))
    return {
        (int(c), int(p)): (float(a), float(b))
        for c, p, a, b in zip(corner, part, start, end, strict=True)
        if np.isfinite(b)
    }


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6])
def test_a_tip_that_is_cut_off_is_found(depth: float) -> None:
    geometry, path = passing(-depth)
    start, end = found(geometry, path, 2.5)[0, 1]
    corner, part = np.array([0]), np.array([1])
    before, inside = (
        geometry.clearance(geometry.pose(path(s)), corner, part) for s in (start, end)
    )
    assert before >= 0 > inside


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-6])
def test_a_tip_that_is_passed_by_is_not(gap: float) -> None:
    assert not found(*passing(gap), 2.5)


def test_bodies_at_rest_have_none() -> None:
    geometry, path = passing(0.0)
    still = Path(path.start, np.zeros(6), np.zeros(6))
    assert not found(geometry, still, 1.0)


def test_random_paths_agree_with_dense_samples() -> None:
    rng = np.random.default_rng(1984)
    seen = 0
    for _ in range(60):
        geometry, path = passing(0.0)
        path = Path(
            path.start + 0.1 * rng.normal(size=6), 3 * rng.normal(size=6), rng.normal(size=6)
        )
        h = 0.7
        hits = found(geometry, path, h)
        steps = np.linspace(0.0, h, 401)
        poses = [geometry.pose(path(s)) for s in steps]
        for corner, part in [(c, 1) for c in range(3)] + [(c, 0) for c in range(3, 7)]:
            gaps = np.array(
                [geometry.clearance(p, np.array([corner]), np.array([part]))[0] for p in poses]
            )
            if gaps.min() < min(0.0, gaps[0], gaps[-1]) - 1e-8:
                seen += 1
                assert (corner, part) in hits
            elif (corner, part) in hits:
                _, end = hits[corner, part]
                # a dip between two samples
                assert gaps.min() < 5e-3
                inside = geometry.pose(path(end))
                assert geometry.clearance(inside, np.array([corner]), np.array([part]))[0] < 0
    assert seen > 5


def test_the_first_of_several_crossings_is_the_collision() -> None:
    """A thorn enters a wedge through its side, leaves it by its top and comes down on that again.

    Afterwards the edges of the two cross at the tip, with no corner of either inside the other.
    """
    wedge = polygon_body([(-1.0, 0.0), (0.0, -2.0), (1.0, 0.0)])
    thorn = polygon_body([(0.0, 0.0), (-1.0, -0.1), (-1.0, -0.3)])
    graph = ConstraintGraph(Geometry((wedge, thorn), ()), lambda a, b: 0.0)
    end, k = 0.5 + 1e-4, 0.1  # the thorn's corner moves along y = −k (x + 0.9)(x − 0.5)
    v = end + 1.2
    curve = np.array([0, 0, 0, 0, -k * v * v, 0])
    slope = -k * (2 * -1.2 + 0.4) * v
    start = np.array([0, -2 / 3, 0, -1.2 - 2 / 3, -k * -0.3 * -1.7 - 0.4 / 3, 0])
    path = Path(start, np.array([0, 0, 0, v, slope, 0]), curve)
    tip = int(np.argmax(graph.geometry.pose(start).corners[3:, 0])) + 3
    np.testing.assert_allclose(graph.geometry.pose(path(1.0)).corners[tip, 0], end)
    hits = look_ahead(graph, path, 1.0, 1e-6).hits
    assert [(hit.corner, hit.part) for hit in hits] == [(tip, 0)]
    where = graph.geometry.pose(path(hits[0].h)).corners[tip, :2]
    assert where[0] < -0.9 and where[1] < 0.0  # through the side, not through the top
