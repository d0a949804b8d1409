"""A box or a ball that slides on level ground or down a slope, in any direction."""

from __future__ import annotations

import numpy as np

from problems.space.attitude import UPRIGHT, attitude, rotations
from problems.space.scene import Plane, SpaceScene
from problems.space.solids import ball, block


def slope(
    angle: float = 0.4,
    heading: float = 0.35,
    speed: float = 0.0,
    mu: float = 0.2,
    side: float = 1.0,
    height: float = 0.4,
    faces: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A box slides down a slope whose steepest line points anywhere.

    angle of the slope [rad];  heading : of its steepest line from x [rad];  speed : across that
    line, at t = 0 [m/s];  side, height of the box [m];  faces : of the friction polygon, 0 for
    Coulomb's disc
    """
    across = np.array([-np.sin(heading), np.cos(heading), 0.0])
    down = attitude((-np.sin(heading), np.cos(heading), 0.0), angle)
    n = rotations(down[None])[0, :, 2]
    return SpaceScene(
        solids=(block(side, side, height),),
        centres=0.5 * height * n[None],
        attitudes=down[None],
        v0=np.concatenate([speed * across, np.zeros(3)])[None],
        planes=(Plane(normal=(float(n[0]), float(n[1]), float(n[2]))),),
        mu=mu,
        faces=faces,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def skid(
    speed: float = 3.0,
    heading: float = 0.35,
    spin: float = 0.0,
    mu: float = 0.5,
    side: float = 1.0,
    height: float = 0.4,
    turn: float = 0.0,
    faces: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A box skids to a stop on level ground, turning or not.

    speed [m/s] in the direction of `heading` from x [rad];  spin about the vertical [rad/s]
    side, height of the box [m], turned by `turn` [rad];  faces : of the friction polygon, 0 for
    Coulomb's disc
    """
    return SpaceScene(
        solids=(block(side, side, height),),
        centres=np.array([[0.0, 0.0, 0.5 * height]]),
        attitudes=attitude((0.0, 0.0, 1.0), turn)[None],
        v0=np.array([[speed * np.cos(heading), speed * np.sin(heading), 0.0, 0.0, 0.0, spin]]),
        mu=mu,
        faces=faces,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def bowl(
    speed: float = 2.0,
    heading: float = 0.35,
    back_spin: float = 0.0,
    angle: float = 0.0,
    mu: float = 0.3,
    radius: float = 0.5,
    faces: int = 0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A ball is thrown along the ground: it slides, and then rolls at 5/7 of its speed.

    speed [m/s] in the direction of `heading` from x [rad];  back_spin : angular velocity against
    that of rolling [rad/s];  angle by which the ground falls towards x [rad];  radius [m]
    """
    normal = (float(np.sin(angle)), 0.0, float(np.cos(angle)))
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    along = np.cos(heading) * down + np.sin(heading) * np.array([0.0, 1.0, 0.0])
    omega = -back_spin * np.cross(normal, along)
    return SpaceScene(
        solids=(ball(radius),),
        centres=radius * np.array([normal]),
        attitudes=np.array([UPRIGHT]),
        v0=np.concatenate([speed * along, omega])[None],
        planes=(Plane(normal=normal),),
        mu=mu,
        faces=faces,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
