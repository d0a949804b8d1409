"""The velocity step in space: its QP, repeated until friction and guess agree; and impulses.

With momenta P = M v, M = M(q), and BDF as in the plane, a step of length h that ends at q_n solves

    α₀ P_n = h (f_n + G λ_n) + b,    b = −Σ_{i≥1} α_i P_{n−i}
    v_n = (h/α₀) D⁻¹ (A λ_n + d),    A = D⁻ᵀG,    d = D⁻ᵀ (f_n + b/h),    M_n = DᵀD

so min ½‖A x + d‖² within the bounds is the QP (3.2) again.  Its `ContactQP.D` is 1: with D block
diagonal it is posed for w = D v, whose mass matrix is the unit matrix, and w = (h/α₀) r.

This differs from the paper: BDF is applied to P and not to v, because M is not constant.  The
gyroscopic torque, which depends on v, then is the change of M, and (3.9) need not be repeated for
it; what no force acts on keeps its momentum to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.bodies.bodies import GROUND
from problems.formulas.multistep import asked_accuracy
from problems.friction.impulses import IMPULSE_ACCURACY
from problems.least_norm.minimum_norm import minimum_norm
from problems.qp import ContactQP, Vector
from problems.sequence import QPSequence
from problems.space.attitude import cross, rotations
from problems.space.columns import Columns
from problems.space.discs import DiscQP
from problems.space.friction import BEYOND, Contact, State, across, cone, refined, share_of
from problems.space.motion import Mass, Pose
from problems.space.scene import SpaceScene

MAX_PASSES = 30
"""Of a step; then it is taken as it is, and counted as unsettled."""
AGREE = 1e-3
"""Passes agree when they change ‖q̇‖_M by less than this much of ε, …"""
AGREE_BOUND = 1e-6
"""… and the bounds of friction by less than this much of the largest."""
ROWS = 32
"""Numbers that the rows of one contact, or generators of its impulse, have for their own."""
CONE_FACES = 8
"""Edges of the pyramid of impulses that a round cone begins with."""
ROUND = 1e-9
"""By how much of the largest speed before an impact a contact may slip out of its cone after it."""
LEAST = 1e-14
"""The same, where it falls no further."""
MOST_REFINED = 40
"""QPs of an impulse; each halves what is missing, or better."""


Mask = NDArray[np.bool_]


class Moved(NamedTuple):
    """What the QP of a step of length h [s] needs to know.

    w : h over the last step, 0 where there is none
    pose, mass : at its end;  b : (6n,) of momenta;  alpha0 : of BDF;  guess : (6n,) v at its end
    """

    t: float
    h: float
    w: float
    pose: Pose
    mass: Mass
    b: Vector
    alpha0: float
    guess: Vector


class VelocityStep(NamedTuple):
    """v (6n,) at the end of a step, and what the contacts did.

    lam : (N,) λ_N;  friction : (N, 3) forces [N];  reaction : (6n,) G λ, of pins too
    settled : whether the passes agreed
    radius : (N,) of the friction discs of the last pass;  pins : x of the pins
    """

    v: Vector
    lam: Vector
    friction: Vector
    reaction: Vector
    settled: bool
    radius: Vector
    pins: Vector


class Row(NamedTuple):
    """A direction (3,) at a place (3,) of two bodies; of : the contact, −1 of a pin."""

    row_id: int
    of: int
    is_normal: bool
    direction: Vector
    place: Vector
    bodies: tuple[int, int]


@final
class Poser:
    """Poses and solves the QPs of a scene."""

    def __init__(self, scene: SpaceScene, qps: QPSequence, eps: float) -> None:
        self.scene, self.qps, self.eps = scene, qps, eps
        self.accuracy = asked_accuracy(eps, iterates=scene.mu > 0)
        self.weight = np.zeros((len(scene.solids), 6))
        self.weight[:, 2] = [-solid.mass * scene.gravity for solid in scene.solids]

    # --- steps ---------------------------------------------------------------------------------

    def step(self, contacts: Sequence[Contact], moved: Moved) -> VelocityStep:
        """Solve the step; contacts know where they are at its end, and their states change."""
        d = self._pushed(moved)
        mu = np.array([contact.mu for contact in contacts])
        radius = mu * np.array([contact.extrapolated(moved.w) for contact in contacts])
        guess, pull = moved.guess, np.zeros((len(contacts), 3))
        aims = np.ones(len(contacts), dtype=bool)
        for number in range(1, MAX_PASSES + 1):
            _aim(contacts, aims, moved.pose, guess, pull)
            held = radius
            rows = [*self._pinned(moved.pose), *_rows(contacts, self.scene)]
            columns = _columns(rows, moved.pose)
            qp, x = self._solve(rows, columns, mu, radius, d, moved, number)
            v = moved.mass.unscaled(moved.h / moved.alpha0 * qp.residual(x))
            lam, friction = _forces(rows, x, len(contacts))
            slides = any(contact.state is not State.STICKS for contact in contacts)
            change = np.linalg.norm(moved.mass.scaled(v - guess)) if slides else 0.0
            apart = np.abs(mu * lam - radius).max(initial=0.0)
            settled = bool(
                apart <= AGREE_BOUND * (mu * lam).max(initial=0.0) and change <= AGREE * self.eps
            )
            if settled and not self._revised(contacts, friction, radius):
                break
            aims = np.linalg.norm(friction, axis=1) >= radius - BEYOND * radius.max(initial=0.0)
            radius, guess = mu * lam, v
            pull = moved.h / moved.alpha0 * _compliance(qp, rows, len(contacts)) * friction
        reaction = columns.force(x, len(self.scene.solids))
        return VelocityStep(
            v, lam, friction, reaction, settled, held, x[: 3 * len(self.scene.pins)]
        )

    def with_discs(
        self, contacts: Sequence[Contact], moved: Moved, step: VelocityStep
    ) -> tuple[DiscQP, Vector]:
        """The QP that the last pass has solved, with two rows across each normal, and its x."""
        rows = [*self._pinned(moved.pose), *_rows(contacts, self.scene, across)]
        rubbing = [i for i, contact in enumerate(contacts) if contact.mu > 0]
        first = len(step.pins) + len(step.lam)
        discs = first + np.arange(2 * len(rubbing)).reshape(-1, 2)
        pairs = [across(contacts[i].point.normal) @ step.friction[i] for i in rubbing]
        lower = np.full(len(rows), -np.inf)
        lower[len(step.pins) : first] = 0.0
        A, d = _columns(rows, moved.pose).scaled(moved.mass), self._pushed(moved)
        upper, radius = np.full(len(rows), np.inf), step.radius[rubbing]
        qp = DiscQP(A, d, lower, upper, discs, radius, moved.t)
        return qp, np.concatenate([step.pins, step.lam, *pairs])

    def _pushed(self, moved: Moved) -> Vector:
        """d (6n,) of a step."""
        return moved.mass.forced(self.weight.ravel() + moved.b / moved.h)

    def _revised(self, contacts: Sequence[Contact], friction: Vector, radius: Vector) -> bool:
        """Whether the state of any contact was wrong; polygons have no states."""
        if self.scene.faces:
            return False
        slack = BEYOND * radius.max(initial=0.0)
        triples = zip(contacts, friction, radius, strict=True)
        verdicts = [contact.revise(force, bound, slack) for contact, force, bound in triples]
        return any(verdicts)

    def _solve(
        self,
        rows: Sequence[Row],
        columns: Columns,
        mu: Vector,
        radius: Vector,
        d: Vector,
        moved: Moved,
        number: int,
    ) -> tuple[ContactQP, Vector]:
        """The QP, and x of least norm, so that the next radius is unique."""
        upper = np.array([
            np.inf if row.of < 0 or row.is_normal else radius[row.of] * share_of(self.scene.faces)
            for row in rows
        ])  # fmt: skip
        lower = np.where([row.is_normal for row in rows], 0.0, -upper)
        qp, solution = self.qps.solve(
            A=columns.scaled(moved.mass),
            d=d,
            lower=lower,
            upper=upper,
            row_id=np.array([row.row_id for row in rows], dtype=np.int64),
            kind="step" if number == 1 else "corrector",
            t=moved.t,
            h=moved.h,
            alpha0=moved.alpha0,
            eps0=self.accuracy,
        )
        x = np.asarray(solution.x)
        if mu.any():
            slack = BEYOND * radius.max(initial=0.0)
            within = (np.abs(x) < upper - slack) | ~_pressed(qp, x, self.accuracy)
            x = self._least(qp, x, rows, mu * share_of(self.scene.faces), within)
        return qp, x

    def _least(
        self, qp: ContactQP, x: Vector, rows: Sequence[Row], mu: Vector, within: Mask
    ) -> Vector:
        """x of least norm with the same A x; those pressed to their bounds keep what they are.

        They slide, and the bound is lagged: the λ_N of their own QP may be just too small for it.
        within : (k,) which x are not
        """
        kept = [row for row, free in zip(rows, within, strict=True) if free]
        part = ContactQP(
            qp.A[:, within],
            qp.d,
            qp.lower[within],
            qp.upper[within],
            row_id=qp.row_id[within],
            t=qp.t,
            h=qp.h,
            alpha0=qp.alpha0,
        )
        least = x.copy()
        least[within] = minimum_norm(self.qps, part, x[within], _coulomb(kept, mu))
        return least

    def _pinned(self, pose: Pose) -> list[Row]:
        """Three rows of each pin, along the axes of the world."""
        R = rotations(pose.attitudes)
        return [
            Row(ROWS * i + axis, -1, False, direction, place, (pin.body, GROUND))
            for i, pin in enumerate(self.scene.pins)
            for place in (pose.centres[pin.body] + R[pin.body] @ pin.point,)
            for axis, direction in enumerate(np.eye(3))
        ]

    # --- impulses ------------------------------------------------------------------------------

    def impulse(self, contacts: Sequence[Contact], pose: Pose, mass: Mass, v: Vector, t: float
                ) -> Vector:  # fmt: skip
        """v₊ (6n,) of (2.13), (2.14): a step with h = α₀ = 1, its cones posed by generators.

        Round cones, where `faces` asks for no others, are refined until nothing slips out of one:
        μ |w_t| ≤ w_n at every contact with the velocity w afterwards, up to `ROUND`.  What is
        missing is the square of an angle, so it is followed to rounding as long as it falls.
        """
        mu = np.array([self.scene.mu_I if contact.mu > 0 else 0.0 for contact in contacts])
        cones = [cone(c.point.normal, m, self.scene.faces or CONE_FACES)
                 for c, m in zip(contacts, mu.tolist(), strict=True)]  # fmt: skip
        before = gap_speeds(contacts, pose, v), slips(contacts, pose, v)
        speed = max(float(np.abs(each).max(initial=0.0)) for each in before)
        last = np.inf
        for left in reversed(range(MOST_REFINED)):
            after, shares = self._impulse(contacts, cones, pose, mass, v, t)
            slip = slips(contacts, pose, after)
            beyond = mu * np.linalg.norm(slip, axis=1) - gap_speeds(contacts, pose, after)
            beyond[mu == 0] = 0.0  # a normal is all of its cone
            worst = float(beyond.max(initial=0.0))
            settled = worst <= LEAST * speed or last <= worst <= ROUND * speed
            if self.scene.faces or settled or not left:
                break
            last = worst
            self.qps.settle(accepted=False)
            for i in np.flatnonzero(beyond > LEAST * speed).tolist():
                normal = contacts[i].point.normal
                cones[i] = refined(cones[i], shares[i], normal, float(mu[i]), -slip[i])
        return after

    def _impulse(
        self, contacts: Sequence[Contact], cones: Sequence[Vector], pose: Pose, mass: Mass,
        v: Vector, t: float,
    ) -> tuple[Vector, list[Vector]]:  # fmt: skip
        """v₊ (6n,), and of each contact the shares of its generators."""
        pinned = self._pinned(pose)
        rows = [*pinned, *_impulse_rows(contacts, cones, len(pinned))]
        columns, d = _columns(rows, pose), mass.scaled(v)
        qp, solution = self.qps.solve(
            A=columns.scaled(mass),
            d=d,
            lower=np.array([-np.inf if row.of < 0 else 0.0 for row in rows]),
            upper=np.full(len(rows), np.inf),
            row_id=np.array([row.row_id for row in rows], dtype=np.int64),
            kind="impulse",
            t=t,
            eps0=IMPULSE_ACCURACY * max(1.0, float(np.linalg.norm(d))),
        )
        x = np.asarray(solution.x)
        ends = np.cumsum([len(pinned), *(len(each) for each in cones)])
        shares = [x[begin:end] for begin, end in pairwise(ends.tolist())]
        return mass.unscaled(qp.residual(x)), shares


def _rows(
    contacts: Sequence[Contact],
    scene: SpaceScene,
    fan: Callable[[Vector], Vector] | None = None,
) -> list[Row]:
    """Normals, then frictions, in directions that `fan` makes of a normal, or in their own."""
    first, rows, rubbing = ROWS * len(scene.pins), [], []
    for i, contact in enumerate(contacts):
        number, point = first + ROWS * contact.number, contact.point
        place, bodies = point.place, (point.a, point.b)
        rows.append(Row(number, i, True, point.normal, place, bodies))
        if contact.mu > 0:
            ways = contact.directions(scene.faces) if fan is None else fan(point.normal)
            rubbing += [
                Row(number + slot, i, False, direction, place, bodies)
                for slot, direction in enumerate(ways, start=1)
            ]
    return rows + rubbing


def _impulse_rows(contacts: Sequence[Contact], cones: Sequence[Vector], pinned: int) -> list[Row]:
    """One of each generator, whose direction is no unit vector: the column is G V itself."""
    first = ROWS * (pinned // 3)
    return [
        Row(first + ROWS * contact.number + slot, i, True, generator, point.place, bodies)
        for i, (contact, generators) in enumerate(zip(contacts, cones, strict=True))
        for point in (contact.point,)
        for bodies in ((point.a, point.b),)
        for slot, generator in enumerate(generators)
    ]


def _columns(rows: Sequence[Row], pose: Pose) -> Columns:
    u, places = (np.array([row[i] for row in rows]).reshape(-1, 3) for i in (3, 4))
    bodies = np.array([row.bodies for row in rows], dtype=np.int64).reshape(-1, 2)
    return Columns.along(u, places, bodies, pose.centres)


def _aim(contacts: Sequence[Contact], aims: Mask, pose: Pose, guess: Vector, pull: Vector) -> None:
    """Directions of those that slide, by a guess of v; not where the last one was stopped.

    pull : (N, 3) by how much the friction of the guess has changed the slip, or more.  Without it a
    direction would be overturned by the force that it has itself brought about, where slow
    """
    turning = [i for i, contact in enumerate(contacts) if contact.slides and aims[i]]
    if turning:
        slip = slips([contacts[i] for i in turning], pose, guess)
        for i, way in zip(turning, slip - pull[turning], strict=True):
            contacts[i].aim(way)


def _compliance(qp: ContactQP, rows: Sequence[Row], n: int) -> Vector:
    """Bound (N, 1) of the slip that friction forces of size 1 bring about, by row sums of AᵀA."""
    rubs = [j for j, row in enumerate(rows) if row.of >= 0 and not row.is_normal]
    A, most = qp.A[:, rubs], np.zeros((n, 1))
    sums = np.asarray(abs(A.T @ A).sum(axis=1)).ravel()
    for j, total in zip(rubs, sums, strict=True):
        most[rows[j].of] = max(most[rows[j].of, 0], total)
    return most


def slips(contacts: Sequence[Contact], pose: Pose, v: Vector) -> Vector:
    """Velocities across the normals (N, 3) [m/s]."""
    points = [contact.point for contact in contacts]
    normals = np.array([point.normal for point in points]).reshape(-1, 3)
    places = np.array([point.place for point in points]).reshape(-1, 3)
    motions = np.vstack([v.reshape(-1, 6), np.zeros(6)])  # index −1: the ground
    centres = np.vstack([pose.centres, np.zeros(3)])
    relative = np.zeros_like(normals)
    for sign, bodies in ((1.0, [point.a for point in points]), (-1.0, [p.b for p in points])):
        turn = cross(motions[bodies, 3:], places - centres[bodies])
        relative += sign * (motions[bodies, :3] + turn)
    return relative - normals * np.sum(relative * normals, axis=1, keepdims=True)


def gap_speeds(contacts: Sequence[Contact], pose: Pose, v: Vector) -> Vector:
    """G_Nᵀ v (N,) [m/s]."""
    if not contacts:
        return np.zeros(0)
    rows = [Row(0, 0, True, c.point.normal, c.point.place, (c.point.a, c.point.b))
            for c in contacts]  # fmt: skip
    return _columns(rows, pose).speeds(v)


def _forces(rows: Sequence[Row], x: Vector, n: int) -> tuple[Vector, Vector]:
    """λ_N (N,), at least 0, and friction forces (N, 3)."""
    lam, friction = np.zeros(n), np.zeros((n, 3))
    for row, value in zip(rows, x, strict=True):
        if row.is_normal:
            lam[row.of] = max(value, 0.0)
        elif row.of >= 0:
            friction[row.of] += value * row.direction
    return lam, friction


def _pressed(qp: ContactQP, x: Vector, eps0: float) -> Mask:
    """(k,) which x are at their bound in every solution: |a_jᵀ r| > ε₀ ‖a_j‖, r = A x + d.

    r is unique, and x is not: what is at its bound in this x may be inside in another.
    """
    lengths = np.sqrt((qp.A * qp.A).sum(axis=0))
    return np.asarray(np.abs(qp.A.T @ qp.residual(x)) > eps0 * lengths)


def _coulomb(rows: Sequence[Row], mu: Vector) -> sp.csr_array:
    """Rows C with C x ≥ 0, first μ λ_N − x of each friction row, then μ λ_N + x."""
    normal = {row.of: j for j, row in enumerate(rows) if row.is_normal}
    rubs = [j for j, row in enumerate(rows) if row.of >= 0 and not row.is_normal]
    n, of = len(rubs), [rows[j].of for j in rubs]
    every, one = np.arange(2 * n), np.ones(n)
    bears = np.tile([normal[i] for i in of], 2), np.tile(mu[of], 2)
    entries = np.concatenate([bears[1], -one, one])
    where = np.tile(every, 2), np.concatenate([bears[0], rubs, rubs])
    return sp.csr_array((entries, where), shape=(2 * n, len(rows)))
