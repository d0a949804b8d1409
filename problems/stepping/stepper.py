"""Algorithm 1: rigid bodies in contact, stepped by AB-r and BDF-r with a QP at every step.

One step from t_{n−1} to t_n (Lötstedt 1984, §3.1, with the additions of §4.1):

    1. q_n by AB-1 or AB-2 with a step length h that meets (3.5)
    2. q̇_n, λ_n and q̈_n by the QP (3.2) or (4.6), iterated where f depends on q̇ or with friction
    3. events between t_{n−1} and t_n: (i) a jump in q̇: a new contact or an external impulse;
       (ii) a jump in q̈: a force that jumps, a corner that slides off its support, slip → stick.
       The earliest is located at t_*, the step is redone with h_* = t_* − t_{n−1}, and the
       integration restarts there with two first-order steps
    4. contacts that separate faster than `drop_tol`, whose λ is 0 by complementarity, leave J_N;
       sticking contacts at their bound that slip faster than ε become sliding ones.  Neither
       restarts

This differs from the paper, because the text leaves it open or the rule fails as printed:
 1. contacts are found, inserted and removed automatically; a contact whose corner leaves its edge
    while two edges lie on each other is handed over to the coincident corner, without an event, and
    where a corner slides off the end of the edge takes over if it touches;
 2. t_* is refined from the inverse linear interpolation, collisions and slide-offs are located on
    the position polynomial before any QP is solved, and also where they are undone by the end of
    the step (`problems.contacts.dips`);
 3. the threshold of step 4 is a parameter of its own, `drop_tol`, by default ε; contacts that have
    opened more slowly, but wide, are dropped too;
 4. with slip → stick, every contact that slips slower than ε sticks with it; with
    `stops="held"`, for contacts by the thousand, no step is cut there: what would stop within it
    may stick for all of it;
 5. events at less than `SHORTEST_STEP` are handled where they are, with no step;
 6. corrected friction, see `problems.friction.rules`;
 7. jamming: sliding forces s μ λ with s kept may feed back on λ with a gain ≥ 1, and then no λ
    meets both laws at any h (Painlevé).  Where the passes have failed for `JAM_TRIALS` lengths,
    the integration restarts at t_{n−1} with a short step in which every contact may stick: if some
    catch, q̇ jumps, and it restarts once more.  Gains ≥ 1 are events, see `problems.stepping.gain`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from problems.contacts.assembly import Assembly
from problems.contacts.constraint_graph import Friction
from problems.formulas.multistep import (
    REDONE,
    SHORTEST_STEP,
    STOP_TRIALS,
    first_order_step,
    first_redone_length,
    next_length,
    redone_length,
)
from problems.formulas.step_kernels import FAR_TOO_DEEP, fastest_body, stopping_lengths
from problems.friction.impulses import ImpulseRule
from problems.friction.rules import FrictionRule
from problems.qp import Vector
from problems.scenes import Scene
from problems.sequence import SimulationError, SolvesQPs
from problems.stepping.drift import DRIFT_TIME, DriftRule
from problems.stepping.events import (
    SAME_TIME,
    TOUCH_TOL,
    Arrival,
    Hit,
    SlideOff,
    look_ahead,
    touching,
)
from problems.stepping.options import StepperOptions, StopRule
from problems.stepping.quiet import LastStep
from problems.stepping.run import Run
from problems.stepping.transitions import Transitions
from problems.stepping.velocity import STUCK, VelocityStep

MAX_TRIES = 60
"""Trials of one step before the simulation gives up."""
JAM_TRIALS = 2
"""Trials of a step in which the friction passes may fail to settle before contacts jam."""
JAM_STEP = 1e-4
"""Longest step in which contacts catch [s]: the jump in q̇ does not depend on it."""
REST_HORIZON = 0.3
"""At rest, no body would double its `rest_speed` in this time if it kept its acceleration [s]."""
REST_SHOWN = 0.3
"""How long a run goes on at rest [s]: the QPs of rest, of redundant contacts, belong to it."""


def simulate(
    scene: Scene,
    solver: SolvesQPs,
    *,
    eps: float | None = None,
    until: float | None = None,
    drop_tol: float | None = None,
    friction: FrictionRule = "corrected",
    fixed_step: float | None = None,
    stops: StopRule = "located",
    h_first: float = 1e-3,
    h_max: float = 0.02,
    rest_speed: float | None = None,
    order: int = 2,
    impulses: ImpulseRule = "paper",
    drift: DriftRule = "none",
    drift_time: float = DRIFT_TIME,
    keep_qps: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Simulate `scene` with `solver` in the loop, to `until` [s], its end time or rest.

    eps and until default to the scene's own; the other settings are those of `StepperOptions`.
    keep_qps : whether the run holds its QPs; without them, steps in which nothing happens are left
        to the solver where it can take them, see `problems.stepping.quiet`
    progress : called with t after every accepted step, or after some at once

    Raises ValueError for bad settings or bodies that overlap at the start, see `Stepper.start`,
    `SimulationError` where the simulation cannot go on.  Whatever ends it early, Ctrl-C too, has
    the motion until then as its `run`.
    """
    options = StepperOptions.of(
        scene.eps if eps is None else eps,
        drop_tol,
        rest_speed,
        friction=friction,
        fixed_step=fixed_step,
        stops=stops,
        h_first=h_first,
        h_max=h_max,
        order=order,
        impulses=impulses,
        drift=drift,
        drift_time=drift_time,
    )
    end = scene.end_time if until is None else float(until)
    if not (np.isfinite(end) and end > 0):
        name = "end_time" if until is None else "until"
        raise ValueError(f"{name} = {end!r}; it must be a positive time")
    stepper = Stepper(scene, solver, options, keep_qps)
    try:
        stepper.start()
        while stepper.t < end - SHORTEST_STEP and not stepper.at_rest:
            stepper.advance(end)
            if progress is not None:
                progress(stepper.t)
    except BaseException as error:
        if stepper.stretches:
            error.run = stepper.finish()  # type: ignore[attr-defined]
        raise
    return stepper.finish()


