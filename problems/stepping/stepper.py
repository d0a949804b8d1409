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
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from problems.bodies.path import Path
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
from problems.qp import Vector
from problems.scenes import Scene
from problems.sequence import SimulationError, SolvesQPs
from problems.stepping.events import (
    SAME_TIME,
    TOUCH_TOL,
    Arrival,
    Hit,
    SlideOff,
    look_ahead,
    touching,
)
from problems.stepping.options import StepperOptions
from problems.stepping.quiet import LastStep, Quiet
from problems.stepping.run import Run
from problems.stepping.system import System
from problems.stepping.transitions import Transitions
from problems.stepping.velocity import STUCK, Interval, VelocityStep

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
    keep_qps: bool = True,
    progress: Callable[[float], None] | None = None,
    **settings: Any,
) -> Run:
    """Simulate `scene` with `solver` in the loop, to `until` [s], its end time or rest.

    eps and until default to the scene's own.
    keep_qps : whether the run holds its QPs; without them, steps in which nothing happens are left
        to the solver where it can take them, see `problems.stepping.quiet`
    progress : called with t after every accepted step, or after some at once
    settings : the others of `StepperOptions`, by name: friction="paper", fixed_step=0.005, …

    Raises ValueError for bad settings or bodies that overlap at the start, see `Stepper.start`,
    TypeError for settings that there are not, `SimulationError` where the simulation cannot go on.
    Whatever ends it early, Ctrl-C too, has the motion until then as its `run`.
    """
    options = StepperOptions.of(scene.eps if eps is None else eps, **settings)
    end = scene.end_time if until is None else float(until)
    if not (np.isfinite(end) and end > 0):
        name = "end_time" if until is None else "until"
        raise ValueError(f"{name} = {end!r}; it must be a positive time")
    stepper = Stepper(scene, solver, options, keep_qps)
    system = stepper.system
    try:
        stepper.start()
        while system.t < end - SHORTEST_STEP and not stepper.at_rest:
            stepper.advance(end)
            if progress is not None:
                progress(system.t)
    except BaseException as error:
        if system.stretches:
            error.run = system.finish()  # type: ignore[attr-defined]
        raise
    return system.finish()


class Ahead(NamedTuple):
    """What the path meets first, and where it is then: step 3, before any QP is solved.

    hits, losses : the collisions and losses of support there, none where nothing is met
    """

    arrival: Arrival
    hits: list[Hit]
    losses: list[SlideOff]

    @property
    def stands(self) -> bool:
        """Whether it is met at t_{n−1} itself."""
        return bool(self.hits or self.losses) and self.arrival.h < SHORTEST_STEP


@dataclass(eq=False)
class Trial:
    """What the next trial of a step is made with, and how many before it were in vain.

    here : the columns at t_{n−1};  slip : (F,) G_Fᵀq̇ there
    path : q(h), with the step length h [s], the one wished for, and the time not to be passed
    signs : (F,) s of the contacts in J_FW, 0 of those in J_FO;  known : see `velocity`
    unsettled, redone, located : trials whose passes did not settle, whose error was too large,
        in which friction stopped
    """

    here: Assembly
    slip: Vector
    path: Path
    h: float
    wish: float
    latest: float
    signs: Vector
    known: int
    unsettled: int = 0
    redone: int = 0
    located: int = 0


