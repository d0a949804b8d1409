"""Cundall's springs and dampers at the contacts, the paper's own foil ([7], analysed in [26]).

Bodies may overlap.  A corner that is inside a part by δ = −φ > 0 is pushed out through that edge
whose normal is nearest to the direction in which the two parts overlap least, and dragged along it:

    F_N = max(0, k δ − c g_Nᵀq̇)
    F_T ← F_T − k_T h g_Fᵀq̇,   |F_T| ≤ μ F_N

c being the share `damping` of what is critical for the two bodies, c = 2 ζ √(k m), 1/m =
g_NᵀM⁻¹g_N.  Time goes on by central differences, as Cundall's does: q̇ at the middle of a step,
q at its end,

    q̇_{n+½} = q̇_{n−½} + h M⁻¹ f(q_n, q̇_{n−½}),   q_{n+1} = q_n + h q̇_{n+½}.

No QP is solved, no event is located, and nothing is ill-posed; the price is the overlap, some
weight/k, and the step, which must be well below 2√(m/k).  A body that rests rests in a spring.
"""

from __future__ import annotations

import numpy as np

from problems.bodies.bodies import GROUND, mass_diagonal
from problems.contacts.geometry import Columns, Geometry, Pose
from problems.qp import Indices, Vector
from problems.scenes import Scene

SAFETY = 0.05
"""Step over 2√(m/k) of the lightest body: many springs may act on one body at once."""


class SpringsAndDampers:
    """The state of one simulation; `step` moves it on by h.

    stiffness : k of every contact [N/m];  shear : k_T/k;  damping : ζ, share of the critical one

    Raises ValueError for a stiffness that is not positive or a share that is negative.
    """

    def __init__(
        self, scene: Scene, stiffness: float, *, damping: float = 0.5, shear: float = 0.5
    ) -> None:
        if not (np.isfinite(stiffness) and stiffness > 0):
            raise ValueError(f"stiffness = {stiffness!r}; it must be a positive number [N/m]")
        if not (damping >= 0 and shear >= 0):
            raise ValueError(f"damping = {damping!r}, shear = {shear!r}; neither may be negative")
        self.scene, self.stiffness, self.damping, self.shear = scene, stiffness, damping, shear
        self.geometry = Geometry(scene.bodies, scene.ground)
        self.M = mass_diagonal(scene.bodies)
        self.t, self.q, self.v = 0.0, scene.q0.ravel().copy(), scene.v0.ravel().copy()
        self._forces = scene.all_forces()
        self._drag: dict[tuple[int, int], float] = {}

    @property
    def largest_step(self) -> float:
        """`SAFETY` × 2√(m/k) of the lightest body [s]."""
        lightest = min(body.mass for body in self.scene.bodies)
        return SAFETY * 2.0 * float(np.sqrt(lightest / self.stiffness))

    def step(self, h: float) -> None:
        """One step of length h [s]."""
        f = np.zeros_like(self.q)
        for force in self._forces:
            force.add(f, self.q, self.v, self.t)
        self._add_contacts(f, h)
        self.v = self.v + h * f / self.M
        for impulse in self.scene.impulses:
            if self.t <= impulse.t < self.t + h:
                i = 3 * impulse.body
                self.v[i : i + 3] += np.array(impulse.value) / self.M[i : i + 3]
        self.q = self.q + h * self.v
        self.t += h

    def kinetic_energy(self) -> float:
        """½ q̇ᵀ M q̇ [J], with q̇ half a step before q."""
        return 0.5 * float(self.M @ self.v**2)

    def _add_contacts(self, f: Vector, h: float) -> None:
        """Add the forces of all overlaps to f (3n,)."""
        pose = self.geometry.pose(self.q)
        corner, part, edge = self._overlaps(pose)
        if not corner.size:
            self._drag = {}
            return
        columns = self.geometry.columns(pose, corner, part, edge)
        index = self._entries(columns)
        moving = index >= 0
        v = np.where(moving, self.v[index], 0.0)
        per_mass = np.where(moving, 1.0 / self.M[index], 0.0)
        effective = 1.0 / (columns.normal**2 * per_mass).sum(axis=1)
        c = 2.0 * self.damping * np.sqrt(self.stiffness * effective)
        push = -self.stiffness * columns.phi - c * (columns.normal * v).sum(axis=1)
        push = np.maximum(push, 0.0)
        slip = (columns.tangent * v).sum(axis=1)
        keys = [(int(a), int(b)) for a, b in zip(corner, part, strict=True)]
        held = np.array([self._drag.get(key, 0.0) for key in keys])
        mu = np.array([self.scene.mu_between(int(a), int(b)) for a, b in columns.bodies])
        drag = held - self.shear * self.stiffness * h * slip
        drag = np.clip(drag, -mu * push, mu * push)
        self._drag = dict(zip(keys, drag.tolist(), strict=True))
        total = columns.normal * push[:, None] + columns.tangent * drag[:, None]
        np.add.at(f, index[moving], total[moving])

    def _overlaps(self, pose: Pose) -> tuple[Indices, Indices, Indices]:
        """(corner, part, edge) of every corner that is inside a part of another body."""
        found: list[tuple[int, int, int]] = []
        for pair in self.geometry.near_pairs(pose, 0.0):
            sides = [(part, other) for part, other in (pair, pair[::-1]) if self._size(other)]
            phi = [self._distances(pose, *side) for side in sides]
            # the best separating axis: the edge that all corners of the other are least inside
            depth = [distances.min(axis=0) for distances in phi]
            best = int(np.argmax([edges.max() for edges in depth]))
            if depth[best].max() >= 0:
                continue
            axis = self._normals(pose, sides[best][0])[int(depth[best].argmax())]
            for place, (part, other) in enumerate(sides):
                along = self._normals(pose, part) @ (axis if place == best else -axis)
                edge = int(along.argmax())
                first = int(self.geometry.part_first[other])
                inside = np.flatnonzero(phi[place].max(axis=1) < 0)
                found += [(first + int(corner), part, edge) for corner in inside]
        places = np.array(found, dtype=np.int64).reshape(-1, 3)
        return places[:, 0], places[:, 1], places[:, 2]

    def _size(self, part: int) -> int:
        return int(self.geometry.part_size[part])

    def _distances(self, pose: Pose, part: int, other: int) -> Vector:
        """φ of the corners of `other` against the edges of `part`; −inf where there is no edge."""
        first, size = int(self.geometry.part_first[other]), self._size(other)
        return self.geometry.distances(pose, np.arange(first, first + size), np.full(size, part))

    def _normals(self, pose: Pose, part: int) -> Vector:
        """Outward normals of the edges of a part, (E, 2)."""
        b, edges = self.geometry.part_body[part], max(self._size(part), 1)
        local = self.geometry.edge_normal[part, :edges]
        c, s = pose.cosine[b], pose.sine[b]
        return local @ np.array([[c, s], [-s, c]])

    def _entries(self, columns: Columns) -> Indices:
        """Positions in q of the six entries of each column, −1 for the ground's.  (N, 6)"""
        first = np.where(columns.bodies == GROUND, -1, 3 * columns.bodies)
        offsets = np.arange(3)
        return np.concatenate(
            [np.where(one < 0, -1, one + offsets) for one in (first[:, :1], first[:, 1:])], axis=1
        )
