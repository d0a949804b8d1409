"""Joints, as a scene declares them: bilateral, non-holonomic and plastic constraints (§6).

Each gives rows of G whose multipliers have no bounds, or those of a material that yields, and whose
columns are those of a contact's normal: g = ∂φ/∂q, or for a blade g of a velocity that vanishes.
A point is given in coordinates of its body, about the centre of gravity; of the ground (`GROUND`)
in the inertial frame.  Bodies that a joint connects do not touch each other, unless it says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, inf, sin
from typing import Any, Protocol

import numpy as np

from problems.bodies.bodies import GROUND
from problems.bodies.checks import check_body, check_number, check_numbers
from problems.joints.row_kernels import (
    BLADE,
    CARRIED,
    DISTANCE,
    FIXED,
    TURN,
    Row,
    Rows,
    gathered,
)
from problems.qp import Vector

Point = tuple[float, float]


class Joint(Protocol):
    """What the stepper needs to know of a joint between `body` and `other`."""

    @property
    def body(self) -> int: ...

    @property
    def other(self) -> int: ...

    @property
    def touches(self) -> bool: ...

    def rows(self, q: Vector) -> list[Row]:
        """Its rows, for a scene that begins at q (3n,)."""


def _check(joint: Any, **points: Point) -> None:
    owner = type(joint).__name__
    check_body(owner, joint.body)
    if joint.other != GROUND:
        check_body(owner, joint.other)
    if joint.body == joint.other:
        raise ValueError(f"{owner}: body and other are both {joint.body}; it needs two")
    check_numbers(owner, 2, **points)


@dataclass(frozen=True)
class Pin:
    """A revolute joint: a point of `body` stays at a point, the anchor, of `other`.

    point, anchor : in coordinates of their bodies [m]
    """

    body: int
    point: Point
    other: int = GROUND
    anchor: Point = (0.0, 0.0)
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self, point=self.point, anchor=self.anchor)

    def rows(self, q: Vector) -> list[Row]:
        pair, points = (self.body, self.other), (*self.point, *self.anchor)
        return [Row(FIXED, pair, points, (*u, 0.0)) for u in ((1.0, 0.0), (0.0, 1.0))]


@dataclass(frozen=True)
class Rod:
    """Two points at a constant distance, by a bar without mass that may yield at either end.

    length : [m], by default that at the start
    tension, compression : the forces at which it is drawn out and pushed together [N]; perfectly
        plastic beyond (a reinforcement bar of §6: an upper bound only), ∞: never.  What can yield
        bears no impulse, and its length is not restored
    """

    body: int
    point: Point
    other: int = GROUND
    anchor: Point = (0.0, 0.0)
    length: float | None = None
    tension: float = inf
    compression: float = inf
    touches: bool = True

    def __post_init__(self) -> None:
        _check(self, point=self.point, anchor=self.anchor)
        if self.length is not None:
            check_number("Rod", length=self.length)
        for name in ("length", "tension", "compression"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ValueError(f"Rod: {name} = {value!r}; it must not be negative")

    def rows(self, q: Vector) -> list[Row]:
        apart = _placed(q, self.body, self.point) - _placed(q, self.other, self.anchor)
        length = float(np.hypot(*apart)) if self.length is None else self.length
        if not np.hypot(*apart) > 0:
            raise ValueError("Rod: its two ends are at one place; use a Pin")
        yields = self.tension < inf or self.compression < inf
        bounds = -self.tension, self.compression
        points = (*self.point, *self.anchor)
        frame = (0.0, 0.0, length)
        return [Row(DISTANCE, (self.body, self.other), points, frame, not yields, *bounds)]


@dataclass(frozen=True)
class Guide:
    """A point of `body` stays on a line of `other`, through the anchor along `axis`.

    fixes_angle : whether `body` cannot turn against `other` either (a slider)
    """

    body: int
    point: Point
    axis: Point
    other: int = GROUND
    anchor: Point = (0.0, 0.0)
    fixes_angle: bool = False
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self, point=self.point, anchor=self.anchor, axis=self.axis)
        if not hypot(*self.axis) > 0:
            raise ValueError(f"Guide: axis = {self.axis!r}; it must point somewhere")

    def rows(self, q: Vector) -> list[Row]:
        size, (x, y) = hypot(*self.axis), self.axis
        pair, points = (self.body, self.other), (*self.point, *self.anchor)
        along = Row(CARRIED, pair, points, (-y / size, x / size, 0.0))
        return [along, *([_turn(self.body, self.other, -1.0, q)] if self.fixes_angle else [])]


@dataclass(frozen=True)
class Weld:
    """`body` and `other` as one rigid body, where they are at the start."""

    body: int
    other: int
    point: Point = (0.0, 0.0)
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self, point=self.point)

    def rows(self, q: Vector) -> list[Row]:
        place = _placed(q, self.body, self.point)
        points = (*self.point, *_local(q, self.other, place))
        pair = self.body, self.other
        pin = [Row(FIXED, pair, points, (*u, 0.0)) for u in ((1.0, 0.0), (0.0, 1.0))]
        return [*pin, _turn(self.body, self.other, -1.0, q)]


@dataclass(frozen=True)
class Gear:
    """φ_body + ratio φ_other stays what it is at the start: wheels in mesh, or a belt."""

    body: int
    other: int = GROUND
    ratio: float = 1.0
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self)
        check_number("Gear", ratio=self.ratio)

    def rows(self, q: Vector) -> list[Row]:
        return [_turn(self.body, self.other, self.ratio, q)]


@dataclass(frozen=True)
class Blade:
    """A skate: a point of `body` moves along `axis`, which the body carries; non-holonomic.

    The velocity across it, against `other`, is 0; there is no φ (design §2).
    """

    body: int
    point: Point = (0.0, 0.0)
    axis: Point = (1.0, 0.0)
    other: int = GROUND
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self, point=self.point, axis=self.axis)
        if not hypot(*self.axis) > 0:
            raise ValueError(f"Blade: axis = {self.axis!r}; it must point somewhere")

    def rows(self, q: Vector) -> list[Row]:
        size, (x, y) = hypot(*self.axis), self.axis
        points, frame = (*self.point, 0.0, 0.0), (-y / size, x / size, 0.0)
        return [Row(BLADE, (self.body, self.other), points, frame, has_phi=False)]


@dataclass(frozen=True)
class Stop:
    """φ_body − φ_other between `least` and `most` [rad]: a limit, one-sided as a contact is.

    The limit that is reached is an event with an impulse, and is kept while its moment pushes.
    """

    body: int
    other: int = GROUND
    least: float = -inf
    most: float = inf
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self)
        if not self.least < self.most:
            raise ValueError(
                f"Stop: least = {self.least!r}, most = {self.most!r}; least must be smaller"
            )

    def rows(self, q: Vector) -> list[Row]:
        pair, nowhere = (self.body, self.other), (0.0, 0.0, 0.0, 0.0)
        made = []
        for weight, limit in ((1.0, self.least), (-1.0, -self.most)):
            if limit > -inf:
                frame = (weight, -weight, limit)
                made.append(Row(TURN, pair, nowhere, frame, lower=0.0, stop=True))
        return made


@dataclass(frozen=True)
class Apart:
    """No joint: `body` and `other` pass each other, as limbs do that move side by side."""

    body: int
    other: int = GROUND
    touches: bool = False

    def __post_init__(self) -> None:
        _check(self)

    def rows(self, q: Vector) -> list[Row]:
        return []


def _turn(body: int, other: int, ratio: float, q: Vector) -> Row:
    offset = _angle(q, body) + ratio * _angle(q, other)
    return Row(TURN, (body, other), (0.0, 0.0, 0.0, 0.0), (1.0, ratio, offset))


def _angle(q: Vector, body: int) -> float:
    return 0.0 if body == GROUND else float(q[3 * body + 2])


def _placed(q: Vector, body: int, point: Point) -> Vector:
    """A point of a body in the inertial frame, (2,)."""
    angle, (x, y) = _angle(q, body), point
    centre = np.zeros(2) if body == GROUND else q[3 * body : 3 * body + 2]
    arm = np.array([cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y])
    return centre + arm


def _local(q: Vector, body: int, place: Vector) -> Point:
    """A place of the inertial frame in coordinates of a body."""
    angle = _angle(q, body)
    x, y = place if body == GROUND else place - q[3 * body : 3 * body + 2]
    return float(cos(angle) * x + sin(angle) * y), float(cos(angle) * y - sin(angle) * x)


def all_rows(joints: Sequence[Joint], q: Vector) -> Rows:
    """The rows of all joints of a scene that begins at q (3n,)."""
    return gathered([row for joint in joints for row in joint.rows(q)])


def kept_apart(joints: Sequence[Joint]) -> frozenset[tuple[int, int]]:
    """Pairs of bodies, the lower number first, that a joint keeps from touching each other."""
    pairs = ((joint.body, joint.other) for joint in joints if not joint.touches)
    return frozenset((min(pair), max(pair)) for pair in pairs)
