"""Columns of G: a direction at a point that two bodies share, or a body and the ground."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.contacts.assembly import DENSE_ENTRIES
from problems.qp import Indices, Matrix, Vector
from problems.space.attitude import cross
from problems.space.motion import Mass


class Columns(NamedTuple):
    """g of k constraints: how fast the first body moves along a direction, seen from the second.

    bodies : (k, 2), −1 is the ground;  entries : (k, 2, 6)
    """

    bodies: Indices
    entries: Vector

    @classmethod
    def along(cls, u: Vector, points: Vector, bodies: Indices, centres: Vector) -> Columns:
        """Of unit vectors u (k, 3) at points (k, 3) [m]."""
        every = np.vstack([centres, np.zeros(3)])  # index −1: the ground
        arms = points[:, None] - every[bodies]
        both = np.broadcast_to(u[:, None], arms.shape)
        entries = np.concatenate([both, cross(arms, both)], axis=2)
        entries[:, 1] *= -1
        entries[bodies < 0] = 0.0
        return cls(bodies, entries)

    def speeds(self, v: Vector) -> Vector:
        """Gᵀ v (k,)."""
        every = np.vstack([v.reshape(-1, 6), np.zeros(6)])
        return np.einsum("kij,kij->k", self.entries, every[self.bodies])

    def force(self, lam: Vector, n: int) -> Vector:
        """G λ (6n,)."""
        total = np.zeros((n + 1, 6))
        np.add.at(total, self.bodies, self.entries * lam[:, None, None])
        return total[:-1].ravel()

    def scaled(self, mass: Mass) -> Matrix:
        """A = D⁻ᵀ G, dense unless it is large."""
        n, k = mass.root.size, len(self.bodies)
        root = np.append(mass.root, 1.0)
        inverse = np.concatenate([mass.inverse, np.eye(3)[None]])
        entries = np.concatenate(
            [
                self.entries[..., :3] / root[self.bodies][..., None],
                np.einsum("kbji,kbj->kbi", inverse[self.bodies], self.entries[..., 3:]),
            ],
            axis=2,
        )
        if 6 * n * k <= DENSE_ENTRIES:
            A = np.zeros((n + 1, 6, k))
            for side in (0, 1):
                A[self.bodies[:, side], :, np.arange(k)] += entries[:, side]
            return np.ascontiguousarray(A[:-1].reshape(6 * n, k))
        own = self.bodies >= 0
        rows = (6 * self.bodies[..., None] + np.arange(6))[own].ravel()
        numbers = np.broadcast_to(np.arange(k)[:, None, None], (k, 2, 6))[own].ravel()
        return sp.csc_array((entries[own].ravel(), (rows, numbers)), shape=(6 * n, k))
