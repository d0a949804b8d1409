"""Ellipses: one that rocks to and fro, and pebbles, some of them discs, that are poured on a wedge.

An ellipse with the semi-axes a ≥ b that rolls on level ground has one degree of freedom, its angle
φ, and the height h = √(b² + k² sin² φ), k² = a² − b².  With h' = dh/dφ and h + h'' = a²b²/h³

    (I + m (h² + h'²)) φ̈ + m h' (h + h'') φ̇² + m g h' = 0,    ẋ = −h φ̇

which is T + V = const.
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import Body, disc, ellipse, polygon_body
from problems.contacts.geometry import HalfPlane
from problems.scenes.scene import MOST_POLYGONS, Scene, at_most


def rocking(
    a: float = 0.5,
    b: float = 0.3,
    density: float = 1.0,
    angle: float = 50.0,
    mu: float = 1.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """An ellipse that is let go askew on the ground, and rocks without slipping.

    a, b : semi-axes [m];  density [kg/m²];  angle : of the longer one above the ground [°]
    """
    body, phi = ellipse(a, b, density), np.radians(angle)
    height = np.hypot(b * np.cos(phi), a * np.sin(phi))
    return Scene(
        bodies=(body,),
        q0=np.array([(0.0, height, phi)]),
        v0=np.zeros((1, 3)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


@at_most(pebbles=MOST_POLYGONS)
def pebbles(
    pebbles: int = 8,
    size: float = 0.2,
    density: float = 1.0,
    width: float = 1.6,
    mu: float = 0.4,
    seed: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """Ellipses, every fourth one a disc, are poured between two walls on a wedge, whose tip is up.

    pebbles : how many;  size : the longer semi-axis [m], the other from 0.5 to 0.9 of it
    density [kg/m²], the wedge's ten times that;  width : between the walls [m]

    Raises ValueError for less than one pebble, or a width that is less than eight sizes.
    """
    if pebbles < 1:
        raise ValueError(f"pebbles = {pebbles}; pour one at least")
    if width < 8 * size:
        raise ValueError(f"width = {width:g}; it must be eight sizes at least, {8 * size:g}")
    rng = np.random.default_rng(seed)
    wedge = polygon_body([(-size, 0.0), (size, 0.0), (0.0, 1.5 * size)], 10 * density)
    bodies: list[Body] = [wedge]
    q0 = [(0.0, 0.5 * size, 0.0)]
    columns = int(width / (2.5 * size))
    for i in range(pebbles):
        row, column = divmod(i, columns)
        share, phi = rng.uniform(0.5, 0.9), rng.uniform(-np.pi, np.pi)
        bodies.append(
            disc(share * size, density) if i % 4 == 3 else ellipse(size, share * size, density)
        )
        x = (column - 0.5 * (columns - 1)) * 2.4 * size + rng.uniform(-0.1, 0.1) * size
        q0.append((x, (3.0 + 2.2 * row) * size, phi))
    walls = (HalfPlane((-0.5 * width, 0.0), (1.0, 0.0)), HalfPlane((0.5 * width, 0.0), (-1.0, 0.0)))
    return Scene(
        bodies=tuple(bodies),
        q0=np.array(q0),
        v0=np.zeros((len(bodies), 3)),
        ground=(HalfPlane(), *walls),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
