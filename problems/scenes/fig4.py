"""Figure 4: three standing boxes; the first is pushed and they fall against each other."""

import numpy as np

from problems.bodies.bodies import box
from problems.bodies.forces import Impulse
from problems.scenes.scene import MOST_BODIES, Scene, at_most


@at_most(boxes=MOST_BODIES)
def fig4(
    boxes: int = 3,
    width: float = 1.0,
    height: float = 3.0,
    gap: float = 1.0,
    density: float = 1.0,
    push: float = 10.0,
    moment: float = -10.0,
    mu: float = 0.5,
    mu_I: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 15.0,
) -> Scene:
    """Three standing boxes with friction; an impulse (push, 0, moment) tips the first (§4.4).

    width, height of a box and the gap between two [m]; push [N·s] and moment [N·m·s] as printed: a
    push at 1 m above the centre.  The run ends at rest.
    """
    q0 = np.zeros((boxes, 3))
    q0[:, 0] = (width + gap) * np.arange(boxes)
    q0[:, 1] = height / 2
    return Scene(
        bodies=(box(width, height, density),) * boxes,
        q0=q0,
        v0=np.zeros((boxes, 3)),
        impulses=(Impulse(0.0, 0, (push, 0.0, moment)),),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
        stop_at_rest=True,
    )
