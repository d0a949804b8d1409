"""The data structure of §5 and figure 6: bodies, contacts and constraints as vertices of a graph.

A `Contact` joins two bodies; it holds one `Normal` constraint, or two when edge lies on edge, and
with friction one `Friction` constraint (λ_F is bounded by μ times the sum of its normals).  From a
constraint one reaches its contact, from a contact its bodies and constraints, from a body its
contacts.  Insertion and deletion touch only the vertices concerned.  Whatever order matters for a
recording is the order of `row_id`, given once and never reused.

Candidates are the pairs (corner, part) that are near but not active, φ > 0 in the paper's words.
They are found by the broad phase, with a margin, so that the list stays valid until something has
moved by half of it.  A candidate may carry a *reference level*: where a contact was dropped with
φ < 0 (drift is proportional to ε), the corner collides on φ − level, else it would never do so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from problems.contacts import PARALLEL_SINE, Geometry, Pose
from problems.qp import Indices, Vector
from problems.shapes import cross

FORGET_LEVEL = 1e-6
"""A reference level is forgotten once the corner is this far outside [m]."""
ROUNDING = 1e-12
"""A gap that closes by less than this has not changed [m]."""


@dataclass(eq=False)
class Normal:
    """A contact constraint φ ≥ 0 with its multiplier at the last two time points."""

    row_id: int
    corner: int
    part: int
    edge: int
    contact: Contact = field(repr=False)
    lam: float = 0.0
    lam_before: float = 0.0

    @property
    def place(self) -> tuple[int, int, int]:
        return self.corner, self.part, self.edge


@dataclass(eq=False)
class Friction:
    """A friction constraint on g_Fᵀq̇ of one contact.

    sign : 0 while the contact sticks (J_FO); else s = −sign(g_Fᵀq̇) of sliding (J_FW), (2.10)
    """

    row_id: int
    contact: Contact = field(repr=False)
    sign: int = 0


@dataclass(eq=False)
class Contact:
    """Two parts in contact at one point or, with two normals, along their edges."""

    pair: tuple[int, int]
    mu: float
    normals: list[Normal] = field(default_factory=list)
    friction: Friction | None = None


class ActiveSet(NamedTuple):
    """J_N and J_F in the order of row_id, in arrays.

    place : (N, 3) corner, part, edge;  feature : (N, 5), see `ContactQP`
    friction_of : (N,) index of the friction that a normal bounds, or −1
    first : (F,) index of the first normal of a friction's contact;  mu : (F,)
    """

    normals: list[Normal]
    frictions: list[Friction]
    normal_ids: Indices
    friction_ids: Indices
    place: Indices
    feature: Indices
    friction_of: Indices
    first: Indices
    mu: Vector


class ConstraintGraph:
    """Active constraints J_N, J_FO, J_FW and the candidates around them."""

    def __init__(self, geometry: Geometry, mu_of: Callable[[int, int], float]):
        self.geometry = geometry
        self.mu_of = mu_of
        self.of_body: dict[int, list[Contact]] = {}
        self.of_pair: dict[tuple[int, int], list[Contact]] = {}
        self.normals: dict[int, Normal] = {}
        self.frictions: dict[int, Friction] = {}
        self.level: dict[tuple[int, int], float] = {}
        self._next_row_id = 0
        self._active: ActiveSet | None = None
        self._margin = 0.25 / 1e-3 * geometry.contact_tol
        self._listed_at: Vector | None = None
        self._candidates = (np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._free: tuple[ActiveSet, Indices, Indices] | None = None

    # --- constraints -----------------------------------------------------------------------------

    def _new_row_id(self) -> int:
        self._next_row_id += 1
        return self._next_row_id - 1

    def pair_of(self, corner: int, part: int) -> tuple[int, int]:
        own = int(self.geometry.corner_part[corner])
        return (own, part) if own < part else (part, own)

    def _parallel(self, pose: Pose, contact: Contact, part: int, edge: int) -> bool:
        other = contact.normals[0]
        one = self.geometry.direction(pose, part, edge)
        two = self.geometry.direction(pose, other.part, other.edge)
        return abs(float(cross(one, two))) < PARALLEL_SINE

    def redundant(self, pose: Pose, corner: int, part: int, edge: int) -> bool:
        """Whether an active contact of the pair already keeps this corner out.

        It does where one of its points coincides with the corner, or where two parallel constraints
        are active: an edge on an edge needs no more than its two ends.
        """
        for contact in self.of_pair.get(self.pair_of(corner, part), ()):
            if len(contact.normals) == 2 and self._parallel(pose, contact, part, edge):
                return True
            for normal in contact.normals:
                gap = pose.corners[normal.corner] - pose.corners[corner]
                if np.hypot(*gap) <= self.geometry.contact_tol:
                    return True
        return False

    def insert(self, pose: Pose, corner: int, part: int, edge: int) -> Normal | None:
        """Activate a constraint; None where an active contact makes it redundant."""
        if self.redundant(pose, corner, part, edge):
            return None
        pair = self.pair_of(corner, part)
        contacts = self.of_pair.setdefault(pair, [])
        contact = next((c for c in contacts if self._parallel(pose, c, part, edge)), None)
        if contact is None:
            contact = Contact(pair, self.mu_of(*(int(self.geometry.part_body[p]) for p in pair)))
            contacts.append(contact)
            for body in {int(self.geometry.part_body[p]) for p in pair}:
                self.of_body.setdefault(body, []).append(contact)
        normal = Normal(self._new_row_id(), corner, part, edge, contact)
        contact.normals.append(normal)
        self.normals[normal.row_id] = normal
        if contact.mu > 0 and contact.friction is None:
            contact.friction = Friction(self._new_row_id(), contact)
            self.frictions[contact.friction.row_id] = contact.friction
        self.level.pop((corner, part), None)
        self._active = None
        return normal

    def remove(self, normal: Normal, clearance: float) -> None:
        """Deactivate a constraint; the corner's reference level becomes min(0, clearance)."""
        contact = normal.contact
        self._active = None
        contact.normals.remove(normal)
        del self.normals[normal.row_id]
        if clearance < 0:
            self.level[normal.corner, normal.part] = clearance
        if contact.normals:
            return
        if contact.friction is not None:
            del self.frictions[contact.friction.row_id]
        self.of_pair[contact.pair].remove(contact)
        if not self.of_pair[contact.pair]:
            del self.of_pair[contact.pair]
        for body in {int(self.geometry.part_body[p]) for p in contact.pair}:
            self.of_body[body].remove(contact)

    def hand_over(self, normal: Normal, place: tuple[int, int, int]) -> None:
        """Let another corner and edge carry a constraint."""
        normal.corner, normal.part, normal.edge = place
        self._active = None

    def active(self) -> list[Normal]:
        """J_N in the order of row_id."""
        return self.active_set().normals

    def active_frictions(self) -> list[Friction]:
        """J_F = J_FO ∪ J_FW in the order of row_id."""
        return self.active_set().frictions

    def active_set(self) -> ActiveSet:
        """Both, with their arrays; made anew when a constraint comes, goes or is handed over."""
        if self._active is None:
            normals = [self.normals[i] for i in sorted(self.normals)]
            frictions = [self.frictions[i] for i in sorted(self.frictions)]
            index = {normal.row_id: i for i, normal in enumerate(normals)}
            number = {friction.row_id: j for j, friction in enumerate(frictions)}
            rubs = (n.contact.friction for n in normals)
            place = np.array([n.place for n in normals], dtype=np.int64).reshape(-1, 3)
            self._active = ActiveSet(
                normals,
                frictions,
                normal_ids=np.array(list(index), dtype=np.int64),
                friction_ids=np.array(list(number), dtype=np.int64),
                place=place,
                feature=self.geometry.features(place),
                friction_of=np.array(
                    [-1 if f is None else number[f.row_id] for f in rubs], dtype=np.int64
                ),
                first=np.array(
                    [index[f.contact.normals[0].row_id] for f in frictions], dtype=np.int64
                ),
                mu=np.array([f.contact.mu for f in frictions]),
            )
        return self._active

    # --- candidates ------------------------------------------------------------------------------

    def candidates(self, before: Vector, after: Vector) -> tuple[Indices, Indices]:
        """Corners and parts (N,), (N,) that may touch on the way from q `before` to q `after`.

        Active constraints are left out.  The list of the broad phase is kept until a body has moved
        by half its margin.
        """
        moved = self._largest_motion(self._listed_at, after)
        if not moved <= self._margin / 2:
            reach = max(self._margin, 2.5 * self._largest_motion(before, after))
            self._list_candidates(before, reach)
        active = self.active_set()
        if self._free is None or self._free[0] is not active:
            corner, part = self._candidates
            parts = len(self.geometry.part_body)
            busy = active.place[:, 0] * parts + active.place[:, 1]
            free = ~np.isin(corner * parts + part, busy)
            self._free = active, corner[free], part[free]
        return self._free[1:]

    def listed(self, q: Vector) -> tuple[Indices, Indices, Vector, float]:
        """The candidates at q, where they were listed, and how far from there they hold [m].

        The list is made anew where more than half of that is used up.
        """
        if not self._largest_motion(self._listed_at, q) <= self._margin / 4:
            self._list_candidates(q, self._margin)
        corner, part = self.candidates(q, q)
        assert self._listed_at is not None
        return corner, part, self._listed_at, self._margin / 2

    def levels(self, corner: Indices, part: Indices) -> Vector:
        """Reference level of each candidate, (N,) ≤ 0."""
        levels = np.zeros(corner.size)
        if self.level:
            known, parts = np.array(list(self.level)), len(self.geometry.part_body)
            key, wanted = known[:, 0] * parts + known[:, 1], corner * parts + part
            order = np.argsort(key)
            at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), key.size - 1)]
            levels = np.where(key[at] == wanted, np.array(list(self.level.values()))[at], 0.0)
        return levels

    def set_levels(self, corner: Indices, part: Indices, level: Vector) -> None:
        """Reference levels (N,) ≤ 0 of candidates; one of 0 is forgotten."""
        for i in np.flatnonzero(self.levels(corner, part) != level):
            if level[i] < 0:
                self.level[int(corner[i]), int(part[i])] = float(level[i])
            else:
                del self.level[int(corner[i]), int(part[i])]

    def note_clearances(self, corner: Indices, part: Indices, clearance: Vector) -> None:
        """Follow corners that were let in without a contact: their levels sink with them."""
        level = self.levels(corner, part)
        forgotten = (level < 0) & (clearance > FORGET_LEVEL)
        for i in np.flatnonzero(forgotten | (clearance < level - ROUNDING)):
            if forgotten[i]:
                del self.level[int(corner[i]), int(part[i])]
            else:
                self.level[int(corner[i]), int(part[i])] = float(clearance[i])

    def _largest_motion(self, before: Vector | None, after: Vector) -> float:
        if before is None:
            return np.inf
        step = np.abs((after - before).reshape(-1, 3))
        return float((np.hypot(step[:, 0], step[:, 1]) + self.geometry.radius * step[:, 2]).max())

    def _list_candidates(self, q: Vector, margin: float) -> None:
        geometry = self.geometry
        pose = geometry.pose(q)
        corners, parts = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for p, r in geometry.near_pairs(pose, margin):
            for one, other in ((p, r), (r, p)):
                first, size = geometry.part_first[one], geometry.part_size[one]
                corners.append(np.arange(first, first + size))
                parts.append(np.full(size, other))
        corner, part = np.concatenate(corners), np.concatenate(parts)
        if corner.size:
            near = geometry.clearance(pose, corner, part) <= margin
            corner, part = corner[near], part[near]
        self._candidates = (corner, part)
        self._free = None
        self._listed_at = q
        self.level = {pair: level for pair, level in self.level.items() if level < 0}
