"""Polygons that fall from above one another into a box or onto a plane, and come to lie in a heap.

What they carry is the comparison of motions that must go well, not of QPs: corners meet corners,
edges and walls at all angles, bodies of very different sizes lie on each other, and in the end all
of it should stand still.
"""

from __future__ import annotations

import numpy as np

from problems.contacts.geometry import HalfPlane
from problems.scenes.random_scenes import random_polygons, scene_generator
from problems.scenes.scene import MOST_CORNERS, MOST_POLYGONS, Scene, at_most


@at_most(bodies=MOST_POLYGONS, corners=MOST_CORNERS)
def rain(
    bodies: int = 12,
    corners: int = 0,
    size: float = 0.4,
    spread: float = 0.5,
    gap: float = 0.2,
    columns: int = 3,
    walls: bool = True,
    speed: float = 0.5,
    spin: float = 2.0,
    density: float = 1.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """Family: random convex polygons that fall, turning, into a box or onto a plane.

    corners of every polygon, 0 for 3 to 8 at random;  size : mean distance of a corner from the
    middle of the longer axis [m];  spread : relative, of the sizes;  gap : least distance of two
    bodies, and above the ground, at the start [m];  columns that they fall in, and the width of the
    box;  walls : whether the box has sides;  speed : greatest |v_x|, |v_y| [m/s];  spin : greatest
    |ω| [rad/s];  density [kg/m²]

    Raises ValueError for parameters that make no sense.
    """
    rng = scene_generator(bodies, seed, gap=gap, speed=speed, spin=spin)
    if columns < 1:
        raise ValueError(f"columns = {columns}; there must be at least one")
    polygons = random_polygons(rng, bodies, corners, size, spread, density, at_random=(3, 8))
    cell = 2 * max(body.radius for body in polygons) + gap
    q0, v0 = np.empty((bodies, 3)), np.empty((bodies, 3))
    for i, body in enumerate(polygons):
        room = (cell - gap) / 2 - body.radius
        q0[i, 0] = cell * (i % columns - (columns - 1) / 2) + room * rng.uniform(-1.0, 1.0)
        q0[i, 1] = gap / 2 + cell * (i // columns + 0.5) + room * rng.uniform(-1.0, 1.0)
        q0[i, 2] = rng.uniform(0.0, 2 * np.pi)
        v0[i] = rng.uniform(-1.0, 1.0, 3) * (speed, speed, spin)
    half = cell * columns / 2
    sides = (HalfPlane((-half, 0.0), (1.0, 0.0)), HalfPlane((half, 0.0), (-1.0, 0.0)))
    return Scene(
        bodies=polygons,
        q0=q0,
        v0=v0,
        ground=(HalfPlane(), *(sides if walls else ())),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
