"""Convex polygons: area, centre of gravity, moment of inertia, checks; points of an ellipse."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from problems.qp import Vector

CONVEXITY_TOL = 1e-12
"""Smallest admissible turn at a corner, relative to the product of the adjacent side lengths."""


def cross(a: Vector, b: Vector) -> Vector:
    """a_x b_y − a_y b_x for stacks of plane vectors (..., 2) → (...)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def rotate_quarter(a: Vector) -> Vector:
    """J a = (−a_y, a_x): a quarter turn counter-clockwise, for (..., 2)."""
    return np.stack([-a[..., 1], a[..., 0]], axis=-1)


def convex_polygon(corners: ArrayLike) -> Vector:
    """Corners (c, 2) [m] of a strictly convex polygon, counter-clockwise.

    A clockwise polygon is turned round; its first corner stays first.  Raises ValueError, with the
    number of the offending corner, for fewer than 3 corners, NaN, repeated or collinear corners,
    and where the polygon is not convex.
    """
    corners = np.array(corners, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or corners.shape[0] < 3:
        raise ValueError(f"a polygon needs corners of shape (c ≥ 3, 2); got {corners.shape}")
    if not np.isfinite(corners).all():
        raise ValueError("a polygon's corners must be finite numbers")
    clockwise = polygon_area(corners) < 0
    if clockwise:
        corners = np.concatenate([corners[:1], corners[:0:-1]])
    side = np.roll(corners, -1, axis=0) - corners
    turn = cross(np.roll(side, 1, axis=0), side)
    size = np.linalg.norm(side, axis=1)
    bad = np.flatnonzero(turn <= CONVEXITY_TOL * size * np.roll(size, 1))
    if bad.size:
        number = -bad[-1] % len(corners) if clockwise else bad[0]
        raise ValueError(
            f"the polygon is not strictly convex at corner {number}; "
            "give a non-convex body as several convex parts"
        )
    if turning_number(side) != 1:
        raise ValueError("the polygon crosses itself; give its corners in order round the boundary")
    return corners


def turning_number(side: Vector) -> int:
    """How many times the boundary with sides (c, 2) turns round."""
    turn = np.arctan2(
        cross(np.roll(side, 1, axis=0), side), np.sum(np.roll(side, 1, axis=0) * side, axis=1)
    )
    return int(np.rint(turn.sum() / (2 * np.pi)))


def polygon_area(corners: Vector) -> float:
    """Signed area [m²], positive when counter-clockwise."""
    return 0.5 * float(cross(corners, np.roll(corners, -1, axis=0)).sum())


def polygon_centroid(corners: Vector) -> Vector:
    """Centre of area (2,) [m]."""
    after = np.roll(corners, -1, axis=0)
    weight = cross(corners, after)
    return (weight[:, None] * (corners + after)).sum(axis=0) / (3 * weight.sum())


def polygon_second_moment(corners: Vector) -> float:
    """Polar second moment of area about the origin, ∫ x² + y² dA [m⁴]."""
    after = np.roll(corners, -1, axis=0)
    weight = cross(corners, after)
    spread = (corners * corners + corners * after + after * after).sum(axis=1)
    return float((weight * spread).sum()) / 12


def box_corners(width: float, height: float) -> Vector:
    """Corners of an upright box about its centre: bottom left first, counter-clockwise."""
    x, y = width / 2, height / 2
    return np.array([(-x, -y), (x, -y), (x, y), (-x, y)])


def semi_axes(part: Vector) -> tuple[float, float]:
    """a and b [m] of a disc, the one point (a, 0), or an ellipse, the points (a, 0) and (0, b)."""
    return float(part[0, 0]), float(part[-1, len(part) - 1])


def ellipse_point(a: float, b: float, direction: Vector) -> Vector:
    """The point (..., 2) of an ellipse, semi-axes a along x and b along y, farthest that way.

    direction : (..., 2), of any length but 0
    """
    axes = np.array([a, b])
    return axes * axes * direction / np.linalg.norm(axes * direction, axis=-1, keepdims=True)
