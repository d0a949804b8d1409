"""A heavy box on a light one, at rest: it stays there whatever the ratio of their masses."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def mass_ratio(
    ratio: float = 100.0,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> Scene:
    """A box lies on one of the same size and a `ratio`-th of its mass, which is 1 kg."""
    return Scene(
        bodies=(box(1.0, 1.0), box(1.0, 1.0, ratio)),
        q0=np.array([[0.0, 0.5, 0.0], [0.0, 1.5, 0.0]]),
        v0=np.zeros((2, 3)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
