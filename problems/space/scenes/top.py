"""Tops: an asymmetric one that no force acts on, and a heavy symmetric one on its tip."""

from __future__ import annotations

import numpy as np

from problems.space.attitude import attitude, rotations
from problems.space.scene import Pin, SpaceScene
from problems.space.solids import Solid


def free_top(
    spin: float = 6.0,
    nudge: float = 0.01,
    small: float = 1.0,
    middle: float = 2.0,
    large: float = 2.5,
    eps: float = 1e-3,
    end_time: float = 3.0,
) -> SpaceScene:
    """A free asymmetric top that spins about its middle axis, and flips (Dzhanibekov).

    spin, nudge : angular velocity about the middle axis, and about the others [rad/s]
    small, middle, large : principal moments [kg·m²]
    """
    return SpaceScene(
        solids=(Solid(1.0, (small, middle, large)),),
        centres=np.zeros((1, 3)),
        attitudes=attitude((0.0, 0.0, 1.0), 0.0)[None],
        v0=np.array([[0.0, 0.0, 0.0, nudge, spin, nudge]]),
        planes=(),
        gravity=0.0,
        eps=eps,
        end_time=end_time,
    )


def heavy_top(
    spin: float = 40.0,
    tilt: float = 0.5,
    mass: float = 1.0,
    arm: float = 0.3,
    axial: float = 0.1,
    transverse: float = 0.2,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.0,
) -> SpaceScene:
    """A heavy symmetric top on a tip that is held, in steady precession.

    spin about its own axis [rad/s];  tilt of the axis from the vertical [rad];  arm from the tip to
    the centre of gravity [m];  axial, transverse : moments about the tip [kg·m²]

    With I₁ about the tip the slow precession ψ' solves
    (axial − I₁) cos(tilt) ψ'² + axial spin ψ' = mass gravity arm,  where the angular velocity along
    the axis is spin + ψ' cos(tilt).
    """
    about_centre = transverse - mass * arm**2
    rate = precession(spin, tilt, mass, arm, axial, transverse, gravity)
    turn = attitude((0.0, 1.0, 0.0), tilt)
    axis = rotations(turn[None])[0, :, 2]
    omega = np.array([0.0, 0.0, rate]) + spin * axis
    centre = arm * axis
    return SpaceScene(
        solids=(Solid(mass, (about_centre, about_centre, axial)),),
        centres=centre[None],
        attitudes=turn[None],
        v0=np.concatenate([np.cross(omega, centre), omega])[None],
        planes=(),
        pins=(Pin(0, (0.0, 0.0, -arm)),),
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def precession(
    spin: float, tilt: float, mass: float, arm: float, axial: float, transverse: float, g: float
) -> float:
    """The slow rate ψ' [rad/s] of a steady precession.

    Raises ValueError where there is none.
    """
    a, b, c = (axial - transverse) * np.cos(tilt), axial * spin, -mass * g * arm
    inside = b * b - 4 * a * c
    if inside < 0:
        raise ValueError(f"spin = {spin:g}: too slow for a steady precession; spin it faster")
    return float(-2 * c / (b + np.sqrt(inside)))
