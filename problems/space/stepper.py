"""Algorithm 1 in space: AB-r for positions, BDF-r for momenta, a QP at every step.

One step from t_{n−1} to t_n:

    1. centres by AB-r, attitudes by AB-r on rotation vectors: e_n = exp(½ h ω̄) e_{n−1}, where h ω̄
       is what AB-r makes of the angular velocities; h by (3.5)
    2. v_n and λ_n by the QP, repeated until friction agrees with itself (`problems.space.passes`)
    3. (i) a point that begins to touch: t_* is located on q(h), the step is redone to end there, an
       impulse (2.14) follows, and the integration restarts with two first-order steps
    4. contacts that separate faster than `drop_tol` leave

This differs from the plane's: where a slip ends, the contact sticks from the end of that step on,
which is not cut (the plane's ``stops="held"``), and the integration restarts; a contact that loses
its support is noticed at the end of a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, NamedTuple, final

import numpy as np
import scipy

from problems.formulas.multistep import (
    REDONE,
    SHORTEST_STEP,
    first_order_step,
    first_redone_length,
    next_length,
    redone_length,
    second_order_bdf,
    second_order_error,
    second_order_step,
)
from problems.qp import Vector
from problems.sequence import QPSequence, SimulationError, SolvesQPs
from problems.space.active import Active
from problems.space.contacts import Point
from problems.space.discs import DiscQP
from problems.space.friction import Contact, State
from problems.space.motion import Mass, Pose
from problems.space.passes import Moved, Poser, VelocityStep, gap_speeds, slips
from problems.space.run import SpaceRun
from problems.space.scene import SpaceScene
from problems.stepping.events import TOUCH_TOL
from problems.stepping.options import StepperOptions, end_of
from problems.stepping.run import Event, kept_until_then

FIRST_ORDER = 2
"""Steps of order 1 after a restart (§3.1)."""
USED = ("eps", "drop_tol", "fixed_step", "h_first", "h_max", "order")
"""Options that a scene in space is stepped with."""
SLOWEST = 1e-3
"""Approach below this much of `drop_tol` is none."""
MAX_STANDSTILL = 200
"""Impulses in a row without time moving on before the simulation gives up."""
DEEPEST = 1e-4
"""Overlap at the start that is taken for contact, over the size of the smallest body."""


def simulate(
    scene: SpaceScene,
    solver: SolvesQPs,
    *,
    eps: float | None = None,
    until: float | None = None,
    keep_qps: bool = True,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> SpaceRun:
    """Simulate a scene in space with `solver` in the loop, as `problems.simulate` does the plane.

    settings : of `StepperOptions`, those of `USED`

    Raises ValueError for bad settings, for those that are of the plane alone and for bodies that
    overlap at the start, `SimulationError` where the simulation cannot go on.  Whatever ends it
    early has the motion until then as its `run`.
    """
    options = StepperOptions.of(scene.eps if eps is None else eps, **settings)
    options.refuse_all_but(USED, "is of scenes in the plane")
    end = end_of(scene.end_time, until)
    stepper = SpaceStepper(scene, solver, options, keep_qps)
    with kept_until_then(stepper.kept, stepper.finish):
        stepper.start()
        while stepper.t < end - SHORTEST_STEP:
            stepper.advance(end)
            if progress is not None:
                progress(stepper.t)
    return stepper.finish()


class Trial(NamedTuple):
    """A step that may be rejected.

    contacts, lost : that it had, and that are no more at its end
    states : of the contacts' friction, before it
    """

    step: VelocityStep
    moved: Moved
    contacts: list[Contact]
    lost: list[Contact]
    states: list[tuple[State, Vector]]


def _root(clear: Callable[[float], float], level: float, h: float) -> float:
    """Where on the way to h a clearance falls below a level, which it is above at 0."""
    return float(
        scipy.optimize.brentq(lambda at: clear(at) - level, 0.0, h, xtol=1e-14, rtol=1e-14)
    )


def _beyond(clear: Callable[[float], float], level: float, low: float, high: float) -> float:
    """Where a clearance jumps below a level, between a place where it is above and one below."""
    while low < 0.5 * (low + high) < high and high - low > 1e-14:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if clear(middle) <= level else (middle, high)
    return high


@final
class SpaceStepper:
    """One simulation; `start` once, `advance` until t has reached the end, then `finish`.

    pose, v : now;  before : v and momenta of one step ago;  h, steps : the last step [s], and steps
    since the last restart;  wish, allowed : the length that the last step was to have, and that
    (3.5) allows the next [s]
    """

    def __init__(
        self, scene: SpaceScene, solver: SolvesQPs, options: StepperOptions, keep_qps: bool = True
    ) -> None:
        self.scene, self.options = scene, options
        self.qps = QPSequence(solver, keep_qps)
        self.poser = Poser(scene, self.qps, options.eps)
        self.active = Active(scene, options.drop_tol)
        self.h_max = min(options.h_max, scene.h_max)
        self.t, self.pose = 0.0, Pose(scene.centres, scene.attitudes)
        self.v = scene.v0.ravel().copy()
        self.wish, self.allowed = options.h_first, np.inf
        self.a = np.zeros_like(self.v)
        self.event_log: list[Event] = []
        names = ("steps", "rejected_steps", "restarts", "impulses", "unsettled")
        self.counts = dict.fromkeys(names, 0)
        self.kept: list[tuple[Any, ...]] = []
        self.discs: list[tuple[DiscQP, Vector]] = []
        self.standstill = 0
        self._forget()

    # --- the past ------------------------------------------------------------------------------

    def _forget(self) -> None:
        """Two first-order steps follow, from the pose and velocity that there are."""
        self.mass = Mass(self.scene.solids, self.pose.attitudes)
        self.p = self.mass.momentum(self.v)
        self.v_before, self.p_before, self.h, self.steps = self.v, self.p, 0.0, 0

    def _restart(self) -> None:
        """After a jump of v or its derivative."""
        self._forget()
        for contact in self.active.contacts:
            contact.lam_before = np.nan
        self.counts["restarts"] += 1
        self.qps.restart()

    @property
    def _second(self) -> bool:
        """Whether the next step is of order 2."""
        return self.options.order == 2 and self.steps >= FIRST_ORDER

    def _way(self, h: float) -> Vector:
        """Ways and rotation vectors (6n,) by AB-r (3.1a)."""
        bend = (self.v - self.v_before) / (2 * self.h) if self._second else 0.0
        return np.asarray(h * (self.v + h * bend))

    def _bdf(self, h: float, newest: Vector, oldest: Vector) -> tuple[float, Vector]:
        """α₀ and b of (3.1b)."""
        if not self._second:
            return 1.0, newest
        alpha0, one, two = second_order_bdf(h / self.h)
        return alpha0, one * newest - two * oldest

    # --- steps ---------------------------------------------------------------------------------

    def start(self) -> None:
        """What touches at t = 0 is active, after the impulse that v₀ may call for.

        Raises ValueError where bodies overlap.
        """
        points = self.active.points(self.pose)
        deepest = min(points, key=lambda point: point.gap, default=None)
        if deepest is not None and deepest.gap < -DEEPEST * self.active.size:
            other = "the ground" if deepest.b < 0 else f"body {deepest.b + 1}"
            raise ValueError(
                f"scene {self.scene.name!r}: body {deepest.a + 1} and {other} overlap by "
                f"{-deepest.gap:.3g} m at the start; move them apart"
            )
        touching = [p for p in points if p.gap <= 1e-6 * self.active.size]
        for point in touching:
            self.active.insert(point)
        speeds = self.active.speeds(touching, self.pose, self.v)
        self._record(np.zeros_like(self.v))
        if (speeds < -SLOWEST * self.options.drop_tol).any():
            self._impulse([])
        else:
            self._drop_separating()
            self._stand()

    def advance(self, end: float) -> None:
        """One accepted step, or an impulse where no time passes."""
        self.wish = self._wanted()
        h, hits = self._first_hit(min(self.wish, end - self.t))
        if hits and h < SHORTEST_STEP:
            self._stand_still()
            self._impulse(hits)
            return
        trial = self._trial(h)
        for _ in range(REDONE):
            shorter = self._redone(trial.step, trial.moved)
            if not shorter < h:
                break
            self._reject(trial)
            self.wish = max(shorter, 10 * SHORTEST_STEP)
            h, hits = self._first_hit(min(self.wish, end - self.t))
            trial = self._trial(h)
        self._accept(trial)
        if hits:
            self._impulse(hits)

    def _wanted(self) -> float:
        """Step 1: what (3.5) allows after the last step [s]."""
        if self.options.fixed_step is not None:
            return min(self.options.fixed_step, self.h_max)
        return next_length(self.wish, self.steps, self.allowed, self.h_max)

    def _guess(self, h: float) -> Vector:
        """v at the end of a step, by what is known of v̇."""
        return self.v + h * self.a if self.steps else self.v

    def _first_hit(self, h: float) -> tuple[float, list[Point]]:
        """Step 3: where on the way to h something begins to touch, and what."""
        end = self.pose.moved(self._way(h))
        skip = {point.key for point in self.active.carry(end, self._guess(h)).joined}

        def clear(length: float) -> float:
            return self.active.least_clearance(self.pose.moved(self._way(length)), skip)

        while (last := clear(h)) < -TOUCH_TOL:
            start = clear(0.0)
            level = 0.0 if start > 0 else min(start, 0.0) - TOUCH_TOL
            at = _root(clear, level, h) if last < level else h
            if clear(at) > max(level, TOUCH_TOL):  # a point that is there all at once
                at = _beyond(clear, level, at, h)
            pose = self.pose.moved(self._way(at))
            touching = self.active.touching(pose, skip, level)
            hits = self.active.approaching(touching, pose, self._guess(at), 0.0)
            if hits:
                return (at if start > 0 else 0.0), hits
            skip |= {point.key for point in touching}
        return h, []

    def _trial(self, h: float) -> Trial:
        """Steps 1 and 2 with this h."""
        pose = self.pose.moved(self._way(h))
        carried = self.active.carry(pose, self._guess(h))
        mass = Mass(self.scene.solids, pose.attitudes)
        alpha0, b = self._bdf(h, self.p, self.p_before)
        w = h / self.h if self.h else 0.0
        moved = Moved(self.t + h, h, w, pose, mass, b, alpha0, self._guess(h))
        contacts = carried.contacts + [self.active.new(point) for point in carried.joined]
        states = [(contact.state, contact.way) for contact in contacts]
        step = self.poser.step(contacts, moved)
        return Trial(step, moved, contacts, carried.lost, states)

    def _reject(self, trial: Trial) -> None:
        for contact, (state, way) in zip(trial.contacts, trial.states, strict=True):
            contact.state, contact.way = state, way
        self.counts["rejected_steps"] += 1
        self.qps.settle(accepted=False)

    def _redone(self, step: VelocityStep, moved: Moved) -> float:
        """A shorter h where (3.5) does not hold after all, else ∞."""
        if self.options.fixed_step is not None:
            return np.inf
        eps, norm = self.options.eps, self._norm(moved, self._acceleration(step, moved))
        if self.steps == 0:
            return first_redone_length(moved.h, first_order_step(norm, eps))
        change = self._norm(moved, self._acceleration(step, moved) - self.a)
        if self.h == 0:
            return np.inf
        return redone_length(moved.h, second_order_error(change, moved.h, self.h), eps)

    def _acceleration(self, step: VelocityStep, moved: Moved) -> Vector:
        alpha0, b = self._bdf(moved.h, self.v, self.v_before)
        return np.asarray((alpha0 * step.v - b) / moved.h)

    def _norm(self, moved: Moved, a: Vector) -> float:
        """‖·‖_M."""
        return float(np.linalg.norm(moved.mass.scaled(a)))

    def _accept(self, trial: Trial) -> None:
        """Take the step; step 4, and what friction has done."""
        step, moved = trial.step, trial.moved
        self.qps.settle(accepted=True)
        a = self._acceleration(step, moved)
        self.allowed = self._allowed(a, moved)
        self.t, self.pose, self.mass, self.a = moved.t, moved.pose, moved.mass, a
        self.v_before, self.p_before = self.v, self.p
        self.v, self.p = step.v, moved.mass.momentum(step.v)
        self.h, self.steps, self.standstill = moved.h, self.steps + 1, 0
        self.counts["steps"] += 1
        self.counts["unsettled"] += not step.settled
        rubs = any(contact.mu > 0 for contact in trial.contacts)
        if self.qps.keep and self.scene.faces == 0 and rubs:
            self.discs.append(self.poser.with_discs(trial.contacts, moved, step))
        stopped = self._tell_of_friction(trial)
        for contact, lam in zip(trial.contacts, step.lam.tolist(), strict=True):
            contact.bore(lam)
        lonely = self._change_contacts(trial)
        self._record(step.reaction)
        self._drop_separating()
        if stopped or lonely:
            self._restart()

    def _change_contacts(self, trial: Trial) -> bool:
        """Take in what has joined, leave what is lost; whether a support went without another."""
        for contact in trial.contacts:
            if self.active.take(contact):
                self._log("join", contact.point)
        for contact in trial.lost:
            self.active.remove(contact)
            self._log("slide_off", contact.point)
        pairs = {contact.point.key[:2] for contact in trial.contacts}
        return any(contact.point.key[:2] not in pairs for contact in trial.lost)

    def _tell_of_friction(self, trial: Trial) -> bool:
        """Events of friction; who has begun to slide slides on.  Whether any has stopped."""
        stopped = False
        for contact, (before, _) in zip(trial.contacts, trial.states, strict=True):
            if contact.state is State.BEGINS:
                contact.state = State.SLIDES
            if contact.state is not before:
                sticks = contact.state is State.STICKS
                stopped |= sticks
                self._log("slip_to_stick" if sticks else "stick_to_slip", contact.point)
        return stopped

    def _allowed(self, a: Vector, moved: Moved) -> float:
        """The step that (3.5) allows next [s]."""
        eps = self.options.eps
        if self.options.order == 1 or self.steps < FIRST_ORDER - 1:
            return first_order_step(self._norm(moved, a), eps)
        jerk = self._norm(moved, a - self.a) / moved.h
        return second_order_step(jerk, moved.h, eps)

    def _drop_separating(self) -> None:
        """Step 4: contacts that separate leave."""
        contacts = self.active.contacts
        speeds = gap_speeds(contacts, self.pose, self.v)
        for contact in self.active.separating(contacts, speeds):
            self._log("drop", contact.point)
            self.active.remove(contact)

    # --- events --------------------------------------------------------------------------------

    def _impulse(self, hits: list[Point]) -> None:
        """(2.14), repeated with the points that touch and approach with the new velocities."""
        for point in hits:
            self._log("impulse", point)
            self.active.insert(point)
        slowest, v = SLOWEST * self.options.drop_tol, self.v
        while True:
            self.active.carry(self.pose, self.v)
            v = self.poser.impulse(self.active.contacts, self.pose, self.mass, self.v, self.t)
            touching = self.active.touching(self.pose, set(), TOUCH_TOL)
            more = self.active.approaching(touching, self.pose, v, slowest)
            if not more:
                break
            self.qps.settle(accepted=False)
            for point in more:
                self.active.insert(point)
        self.qps.settle(accepted=True)
        self.counts["impulses"] += 1
        self.v = v
        self._drop_separating()
        self._restart()
        self._stand()
        self._record(np.zeros_like(v))

    def _stand(self) -> None:
        """Which contacts slide, by the velocities now; their λ is not known."""
        contacts = self.active.contacts
        for contact, slip in zip(contacts, slips(contacts, self.pose, self.v), strict=True):
            contact.stand(slip, self.options.eps)
            contact.lam = contact.lam_before = np.nan

    def _stand_still(self) -> None:
        self.standstill += 1
        if self.standstill > MAX_STANDSTILL:
            raise SimulationError(
                f"t = {self.t:.6g}: {MAX_STANDSTILL} impulses in a row without time moving on; "
                "try another eps or drop_tol"
            )

    # --- what is kept --------------------------------------------------------------------------

    def _log(self, kind: str, point: Point) -> None:
        other = "ground" if point.b < 0 else f"body {point.b + 1}"
        self.event_log.append(Event(self.t, kind, f"body {point.a + 1} on {other}"))

    def _record(self, reaction: Vector) -> None:
        gaps = [contact.point.gap for contact in self.active.contacts]
        pose = np.hstack([self.pose.centres, self.pose.attitudes])
        v, reaction = self.v.reshape(-1, 6).copy(), reaction.reshape(-1, 6)
        self.kept.append((self.t, pose, v, reaction, min(gaps, default=np.inf)))

    def finish(self) -> SpaceRun:
        """Everything that the simulation leaves behind."""
        columns = (np.array(column) for column in zip(*self.kept, strict=True))
        t, poses, velocities, reactions, gaps = columns
        return SpaceRun(
            self.scene,
            t,
            poses,
            velocities,
            reactions,
            gaps,
            event_log=self.event_log,
            qps=self.qps.qps,
            solutions=self.qps.solutions,
            counts=self.counts | {"qps": self.qps.count},
            options=asdict(self.options),
            discs=self.discs,
        )
