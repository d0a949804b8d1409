"""Linkages whose motion is known by other means: bilateral and non-holonomic constraints (§6).

What each does follows from its energy, or from equations in as many coordinates as it has freedoms:

    slider_crank     one freedom, the angle θ of the crank: ½ J(θ) θ̇² + V(θ) is constant
    double_pendulum  two angles; the inner stop makes one body of both while it is pressed
    skate            on ice that slopes it turns at a constant rate ω, and v̇ = −g sin ωt along it
    bungee           it falls freely, and swings as cos √(k/m) t while the string is taut
    bounce           after each impact it rises to e² of the height before, and rests in the end
    motor            it is driven by a constant force until it has come so far, and coasts
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import box
from problems.bodies.forces import Load, SpringDamper, Switched
from problems.joints.joints import Blade, Guide, Pin, Stop
from problems.scenes.scene import Scene


def slider_crank(
    angle: float = 60.0,
    speed: float = 4.0,
    crank: float = 0.3,
    rod: float = 1.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """A crank that turns about a pin, a rod, and a slider on a line through that pin.

    angle : of the crank [°];  speed : at which it turns [rad/s];  crank, rod : their lengths [m]

    Raises ValueError for a rod that is not longer than the crank.
    """
    if not rod > crank:
        raise ValueError(f"rod = {rod:g}, crank = {crank:g}; the rod must be longer")
    a = np.radians(angle)
    b = -np.arcsin(crank * np.sin(a) / rod)
    rate = -crank * np.cos(a) * speed / (rod * np.cos(b))
    end = crank * np.array([np.cos(a), np.sin(a)])
    along = rod * np.array([np.cos(b), np.sin(b)])
    ends, alongs = (np.array([-w[1], w[0]]) for w in (end, along))
    return Scene(
        bodies=(box(crank, 0.06), box(rod, 0.04), box(0.2, 0.12)),
        q0=np.array([(*(end / 2), a), (*(end + along / 2), b), (*(end + along), 0.0)]),
        v0=np.array(
            [
                (*(speed * ends / 2), speed),
                (*(speed * ends + rate * alongs / 2), rate),
                (*(speed * ends + rate * alongs), 0.0),
            ]
        ),
        ground=(),
        joints=(
            Pin(0, (-crank / 2, 0.0)),
            Pin(1, (-rod / 2, 0.0), 0, (crank / 2, 0.0)),
            Pin(2, (0.0, 0.0), 1, (rod / 2, 0.0)),
            Guide(2, (0.0, 0.0), (1.0, 0.0), fixes_angle=True),
        ),
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def double_pendulum(
    upper: float = 70.0,
    lower: float = 50.0,
    stop: float = 25.0,
    length: float = 1.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """Two bars on pins, with a stop that lets the lower turn against the upper by so much.

    upper, lower : their angles to the vertical at the start [°];  stop [°];  length : of each [m]
    """
    a, b = np.radians(upper) - np.pi / 2, np.radians(lower) - np.pi / 2
    knee = length * np.array([np.cos(a), np.sin(a)])
    half = length / 2
    return Scene(
        bodies=(box(length, 0.08), box(length, 0.08)),
        q0=np.array([(*(knee / 2), a), (*(knee + half * np.array([np.cos(b), np.sin(b)])), b)]),
        v0=np.zeros((2, 3)),
        ground=(),
        joints=(
            Pin(0, (-half, 0.0)),
            Pin(1, (-half, 0.0), 0, (half, 0.0)),
            Stop(1, 0, -np.radians(stop), np.radians(stop)),
        ),
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def skate(
    turn: float = 2.0,
    speed: float = 0.0,
    slope: float = 10.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 3.0,
) -> Scene:
    """A knife edge on ice that slopes: it does not slide down, it cycles across.

    turn : rate at which it turns [rad/s];  speed : along the edge [m/s];  slope [°]
    """
    return Scene(
        bodies=(box(0.3, 0.05),),
        q0=np.zeros((1, 3)),
        v0=np.array([(speed, 0.0, turn)]),
        ground=(),
        joints=(Blade(0),),
        gravity=gravity * float(np.sin(np.radians(slope))),
        eps=eps,
        end_time=end_time,
    )


def bungee(
    length: float = 1.0,
    stiffness: float = 40.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.5,
) -> Scene:
    """A box on a light elastic string falls from where the string begins.

    length : natural length of the string [m];  stiffness [N/m]
    """
    body = box(0.5, 0.5, 4.0)
    string = SpringDamper(0, (0.0, 0.0), (0.0, 0.0), stiffness, 0.0, length, slack=True)
    return Scene(
        bodies=(body,),
        q0=np.array([(0.0, -1e-6, 0.0)]),
        v0=np.zeros((1, 3)),
        ground=(),
        forces=(string,),
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def motor(
    force: float = 6.0,
    until_x: float = 1.0,
    mu: float = 0.2,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """A box on the ground that is pushed until it has come so far, and brakes.

    force [N];  until_x : where the force ends [m]
    """
    return Scene(
        bodies=(box(0.4, 0.2, 12.5),),
        q0=np.array([(0.0, 0.1, 0.0)]),
        v0=np.zeros((1, 3)),
        forces=(Switched(Load(0, (force, 0.0, 0.0)), lambda q, v, t: float(until_x - q[0, 0])),),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def bounce(
    restitution: float = 0.5,
    height: float = 1.0,
    spin: float = 0.0,
    mu: float = 0.0,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """A box that falls on the ground and bounces.

    restitution : from 0 to 1;  height : that it falls from [m];  spin : at the start [rad/s]
    """
    return Scene(
        bodies=(box(0.4, 0.2, 12.5),),
        q0=np.array([(0.0, height + 0.1, 0.0)]),
        v0=np.array([(0.0, 0.0, spin)]),
        mu=mu,
        mu_I=mu,
        restitution=restitution,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
