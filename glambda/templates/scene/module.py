"""A scene for glambda.  All named parameters are recorded with it."""

import numpy as np
from glambda import Scene, box


def {{ target }}(speed: float = 3.0, mu: float = 0.3, eps: float = 1e-3) -> Scene:
    """A box slides on the ground and hits another."""
    return Scene(
        bodies=(box(1.0, 1.0), box(1.0, 1.0)),  # width, height [m]; density 1 kg/m²
        q0=np.array([[0.0, 0.5, 0.0], [2.0, 0.5, 0.0]]),  # x, y [m], angle [rad]
        v0=np.array([[speed, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        mu=mu,
        eps=eps,
        end_time=2.0,
        stop_at_rest=True,
    )
