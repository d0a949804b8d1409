"""Where along a step something happens: step 3 of algorithm 1.

The position is a polynomial in h (AB-r), so collisions and the loss of support are located before
any QP is solved; slip→stick needs q̇_n and is located after it.  Every root starts from the paper's
inverse linear interpolation and is refined within its bracket.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

from problems.bodies.bodies import GROUND
from problems.bodies.path import Path
from problems.bodies.shapes import cross
from problems.contacts.constraint_graph import ConstraintGraph, Normal
from problems.contacts.dips import dips, floors
from problems.contacts.geometry import Columns, Geometry, Pose
from problems.contacts.geometry_kernels import column_speeds
from problems.contacts.path_kernels import END_SLACK, beyond_edge, ends_inside, miss, ways
from problems.formulas.multistep import SHORTEST_STEP
from problems.formulas.step_kernels import FAR_TOO_DEEP, next_overlap
from problems.joints.row_kernels import Rows, rows_at
from problems.qp import Vector

SAME_TIME = 1e-9
"""Events within this many seconds of each other are simultaneous."""
TOUCH_TOL = 1e-7
"""A corner within this distance of a part touches it [m]."""
DRIFT_ALLOWED = 1.0
"""Overlap that drift may leave, over ε [s]: heaps of ordinary polygons come to a tenth of it, …"""
LEAST_ALLOWED = 1e-6
"""… but no less than this [m]."""


@dataclass(frozen=True)
class Hit:
    """A corner that reaches the boundary of a part at step length h.

    late : whether the parts overlap there by more than drift may leave
    """

    h: float
    corner: int
    part: int
    edge: int
    late: bool = False

    @property
    def place(self) -> tuple[int, int, int]:
        return self.corner, self.part, self.edge


@dataclass(frozen=True)
class SlideOff:
    """An active corner that passes the end of its edge, with nothing to hand over to."""

    h: float
    normal: Normal


class Ahead(NamedTuple):
    """What a path meets first, at step length h [s], and what is true there.

    hits, losses : the collisions and losses of support there, none where nothing is met
    handed_over : {row_id: (corner, part, edge)} of the constraints that another corner carries then
    too_deep : {(part, part): overlap [m]} of pairs that overlap as they never should
    stops, switches : numbers of the rows of joints that are reached, and of the forces that switch
    """

    h: float
    hits: list[Hit]
    losses: list[SlideOff]
    handed_over: dict[int, tuple[int, int, int]]
    too_deep: dict[tuple[int, int], float]
    stops: list[int]
    switches: list[int]

    @property
    def stands(self) -> bool:
        """Whether it is met at t_{n−1} itself."""
        met = self.hits or self.losses or self.stops or self.switches
        return bool(met) and self.h < SHORTEST_STEP


Crossings = list[tuple[float, int]]
"""(h [s], number) of what changes its sign on a path."""
NO_CROSSINGS: Crossings = []


class May(NamedTuple):
    """What may be met on a path: a corner hits a part, parts overlap, a corner leaves its edge, a
    stop is reached."""

    hits: bool = True
    overlaps: bool = True
    ends: bool = True
    stops: bool = True


ANYTHING = May()


def look_ahead(
    graph: ConstraintGraph,
    path: Path,
    h: float,
    slowest: float,
    allowed: float = np.inf,
    may: May = ANYTHING,
    switches: Crossings = NO_CROSSINGS,
) -> Ahead:
    """What is met first on a path to h.

    allowed : overlap that drift may leave [m];  switches : those of forces on it
    """
    met, stops, forces = h, list[int](), list[int]()
    if switches or may.stops:
        reached = stop_crossings(graph, path, h) if may.stops else NO_CROSSINGS
        met = min([h, *(where for where, _ in (*reached, *switches))])
        stops, forces = (
            [number for where, number in crossings if where <= met + SAME_TIME]
            for crossings in (reached, switches)
        )
        if (stops or forces) and met < SHORTEST_STEP:
            return Ahead(0.0, [], [], {}, {}, stops, forces)
    ahead = contacts_ahead(graph, path, met, slowest, allowed, may)
    if ahead.h < met - SAME_TIME:
        return ahead
    return ahead._replace(stops=stops, switches=forces)


def contacts_ahead(
    graph: ConstraintGraph, path: Path, h: float, slowest: float, allowed: float, may: May
) -> Ahead:
    """What bodies meet first on a path to h."""
    geometry, near = graph.geometry, graph.candidates
    near.cover(path.start, path(h), graph.active_set().place)
    pose = geometry.pose(path(h))
    handed_over, losses = edge_ends(graph, path, h, pose) if may.ends else ({}, [])
    hits = first_hits(graph, path, h, pose, slowest) if may.hits else []
    too_deep: dict[tuple[int, int], float] = {}
    if may.overlaps:
        late, too_deep = late_hits(graph, path, h, pose, slowest, allowed)
        hits += late
    if not (hits or losses):
        return Ahead(h, [], [], handed_over, too_deep, [], [])
    first = min([*(hit.h for hit in hits), *(loss.h for loss in losses)])
    hits = [hit for hit in hits if hit.h <= first + SAME_TIME]
    losses = [loss for loss in losses if loss.h <= first + SAME_TIME]
    if SHORTEST_STEP <= first < h:
        pose = geometry.pose(path(first))
        handed_over, _ = edge_ends(graph, path, first, pose)
        _, too_deep = late_hits(graph, path, first, pose, np.inf, allowed)
    return Ahead(min(first, h), hits, losses, handed_over, too_deep, [], [])


def stop_crossings(graph: ConstraintGraph, path: Path, h: float) -> Crossings:
    """Where on a path to h stops are reached that are not active, and their numbers."""
    waiting = graph.waiting_stops
    before, after = (rows_at(graph.rows.take(waiting), path(step))[0] for step in (0.0, h))
    found: Crossings = []
    for i in np.flatnonzero(ends_inside(before, after)):
        row = graph.rows.take(waiting[i : i + 1])

        def gap(step: float, row: Rows = row) -> float:
            return float(rows_at(row, path(step))[0][0])

        ends = float(before[i]), float(after[i])
        found.append((locate_zero(gap, h, *ends) if ends[0] > 0 else 0.0, int(waiting[i])))
    return found


def touching_stops(graph: ConstraintGraph, q: Vector, v: Vector, slowest: float) -> list[int]:
    """Numbers of the stops that are not active, touch at q and approach with q̇ = v."""
    waiting = graph.waiting_stops
    if waiting.size == 0:
        return []
    phi, entries, bodies = rows_at(graph.rows.take(waiting), q)
    there = (phi <= TOUCH_TOL) & (column_speeds(entries, bodies, v) < -slowest)
    return [int(row) for row in waiting[there]]


def locate_zero(function: Callable[[float], float], h: float, f0: float, f1: float) -> float:
    """Root in [0, h] of a function with f(0) = f0 and f(h) = f1 of opposite signs.

    Inverse linear interpolation, t_* = h f0/(f0 − f1) (§3.1), refined inside its bracket.
    """
    guess = h * f0 / (f0 - f1)
    value = function(guess)
    if value == 0.0 or not 0 < guess < h:
        return min(max(guess, 0.0), h)
    low, high = (guess, h) if (value > 0) == (f0 > 0) else (0.0, guess)
    return float(scipy.optimize.brentq(function, low, high, xtol=1e-15, rtol=1e-14))


def approach_speed(
    geometry: Geometry, pose: Pose, v: Vector, corner: int, part: int, edge: int
) -> float:
    """g_Nᵀ q̇ of one corner–edge pair [m/s]; negative when they approach."""
    columns = geometry.columns_at(pose, np.array([(corner, part, edge)]))
    return float(column_speeds(columns.normal, columns.bodies, v)[0])


def first_hits(
    graph: ConstraintGraph, path: Path, h: float, pose: Pose, slowest: float
) -> list[Hit]:
    """The earliest collisions along the path within h; several if simultaneous, sorted.

    A candidate collides when its clearance falls below its reference level, or almost to it, be it
    for a part of the step only (`problems.contacts.dips`), unless an active contact makes it
    redundant there or the parts are not approaching (faster than `slowest`) along the normal of the
    edge concerned.

    pose : that of path(h)
    """
    geometry, near = graph.geometry, graph.candidates
    clearance = geometry.clearance(pose, near.corner, near.part)
    way = ways(path.velocity, path.curvature, h, geometry.radius)
    both = way[geometry.corner_body[near.corner]] + way[geometry.part_body[near.part]]
    there = np.flatnonzero(near.free & ~miss(0.0, clearance - near.level, both))
    corner, part, level = near.corner[there], near.part[there], near.level[there]
    before = geometry.clearance(geometry.pose(path.start), corner, part) - level
    after = clearance[there] - level
    inside = ends_inside(before, after)
    floor = floors(before + level, level)
    dip_start, dip_end = dips(geometry, path, h, corner, part, floor)
    hits: list[Hit] = []
    for i in np.flatnonzero(inside | np.isfinite(dip_end)):
        c, p = int(corner[i]), int(part[i])

        def gap(step: float, ref: float, c=c, p=p) -> float:
            return geometry.clearance_on_path(path, step, c, p) - ref

        # a corner that ends inside may have cut off a tip before that, and come out again
        stretches = [(float(dip_start[i]), float(dip_end[i]))] if np.isfinite(dip_end[i]) else []
        stretches += [(0.0, h)] if inside[i] else []
        for start, end in stretches:
            ref = float(level[i] if inside[i] and gap(end, level[i]) < 0 else floor[i])
            where = _crossing(partial(gap, ref=ref), start, end)
            pose = geometry.pose(path(where))
            edge = graph.hit_edge(pose, c, p)
            v = path.rate(where)
            speed = approach_speed(geometry, pose, v, c, p, edge)
            spared = graph.redundant(pose, c, p, edge) or ends_a_slide(graph, pose, v, c, p, edge)
            if speed < -slowest and not spared:
                hits.append(Hit(where, c, p, edge))
                break
    if not hits:
        return []
    first = min(hit.h for hit in hits)
    return sorted(
        (hit for hit in hits if hit.h <= first + SAME_TIME), key=lambda hit: (hit.corner, hit.part)
    )


def late_hits(
    graph: ConstraintGraph, path: Path, h: float, pose: Pose, slowest: float, allowed: float
) -> tuple[list[Hit], dict[tuple[int, int], float]]:
    """Where parts that no constraint keeps apart come to overlap by more than `allowed` [m].

    No corner tells of it: where edges cross, no corner of either part need be inside the other, and
    a contact may have been lost or found on the wrong edge.  The axis along which the parts overlap
    the least says what should have been in contact.

    pose : that of path(h).  Returns also the pairs that overlap by `FAR_TOO_DEEP` times as much.
    """
    geometry, near = graph.geometry, graph.candidates
    motion = path.velocity, path.curvature, h
    parts = geometry.part_first, geometry.part_size, geometry.radius
    hits: list[Hit] = []
    too_deep: dict[tuple[int, int], float] = {}
    i = -1
    while True:
        i = next_overlap(
            *(i + 1, near.pairs, allowed, motion, tuple(pose)),
            *(graph.active_set().place, parts, geometry.tables),
        )
        if i < 0:
            return hits, too_deep
        one, two = near.pairs[i].tolist()

        def excess(step: float, one=one, two=two) -> float:
            return geometry.overlap(geometry.pose(path(step)), one, two)[0] - allowed

        before, after = excess(0.0), excess(h)
        if after > (FAR_TOO_DEEP - 1) * allowed:
            too_deep[one, two] = after + allowed
        where = locate_zero(excess, h, before, after) if before < 0 < after else 0.0
        there = geometry.pose(path(where))
        place = geometry.overlap(there, one, two)[1]
        speed = approach_speed(geometry, there, path.rate(where), *place)
        if speed < -slowest and not graph.kept_out(there, *place):
            hits.append(Hit(where, *place, late=True))


def ends_a_slide(
    graph: ConstraintGraph, pose: Pose, v: Vector, corner: int, part: int, edge: int
) -> bool:
    """Whether a corner that reaches an edge is the end at which an active corner is to slide off.

    With no drift the edge, which begins at the active corner, would be above the end until then,
    unless the bodies turn towards each other.  A corner that has sunk in takes it below before:
    by the slide, for the larger part, and not by the turn.
    """
    geometry, other = graph.geometry, int(graph.geometry.corner_part[corner])
    if geometry.is_round(corner):
        return False
    tips = [
        int(geometry.part_first[part]) + i % max(int(geometry.part_size[part]), 1)
        for i in (edge, edge + 1)
    ]
    for contact in graph.of_pair.get(graph.pair_of(corner, part), ()):
        for normal in contact.normals:
            if normal.part != other or normal.corner not in tips:
                continue
            end = (corner - int(geometry.part_first[other]) - normal.edge) % int(
                geometry.part_size[other]
            )
            if end > 1:
                continue
            places = np.array([normal.place, (corner, part, edge)])
            columns = geometry.columns_at(pose, places)
            slip = float(column_speeds(columns.tangent, columns.bodies, v)[0])
            speed = float(column_speeds(columns.normal, columns.bodies, v)[1])
            sine = abs(float(cross(*columns.tangent[:, :2])))
            if columns.phi[0] < 0 and 2 * sine * (-slip if end else slip) < speed:
                return True
    return False


def _crossing(gap: Callable[[float], float], start: float, end: float) -> float:
    """Where a gap that is negative at `end` falls through 0 after `start`; there, if it never does.

    A gap that is negative at the start, too, may be positive in between.
    """
    above, below = gap(start), gap(end)
    if above <= 0:
        samples = start + (end - start) * np.arange(1, 8) / 8
        values = np.array([gap(step) for step in samples])
        best = int(np.argmax(values))
        if values[best] <= 0:
            return start
        start, above = float(samples[best]), float(values[best])
    return start + locate_zero(lambda step: gap(start + step), end - start, above, below)


def edge_ends(
    graph: ConstraintGraph, path: Path, h: float, pose: Pose
) -> tuple[dict[int, tuple[int, int, int]], list[SlideOff]]:
    """Active corners that pass an end of their edge within h; `pose` is that of path(h).

    Returns what is handed over at q(h), {row_id: (corner, part, edge)}, and the earliest losses of
    support.
    """
    geometry = graph.geometry
    active = graph.active_set()
    columns = geometry.columns_at(pose, active.place)
    slack = END_SLACK * columns.length
    handed_over, losses = {}, []
    for i in np.flatnonzero(beyond_edge(columns.along, columns.length)):
        normal, end = active.normals[i], int(columns.along[i] > 0)
        taker = geometry.partner(pose, *normal.place, end)
        if taker is not None:
            handed_over[normal.row_id] = taker
            continue

        def inside(step: float, at=active.place[i : i + 1], end=end, spare=slack[i]) -> float:
            now = geometry.columns_at(geometry.pose(path(step)), at)
            along, length = float(now.along[0]), float(now.length[0])
            return float(spare + (length - along if end else along))

        before, after = inside(0.0), inside(h)
        where = locate_zero(inside, h, before, after) if before > 0 > after else 0.0
        losses.append(SlideOff(where, normal))
    if losses:
        first = min(loss.h for loss in losses)
        losses = [loss for loss in losses if loss.h <= first + SAME_TIME]
    return handed_over, losses


def successor(geometry: Geometry, pose: Pose, normal: Normal) -> tuple[int, int, int] | None:
    """(corner, part, edge) that takes over where a corner slides off the end of its edge.

    The end of the edge is a corner, too, and is on an edge of the part that slid off; of two such
    edges the best separating axis counts.  What had sunk in still touches, however deep: drift
    knows nothing of `contact_tol`.  None on the ground, or where nothing touches any more.  What is
    round goes on at the corner, or the edge beside it, that is nearest.
    """
    corner, part, edge = normal.place
    if geometry.part_body[part] == GROUND:
        return None
    if geometry.is_round(corner):
        return corner, part, geometry.nearest(pose, corner, part)
    columns = geometry.columns_at(pose, np.array([normal.place]))
    end = int(columns.along[0] > columns.length[0] / 2)
    taker = int(geometry.part_first[part]) + (edge + end) % int(geometry.part_size[part])
    other = int(geometry.corner_part[corner])
    number = corner - int(geometry.part_first[other])
    edges = (number, (number - 1) % int(geometry.part_size[other]))
    depths = geometry.depths_below(pose, other, part)
    line = max(edges, key=lambda e: (depths[e], -e))
    on = geometry.columns_at(pose, np.array([(taker, other, line)]))
    wide, sunk = geometry.tolerance(corner, part), max(0.0, -float(columns.phi[0]))
    touches = -(sunk + wide) <= on.phi[0] <= wide
    return (taker, other, line) if touches and not beyond_edge(on.along, on.length)[0] else None


def touching(graph: ConstraintGraph, q: Vector, v: Vector, slowest: float) -> list[Hit]:
    """Inactive corners that touch at q and approach with q̇ = v; most inward first.

    Of coincident corners (two boxes whose sides are flush) the one that is, or is moving, further
    inside the other's edge comes first, so that it is the one that becomes active.
    """
    geometry, near = graph.geometry, graph.candidates
    near.cover(q, q, graph.active_set().place)
    pose = geometry.pose(q)
    gap = geometry.clearance(pose, near.corner, near.part) - near.level
    there = np.flatnonzero(near.free & (np.abs(gap) <= TOUCH_TOL))
    if there.size == 0:
        return []
    places = [
        (c, p, graph.hit_edge(pose, c, p))
        for c, p in zip(near.corner[there].tolist(), near.part[there].tolist(), strict=True)
    ]
    at = np.array(places, dtype=np.int64).reshape(-1, 3)
    columns = geometry.columns_at(pose, at)
    approach = column_speeds(columns.normal, columns.bodies, v)
    inside, inwards = _inwardness(columns, geometry.tolerances(at), v)
    found = [
        ((-inside[i], -inwards[i]), Hit(0.0, *places[i]))
        for i in np.flatnonzero(approach < -slowest)
        if not graph.redundant(pose, *places[i])
    ]
    found.sort(key=lambda entry: (*entry[0], entry[1].corner, entry[1].part))
    return [hit for _, hit in found]


def _inwardness(columns: Columns, tolerances: Vector, v: Vector) -> tuple[Vector, Vector]:
    """How far inside its edge each corner is, and how fast it moves inwards, in tolerances."""
    near_start = columns.along < columns.length / 2
    inside = np.where(near_start, columns.along, columns.length - columns.along)
    speed = column_speeds(columns.tangent, columns.bodies, v)
    endless = np.isinf(columns.length)
    inside = np.where(endless, 0.0, np.round(inside / tolerances))
    return inside, np.where(endless, 0.0, np.where(near_start, speed, -speed))
