"""States of bodies in space as engines tell them, and what is measured of them.

A state is centres and rotation matrices, (n, 12): numbers that can be told apart one by one, which
quaternions with their two signs cannot; and (n, 6) velocities and angular velocities.  All in axes
of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from harness.peers.base import GROUND_DEPTH, GROUND_MARGIN
from problems.qp import Vector
from problems.space.attitude import attitudes_of, cross, rotations
from problems.space.contacts import Near
from problems.space.motion import Pose
from problems.space.scene import SpaceScene


def state_of(centres: Vector, R: Vector) -> Vector:
    """(…, n, 12) of centres (…, n, 3) [m] and rotation matrices (…, n, 3, 3)."""
    return np.concatenate([centres, R.reshape(*R.shape[:-2], 9)], axis=-1)


def rotation(state: Vector) -> Vector:
    """Rotation matrices (…, n, 3, 3) of states."""
    return state[..., 3:].reshape(*state.shape[:-1], 3, 3)


def frame_of(normal: Sequence[float]) -> Vector:
    """A rotation matrix (3, 3) whose third column is a unit vector."""
    turn, _ = Rotation.align_vectors([normal], [(0.0, 0.0, 1.0)])
    return np.asarray(turn.as_matrix())


class Slab(NamedTuple):
    """A half space as a box: middle and sides [m], and its axes as columns."""

    centre: Vector
    size: Vector
    R: Vector


def slabs(scene: SpaceScene) -> list[Slab]:
    """A box for each plane, `GROUND_DEPTH` thick, its upper side on the surface.

    It spans the scene and `GROUND_MARGIN` more on either side.
    """
    reach = 2 * (float(np.abs(scene.centres).max()) + GROUND_MARGIN)
    size = np.array([reach, reach, GROUND_DEPTH])
    axes = [frame_of(plane.normal) for plane in scene.planes]
    return [
        Slab(plane.point - 0.5 * GROUND_DEPTH * R[:, 2], size, R)
        for plane, R in zip(scene.planes, axes, strict=True)
    ]


def first_state(scene: SpaceScene) -> Vector:
    """Of t = 0, (n, 12)."""
    return state_of(scene.centres, rotations(scene.attitudes))


def rate(state: Vector, v: Vector) -> Vector:
    """The derivative (…, n, 12) of states that move with v: Ṙ = ω × R, column by column."""
    columns = np.swapaxes(rotation(state), -1, -2)
    turning = np.swapaxes(cross(v[..., None, 3:], columns), -1, -2)
    return state_of(v[..., :3], turning)


def velocity(state: Vector, derivative: Vector) -> Vector:
    """v (…, n, 6) of states and their derivatives: ω is the axial vector of Ṙ Rᵀ."""
    W = rotation(derivative) @ np.swapaxes(rotation(state), -1, -2)
    axial = np.stack([W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0],
                      W[..., 1, 0] - W[..., 0, 1]], axis=-1)  # fmt: skip
    return np.concatenate([derivative[..., :3], 0.5 * axial], axis=-1)


def energy(scene: SpaceScene, q: Vector, v: Vector) -> Vector:
    """T + V of gravity from z = 0, for states (times, n, 12), in (times,) [J]."""
    mass = np.array([solid.mass for solid in scene.solids])
    J = np.array([solid.inertia for solid in scene.solids])
    turning = np.einsum("tnji,tnj->tni", rotation(q), v[..., 3:])  # ω in axes of the body
    kinetic = 0.5 * (mass * (v[..., :3] ** 2).sum(-1) + (J * turning**2).sum(-1))
    return np.asarray((kinetic + scene.gravity * mass * q[..., 2]).sum(-1))


def penetration(scene: SpaceScene, q: Vector) -> float:
    """The deepest overlap of two bodies, or of one and a plane, at any time [m]; at least 0."""
    near, deepest = Near(scene), 0.0
    for state in q:
        points = near.points(Pose(state[:, :3], attitudes_of(rotation(state))), 0.0)
        deepest = max([deepest, *(-point.gap for point in points)])
    return float(deepest)


def moved(scene: SpaceScene, state: Vector) -> tuple[list[float], list[float]]:
    """How far each body has moved along an axis since t = 0 [m], and by how much turned [rad]."""
    start = first_state(scene)
    drift = np.abs(state[:, :3] - start[:, :3]).max(axis=1)
    apart = np.linalg.norm(rotation(state) - rotation(start), axis=(1, 2))
    turn = 2 * np.arcsin(np.minimum(apart / np.sqrt(8), 1.0))  # ‖R − R₀‖ = 2√2 sin(turn/2)
    return drift.tolist(), turn.tolist()
