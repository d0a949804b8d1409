"""A masonry arch: half a circle of voussoirs stands if it is thick enough, t/R = 0.1075."""

import numpy as np

from problems.bodies.bodies import polygon_body
from problems.scenes.scene import MOST_POLYGONS, Scene, at_most


@at_most(stones=MOST_POLYGONS)
def arch(
    stones: int = 19,
    thickness: float = 0.12,
    radius: float = 1.0,
    mu: float = 1.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 0.5,
) -> Scene:
    """A half circle of voussoirs on the ground; it stands where thickness/radius > 0.1075.

    thickness of the ring, radius of its middle line [m]

    Least thickness of a half circle under its own weight, without sliding: t/R = 0.1075
    (Milankovitch 1907).  Stones whose joints are not where the hinges want to be stand a little
    below that.
    """
    joints = np.linspace(0.0, np.pi, stones + 1)
    rays = np.column_stack([np.cos(joints), np.sin(joints)])
    inner, outer = (radius - thickness / 2) * rays, (radius + thickness / 2) * rays
    parts = [np.array([inner[i], outer[i], outer[i + 1], inner[i + 1]]) for i in range(stones)]
    bodies = tuple(polygon_body(part) for part in parts)
    # a body's corners are those of its part, shifted to the centre of gravity
    centres = [part[0] - body.polygons[0][0] for part, body in zip(parts, bodies, strict=True)]
    q0 = np.column_stack([np.array(centres), np.zeros(stones)])
    return Scene(
        bodies=bodies,
        q0=q0,
        v0=np.zeros((stones, 3)),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