class Stepper(Transitions):
    """One simulation by algorithm 1; `start` once, then `advance` step by step."""

    def start(self) -> None:
        """J_N at t = 0, after the impulse that the initial velocities or F call for (§3.1).

        Where a scene begins with a state of another run, φ has drifted: what overlaps by no more
        than the `contact_tol` of its parts touches.

        Raises ValueError, with the pair and the depth, where parts overlap by more, and where a
        body is too small or too large for the tolerances.
        """
        self._check_sizes()
        geometry = self.graph.geometry
        pose = geometry.pose(self.q)
        for pair in geometry.near_pairs(pose, 0.0):
            depth, most = (
                geometry.penetration(pose, pair),
                float(geometry.contact_tol[[*pair]].min()),
            )
            if depth > most:
                names = [self._body_name(int(geometry.part_body[p])) for p in pair]
                raise ValueError(
                    f"scene {self.scene.name!r}: {names[0]} and {names[1]} overlap by "
                    f"{depth:.3g} m at the start, and up to {most:.3g} m is taken for contact; "
                    "move them apart"
                )
        self.graph.candidates.take_as_touching(self.q, TOUCH_TOL)
        for hit in touching(self.graph, self.q, self.history.v, -np.inf):
            self.graph.insert(pose, hit.corner, hit.part, hit.edge)
        self._record()
        F = self._external_impulse(0.0)
        assembly = Assembly(self.graph, self.q)
        violated = (assembly.gap_speed(self.history.v) < -self.slowest_approach).any()
        if violated or F.any():
            self._impulse([], F)
        else:
            self._drop_separating(assembly, assembly.gap_speed(self.history.v))
            self._sort_frictions(Assembly(self.graph, self.q), self.history.v)

    def _check_sizes(self) -> None:
        """Raise ValueError for a body smaller than an overlap may be, or so large or far off that
        its corners are rounded by more than a hundredth of what counts as touching.
        """
        least, centres = FAR_TOO_DEEP * self.allowed_overlap, self.scene.q0[:, :2]
        for i, radius in enumerate(self.graph.geometry.radius):
            far = float(np.abs(centres[i]).max() + radius)
            if 2 * radius < least:
                reason = (
                    f"is {2 * radius:.3g} m across, and at eps = {self.options.eps:g} bodies may "
                    f"overlap by {least:.3g} m; choose a smaller eps, or a smaller unit of length"
                )
            elif np.spacing(far) > TOUCH_TOL / 100:
                reason = (
                    f"reaches to {far:.3g} m from the origin, where places are rounded to "
                    f"{np.spacing(far):.2g} m; what is within {TOUCH_TOL:g} m touches: choose a "
                    "larger unit of length"
                )
            else:
                continue
            raise ValueError(f"scene {self.scene.name!r}: {self._body_name(i)} {reason}")

    def advance(self, end: float) -> None:
        """One accepted step, some quiet ones, or one event where no time passes."""
        self.watch_progress()
        taken, last = self._quiet.take_steps(self, end)
        if taken:
            self._after_quiet_steps(taken, last)
            return
        here, gap_speed, slip_before = self._here()
        self._check_constraints(here, gap_speed)
        self._sort_signs(here, slip_before)
        path = self.history.path(self.q)
        signs = np.array([friction.sign for friction in here.frictions], dtype=np.float64)
        known = self.lam_known
        h_full = self._step_length()
        jump = self.scheduled()
        h = min(h_full, min(jump, end) - self.t)
        unsettled = redone = located = 0
        for _ in range(MAX_TRIES):
            arrival, hits, losses = look_ahead(
                self.graph, path, h, self.slowest_approach, self.allowed_overlap
            )
            if hits or losses:
                h_event = min([*(hit.h for hit in hits), *(loss.h for loss in losses)])
                hits = [hit for hit in hits if hit.h <= h_event + SAME_TIME]
                losses = [loss for loss in losses if loss.h <= h_event + SAME_TIME]
                if h_event < SHORTEST_STEP:
                    self._standing_event(hits, losses)
                    return
                if h_event < h:
                    h = h_event
                    arrival, _, _ = look_ahead(self.graph, path, h, np.inf, self.allowed_overlap)
            step = self._try_velocity(arrival, min(self.t + h, jump), signs, known)
            unsettled += not step.settled
            if not step.settled:
                self._watch_gain(step, signs)
            if unsettled == JAM_TRIALS and signs.any():
                self._reject()
                self._restart(1)
                path = self.history.path(self.q)
                h, known = min(h, JAM_STEP), STUCK
                signs = np.zeros_like(signs)
                continue
            shorter = self._rejected_length(step, h, known == STUCK, redone < REDONE)
            if shorter < np.inf:
                h, h_full, redone = shorter, min(h_full, shorter), redone + step.settled
                self._reject()
                continue
            lengths = stopping_lengths(
                signs, slip_before, step.slip_speed, step.h, self.options.eps
            )
            h_stick = lengths.min(initial=np.inf)
            if h_stick < h and self.options.stops == "held":
                signs = np.where(lengths < h, 0.0, signs)
                self._reject()
                continue
            if h_stick < SHORTEST_STEP:
                self._reject()
                self._count_standstill()
                self._stick([here.frictions[j] for j in np.flatnonzero(lengths <= h_stick)])
                return
            if h_stick < h * (1 - 1e-6):
                located += 1
                h = h_stick if located < STOP_TRIALS else min(h_stick, h / 2)
                self._reject()
                continue
            self._accept(step, arrival, h_full)
            self._watch_gain(step, signs)
            if known == STUCK:
                self._jam(step)
            held = (signs == 0) & ~self._slides(step)
            ends = [here.frictions[j] for j in np.flatnonzero(held | (lengths <= h))]
            stopped = [friction for friction in ends if friction.sign != 0]
            self._after_step(step, hits, losses, stopped)
            self._watch_rest()
            return
        raise SimulationError(
            f"t = {self.t:.6g}: no acceptable step after {MAX_TRIES} trials (h = {h:.3g}); "
            "try a smaller eps or another solver"
        )

    def _here(self) -> tuple[Assembly, Vector, Vector]:
        """The columns at t_{n−1}, G_Nᵀq̇ and G_Fᵀq̇: those of the last step where they still hold."""
        last = self._last
        if last is not None:
            same = last.v is self.history.v and last.assembly.active is self.graph.active_set()
            if same:
                return last.assembly, last.gap_speed, last.slip_speed
        here = Assembly(self.graph, self.q)
        return here, here.gap_speed(self.history.v), here.slip_speed(self.history.v)

    def _step_length(self) -> float:
        """Step 1: h from (3.5), with limits on growth; the old one after a restart."""
        if self.options.fixed_step is not None:
            return self.options.fixed_step
        steps, allowed = self.history.steps, np.inf
        if steps:
            allowed = self.history.largest_step(self.options.eps, self.equations.norm)
        return next_length(self.h_last, steps, allowed, self.options.h_max)

    def _try_velocity(
        self,
        arrival: Arrival,
        t: float,
        signs: Vector,
        known: int,
    ) -> VelocityStep:
        """Step 2, to the time t."""
        h = arrival.h
        step = self.equations.solve(
            self.qps,
            Assembly(self.graph, arrival.q, arrival.handed_over, arrival.pose),
            self.history,
            self.q,
            t,
            h,
            signs,
            known,
        )
        if known == STUCK and h <= 100 * SHORTEST_STEP:  # that short it is taken as it is
            return step._replace(settled=True)
        return step

    def _rejected_length(self, step: VelocityStep, h: float, caught: bool, check: bool) -> float:
        """A shorter h where the trial does not do, else ∞.

        The iteration did not settle; or it is the first step after a restart, whose local error is
        known only now; or, where that is to be checked, the error is much larger than (3.5) had it.
        """
        if not step.settled:
            return h / 2
        if self.options.fixed_step is not None or caught or h <= 100 * SHORTEST_STEP:
            return np.inf
        norm, eps = self.equations.norm, self.options.eps
        if self.history.steps == 0:
            return first_redone_length(h, first_order_step(norm(step.a), eps))
        return redone_length(h, self.history.error(h, step.a, norm), eps) if check else np.inf

    def _reject(self) -> None:
        self.qps.settle(accepted=False)
        self.counts["rejected_steps"] += 1

    def _accept(self, step: VelocityStep, arrival: Arrival, h_full: float) -> None:
        self.qps.settle(accepted=True)
        self._last = step
        self.t, self.q = step.t, step.q
        self.history.push(step.h, step.v, step.a)
        self.h_last = max(h_full, step.h)
        # λ from before a restart is never extrapolated: (4.4), (4.3), (4.2) after a jump in q̇, and
        # (4.3), (4.3), (4.2) after one in q̈
        self.lam_known = min(self.lam_known + 1, self.history.steps, 2)
        self.graph.note_multipliers(step.lam_N)
        for row_id, place in arrival.handed_over.items():
            before = self.graph.normals[row_id].place
            self._log("hand_over", f"{self._place_name(before)} to {self._place_name(place)}")
        if arrival.handed_over:
            self.graph.hand_over(arrival.handed_over)
        self.graph.candidates.note_clearances(arrival.clearance)
        self._tell_of_overlaps(arrival.too_deep)
        gaps = step.assembly.columns.phi
        if self.options.drift == "projection":
            gaps = self._project(step)
        self.counts["steps"] += 1
        self._standstill = 0
        self._record(step, gaps)

    def _after_step(
        self,
        step: VelocityStep,
        hits: list[Hit],
        losses: list[SlideOff],
        stopped: list[Friction],
    ) -> None:
        """Steps 3 and 4, at the end of an accepted step."""
        hits = [hit for hit in hits if hit.h <= step.h + SAME_TIME]
        losses = [loss for loss in losses if loss.h <= step.h + SAME_TIME]
        F = self._external_impulse(self.t)
        if stopped:
            self._stick(stopped)
        hits += self._slide_off(losses)
        if hits or F.any():
            self._impulse(hits, F)
            return
        if any(abs(time - self.t) <= SHORTEST_STEP for time in self._jumps):
            self._log("force_jump", "")
            self._restart(1)
        if stopped or losses:
            return
        self._drop_separating(step.assembly, step.gap_speed)
        for j in np.flatnonzero(self._slides(step)):
            friction = step.assembly.frictions[j]
            if friction.sign == 0 and friction.row_id in self.graph.frictions:
                self.slip(friction, -int(np.sign(step.slip_speed[j])))

    def _after_quiet_steps(self, taken: int, last: LastStep | None) -> None:
        """Step 4 after steps that were taken elsewhere, where it is not done."""
        self._standstill, self._last = 0, None
        if last is None:
            self.gain_watch.calm()
            self.rest_since = np.inf
            return
        step = self._last = last.step
        self._check_constraints(step.assembly, step.gap_speed)
        if taken > 1:  # those before the last were quiet and in motion
            self.gain_watch.calm()
            self.rest_since = np.inf
        self._watch_gain(step, last.signs)
        stopped = [step.assembly.frictions[j] for j in np.flatnonzero(last.stopped)]
        self._after_step(step, [], [], stopped)
        self._watch_rest()

    @property
    def at_rest(self) -> bool:
        """Whether rest has been shown for as long as it belongs to a run."""
        return bool(self.t >= self.rest_since + REST_SHOWN)

    def _watch_rest(self) -> None:
        """Whether all bodies are still, and nothing that is ahead or acts on them changes that."""
        if not self.scene.stop_at_rest or not self.history.a or self.scheduled() < np.inf:
            return
        v, a = (fastest_body(self.D, motion) for motion in (self.history.v, self.history.a[0]))
        if max(v, REST_HORIZON * a) > self.options.rest_speed:
            self.rest_since = np.inf
        elif self.rest_since == np.inf:
            self.rest_since = self.t
            self._log("rest", "")
