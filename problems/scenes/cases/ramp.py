"""A block on a ramp: it sticks where μ ≥ tan θ, and slides with g (sin θ − μ cos θ) where not."""

import numpy as np

from problems.bodies.bodies import box
from problems.contacts.geometry import HalfPlane
from problems.scenes.scene import Scene


def ramp(
    angle: float = 0.4,
    mu: float = 0.5,
    width: float = 2.0,
    height: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> Scene:
    """A flat block at rest on a ramp that falls to the right; it sticks if mu ≥ tan(angle).

    angle of the ramp [rad];  width, height of the block [m], which tips where height tan(angle)
    exceeds width
    """
    normal = np.array([np.sin(angle), np.cos(angle)])
    return Scene(
        bodies=(box(width, height),),
        q0=np.array([[*(0.5 * height * normal), -angle]]),
        v0=np.zeros((1, 3)),
        ground=(HalfPlane((0.0, 0.0), (float(normal[0]), float(normal[1]))),),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
