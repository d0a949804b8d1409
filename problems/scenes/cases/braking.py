"""A block slides to a stop: v²/(2μg), and it must not lift where μ is below width/height."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def braking(
    speed: float = 6.0,
    mu: float = 0.5,
    width: float = 1.0,
    height: float = 1.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 10.0,
) -> Scene:
    """A cube pushed at 6 m/s stops after speed²/(2 mu gravity), both corners on the ground.

    speed [m/s];  width, height [m]
    """
    return Scene(
        bodies=(box(width, height),),
        q0=np.array([[0.0, height / 2, 0.0]]),
        v0=np.array([[speed, 0.0, 0.0]]),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
        stop_at_rest=True,
    )
