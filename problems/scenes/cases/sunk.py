"""A box that begins a little below the ground: recovery from an overlap, without a jump."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def sunk(
    depth: float = 5e-4,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 0.5,
) -> Scene:
    """A unit box begins `depth` below the ground [m], within what counts as contact.

    Nothing moves it without a rule against drift; Baumgarte's lifts it as exp(−t/τ).
    """
    return Scene(
        bodies=(box(1.0, 1.0),),
        q0=np.array([[0.0, 0.5 - depth, 0.0]]),
        v0=np.zeros((1, 3)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
