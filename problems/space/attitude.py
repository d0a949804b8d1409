"""Attitudes of bodies: unit quaternions (w, x, y, z) that turn axes of a body into the world's.

An attitude has four numbers and an angular velocity three, so that q̇ = T(q) v is not v.  Attitudes
are not added to: they are turned by rotation vectors, and stay of unit length to rounding.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

from problems.qp import Vector

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
"""The attitude of a body whose axes are the world's."""


def attitude(axis: tuple[float, float, float], angle: float) -> Vector:
    """The attitude (4,) of a body turned by `angle` [rad] about an axis of the world."""
    unit = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.append(np.cos(angle / 2), np.sin(angle / 2) * unit)


def attitudes_of(R: ArrayLike) -> Vector:
    """The attitudes (…, 4) of rotation matrices (…, 3, 3); `rotations` the other way round."""
    return np.asarray(
        np.roll(scipy.spatial.transform.Rotation.from_matrix(R).as_quat(), 1, axis=-1)
    )


def turned(e: Vector, turn: Vector) -> Vector:
    """Attitudes (n, 4) after rotation vectors (n, 3) [rad] in the world: exp(turn/2) e."""
    half = 0.5 * np.linalg.norm(turn, axis=1, keepdims=True)
    by = np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn])
    made = product(by, e)
    unit: Vector = made / np.linalg.norm(made, axis=1, keepdims=True)
    return unit


def product(a: Vector, b: Vector) -> Vector:
    """Hamilton's product of quaternions (n, 4): b first, then a."""
    w, x = a[:, :1], a[:, 1:]
    u, y = b[:, :1], b[:, 1:]
    scalar = w * u - np.sum(x * y, axis=1, keepdims=True)
    return np.hstack([scalar, w * y + u * x + cross(x, y)])


def cross(a: Vector, b: Vector) -> Vector:
    """Of vectors (…, 3): np.cross, which takes several times as long for a few."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    made[..., 0], made[..., 1], made[..., 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return made


def rotations(e: Vector) -> Vector:
    """Rotation matrices (n, 3, 3): columns are the axes of the bodies in the world."""
    w, x, y, z = e.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
