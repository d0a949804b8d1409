"""The data structure of §5 and figure 6: bodies, contacts and constraints as vertices of a graph.

A `Contact` joins two bodies; it holds one `Normal` constraint, or two when edge lies on edge, and
with friction one `Friction` constraint (λ_F is bounded by μ times the sum of its normals).  From a
constraint one reaches its contact, from a contact its bodies and constraints, from a body its
contacts.  Insertion and deletion touch only the vertices concerned.  Whatever order matters for a
recording is the order of `row_id`, given once and never reused.

What is near but not active is in `problems.contacts.candidates`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import dist
from typing import NamedTuple

import numpy as np

from problems.contacts.active_kernels import JOINT, Contacts
from problems.contacts.candidates import Candidates
from problems.contacts.geometry import PARALLEL_SINE, Geometry, Pose
from problems.contacts.layout import Layout
from problems.joints.row_kernels import NO_ROWS, Rows
from problems.qp import Indices, Vector

NO_LAM = (0.0, 0.0)
JOINT_IDS = 1 << 40
"""Those of rows of joints follow from here on, after all contacts."""


@dataclass(eq=False)
class Normal:
    """A contact constraint φ ≥ 0."""

    row_id: int
    corner: int
    part: int
    edge: int
    contact: Contact = field(repr=False)

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

    Of N normals C are of contacts, listed in `normals`; the others are rows of joints.

    place : (C, 3) corner, part, edge;  rows : of joints;  feature : (N, 5), see `ContactQP`
    friction_of : (N,) index of the friction that a normal bounds, or −1, or `JOINT`
    first : (F,) index of the first normal of a friction's contact;  mu : (F,)
    lam : (2, N) the multipliers of the last two time points, newest first; 0 before there were any
    layouts : the `Layout` of each set of sticking frictions that a QP has been posed with
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
    lam: Vector
    rows: Rows
    layouts: dict[bytes, Layout]

    def layout(self, signs: Vector) -> Layout:
        """Columns of the QP with the frictions that stick, s = 0 in `signs` (F,)."""
        key = (signs == 0).tobytes()
        if key not in self.layouts:
            self.layouts[key] = Layout(
                self.normal_ids, self.friction_ids, self.feature, self.first, signs
            )
        return self.layouts[key]

    def contacts(self, signs: Vector) -> Contacts:
        """The same for kernels, which may write to the multipliers; signs (F,) of the frictions."""
        return Contacts(
            *(self.place, self.normal_ids, self.friction_of, self.lam[0], self.lam[1]),
            *(self.friction_ids, self.first, self.mu, signs),
        )

    def carried_by(
        self, geometry: Geometry, handed_over: Mapping[int, tuple[int, int, int]]
    ) -> ActiveSet:
        """The same constraints, some {row_id: (corner, part, edge)} of them at another place."""
        place = self.place.copy()
        for row_id, where in handed_over.items():
            place[np.searchsorted(self.normal_ids, row_id)] = where
        feature = np.concatenate([geometry.features(place), self.feature[len(place) :]])
        return self._replace(place=place, feature=feature, layouts={})


class ConstraintGraph:
    """Active constraints J_N, J_FO, J_FW and the candidates around them.

    candidates : `Candidates`, of which those are free that are not in J_N
    rows : all R rows of joints;  acting : (R,) which of them are in J_N, of stops those reached
    waiting_stops : numbers of the others
    """

    def __init__(
        self, geometry: Geometry, mu_of: Callable[[int, int], float], rows: Rows = NO_ROWS
    ):
        self.geometry = geometry
        self.mu_of = mu_of
        self.rows = rows
        self.acting = rows.stop == 0
        self.waiting_stops: Indices = np.flatnonzero(~self.acting)
        self.of_body: dict[int, list[Contact]] = {}
        self.of_pair: dict[tuple[int, int], list[Contact]] = {}
        self.normals: dict[int, Normal] = {}
        self.frictions: dict[int, Friction] = {}
        self.candidates = Candidates(geometry)
        self._next_row_id = 0
        self._active: ActiveSet | None = None
        self._lam: dict[int, Sequence[float]] = {}

    # --- constraints -----------------------------------------------------------------------------

    def _change(self) -> None:
        """J_N or J_F is about to be another: keep the multipliers by row_id."""
        if self._active is not None:
            self._lam = dict(
                zip(self._active.normal_ids.tolist(), self._active.lam.T.tolist(), strict=True)
            )
            self._active = None

    def _new_row_id(self) -> int:
        self._next_row_id += 1
        return self._next_row_id - 1

    def pair_of(self, corner: int, part: int) -> tuple[int, int]:
        own = int(self.geometry.corner_part[corner])
        return (own, part) if own < part else (part, own)

    def _parallel(self, pose: Pose, contact: Contact, part: int, edge: int) -> bool:
        other = contact.normals[0]
        x, y = self.geometry.direction(pose, part, edge).tolist()
        u, v = self.geometry.direction(pose, other.part, other.edge).tolist()
        return bool(abs(x * v - y * u) < PARALLEL_SINE)

    def redundant(self, pose: Pose, corner: int, part: int, edge: int) -> bool:
        """Whether an active contact of the pair already keeps this corner out.

        It does where one of its points coincides with the corner, or where two parallel constraints
        are active: an edge on an edge needs no more than its two ends.
        """
        contacts = self.of_pair.get(self.pair_of(corner, part), ())
        along = (c for c in contacts if len(c.normals) == 2)
        return any(self._parallel(pose, c, part, edge) for c in along) or bool(
            self.at(pose, corner, part)
        )

    def at(self, pose: Pose, corner: int, part: int) -> list[Normal]:
        """Active constraints of the pair at a point that coincides with this corner; of what is
        round any, as it touches a convex part at one point only."""
        same, at = self.geometry.tolerance(corner, part), pose.corners[corner, :2].tolist()
        if self.geometry.is_round(corner):
            same = np.inf
        return [
            normal
            for contact in self.of_pair.get(self.pair_of(corner, part), ())
            for normal in contact.normals
            if dist(pose.corners[normal.corner, :2].tolist(), at) <= same
        ]

    def kept_out(self, pose: Pose, corner: int, part: int, edge: int) -> bool:
        """Whether an active contact of the pair keeps this corner on its side of this very edge."""
        there = self.at(pose, corner, part)
        if self.geometry.is_round(corner):
            return bool(there)
        for contact in self.of_pair.get(self.pair_of(corner, part), ()):
            if self._parallel(pose, contact, part, edge) and (
                len(contact.normals) == 2 or contact.normals[0] in there
            ):
                return True
        return False

    def hit_edge(self, pose: Pose, corner: int, part: int) -> int:
        """Edge of `part` that a corner at its boundary has hit; a seam is not in the way.

        Where parts lie flush in a row and a body slides along it, the end of the next part touches
        the body's tip: what it meets is not the side of that part but the edge that continues the
        row, to `contact_tol`.
        """
        geometry, other = self.geometry, int(self.geometry.corner_part[corner])
        if geometry.is_round(corner):
            return geometry.nearest(pose, corner, part)
        one, close = (np.array([corner]), np.array([part])), geometry.tolerance(corner, part)
        phi = geometry.distances(pose, *one)[0].tolist()
        touched = [edge for edge, value in enumerate(phi) if abs(value) <= close]
        if len(touched) > 1:
            depths = geometry.depths_below(pose, part, other)
            for edge in touched:
                if -depths[edge] <= close and self._slides_along(pose, corner, part, edge):
                    return edge
        return geometry.hit_edge(pose, corner, part)

    def _slides_along(self, pose: Pose, corner: int, part: int, edge: int) -> bool:
        """Whether an active contact of one of the two bodies with a third part is on this line."""
        geometry = self.geometry
        bodies = {int(geometry.corner_body[corner]), int(geometry.part_body[part])}
        pair = self.pair_of(corner, part)
        for contact in (c for body in bodies for c in self.of_body.get(body, ())):
            if contact.pair == pair or not self._parallel(pose, contact, part, edge):
                continue
            at = np.array([(normal.corner, part) for normal in contact.normals])
            phi = geometry.distances(pose, *at.T)[:, edge]
            if (np.abs(phi) <= geometry.tolerances(at)).any():
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
        self.candidates.set_level(corner, part, 0.0)
        self._change()
        return normal

    def remove(self, normal: Normal, clearance: float) -> None:
        """Deactivate a constraint; the corner's reference level becomes min(0, clearance)."""
        contact = normal.contact
        self._change()
        contact.normals.remove(normal)
        del self.normals[normal.row_id]
        if clearance < 0:
            self.candidates.set_level(normal.corner, normal.part, clearance)
        if contact.normals:
            return
        if contact.friction is not None:
            del self.frictions[contact.friction.row_id]
        self.of_pair[contact.pair].remove(contact)
        if not self.of_pair[contact.pair]:
            del self.of_pair[contact.pair]
        for body in {int(self.geometry.part_body[p]) for p in contact.pair}:
            self.of_body[body].remove(contact)

    def hand_over(self, places: Mapping[int, tuple[int, int, int]]) -> None:
        """Let other corners and edges carry constraints, {row_id: (corner, part, edge)}."""
        self._active = self.active_set().carried_by(self.geometry, places)
        for row_id, place in places.items():
            normal = self.normals[row_id]
            normal.corner, normal.part, normal.edge = place
        self.candidates.occupy(self._active.place)

    # --- joints ----------------------------------------------------------------------------------

    def set_stop(self, row: int, reached: bool) -> None:
        """Let a stop come into J_N, or leave it."""
        self._change()
        self.acting[row] = reached
        self.waiting_stops = np.flatnonzero(~self.acting)

    def active(self) -> list[Normal]:
        """J_N in the order of row_id."""
        return self.active_set().normals

    def active_set(self) -> ActiveSet:
        """Both, with their arrays; made anew when a constraint comes, goes or is handed over."""
        if self._active is None:
            normals = [self.normals[i] for i in sorted(self.normals)]
            frictions = [self.frictions[i] for i in sorted(self.frictions)]
            index = {normal.row_id: i for i, normal in enumerate(normals)}
            number = {friction.row_id: j for j, friction in enumerate(frictions)}
            rubs = (n.contact.friction for n in normals)
            place = np.array([n.place for n in normals], dtype=np.int64).reshape(-1, 3)
            acting, feature = np.flatnonzero(self.acting), self.geometry.features(place)
            if acting.size:
                feature = np.concatenate([feature, joint_features(self.rows, acting)])
            normal_ids = [*index, *(JOINT_IDS + acting).tolist()]
            bounds = [-1 if f is None else number[f.row_id] for f in rubs]
            self._active = ActiveSet(
                normals,
                frictions,
                normal_ids=np.array(normal_ids, dtype=np.int64),
                friction_ids=np.array(list(number), dtype=np.int64),
                place=place,
                feature=feature,
                friction_of=np.array([*bounds, *[JOINT] * acting.size], dtype=np.int64),
                first=np.array(
                    [index[f.contact.normals[0].row_id] for f in frictions], dtype=np.int64
                ),
                mu=np.array([f.contact.mu for f in frictions], dtype=np.float64),
                lam=np.array([self._lam.get(i, NO_LAM) for i in normal_ids])
                .reshape(-1, 2)
                .T.copy(),
                rows=self.rows.take(acting),
                layouts={},
            )
            self.candidates.occupy(place)
        return self._active


def joint_features(rows: Rows, numbers: Indices) -> Indices:
    """Rows of `ContactQP.feature` of rows of joints: body, number, other body, −1, −1."""
    one, other = rows.bodies[numbers].T
    nothing = np.full(numbers.size, -1)
    return np.column_stack([one, numbers, other, nothing, nothing])
