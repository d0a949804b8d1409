"""Discs: one that rolls down a slope, one that slides and then rolls, heaps of them, one on a box.

What a uniform disc of radius ρ does is known:

    rolling     down a slope of angle θ it rolls with ẍ = ⅔ g sin θ where μ ≥ ⅓ tan θ, and slides
                with ẍ = g (sin θ − μ cos θ) where μ is less
    bowling     it slides with ẍ = −μ g until t = v₀/(3 μ g), and rolls with ⅔ v₀ from then on
    discs       a pyramid of equal ones on the ground is symmetric in what it does and what it bears
    wheel_edge  it rolls along a box, over its corner and, pushed from there, back
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import Body, box, disc
from problems.contacts.geometry import HalfPlane
from problems.scenes.scene import MOST_POLYGONS, Scene, at_most


def rolling(
    angle: float = 20.0,
    radius: float = 0.5,
    density: float = 1.0,
    velocity: float = 0.0,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """A disc that rolls down a slope, or slides where mu is less than tan(angle)/3.

    angle : of the slope, downwards to the right [°];  radius [m];  density [kg/m²]
    velocity : down the slope, not turning [m/s]

    Raises ValueError for an angle that is not from 0 to below 90°.
    """
    if not 0.0 <= angle < 90.0:
        raise ValueError(f"angle = {angle:g}; it must be from 0 to below 90 degrees")
    s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    return Scene(
        bodies=(disc(radius, density),),
        q0=np.array([(radius * s, radius * c, 0.0)]),
        v0=np.array([(velocity * c, -velocity * s, 0.0)]),
        ground=(HalfPlane((0.0, 0.0), (float(s), float(c))),),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def bowling(
    velocity: float = 3.0,
    radius: float = 0.2,
    density: float = 1.0,
    mu: float = 0.2,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> Scene:
    """A disc that is thrown along the ground without turning: it slides, then rolls.

    velocity [m/s];  radius [m];  density [kg/m²]
    """
    return Scene(
        bodies=(disc(radius, density),),
        q0=np.array([(0.0, radius, 0.0)]),
        v0=np.array([(velocity, 0.0, 0.0)]),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


@at_most(rows=100)
def discs(
    rows: int = 2,
    radius: float = 0.5,
    density: float = 1.0,
    push: float = 0.0,
    mu: float = 0.3,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> Scene:
    """A pyramid of equal discs that touch, the lowest of its rows on the ground.

    rows : of rows, rows − 1, …, 1 discs;  radius [m];  density [kg/m²]
    push : the bottom discs start with v_x = ∓push, away from the middle [m/s]

    Raises ValueError for less than one row, or more than `MOST_POLYGONS` discs.
    """
    if not 1 <= rows * (rows + 1) // 2 <= MOST_POLYGONS:
        raise ValueError(f"rows = {rows}; they must make from 1 to {MOST_POLYGONS} discs")
    places = [
        ((2 * i - (rows - 1 - row)) * radius, (1 + row * np.sqrt(3)) * radius, 0.0)
        for row in range(rows)
        for i in range(rows - row)
    ]
    q0, v0 = np.array(places), np.zeros((len(places), 3))
    v0[:rows, 0] = push * np.sign(q0[:rows, 0])
    return Scene(
        bodies=(disc(radius, density),) * len(places),
        q0=q0,
        v0=v0,
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def wheel_edge(
    radius: float = 0.3,
    density: float = 1.0,
    width: float = 2.0,
    height: float = 1.0,
    weight: float = 20.0,
    velocity: float = 0.6,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """A disc that rolls along the top of a box, over its corner and down.

    radius [m];  density [kg/m²];  width, height of the box [m];  weight : density of the box, over
    that of the disc;  velocity : at the start, to the right, rolling or, without friction, sliding
    [m/s]
    """
    bodies: tuple[Body, ...] = (box(width, height, weight * density), disc(radius, density))
    spin = -velocity / radius if mu > 0 else 0.0
    return Scene(
        bodies=bodies,
        q0=np.array([(0.0, height / 2, 0.0), (width / 2 - 2 * radius, height + radius, 0.0)]),
        v0=np.array([(0.0, 0.0, 0.0), (velocity, 0.0, spin)]),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
