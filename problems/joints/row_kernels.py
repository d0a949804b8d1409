"""The arithmetic of joints, compiled: constraint functions and columns of their rows."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.kernels.compiled import kernel
from problems.qp import Indices, Vector

FIXED, DISTANCE, CARRIED, BLADE, TURN = range(5)
"""What u of a row is: fixed in the inertial frame, along the line between its points, carried by
the second body or by the first; or the row is one of angles."""


class Rows(NamedTuple):
    """R rows of joints between points p_a of body a and p_b of body b.

    kind : (R,) see `FIXED`;  bodies : (R, 2) a and b, −1 for the ground
    points : (R, 4) p_a in coordinates of a, p_b in those of b [m]
    frame : (R, 3) u and the offset; of angles: their weights, and the offset
    has_phi : (R,) 1.0 where the constraint is one of positions, 0.0 where it is one of velocities
    lower, upper : (R,) bounds of λ [N, N·m];  stop : (R,) whether it acts only at φ = 0

        FIXED     φ = u·(p_a − p_b) − offset                pins and welds
        DISTANCE  φ = |p_a − p_b| − offset                  rods
        CARRIED   φ = (R_b u)·(p_a − p_b) − offset          guides
        BLADE     g only: (R_a u)·(velocity of a − velocity of b at p_a)
        TURN      φ = w_a φ_a + w_b φ_b − offset            welds, gears, stops

    g = ∂φ/∂q; λ > 0 pushes in the direction in which φ grows, as for a contact.
    """

    kind: Indices
    bodies: Indices
    points: Vector
    frame: Vector
    has_phi: Vector
    lower: Vector
    upper: Vector
    stop: Indices

    def take(self, numbers: Indices) -> Rows:
        """Some of the rows."""
        return Rows._make(part[numbers] for part in self)

    def unbounded(self) -> NDArray[np.bool_]:
        """Which (R,) have multipliers without bounds."""
        return np.isinf(self.lower) & np.isinf(self.upper)

    def impulse_bounds(self) -> tuple[Vector, Vector]:
        """Bounds (R,) of impulses: what yields at a finite force bears none."""
        return (
            np.where(np.isinf(self.lower), self.lower, 0.0),
            np.where(np.isinf(self.upper), self.upper, 0.0),
        )


class Row(NamedTuple):
    """One of `Rows`."""

    kind: int
    bodies: tuple[int, int]
    points: tuple[float, float, float, float]
    frame: tuple[float, float, float]
    has_phi: bool = True
    lower: float = -inf
    upper: float = inf
    stop: bool = False


def gathered(rows: Sequence[Row]) -> Rows:
    """These, in arrays."""
    return Rows(
        kind=np.array([row.kind for row in rows], np.int64),
        bodies=np.array([row.bodies for row in rows], np.int64).reshape(-1, 2),
        points=np.array([row.points for row in rows], np.float64).reshape(-1, 4),
        frame=np.array([row.frame for row in rows], np.float64).reshape(-1, 3),
        has_phi=np.array([row.has_phi for row in rows], np.float64),
        lower=np.array([row.lower for row in rows], np.float64),
        upper=np.array([row.upper for row in rows], np.float64),
        stop=np.array([row.stop for row in rows], np.int64),
    )


NO_ROWS = gathered([])
"""Those of a scene without joints."""


@kernel
def place_point(q, body, x, y):
    """A point of a body, and the centre of gravity of the body: x, y, x, y [m]."""
    if body < 0:
        return x, y, 0.0, 0.0
    c, s = np.cos(q[3 * body + 2]), np.sin(q[3 * body + 2])
    centre_x, centre_y = q[3 * body], q[3 * body + 1]
    return centre_x + c * x - s * y, centre_y + s * x + c * y, centre_x, centre_y


@kernel
def turned(q, body, x, y):
    """A direction that is fixed in a body, in the inertial frame."""
    if body < 0:
        return x, y
    c, s = np.cos(q[3 * body + 2]), np.sin(q[3 * body + 2])
    return c * x - s * y, s * x + c * y


@kernel
def angle_of(q, body):
    """φ of a body; 0 of the ground."""
    return q[3 * body + 2] if body >= 0 else 0.0


@kernel
def joint_rows(q, rows, first, phi, entries, bodies):
    """φ, columns (·, 6) and bodies (·, 2) of rows at q (3n,), written from place `first` on."""
    for r in range(rows.kind.size):
        i, kind, a, b = first + r, rows.kind[r], rows.bodies[r, 0], rows.bodies[r, 1]
        ux, uy, offset = rows.frame[r]
        bodies[i, 0], bodies[i, 1] = a, b
        if kind == TURN:
            phi[i] = ux * angle_of(q, a) + uy * angle_of(q, b) - offset
            for j in range(6):
                entries[i, j] = 0.0
            entries[i, 2], entries[i, 5] = ux, uy
            continue
        ax, ay, own_x, own_y = place_point(q, a, rows.points[r, 0], rows.points[r, 1])
        bx, by, other_x, other_y = place_point(q, b, rows.points[r, 2], rows.points[r, 3])
        if kind == DISTANCE:
            length = np.hypot(ax - bx, ay - by)
            ux, uy = (ax - bx) / length, (ay - by) / length
        elif kind != FIXED:
            ux, uy = turned(q, b if kind == CARRIED else a, ux, uy)
        phi[i] = (ux * (ax - bx) + uy * (ay - by) - offset) * rows.has_phi[r]
        if kind in (CARRIED, BLADE):  # what moves against b is at p_a
            bx, by = ax, ay
        entries[i, 0], entries[i, 1] = ux, uy
        entries[i, 2] = (ax - own_x) * uy - (ay - own_y) * ux
        entries[i, 3], entries[i, 4] = -ux, -uy
        entries[i, 5] = -((bx - other_x) * uy - (by - other_y) * ux)


def rows_at(rows: Rows, q: Vector) -> tuple[Vector, Vector, Indices]:
    """φ (R,), columns (R, 6) and bodies (R, 2) of rows at q (3n,)."""
    R = rows.kind.size
    phi, entries, bodies = np.zeros(R), np.zeros((R, 6)), np.zeros((R, 2), dtype=np.int64)
    joint_rows(q, rows, 0, phi, entries, bodies)
    return phi, entries, bodies
