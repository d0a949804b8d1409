"""What §6 says the method is for beside heaps: an arm, a vehicle, a figure, a frame that yields."""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import GROUND, Body, box, disc, polygon_body
from problems.bodies.forces import Drive, Load, SpringDamper, Switched
from problems.contacts.geometry import HalfPlane
from problems.joints.joints import Apart, Guide, Joint, Pin, Rod, Stop, Weld
from problems.scenes.scene import Scene


def arm(
    torque: float = 60.0,
    frequency: float = 0.5,
    wall: float = 1.5,
    mu: float = 0.3,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 2.0,
) -> Scene:
    """A robot's arm of three links with limits at its joints, which strikes a wall.

    torque : of the motor at the shoulder, at the most [N·m];  frequency : of all motors [1/s]
    wall : its distance from the shoulder [m]
    """
    sizes = (0.8, 0.6, 0.4)
    links = [box(length, 0.08, 20.0) for length in sizes]
    angles, place, q = (0.9, 0.1, -0.7), np.array([0.0, 1.0]), []
    for length, angle in zip(sizes, angles, strict=True):
        along = length * np.array([np.cos(angle), np.sin(angle)])
        q.append((*(place + along / 2), angle))
        place = place + along
    joints: list[Joint] = [Pin(0, (-0.4, 0.0), GROUND, (0.0, 1.0)), Stop(0, GROUND, -1.2, 2.0)]
    joints += [Apart(0)]
    drives = [Drive(0, (0.0, 0.0, -torque), frequency)]
    for i in (1, 2):
        joints += [Pin(i, (-sizes[i] / 2, 0.0), i - 1, (sizes[i - 1] / 2, 0.0))]
        joints += [Stop(i, i - 1, -1.5, 1.5)]
        drives += [Drive(i, (0.0, 0.0, -torque / 4**i), frequency, i)]
        drives += [Drive(i - 1, (0.0, 0.0, torque / 4**i), frequency, i)]
    return Scene(
        bodies=tuple(links),
        q0=np.array(q),
        v0=np.zeros((3, 3)),
        ground=(HalfPlane(), HalfPlane((wall, 0.0), (-1.0, 0.0))),
        joints=tuple(joints),
        forces=tuple(drives),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def vehicle(
    torque: float = 25.0,
    top_speed: float = 4.0,
    bump: float = 0.08,
    mu: float = 0.8,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 3.0,
) -> Scene:
    """A car with springs and a motor at its rear wheel, on a road with a bump.

    torque : of the motor [N·m], which switches off at top_speed [m/s];  bump : its height [m]
    """
    radius, wheel = 0.3, disc(0.3, 40.0)
    ramp = polygon_body([(-0.6, 0.0), (0.6, 0.0), (0.2, bump), (-0.2, bump)])
    low = float(ramp.polygons[0][:, 1].min())
    joints: list[Joint] = [Weld(3, GROUND), Apart(0, 3)]
    forces: list[SpringDamper | Switched] = []
    for i, x in ((1, -0.8), (2, 0.8)):
        joints.append(Guide(i, (0.0, 0.0), (0.0, 1.0), 0, (x, 0.0)))
        joints.append(Apart(i, 0))
        forces.append(SpringDamper(i, (0.0, 0.0), (x, 0.5), 3000.0, 250.0, 0.9, other=0))

    def slow(q: np.ndarray, v: np.ndarray, t: float) -> float:
        return float(top_speed - v[0, 0])

    for i, moment in ((1, -torque), (0, torque)):
        forces.append(Switched(Load(i, (0.0, 0.0, moment)), slow))
    return Scene(
        bodies=(box(2.2, 0.4, 80.0), wheel, wheel, ramp),
        q0=np.array([(0, 0.68, 0), (-0.8, radius, 0), (0.8, radius, 0), (4.0, -low, 0)]),
        v0=np.zeros((4, 3)),
        joints=tuple(joints),
        forces=tuple(forces),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


LIMBS = {
    "trunk": (0.60, 0.22), "head": (0.24, 0.18), "arm": (0.32, 0.09), "forearm": (0.30, 0.08),
    "thigh": (0.42, 0.14), "shank": (0.42, 0.10), "foot": (0.22, 0.07),
}  # fmt: skip
"""Length and width of the parts of a human figure [m]."""


def human(
    push: float = 1.0,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """A human figure, seen from its side, with limits at elbow, knee and neck, falls.

    push : velocity of the trunk forwards at the start [m/s]
    """
    up = np.pi / 2
    sizes = list(LIMBS.values())
    bodies = tuple(box(length, width, 1000.0 * width) for length, width in sizes)
    ankle, knee, hip, neck = 0.07, 0.49, 0.91, 1.51
    q0 = np.array(
        [
            (0, (hip + neck) / 2, up), (0, neck + 0.12, up), (0, neck - 0.24, -up),
            (0, neck - 0.55, -up), (0, (knee + hip) / 2, -up), (0, (ankle + knee) / 2, -up),
            (0.06, ankle / 2, 0),
        ]
    )  # fmt: skip
    v0 = np.zeros((7, 3))
    v0[:4, 0] = push
    joints: tuple[Joint, ...] = (
        Pin(1, (-0.12, 0.0), 0, (0.30, 0.0)), Stop(1, 0, -0.7, 0.5),        # neck
        Pin(2, (-0.16, 0.0), 0, (0.22, 0.0)),                               # shoulder
        Pin(3, (-0.15, 0.0), 2, (0.16, 0.0)), Stop(3, 2, 0.0, 2.5),         # elbow
        Pin(4, (-0.21, 0.0), 0, (-0.30, 0.0)), Stop(4, 0, -np.pi - 0.5, -np.pi + 2.0),  # hip
        Pin(5, (-0.21, 0.0), 4, (0.21, 0.0)), Stop(5, 4, -2.4, 0.0),        # knee
        Pin(6, (-0.06, 0.035), 5, (0.21, 0.0)), Stop(6, 5, up - 0.6, up + 0.6),  # ankle
        *(Apart(i, j) for i, j in ((3, 0), (2, 1), (3, 1), (2, 4), (3, 4), (3, 5), (6, 4))),
    )  # fmt: skip
    return Scene(
        bodies=bodies,
        q0=q0,
        v0=v0,
        joints=joints,
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )


def frame(
    load: float = 400.0,
    tension: float = 250.0,
    storeys: int = 1,
    mu: float = 0.5,
    gravity: float = 9.81,
    eps: float = 1e-3,
    end_time: float = 1.5,
) -> Scene:
    """A building frame of pinned columns, held by bars that yield under a load from the side.

    load : on the top beam, from 0.2 s on [N];  tension : at which a bar yields [N], it never pushes
    storeys : of 1 m
    """
    bodies: list[Body] = []
    q: list[tuple[float, float, float]] = []
    joints: list[Joint] = []
    for storey in range(storeys):
        below, first = storey - 1, 3 * storey
        bodies += [box(0.1, 0.9, 100.0), box(0.1, 0.9, 100.0), box(1.6, 0.1, 100.0)]
        q += [(-0.7, storey + 0.45, 0.0), (0.7, storey + 0.45, 0.0), (0.0, storey + 0.95, 0.0)]
        beam = 3 * below + 2 if storey else GROUND
        for i, x in ((0, -0.7), (1, 0.7)):
            foot = (x, 0.05) if storey else (x, 0.0)
            joints.append(Pin(first + i, (0.0, -0.45), beam, foot))
            joints.append(Pin(first + 2, (x, -0.05), first + i, (0.0, 0.45)))
            head = Rod(first + 2, (-x, -0.05), beam, foot, tension=tension, compression=0.0)
            joints.append(head)
    return Scene(
        bodies=tuple(bodies),
        q0=np.array(q),
        v0=np.zeros((len(bodies), 3)),
        joints=tuple(joints),
        forces=(Load(len(bodies) - 1, (load, 0.0, 0.0), start=0.2),),
        mu=mu,
        gravity=gravity,
        eps=eps,
        end_time=end_time,
    )
