"""Figure 3: a hexagon in a spring and damper, dropped on the ground."""

import numpy as np

from problems.bodies.bodies import polygon_body
from problems.bodies.forces import SpringDamper
from problems.scenes.scene import Scene


def fig3(
    side: float = 1.5,
    waist: float = 3.5,
    height: float = 3.0,
    density: float = 1.0,
    stiffness: float = 6.0,
    damping: float = 6.0,
    length: float = 0.0,
    anchor_above: float = 2.0,
    clearance: float = 2.0,
    mu: float = 0.0,
    mu_I: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 12.0,
) -> Scene:
    """A homogeneous hexagon hangs by a corner in a spring and damper above the ground (§3.4).

    side : its lowest and highest side [m];  waist : its width in the middle [m]
    stiffness [N/m], damping [N·s/m], natural length [m] of the spring from its top left corner to
    an anchor `anchor_above` it;  clearance : of the lowest side above the ground [m]
    """
    x, wide, y = side / 2, waist / 2, height / 2
    corners = np.array([(-x, -y), (x, -y), (wide, 0), (x, y), (-x, y), (-wide, 0)])
    centre = clearance + y
    spring = SpringDamper(
        body=0,
        point=(-x, y),
        anchor=(-x, centre + y + anchor_above),
        stiffness=stiffness,
        damping=damping,
        length=length,
    )
    return Scene(
        bodies=(polygon_body(corners, density),),
        q0=np.array([[0.0, centre, 0.0]]),
        v0=np.zeros((1, 3)),
        forces=(spring,),
        mu=mu,
        mu_I=mu_I,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
