"""Friction in space by bounds alone: (6.1) with a lagged radius a = μ λ_*, and what stands for it.

A QP of the project has bounds only, and Coulomb's disc |λ_F| ≤ a is no box.  Two ways to have it:

    directions  (faces = 0)   where a contact slides, λ_F = −a along its slip, whose direction is
                known from the guess of q̇: one row along it, |x| ≤ a.  Where it sticks, two rows;
                the answer is right where |λ_F| ≤ a, and where it is not the contact slides, along
                −λ_F.  Where the row of a sliding contact does not reach its bound, the slip ends
                within the step, and the contact sticks.  In the end every λ_F is in the disc, and
                against the slip where there is one: the law itself, without a direction of its own
    polygons    (faces = 4, 8, 16)   λ_F = Σ c_j t_j with |c_j| ≤ a sin(π/faces) and directions t_j
                at π/(faces/2) from each other: a regular polygon, corners on the disc.  A slip is
                resisted by the corner that does so most, which is not quite against it

Guess and radius are those of the pass before, until passes agree (`problems.space.passes`).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from problems.qp import Vector
from problems.space.contacts import Point

SLOWEST_SLIP = 1e-12
"""A slip below this has no direction [m/s]."""
MOST_GENERATORS = 24
"""Of the cone of an impulse, before others join."""
BEYOND = 1e-7
"""By how much of the largest bound a force may exceed its own, or stay below it, before its state
changes."""


class State(IntEnum):
    """Of a contact with friction: it sticks, slides, or has begun to slide within this step."""

    STICKS = 0
    SLIDES = 1
    BEGINS = 2


class Contact:
    """An active constraint.

    number : of its rows, see `problems.space.passes`;  level : φ at which it counts as touching [m]
    lam, lam_before : λ_N of the last two steps, NaN where not known
    state, way : whether it slides, and (3,) along which direction
    """

    def __init__(self, number: int, point: Point, mu: float) -> None:
        self.number, self.point, self.mu = number, point, mu
        self.lam = self.lam_before = np.nan
        self.state, self.way = State.STICKS, np.zeros(3)

    @property
    def slides(self) -> bool:
        return self.state is not State.STICKS

    def extrapolated(self, w: float) -> float:
        """λ_* of a step w times as long as the last: (4.2), (4.3), or 0 without an earlier λ."""
        if np.isnan(self.lam):
            return 0.0
        if np.isnan(self.lam_before):
            return self.lam
        return max(self.lam + w * (self.lam - self.lam_before), 0.0)

    def bore(self, lam: float) -> None:
        """Remember λ_N of a step."""
        self.lam, self.lam_before = lam, self.lam

    def stand(self, slip: Vector, eps: float) -> None:
        """Slide where the slip (3,) is faster than ε, else stick."""
        speed = float(np.linalg.norm(slip))
        self.state = State.SLIDES if speed > eps else State.STICKS
        if self.state is State.SLIDES:
            self.way = slip / speed

    def aim(self, slip: Vector) -> None:
        """Take the direction of a slip (3,)."""
        speed = float(np.linalg.norm(slip))
        if self.slides and speed > SLOWEST_SLIP:
            self.way = slip / speed

    def directions(self, faces: int) -> Vector:
        """Directions (r, 3) of the rows of its friction."""
        n = self.point.normal
        if faces == 0 and self.state is not State.STICKS:
            flat = self.way - n * float(n @ self.way)
            return (flat / np.linalg.norm(flat))[None]
        if faces in (0, 4):
            return across(n)
        return fan(faces) @ across(n)

    def revise(self, force: Vector, bound: float, slack: float) -> bool:
        """After passes that agree, on a friction force (3,) and its bound: whether it was wrong.

        slack : by how much a force may be off [N]
        """
        size = float(np.linalg.norm(force))
        if self.state is State.STICKS and size > bound + slack:
            self.state, self.way = State.BEGINS, -force / size
            return True
        if self.state is State.SLIDES and size < bound - slack:
            self.state = State.STICKS
            return True
        return False


def across(n: Vector) -> Vector:
    """(2, 3) two directions across a normal, the first that of x where there is one, else of y."""
    k = 0 if abs(n[0]) < 0.9 else 1
    first = -n * n[k]
    first[k] += 1.0
    first /= np.sqrt(first @ first)
    x, y, z = n
    u, v, w = first
    return np.array([first, (y * w - z * v, z * u - x * w, x * v - y * u)])


def fan(faces: int) -> Vector:
    """(faces/2, 2) directions t_j of a polygon, in coordinates across a normal."""
    angles = 2 * np.pi / faces * np.arange(faces // 2)
    return np.column_stack([np.cos(angles), np.sin(angles)])


def share_of(faces: int) -> float:
    """The bound of a row, over a."""
    return float(np.sin(np.pi / faces)) if faces else 1.0


def cone(n: Vector, mu_I: float, faces: int) -> Vector:
    """Generators (r, 3) of the cone of impulses: the normal, or edges of a pyramid round it."""
    if mu_I == 0:
        return n[None]
    angles = 2 * np.pi / faces * (np.arange(faces) + 0.5)
    return n + mu_I * (np.column_stack([np.cos(angles), np.sin(angles)]) @ across(n))


def refined(generators: Vector, shares: Vector, n: Vector, mu_I: float, way: Vector) -> Vector:
    """Generators (r, 3) of a cone that holds the impulse of before, and more of the round one.

    shares : (r,) of the impulse;  way : (3,) against the slip that it has left, across n

    Those without a share leave, and small ones of more than `MOST_GENERATORS`.  One along `way`
    joins, by which the impulse can be better, and one along the friction that there is.
    """
    friction = shares @ generators - shares.sum() * n
    aims = [aim / size for aim in (way, friction) if (size := float(np.linalg.norm(aim))) > 0]
    kept = np.sort(np.argsort(-shares, kind="stable")[:MOST_GENERATORS])
    return np.vstack([generators[kept[shares[kept] > 0]], *(n + mu_I * aim for aim in aims)])
