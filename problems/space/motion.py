"""Where bodies are, and their mass matrix there: M(q) = DᵀD, factorized at every position (2.2).

Velocities v (6n,) are those of the centre of gravity and the angular velocity, body by body, in
axes of the world: M is block diagonal, m times the unit matrix and R J Rᵀ, which turns with the
body; D is the upper triangular Cholesky factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from problems.qp import Vector
from problems.space.attitude import rotations, turned
from problems.space.solids import Solid


class Pose(NamedTuple):
    """Centres (n, 3) [m] and attitudes (n, 4)."""

    centres: Vector
    attitudes: Vector

    def moved(self, way: Vector) -> Pose:
        """After ways and rotation vectors (6n,) in the world."""
        step = way.reshape(-1, 6)
        return Pose(self.centres + step[:, :3], turned(self.attitudes, step[:, 3:]))


class Mass:
    """M = DᵀD of bodies at a pose.

    root : (n,) √m;  D, inverse : (n, 3, 3) the factors of R J Rᵀ and their inverses
    """

    def __init__(self, solids: Sequence[Solid], attitudes: Vector) -> None:
        R = rotations(attitudes)
        J = np.array([solid.inertia for solid in solids])
        inertia = np.einsum("nij,nj,nkj->nik", R, J, R)
        self.root = np.sqrt([solid.mass for solid in solids])
        self.D = np.swapaxes(np.linalg.cholesky(inertia), 1, 2)
        self.inverse = np.linalg.inv(self.D)

    def scaled(self, v: Vector) -> Vector:
        """D v."""
        return self._blocks(v, self.root, self.D)

    def unscaled(self, w: Vector) -> Vector:
        """D⁻¹ w."""
        return self._blocks(w, 1 / self.root, self.inverse)

    def momentum(self, v: Vector) -> Vector:
        """M v: momentum and angular momentum about the centres."""
        return self._blocks(self.scaled(v), self.root, np.swapaxes(self.D, 1, 2))

    def forced(self, p: Vector) -> Vector:
        """D⁻ᵀ p of forces, or momenta."""
        return self._blocks(p, 1 / self.root, np.swapaxes(self.inverse, 1, 2))

    def _blocks(self, v: Vector, root: Vector, turn: Vector) -> Vector:
        parts = v.reshape(-1, 6)
        turned_part = np.einsum("nij,nj->ni", turn, parts[:, 3:])
        return np.hstack([root[:, None] * parts[:, :3], turned_part]).ravel()
