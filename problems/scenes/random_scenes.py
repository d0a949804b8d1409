"""What scenes that are drawn at random share: the generator, and convex polygons of many sizes.

The same parameters give the same scene on every machine, to the rounding of its sines and cosines.
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import Body, polygon_body


def scene_generator(bodies: int, seed: int, **lengths: float) -> np.random.Generator:
    """The scene's random numbers, once its parameters are known to make sense.

    lengths : parameters by name, lengths or speeds

    Raises ValueError where there is no body, and where the seed or one of `lengths` is negative.
    """
    if bodies < 1:
        raise ValueError(f"bodies = {bodies}; there must be at least one")
    for name, value in {"seed": seed, **lengths}.items():
        if value < 0:
            raise ValueError(f"{name} = {value:g}; it must not be negative")
    return np.random.default_rng(seed)


def random_polygons(
    rng: np.random.Generator,
    bodies: int,
    corners: int,
    size: float,
    spread: float,
    density: float,
    at_random: tuple[int, int],
) -> tuple[Body, ...]:
    """Convex polygons with their corners on an ellipse, no two of them close to each other.

    corners of every polygon, 0 for any number from at_random[0] to at_random[1];  size : mean
    distance of a corner from the middle of the longer axis [m];  spread : relative, of the sizes
    density [kg/m²]

    Raises ValueError for corners, size or spread that make no sense.
    """
    if corners != 0 and corners < 3:
        raise ValueError(f"corners = {corners}; it must be at least 3, or 0")
    if not (size > 0 and 0 <= spread < 1):
        raise ValueError(f"size = {size:g}, spread = {spread:g}; needs size > 0, 0 ≤ spread < 1")
    least, most = at_random
    polygons = []
    for _ in range(bodies):
        count = corners or int(rng.integers(least, most + 1))
        angle = 2 * np.pi * (np.arange(count) + 0.6 * rng.uniform(size=count)) / count
        long = size * (1 + spread * rng.uniform(-1.0, 1.0))
        short = long * rng.uniform(0.6, 1.0)
        places = np.column_stack([long * np.cos(angle), short * np.sin(angle)])
        polygons.append(polygon_body(places, density))
    return tuple(polygons)
