"""What pressed where at each accepted step: the forces that a recorded QP answered with.

A = D⁻ᵀG, so that D A x is Gλ, and the first two entries of a column in the block of a body are the
direction of its force.  Normal and tangent of one contact are added up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from problems.bodies.shapes import ellipse_point, semi_axes
from problems.qp import FREE, NORMAL, TANGENT, ContactQP, Solution
from reports.motions.motion import Array, moved

SLIDES, STICKS, IMPULSE = range(3)
"""States of a contact: friction is no unknown, or at its bound; friction is free; an impulse."""


class Force(NamedTuple):
    """On the body of the corner.

    body : its index;  at : (2,) [m];  force : (2,) [N], or [N s] of an impulse
    state : `SLIDES`, `STICKS` or `IMPULSE`
    """

    body: int
    at: Array
    force: Array
    state: int


def qps_of_frames(recording: Any) -> list[int]:
    """For each accepted step the last QP that belongs to it, or −1.

    At an impulse a time occurs twice: what was posed before it belongs to the first of the two.
    """
    of_time: dict[float, list[int]] = {}
    for i, qp in enumerate(recording.qps):
        if qp.accepted:
            of_time.setdefault(qp.t, []).append(i)
    found = np.full(len(recording.t), -1)
    for t, numbers in of_time.items():
        frames = np.flatnonzero(recording.t == t)
        place = 0
        for number in numbers:
            place += recording.qps[number].kind == "impulse"
            if len(frames):
                found[frames[min(place, len(frames) - 1)]] = number
    return [int(number) for number in found]


def forces(
    qp: ContactQP, solution: Solution, pose: Array, polygons: Sequence[Sequence[Array]]
) -> list[Force]:
    """Forces of all contacts of a QP; pose : (bodies, 3), where they are drawn."""
    places: dict[tuple[int, ...], list[int]] = {}
    for column, feature in enumerate(qp.feature.tolist()):
        if feature[0] >= 0 and feature[4] >= 0:
            places.setdefault(tuple(feature[:4]), []).append(column)
    return [
        _force(qp, solution, place, columns, pose, polygons) for place, columns in places.items()
    ]


def _force(
    qp: ContactQP,
    solution: Solution,
    place: tuple[int, ...],
    columns: list[int],
    pose: Array,
    polygons: Sequence[Sequence[Array]],
) -> Force:
    body, corner = place[:2]
    rows = slice(3 * body, 3 * body + 2)
    part = qp.A[rows][:, columns]
    dense = part if isinstance(part, np.ndarray) else part.toarray()
    directions = np.asarray(qp.D)[rows, None] * dense
    normal = next((d for d, c in zip(directions.T, columns, strict=True)
                   if qp.feature[c, 4] == NORMAL), np.zeros(2))  # fmt: skip
    at = _corner(polygons[body], corner, pose[body], normal)
    return Force(
        body, at, directions @ np.asarray(solution.x)[columns], _state(qp, solution, columns)
    )


def _corner(parts: Sequence[Array], corner: int, pose: Array, normal: Array) -> Array:
    """Where a corner is; of a disc or an ellipse, where its periphery touches."""
    local = np.concatenate([np.asarray(part) for part in parts])
    sizes = np.repeat([len(part) for part in parts], [len(part) for part in parts])
    if sizes[corner] > 2:
        return moved(pose, local[corner])
    if not normal.any():
        return np.asarray(pose[:2])
    inward = moved(np.array([0.0, 0.0, -pose[2]]), -normal)
    return moved(pose, ellipse_point(*semi_axes(local), inward))


def _state(qp: ContactQP, solution: Solution, columns: list[int]) -> int:
    if qp.kind == "impulse":
        return IMPULSE
    tangents = [c for c in columns if qp.feature[c, 4] == TANGENT]
    free = [solution.working_set[c] == FREE for c in tangents]
    return STICKS if any(free) else SLIDES
