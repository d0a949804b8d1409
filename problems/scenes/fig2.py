"""Figure 2: a tower of boxes, one of them pushed."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import MOST_BODIES, Scene, at_most


@at_most(boxes=MOST_BODIES)
def fig2(
    boxes: int = 5,
    width: float = 1.5,
    height: float = 1.0,
    density: float = 1.0,
    pushed: int = 2,
    velocity: float = 2.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 6.0,
) -> Scene:
    """Five boxes piled on each other without friction; box 2 starts with v_x = 2 (§3.4).

    boxes are numbered from the bottom; width, height [m]; density [kg/m²]; velocity [m/s] of box
    number `pushed`.

    Raises ValueError for a `pushed` that is no box.
    """
    if not 1 <= pushed <= boxes:
        raise ValueError(f"pushed = {pushed}; it must be a box from 1 to {boxes}")
    q0 = np.zeros((boxes, 3))
    q0[:, 1] = height * (np.arange(boxes) + 0.5)
    v0 = np.zeros((boxes, 3))
    v0[pushed - 1, 0] = velocity
    return Scene(
        bodies=(box(width, height, density),) * boxes,
        q0=q0,
        v0=v0,
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
