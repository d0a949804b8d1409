"""Corners that cut off a tip within one step are found, wherever they do it; others are not."""

import numpy as np
import pytest

from problems.bodies import box, polygon_body
from problems.contacts import Geometry, HalfPlane
from problems.dips import dips
from problems.multistep import Path

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
