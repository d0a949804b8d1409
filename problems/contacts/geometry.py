"""Corner–edge contacts: the constraint functions φ, their columns g_N and g_F, the broad phase.

A constraint says that a corner of one convex part stays on the outer side of an edge of another.
With n the outward normal of the edge, τ = J n its direction, c the corner, x_b the centre of
gravity of the body that carries the edge:

    φ   = n·(c − x_b) − offset                                               (2.3)
    g_N = ∂φ/∂q       = [ n, r_a × n | −n, −r_b × n ],  r_a = c − x_a, r_b = c − x_b
    g_F, with g_Fᵀq̇   = τ·(velocity of the corner − velocity of the edge there)

The corner of one body on the edge of the other and, where two edges lie on each other, the corner
of the other on the edge of the one at the same place have equal columns; a contact may therefore be
handed over between them (`paper` §5: edge-to-edge contacts are described by their end points).

A corner is outside a convex part when it is outside one of its edges, so what collides is the
*clearance* max_e φ_e, and which edge is hit is a question of its own (`Geometry.hit_edge`).
The ground is a set of half planes, parts with one endless edge and body `GROUND`.

A disc or an ellipse about its body's centre of gravity is a part with one corner, its centre, and
with one round edge, its periphery.  Of it and another part its centre is the corner c, and φ its
distance from an edge, from a corner p (edge E + i for corner i, E the most edges of a part) or from
another disc or ellipse about x_b with the support function H.  With its own, h, which is the radius
of a disc (`problems.contacts.round_kernels`),

    φ = n·(c − x_b) − offset − h(n)    φ = n·(c − p) − h(n)    φ = n·(c − x_b) − H(n) − h(n)

where n is the normal of the edge, or else the direction in which φ is the greatest: of a disc that
from p or x_b to c.  As φ does not change with this n to first order, its derivatives are those of
two bodies that touch at s, the point of the first that is farthest along −n: in g_N and g_F r_a and
r_b go to s, and τ is the direction along the periphery.  n does not turn at once where a disc or an
ellipse rolls over the end of an edge, and the corner there takes over; but q̈ jumps, of a disc by
v²/ρ, and that is an event.  It and a convex part touch at one point only, and have one constraint.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.bodies.bodies import GROUND, Body
from problems.bodies.checks import check_numbers
from problems.bodies.path import Path
from problems.bodies.shapes import cross, rotate_quarter
from problems.contacts.broad_phase import near_corners
from problems.contacts.geometry_kernels import (
    clearance_on_path,
    clearances,
    contact_columns,
    edge_distances,
    least_overlap,
    oval_from,
    past_tip,
    place_into,
)
from problems.contacts.round_kernels import oval_clearance, support
from problems.qp import Indices, Vector

CONTACT_TOL = 1e-3
"""Corners this close to each other, in units of the shortest edge of both, are one point; edges
this close to a corner may be the one that it hits."""
PARALLEL_SINE = 0.02
"""Two edges whose directions differ by less than this sine touch edge to edge."""


@dataclass(frozen=True)
class HalfPlane:
    """Fixed ground: everything on the side of `normal` of `point` is free.

    Raises ValueError, naming the field, for what is not finite, and for a normal without length.
    """

    point: tuple[float, float] = (0.0, 0.0)
    normal: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        check_numbers("HalfPlane", 2, point=self.point, normal=self.normal)
        if not np.hypot(*self.normal) > 0:
            raise ValueError(f"HalfPlane: normal = {self.normal!r}; it must point somewhere")


class Pose(NamedTuple):
    """Where everything is: corners (C, 5) [m], centres (n+1, 2), cos φ and sin φ (n+1,).

    The last three of a corner are b, k_x and k_y of the disc or ellipse about it, 0 of a polygon's.
    """

    corners: Vector
    centres: Vector
    cosine: Vector
    sine: Vector

    @classmethod
    def of(cls, C: int, n: int) -> Pose:
        """Room for C corners of n bodies."""
        return cls(np.empty((C, 5)), np.empty((n + 1, 2)), np.empty(n + 1), np.empty(n + 1))


class Columns(NamedTuple):
    """Constraint values and columns of a set of corner–edge pairs.

    phi : (N,) [m];  normal, tangent : (N, 6), entries for the corner's and the edge's body; the
    first two are n and τ
    bodies : (N, 2);  along, length : (N,) position of the corner on its edge and the length of that
    edge [m]
    """

    phi: Vector
    normal: Vector
    tangent: Vector
    bodies: Indices
    along: Vector
    length: Vector

    @classmethod
    def of(cls, N: int) -> Columns:
        """Room for N of them."""
        bodies = np.empty((N, 2), np.int64)
        return cls(
            *(np.empty(N), np.empty((N, 6)), np.empty((N, 6)), bodies, np.empty(N), np.empty(N))
        )


class Geometry:
    """All corners and edges of a system in flat arrays; immutable once made.

    Corners are numbered through all bodies, parts likewise (the ground's half planes last), edges
    within their part; edge i of a part runs from its corner i to the next.  Corners of polygons
    are numbered as edges, too, behind all edges, for discs and ellipses that touch them.

    contact_tol : (parts,) `CONTACT_TOL` of the shortest edge or semi-axis [m], ∞ of a half plane
    kept_apart : (·, 2) pairs of bodies that never touch, the lower number first
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        ground: Sequence[HalfPlane],
        kept_apart: Collection[tuple[int, int]] = (),
    ):
        self.n_bodies = len(bodies)
        self.kept_apart = np.array(sorted(kept_apart), dtype=np.int64).reshape(-1, 2)
        parts = [(b, polygon) for b, body in enumerate(bodies) for polygon in body.polygons]
        n_parts = len(parts) + len(ground)
        axes = [bodies[b].semi_axes for b, _ in parts]
        corners = [_with_axes(p, *both) for (_, p), both in zip(parts, axes, strict=True)]
        n_edges = max([len(polygon) for _, polygon in parts] + [1])
        self.part_body = np.array([b for b, _ in parts] + [GROUND] * len(ground), dtype=np.int64)
        self.part_size = np.array([len(c) for c in corners] + [0] * len(ground), dtype=np.int64)
        self.part_first = np.concatenate([[0], np.cumsum(self.part_size)[:-1]]).astype(np.int64)
        self.n_moving = len(parts)
        self.corner_part = np.repeat(np.arange(n_parts), self.part_size)
        self.corner_body = self.part_body[self.corner_part]
        self.corner_local = np.concatenate([np.zeros((0, 4)), *corners], dtype=np.float64)
        first_of_body = np.searchsorted(self.corner_body, np.arange(self.n_bodies + 1))
        self.corner_number = np.arange(len(self.corner_body)) - first_of_body[self.corner_body]
        # edges are numbered through their body, half planes through the ground
        own_edge = self.part_first[:n_parts] - first_of_body[self.part_body]
        half_plane = np.arange(n_parts) - self.n_moving
        self.first_edge = np.where(self.part_body == GROUND, half_plane, own_edge)
        of_body = np.bincount(self.corner_body, minlength=self.n_bodies)
        self.body_edges = np.where(
            self.part_body == GROUND, 0, np.append(of_body, 0)[self.part_body]
        )
        # an edge that a part does not have is never the farthest: offset +inf, so φ = −inf
        self.edge_normal = np.zeros((n_parts, n_edges, 2))
        self.edge_offset = np.full((n_parts, n_edges), np.inf)
        self.edge_origin = np.zeros((n_parts, n_edges, 2))
        self.edge_length = np.zeros((n_parts, n_edges))
        for p, (_, polygon) in enumerate(parts):
            if axes[p][1] > 0:
                self.edge_offset[p, 0], self.edge_length[p, 0] = axes[p][1], np.inf
                if axes[p][0] > axes[p][1]:
                    self.edge_offset[p, 1] = focal_distance(*axes[p])
                continue
            side = np.roll(polygon, -1, axis=0) - polygon
            c = len(polygon)
            self.edge_length[p, :c] = np.linalg.norm(side, axis=1)
            normal = -rotate_quarter(side) / self.edge_length[p, :c, None]
            self.edge_normal[p, :c] = normal
            self.edge_offset[p, :c] = (normal * polygon).sum(axis=1)
            self.edge_origin[p, :c] = polygon
        for p, plane in enumerate(ground, start=len(parts)):
            normal = np.array(plane.normal) / np.hypot(*plane.normal)
            self.edge_normal[p, 0] = normal
            self.edge_offset[p, 0] = normal @ plane.point
            self.edge_origin[p, 0] = plane.point
            self.edge_length[p, 0] = np.inf
        self.edge_start = (rotate_quarter(self.edge_normal) * self.edge_origin).sum(axis=2)
        lengths = np.where(self.edge_length > 0, self.edge_length, np.inf)
        shortest = np.array([*(b or np.inf for _, b in axes), *(np.inf for _ in ground)])
        self.contact_tol = CONTACT_TOL * np.minimum(lengths.min(axis=1), shortest)
        self.radius = np.array([body.radius for body in bodies])
        self.tables = (
            *(self.corner_body, self.corner_local, self.part_body),
            *(self.edge_normal, self.edge_offset, self.edge_start, self.edge_length),
        )

    def tolerances(self, places: Indices) -> Vector:
        """The lesser `contact_tol` of both parts [m], (N,), at places (N, 2 or 3) corner, part."""
        own = self.contact_tol[self.corner_part[places[:, 0]]]
        return np.minimum(own, self.contact_tol[places[:, 1]])

    def tolerance(self, corner: int, part: int) -> float:
        """That of one corner and part."""
        return float(min(self.contact_tol[self.corner_part[corner]], self.contact_tol[part]))

    def pose(self, q: Vector) -> Pose:
        """Place everything at q (3n,)."""
        pose = Pose.of(len(self.corner_body), self.n_bodies)
        place_into(np.ascontiguousarray(q), self.corner_body, self.corner_local, *pose)
        return pose

    def distances(self, pose: Pose, corner: Indices, part: Indices) -> Vector:
        """φ of each corner against every edge of its part, (N, E); −inf where there is no edge."""
        return edge_distances(
            *pose, corner, part, self.part_body, self.edge_normal, self.edge_offset
        )

    def clearance(self, pose: Pose, corner: Indices, part: Indices) -> Vector:
        """max_e φ_e of each corner against its part, (N,) [m]; the distance of what is round;
        negative inside."""
        return clearances(*pose, corner, part, self.part_body, self.edge_normal, self.edge_offset)

    def clearance_on_path(self, path: Path, h: float, corner: int, part: int) -> float:
        """The same of one corner at path(h)."""
        return clearance_on_path(path.parts, h, corner, part, self.tables)

    def columns(self, pose: Pose, corner: Indices, part: Indices, edge: Indices) -> Columns:
        """Constraint functions and columns of N corner–edge pairs."""
        return self.columns_at(pose, np.column_stack([corner, part, edge]))

    def columns_at(self, pose: Pose, places: Indices) -> Columns:
        """The same for places (N, 3): corner, part, edge."""
        columns = Columns.of(len(places))
        contact_columns(
            *pose,
            places,
            *(self.corner_body, self.part_body),
            *(self.edge_normal, self.edge_offset, self.edge_start, self.edge_length),
            tuple(columns),
        )
        return columns

    def depths_below(self, pose: Pose, part: int, other: int) -> Vector:
        """min over the corners of part `other` of φ against each edge (E,): > 0 if it separates."""
        first, size = self.part_first[other], self.part_size[other]
        corner = np.arange(first, first + size)
        depths: Vector = self.distances(pose, corner, np.full(size, part)).min(axis=0)
        return depths

    def is_round(self, corner: int) -> bool:
        """Whether a corner is the centre of a disc or an ellipse."""
        return bool(self.corner_local[corner, 2] > 0)

    def nearest(self, pose: Pose, corner: int, part: int) -> int:
        """The edge of `part` that is nearest to what is round about a corner, or E + i for its
        corner i."""
        oval = oval_from(*pose, corner, int(self.part_body[part]))
        return int(oval_clearance(oval, self.edge_normal[part], self.edge_offset[part])[1])

    def touched(self, pose: Pose, corner: int, outward: Vector) -> Vector:
        """Where a corner is touched, (2,), or what is round about it, by what has this normal."""
        n_x, n_y = outward
        h, turned = support(n_x, n_y, *pose.corners[corner, 2:])
        return pose.corners[corner, :2] - (h * n_x - turned * n_y, h * n_y + turned * n_x)

    def hit_edge(self, pose: Pose, corner: int, part: int) -> int:
        """Edge of `part` that a corner at its boundary has hit; of what is round see `nearest`.

        Of the edges within `contact_tol` of the corner, the best separating axis of the two parts:
        a corner that drift has put 1e-5 inside one edge, and that passes the end of the adjacent
        side, is still on the first edge.  Where drift has made the parts overlap by more than
        `contact_tol`, all edges within that overlap are looked at.
        """
        if self.is_round(corner):
            return self.nearest(pose, corner, part)
        phi = self.distances(pose, np.array([corner]), np.array([part]))[0]
        other = int(self.corner_part[corner])
        wide = max(self.tolerance(corner, part), self.overlap(pose, part, other)[0])
        near = np.flatnonzero(phi >= phi.max() - wide)
        if near.size == 1:
            return int(near[0])
        return int(near[self.depths_below(pose, part, other)[near].argmax()])

    def past_tip(self, pose: Pose, corner: int, part: int, edge: int) -> bool:
        """Whether a corner that drift has put inside `edge` is less inside, or outside, of another.

        Two tips have passed each other then, by the width of the drift, or are about to: once
        another edge keeps the corner out of the part, no corner would ever be inside the other part
        again, however deep the edges cross.  What is round has no tip.
        """
        if self.is_round(corner):
            return False
        phi = self.distances(pose, np.array([corner]), np.array([part]))[0]
        return past_tip(phi, edge)

    def partner(self, pose: Pose, corner: int, part: int, edge: int, end: int) -> tuple | None:
        """The (corner, part, edge) to which a corner that passed the end of its edge hands over.

        end : 0 where it passed the start of the edge, 1 where it passed its end.

        The edge's own end corner takes over on the adjacent edge of the sliding part, if the two
        edges lie on each other there; None means that the corner has slid off (loss of support),
        or that what is round has come to a corner or from there to an edge.
        """
        if self.part_body[part] == GROUND or self.is_round(corner):
            return None
        size = int(self.part_size[part])
        taker = int(self.part_first[part]) + (edge + end) % size
        other = int(self.corner_part[corner])
        number = corner - int(self.part_first[other])
        count = int(self.part_size[other])
        phi = self.distances(pose, np.array([taker]), np.array([other]))[0]
        lines, wide = [number, (number - 1) % count], 2 * self.tolerance(corner, part)
        direction = self.direction(pose, part, edge)
        for line in lines:
            other_direction = self.direction(pose, other, line)
            opposite = float(direction @ other_direction) < 0
            parallel = abs(float(cross(direction, other_direction))) < PARALLEL_SINE
            if opposite and parallel and abs(phi[line]) <= wide:
                offset = (pose.corners[taker] - pose.corners[corner])[:2] @ other_direction
                inward = offset if line == number else -offset
                if inward >= 0:
                    return taker, other, line
        return None

    def direction(self, pose: Pose, part: int, edge: int) -> Vector:
        """τ of one edge, (2,); NaN, parallel to nothing, of a corner or what is round."""
        straight = edge < self.edge_offset.shape[1]
        n_x, n_y = self.edge_normal[part, edge].tolist() if straight else (0.0, 0.0)
        if n_x == n_y == 0.0:
            return np.full(2, np.nan)
        b = self.part_body[part]
        c, s = float(pose.cosine[b]), float(pose.sine[b])
        return np.array([c * -n_y - s * n_x, s * -n_y + c * n_x])

    def near_corners(self, pose: Pose, margin: float) -> tuple[Indices, Indices]:
        """Corners and parts (L,), (L,) of different bodies within `margin` of each other."""
        corner, part = near_corners(
            *(*pose, margin, self.n_moving, self.part_first, self.part_size),
            *(self.part_body, self.edge_normal, self.edge_offset),
        )
        may = self.may_touch(self.corner_body[corner], self.part_body[part])
        return corner[may], part[may]

    def may_touch(self, one: Indices, other: Indices) -> NDArray[np.bool_]:
        """Whether these bodies (L,) and those may, or a joint keeps them apart."""
        if not self.kept_apart.size:
            return np.ones(one.size, bool)
        n = self.n_bodies + 1
        low, high = np.minimum(one, other), np.maximum(one, other)
        return ~np.isin(low * n + high, self.kept_apart @ [n, 1])

    def near_pairs(self, pose: Pose, margin: float) -> list[tuple[int, int]]:
        """Pairs of parts of different bodies whose boxes come within `margin`, sorted.

        Sort and sweep along x; the ground's half planes are tested against every part.
        """
        n_moving = self.n_moving
        if n_moving == 0:
            return []
        corners, b, k = np.split(pose.corners, [2, 3], axis=1)
        first, reach = self.part_first[:n_moving], np.hypot(b, k)
        low = np.minimum.reduceat(corners - reach, first, axis=0) - margin / 2
        high = np.maximum.reduceat(corners + reach, first, axis=0) + margin / 2
        order = np.argsort(low[:, 0], kind="stable")
        last = np.searchsorted(low[order, 0], high[order, 0], side="right")
        pairs = []
        for place, p in enumerate(order):
            rivals = order[place + 1 : last[place]]
            meets = (low[rivals, 1] <= high[p, 1]) & (high[rivals, 1] >= low[p, 1])
            meets &= self.part_body[rivals] != self.part_body[p]
            pairs += [(int(min(p, r)), int(max(p, r))) for r in rivals[meets]]
        for plane in range(n_moving, len(self.part_body)):
            depth = corners @ self.edge_normal[plane, 0] - self.edge_offset[plane, 0]
            reach = np.hypot(b[:, 0], k @ self.edge_normal[plane, 0])
            lowest = np.minimum.reduceat(depth - reach, first)
            pairs += [(int(p), plane) for p in np.flatnonzero(lowest <= margin)]
        one, two = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        may = self.may_touch(self.part_body[one], self.part_body[two])
        return sorted(pair for pair, touches in zip(pairs, may, strict=True) if touches)

    def overlap(self, pose: Pose, one: int, two: int) -> tuple[float, tuple[int, int, int]]:
        """Depth [m] by which two convex parts overlap, 0 or less where an edge separates them.

        And where: the corner, part and edge of the axis along which it is the least.
        """
        parts = self.part_first, self.part_size, self.part_body
        edges = self.edge_normal, self.edge_offset
        depth, *place = least_overlap(tuple(pose), one, two, -np.inf, parts, edges)
        return depth, (place[0], place[1], place[2])

    def penetration(self, pose: Pose, pair: tuple[int, int]) -> float:
        """That depth alone."""
        return self.overlap(pose, *pair)[0]

    def edge_number(self, part: Any, edge: Any) -> Any:
        """Edges by their number in the body; that of corner i is the body's count of edges + i."""
        E, first = self.edge_offset.shape[1], self.first_edge[part]
        return np.where(edge < E, first + edge, self.body_edges[part] + first + edge - E)

    def features(self, places: Indices) -> Indices:
        """Rows of `ContactQP.feature` of the normals at places (N, 3), (N, 5)."""
        corner, part, edge = places.T
        body, number = self.part_body[part], self.edge_number(part, edge)
        zero = np.zeros_like(corner)
        columns = [self.corner_body[corner], self.corner_number[corner], body, number, zero]
        return np.column_stack(columns)


def _with_axes(polygon: Vector, a: float, b: float) -> Vector:
    """Corners (c, 4) of a polygon, with b and |k| 0; of a disc or an ellipse the centre, with both.

    a, b : its semi-axes, 0 of a polygon
    """
    if b > 0:
        return np.array([[0.0, 0.0, b, focal_distance(a, b)]])
    return np.column_stack([polygon, np.zeros((len(polygon), 2))])


def focal_distance(a: float, b: float) -> float:
    """|k| = √(a² − b²), how far the foci of an ellipse are from its centre [m]."""
    return float(np.sqrt((a - b) * (a + b)))


class Shapes(NamedTuple):
    """The arrays of a `Geometry` that kernels need."""

    corner_body: Indices
    corner_part: Indices
    corner_local: Vector
    part_body: Indices
    part_first: Indices
    part_size: Indices
    edge_normal: Vector
    edge_offset: Vector
    edge_start: Vector
    edge_length: Vector
    radius: Vector
    contact_tol: Vector

    @classmethod
    def of(cls, geometry: Geometry) -> Shapes:
        return cls(*(getattr(geometry, name) for name in cls._fields))