@final
class Stepper:
    """One simulation by algorithm 1; `start` once, then `advance` step by step.

    system : state, forces, records;  transitions : what changes J_N, J_FO and J_FW
    """

    def __init__(
        self, scene: Scene, solver: SolvesQPs, options: StepperOptions, keep_qps: bool = True
    ) -> None:
        self.system = System(scene, solver, options, keep_qps)
        self.transitions = Transitions(self.system)
        self._quiet = Quiet(self.system, self.transitions)
        self._last: VelocityStep | None = None

    def start(self) -> None:
        """J_N at t = 0, after the impulse that the initial velocities or F call for (§3.1).

        Where a scene begins with a state of another run, φ has drifted: what overlaps by no more
        than the `contact_tol` of its parts touches.

        Raises ValueError, with the pair and the depth, where parts overlap by more, and where a
        body is too small or too large for the tolerances.
        """
        self._check_sizes()
        self._check_overlaps()
        system, pose = self.system, self.system.pose()
        system.graph.candidates.take_as_touching(system.q, TOUCH_TOL)
        for hit in touching(system.graph, system.q, system.history.v, -np.inf):
            system.graph.insert(pose, hit.corner, hit.part, hit.edge)
        system.record()
        F, assembly = system.external_impulse(0.0), system.assembly()
        gap_speed = assembly.gap_speed(system.history.v)
        if (gap_speed < -system.slowest_approach).any() or F.any():
            self.transitions.impulse([], F)
        else:
            self.transitions.drop_separating(assembly, gap_speed)
            self.transitions.sort_frictions(system.assembly(), system.history.v)

    def _check_overlaps(self) -> None:
        """Raise ValueError for parts that overlap by more than what is taken for contact."""
        system, geometry = self.system, self.system.graph.geometry
        pose = system.pose()
        for pair in geometry.near_pairs(pose, 0.0):
            depth = geometry.penetration(pose, pair)
            most = float(geometry.contact_tol[[*pair]].min())
            if depth > most:
                names = [system.body_name(int(geometry.part_body[p])) for p in pair]
                raise ValueError(
                    f"scene {system.scene.name!r}: {names[0]} and {names[1]} overlap by "
                    f"{depth:.3g} m at the start, and up to {most:.3g} m is taken for contact; "
                    "move them apart"
                )

    def _check_sizes(self) -> None:
        """Raise ValueError for a body smaller than an overlap may be, or so large or far off that
        its corners are rounded by more than a hundredth of what counts as touching.
        """
        system = self.system
        least, centres = FAR_TOO_DEEP * system.allowed_overlap, system.scene.q0[:, :2]
        for i, radius in enumerate(system.graph.geometry.radius):
            far = float(np.abs(centres[i]).max() + radius)
            if 2 * radius < least:
                reason = (
                    f"is {2 * radius:.3g} m across, and at eps = {system.options.eps:g} bodies may "
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
            raise ValueError(f"scene {system.scene.name!r}: {system.body_name(i)} {reason}")

    def advance(self, end: float) -> None:
        """One accepted step, some quiet ones, or one event where no time passes."""
        self.system.watch_progress()
        taken, last = self._quiet.take_steps(end)
        if taken:
            self._after_quiet_steps(taken, last)
            return
        trial = self._first_trial(end)
        for _ in range(MAX_TRIES):
            ahead = self._look_ahead(trial)
            if ahead.stands:
                self.transitions.standing_event(ahead.hits, ahead.losses)
                return
            step = self._try_velocity(trial, ahead.arrival)
            if self._jams(trial, step) or self._is_redone(trial, step):
                continue
            lengths = self._stopping_lengths(trial, step)
            first = float(lengths.min(initial=np.inf))
            if self._sticks_on_the_way(trial, lengths, first):
                continue
            if first < SHORTEST_STEP:
                self._stop_here(trial, lengths, first)
                return
            if self._is_cut(trial, first):
                continue
            self._take(trial, ahead, step, lengths)
            return
        raise SimulationError(
            f"t = {self.system.t:.6g}: no acceptable step after {MAX_TRIES} trials "
            f"(h = {trial.h:.3g}); try a smaller eps or another solver"
        )

    def _first_trial(self, end: float) -> Trial:
        """The first trial of the next step: h by (3.5), not beyond what is scheduled or `end`."""
        system = self.system
        here, gap_speed, slip = self._here()
        self.transitions.check_constraints(here, gap_speed)
        self.transitions.sort_signs(here, slip)
        wish, latest = self._step_length(), system.scheduled()
        return Trial(
            here=here,
            slip=slip,
            path=system.history.path(system.q),
            h=min(wish, min(latest, end) - system.t),
            wish=wish,
            latest=latest,
            signs=np.array([friction.sign for friction in here.frictions], dtype=np.float64),
            known=system.lam_known,
        )

    def _here(self) -> tuple[Assembly, Vector, Vector]:
        """The columns at t_{n−1}, G_Nᵀq̇ and G_Fᵀq̇: those of the last step where they still hold."""
        last, system = self._last, self.system
        if last is not None:
            same = last.v is system.history.v and last.assembly.active is system.graph.active_set()
            if same:
                return last.assembly, last.gap_speed, last.slip_speed
        here = system.assembly()
        return here, here.gap_speed(system.history.v), here.slip_speed(system.history.v)

    def _look_ahead(self, trial: Trial) -> Ahead:
        """Step 1, and step 3 as far as it concerns positions: h ends where something is met."""
        system = self.system
        graph, path, allowed = system.graph, trial.path, system.allowed_overlap
        arrival, hits, losses = look_ahead(graph, path, trial.h, system.slowest_approach, allowed)
        if not (hits or losses):
            return Ahead(arrival, hits, losses)
        first = min([*(hit.h for hit in hits), *(loss.h for loss in losses)])
        hits = [hit for hit in hits if hit.h <= first + SAME_TIME]
        losses = [loss for loss in losses if loss.h <= first + SAME_TIME]
        if first < SHORTEST_STEP:
            return Ahead(arrival._replace(h=first), hits, losses)
        if first < trial.h:
            trial.h = first
            arrival, _, _ = look_ahead(graph, path, first, np.inf, allowed)
        return Ahead(arrival, hits, losses)

    def _jams(self, trial: Trial, step: VelocityStep) -> bool:
        """Whether the passes have failed `JAM_TRIALS` times: then everything may stick, shortly."""
        if step.settled:
            return False
        trial.unsettled += 1
        self.transitions.watch_gain(step, trial.signs)
        if trial.unsettled != JAM_TRIALS or not trial.signs.any():
            return False
        self._reject()
        self.transitions.restart(1)
        trial.path = self.system.history.path(self.system.q)
        trial.h, trial.known = min(trial.h, JAM_STEP), STUCK
        trial.signs = np.zeros_like(trial.signs)
        return True

    def _is_redone(self, trial: Trial, step: VelocityStep) -> bool:
        """Whether the trial does not do, and the next one is shorter."""
        shorter = self._rejected_length(step, trial)
        if shorter == np.inf:
            return False
        trial.h, trial.wish = shorter, min(trial.wish, shorter)
        trial.redone += step.settled
        self._reject()
        return True

    def _stopping_lengths(self, trial: Trial, step: VelocityStep) -> Vector:
        """Where on the way each sliding contact stops [s], ∞ where it does not.  (F,)"""
        eps = self.system.options.eps
        return stopping_lengths(trial.signs, trial.slip, step.slip_speed, step.h, eps)

    def _sticks_on_the_way(self, trial: Trial, lengths: Vector, first: float) -> bool:
        """With `stops="held"`: whether what stops on the way is to stick for all of it."""
        held = first < trial.h and self.system.options.stops == "held"
        if held:
            trial.signs = np.where(lengths < trial.h, 0.0, trial.signs)
            self._reject()
        return held

    def _stop_here(self, trial: Trial, lengths: Vector, first: float) -> None:
        """Friction that stops at t_{n−1} itself: an event without a step."""
        self._reject()
        self.transitions.count_standstill()
        stopped = np.flatnonzero(lengths <= first)
        self.transitions.stick([trial.here.frictions[j] for j in stopped])

    def _is_cut(self, trial: Trial, first: float) -> bool:
        """Whether friction stops on the way, where the step is to end."""
        if not first < trial.h * (1 - 1e-6):
            return False
        trial.located += 1
        trial.h = first if trial.located < STOP_TRIALS else min(first, trial.h / 2)
        self._reject()
        return True

    def _take(self, trial: Trial, ahead: Ahead, step: VelocityStep, lengths: Vector) -> None:
        """Accept a step, then steps 3 and 4."""
        transitions, frictions = self.transitions, trial.here.frictions
        self._accept(step, ahead.arrival, trial.wish)
        transitions.watch_gain(step, trial.signs)
        if trial.known == STUCK:
            transitions.jam(step)
        stopped: list[Friction] = []
        if frictions:
            held = (trial.signs == 0) & ~transitions.slides(step)
            ends = [frictions[j] for j in np.flatnonzero(held | (lengths <= trial.h))]
            stopped = [friction for friction in ends if friction.sign != 0]
        self._after_step(step, ahead.hits, ahead.losses, stopped)
        self._watch_rest()

    def _step_length(self) -> float:
        """Step 1: h from (3.5), with limits on growth; the old one after a restart."""
        system, options = self.system, self.system.options
        if options.fixed_step is not None:
            return options.fixed_step
        steps, allowed = system.history.steps, np.inf
        if steps:
            allowed = system.history.largest_step(options.eps, system.equations.norm)
        return next_length(system.h_last, steps, allowed, options.h_max)

    def _try_velocity(self, trial: Trial, arrival: Arrival) -> VelocityStep:
        """Step 2, at the end of the path."""
        system, h = self.system, arrival.h
        step = system.equations.solve(
            system.qps,
            Assembly(system.graph, arrival.q, arrival.handed_over, arrival.pose),
            system.history,
            Interval(system.q, min(system.t + h, trial.latest), h),
            trial.signs,
            trial.known,
        )
        if trial.known == STUCK and h <= 100 * SHORTEST_STEP:  # that short it is taken as it is
            return step._replace(settled=True)
        return step

    def _rejected_length(self, step: VelocityStep, trial: Trial) -> float:
        """A shorter h where the trial does not do, else ∞.

        The iteration did not settle; or it is the first step after a restart, whose local error is
        known only now; or, where that is to be checked, the error is much larger than (3.5) had it.
        """
        h, history, options = trial.h, self.system.history, self.system.options
        if not step.settled:
            return h / 2
        if options.fixed_step is not None or trial.known == STUCK or h <= 100 * SHORTEST_STEP:
            return np.inf
        norm, eps = self.system.equations.norm, options.eps
        if history.steps == 0:
            return first_redone_length(h, first_order_step(norm(step.a), eps))
        if trial.redone >= REDONE:
            return np.inf
        return redone_length(h, history.error(h, step.a, norm), eps)

    def _reject(self) -> None:
        self.system.qps.settle(accepted=False)
        self.system.counts["rejected_steps"] += 1

    def _accept(self, step: VelocityStep, arrival: Arrival, wish: float) -> None:
        system, graph = self.system, self.system.graph
        system.qps.settle(accepted=True)
        self._last = step
        system.t, system.q = step.t, step.q
        system.history.push(step.h, step.v, step.a)
        system.h_last = max(wish, step.h)
        # λ from before a restart is never extrapolated: (4.4), (4.3), (4.2) after a jump in q̇, and
        # (4.3), (4.3), (4.2) after one in q̈
        system.lam_known = min(system.lam_known + 1, system.history.steps, 2)
        graph.note_multipliers(step.lam_N)
        for row_id, place in arrival.handed_over.items():
            before = system.place_name(graph.normals[row_id].place)
            system.log("hand_over", f"{before} to {system.place_name(place)}")
        if arrival.handed_over:
            graph.hand_over(arrival.handed_over)
        graph.candidates.note_clearances(arrival.clearance)
        self.transitions.tell_of_overlaps(arrival.too_deep)
        gaps = step.assembly.columns.phi
        if system.options.drift == "projection":
            gaps, self._last = system.project(step), None
        system.counts["steps"] += 1
        self.transitions.time_moves_on()
        system.record(step, gaps)

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
        F = self.system.external_impulse(self.system.t)
        if stopped:
            self.transitions.stick(stopped)
        hits += self.transitions.slide_off(losses)
        if hits or F.any():
            self.transitions.impulse(hits, F)
            return
        if any(abs(time - self.system.t) <= SHORTEST_STEP for time in self.system.jumps):
            self.system.log("force_jump", "")
            self.transitions.restart(1)
        if stopped or losses:
            return
        self.transitions.drop_separating(step.assembly, step.gap_speed)
        for j in np.flatnonzero(self.transitions.slides(step)):
            friction = step.assembly.frictions[j]
            if friction.sign == 0 and friction.row_id in self.system.graph.frictions:
                self.transitions.slip(friction, -int(np.sign(step.slip_speed[j])))

    def _after_quiet_steps(self, taken: int, last: LastStep | None) -> None:
        """Step 4 after steps that were taken elsewhere, where it is not done."""
        self._last = None
        self.transitions.time_moves_on()
        if last is None:
            self.system.gain_watch.calm()
            self.system.rest_since = np.inf
            return
        step = self._last = last.step
        self.transitions.check_constraints(step.assembly, step.gap_speed)
        if taken > 1:  # those before the last were quiet and in motion
            self.system.gain_watch.calm()
            self.system.rest_since = np.inf
        self.transitions.watch_gain(step, last.signs)
        stopped = [step.assembly.frictions[j] for j in np.flatnonzero(last.stopped)]
        self._after_step(step, [], [], stopped)
        self._watch_rest()

    @property
    def at_rest(self) -> bool:
        """Whether rest has been shown for as long as it belongs to a run."""
        return bool(self.system.t >= self.system.rest_since + REST_SHOWN)

    def _watch_rest(self) -> None:
        """Whether all bodies are still, and nothing that is ahead or acts on them changes that."""
        system = self.system
        if not (system.scene.stop_at_rest and system.history.a) or system.scheduled() < np.inf:
            return
        motions = system.history.v, system.history.a[0]
        v, a = (fastest_body(system.D, motion) for motion in motions)
        if max(v, REST_HORIZON * a) > system.options.rest_speed:
            system.rest_since = np.inf
        elif system.rest_since == np.inf:
            system.rest_since = system.t
            system.log("rest", "")
