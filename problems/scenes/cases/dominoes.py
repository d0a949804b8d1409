"""Two dominoes: the first tips about its foot and strikes the second at sin φ = gap/height."""

import numpy as np

from problems.bodies.bodies import box
from problems.scenes.scene import Scene


def dominoes(
    height: float = 1.0,
    thickness: float = 0.2,
    gap: float = 0.5,
    spin: float = 1.5,
    mu: float = 0.6,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """The first of two dominoes is spun about its lower right corner, and strikes the second.

    gap between them [m];  spin : speed about that corner at the start [rad/s], clockwise

    Where the foot sticks, ½ J spin² + m g (y − y₀) is kept with J about the corner, until the upper
    corner has gone as far as the gap.
    """
    x, y = thickness / 2, height / 2
    return Scene(
        bodies=(box(thickness, height),) * 2,
        q0=np.array([[0.0, y, 0.0], [thickness + gap, y, 0.0]]),
        v0=np.array([[spin * y, spin * x, -spin], [0.0, 0.0, 0.0]]),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
