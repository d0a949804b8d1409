"""Figure 5: a box on two boxes, one of which slides away."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def fig5(
    width: float = 2.0,
    height: float = 1.0,
    spacing: float = 2.5,
    density: float = 1.0,
    velocity: float = 4.0,
    mu: float = 0.5,
    mu_I: float = 0.8,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 15.0,
) -> Scene:
    """Box 3 lies on boxes 1 and 2; box 2 starts with v_x = 4, with friction (§4.4).

    width, height of a box [m]; spacing of the centres of boxes 1 and 2 [m]; velocity of box 2
    [m/s].  The run ends at rest.
    """
    q0 = np.array(
        [(0.0, height / 2, 0.0), (spacing, height / 2, 0.0), (spacing / 2, 1.5 * height, 0.0)]
    )
    v0 = np.zeros((3, 3))
    v0[1, 0] = velocity
    return Scene(
        bodies=(box(width, height, density),) * 3,
        q0=q0,
        v0=v0,
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
        stop_at_rest=True,
    )
