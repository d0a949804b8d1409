"""Bodies on each other: a tower and a pyramid at rest, and stones that fall."""

from __future__ import annotations

import numpy as np

from problems.scenes.scene import at_most
from problems.space.attitude import UPRIGHT
from problems.space.scene import SpaceScene
from problems.space.solids import block, polyhedron


@at_most(bodies=1_000)
def space_tower(
    bodies: int = 10,
    side: float = 1.0,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A tower of cubes at rest, in space.

    side of a cube [m]
    """
    heights = side * (np.arange(bodies) + 0.5)
    return _stack(np.column_stack([0 * heights, 0 * heights, heights]), side, mu, gravity, eps,
                  end_time)  # fmt: skip


@at_most(courses=14)
def space_pyramid(
    courses: int = 4,
    side: float = 1.0,
    gap: float = 0.1,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A pyramid of cubes at rest, in space: 4 × 4 of them, on which 3 × 3, 2 × 2 and 1.

    side of a cube, gap between two [m]
    """
    if not 0 <= gap < side:
        raise ValueError(f"gap = {gap:g}; a cube lies on four from 0 to below side")
    places = [
        (
            (side + gap) * (i + 0.5 * course),
            (side + gap) * (j + 0.5 * course),
            side * (course + 0.5),
        )
        for course in range(courses)
        for i in range(courses - course)
        for j in range(courses - course)
    ]
    return _stack(np.array(places), side, mu, gravity, eps, end_time)


@at_most(bodies=100)
def stones(
    bodies: int = 3,
    corners: int = 8,
    size: float = 0.5,
    seed: int = 1,
    mu: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """Convex stones, each above the last one, fall on the ground and on each other.

    corners of a stone, from 4 to 40, on an ellipsoid with the greatest half axis `size` [m];  seed
    of their shapes and attitudes
    """
    if not 4 <= corners <= 40:
        raise ValueError(f"corners = {corners}; a stone has from 4 to 40")
    rng = np.random.default_rng([19, seed])
    solids, centres, attitudes = [], [], []
    for number in range(bodies):
        way = rng.normal(size=(corners, 3))
        points = size * rng.uniform(0.6, 1.0, 3) * way / np.linalg.norm(way, axis=1)[:, None]
        solid, _, turned = polyhedron(points, 1000.0)
        solids.append(solid)
        centres.append((*(0.3 * size * rng.uniform(-1, 1, 2)), size * (1.05 + 2.1 * number)))
        attitudes.append(turned)
    return SpaceScene(
        solids=tuple(solids),
        centres=np.array(centres),
        attitudes=np.array(attitudes),
        v0=np.zeros((bodies, 6)),
        mu=mu,
        mu_I=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def _stack(
    centres: np.ndarray, side: float, mu: float, gravity: float, eps: float, end_time: float
) -> SpaceScene:
    n = len(centres)
    return SpaceScene(
        solids=(block(side, side, side),) * n,
        centres=centres,
        attitudes=np.tile(UPRIGHT, (n, 1)),
        v0=np.zeros((n, 6)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
