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
    catch, q̇ jumps, and it restarts once more.  Gains ≥ 1 are events, see `problems.stepping.gain`;
 8. beyond the paper's contacts, as its section 6 proposes: joints are rows of J_N whose multipliers
    have no bounds, or those of a material that yields, and stops join it where they are reached
    (`problems.joints`); forces switch where a function of the state is 0
    (`problems.stepping.switches`); impacts may bounce (`problems.stepping.restitution`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from problems.contacts.constraint_graph import Friction
from problems.formulas.multistep import SHORTEST_STEP
from problems.formulas.step_kernels import FAR_TOO_DEEP, fastest_body
from problems.friction.passes import UNSETTLED
from problems.joints.row_kernels import rows_at
from problems.scenes import Scene
from problems.sequence import SimulationError, SolvesQPs
from problems.stepping.driver import Driver
from problems.stepping.events import (
    SAME_TIME,
    TOUCH_TOL,
    Ahead,
    May,
    look_ahead,
    touching,
    touching_stops,
)
from problems.stepping.options import StepperOptions, end_of
from problems.stepping.records import AGAIN, GIVES_UP, HELD, LOOK, MEETS, STANDS
from problems.stepping.run import Run, kept_until_then
from problems.stepping.steps import MAX_TRIES
from problems.stepping.system import System
from problems.stepping.transitions import Transitions
from problems.stepping.velocity import VelocityStep

NOTHING_AHEAD = Ahead(np.inf, [], [], {}, {}, [], [])
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
    keep_qps : whether the run holds its QPs; those that it does not hold are left to the compiled
        method of the solver, if it has one, see `problems.stepping.driver`
    progress : called with t after every accepted step, or after some at once
    settings : the others of `StepperOptions`, by name: friction="paper", fixed_step=0.005, …

    Raises ValueError for bad settings or bodies that overlap at the start, see `Stepper.start`,
    TypeError for settings that there are not, `SimulationError` where the simulation cannot go on.
    Whatever ends it early, Ctrl-C too, has the motion until then as its `run`.
    """
    options = StepperOptions.of(scene.eps if eps is None else eps, **settings)
    end = end_of(scene.end_time, until)
    stepper = Stepper(scene, solver, options, keep_qps)
    system = stepper.system
    with kept_until_then(system.stretches, system.finish):
        stepper.start()
        while system.t < end - SHORTEST_STEP and not stepper.at_rest:
            stepper.advance(end)
            if progress is not None:
                progress(system.t)
    return system.finish()


@final
class Stepper:
    """One simulation by algorithm 1; `start` once, then `advance` step by step.

    system : state, forces, records;  transitions : what changes J_N, J_FO and J_FW
    Steps are taken by a `Driver`, which says what they meet.
    """

    def __init__(
        self, scene: Scene, solver: SolvesQPs, options: StepperOptions, keep_qps: bool = True
    ) -> None:
        self.system = System(scene, solver, options, keep_qps)
        self.transitions = Transitions(self.system)
        self._driver = Driver(self.system)
        self._looked = True

    def start(self) -> None:
        """J_N at t = 0, after the impulse that the initial velocities or F call for (§3.1).

        Where a scene begins with a state of another run, φ has drifted: what overlaps by no more
        than the `contact_tol` of its parts touches.

        Raises ValueError, with the pair and the depth, where parts overlap by more, and where a
        body is too small or too large for the tolerances.
        """
        self._check_sizes()
        self._check_overlaps()
        self._check_joints()
        system, pose = self.system, self.system.pose()
        system.graph.candidates.take_as_touching(system.q, TOUCH_TOL)
        for hit in touching(system.graph, system.q, system.history.v, -np.inf):
            system.graph.insert(pose, hit.corner, hit.part, hit.edge)
        for row in touching_stops(system.graph, system.q, system.history.v, -np.inf):
            system.graph.set_stop(row, True)
        system.record()
        F, assembly = system.external_impulse(0.0), system.assembly()
        gap_speed = assembly.gap_speed(system.history.v)
        parting = np.abs(gap_speed[assembly.held]).max(initial=0.0)
        violated = max(parting, -gap_speed.min(initial=0.0)) > system.slowest_approach
        if violated or F.any():
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

    def _check_joints(self) -> None:
        """Raise ValueError for a joint whose parts are farther apart than drift may leave them."""
        system = self.system
        rows = system.graph.rows
        phi = rows_at(rows, system.q)[0]
        phi = np.where(rows.stop != 0, np.maximum(-phi, 0.0), np.abs(phi))
        if phi.max(initial=0.0) > system.allowed_overlap:
            worst = int(np.argmax(phi))
            raise ValueError(
                f"scene {system.scene.name!r}: {system.joint_name(worst)} is open by "
                f"{phi[worst]:.3g} m or rad at the start; move the bodies, or its points"
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
        """One accepted step, some in which nothing happens, or one event where no time passes."""
        driver, ahead, unsettled = self._driver, NOTHING_AHEAD, 0
        self.system.watch_progress()
        self._check_constraints()
        driver.begin(end)
        while True:
            ended = self._go_on()
            if ended == MEETS:
                ahead = self._look_ahead()
                if ahead.stands:
                    self.transitions.standing_event(ahead)
                    return
            elif ended == UNSETTLED:
                ahead, unsettled = NOTHING_AHEAD, unsettled + 1
                self._see_to_failure(unsettled)
            elif ended == HELD:
                sticks = driver.lengths < driver.trial["h"]
                driver.prepare(np.where(sticks, 0.0, driver.signs), ahead.handed_over)
            else:
                break
        self._looked = ended != AGAIN
        if ended == STANDS:
            self._stop_here()
        elif ended == LOOK:
            self._see_to_step(ahead)
        elif ended == GIVES_UP:
            raise SimulationError(
                f"t = {self.system.t:.6g}: no acceptable step after {MAX_TRIES} trials "
                f"(h = {driver.trial['h']:.3g}); try a smaller eps or another solver"
            )

    def _go_on(self) -> int:
        """Why no more steps are taken; those before one to be looked at were in quiet motion."""
        system = self.system
        before = system.counts["steps"]
        ended = self._driver.go_on()
        taken = system.counts["steps"] - before
        if taken:
            self.transitions.time_moves_on()
        if taken > (ended == LOOK):
            system.gain_watch.calm()
            system.rest_since = np.inf
        return ended

    def _check_constraints(self) -> None:
        """What is active is not approached where something has changed."""
        if self._looked:
            assembly = self.system.assembly()
            self.transitions.check_constraints(assembly, assembly.gap_speed(self.system.history.v))

    def _look_ahead(self) -> Ahead:
        """Step 3 as far as it concerns positions: h of the trial ends where something is met."""
        system, driver, trial = self.system, self._driver, self._driver.trial
        limits = system.slowest_approach, system.allowed_overlap
        may, h = May(*(bool(trial[name]) for name in May._fields)), float(trial["h"])
        switches = system.switches.crossings(driver.path, system.t, h)
        ahead = look_ahead(system.graph, driver.path, h, *limits, may, switches)
        if not ahead.stands:
            driver.cut(ahead.h, ahead.handed_over)
        return ahead

    def _see_to_failure(self, unsettled: int) -> None:
        """After passes that did not settle: where they have `JAM_TRIALS` times, all may stick."""
        system, driver, trial = self.system, self._driver, self._driver.trial
        step, signs = driver.last_step(settled=False), driver.signs
        self.transitions.watch_gain(step, signs)
        if unsettled == JAM_TRIALS and signs.any():
            self.transitions.restart(1)
            system.h_last = float(trial["wish"])
            trial["stuck"], trial["cut"] = 1, min(float(trial["h"]), JAM_STEP)
            trial["longest"], trial["looked"], signs = np.inf, 0.0, np.zeros_like(signs)
        driver.prepare(signs)

    def _stop_here(self) -> None:
        """Friction that stops at t_{n−1} itself: an event without a step."""
        lengths = self._driver.lengths
        self.transitions.count_standstill()
        frictions = self.system.graph.active_set().frictions
        stopped = np.flatnonzero(lengths <= lengths.min())
        self.transitions.stick([frictions[j] for j in stopped])

    def _see_to_step(self, ahead: Ahead) -> None:
        """Steps 3 and 4 after the last step that was taken."""
        system, transitions, driver = self.system, self.transitions, self._driver
        step, signs, lengths = driver.last_step(), driver.signs, driver.lengths
        for row_id, place in ahead.handed_over.items():
            before = system.place_name(system.graph.normals[row_id].place)
            system.log("hand_over", f"{before} to {system.place_name(place)}")
        if ahead.handed_over:
            system.graph.hand_over(ahead.handed_over)
        transitions.tell_of_overlaps(ahead.too_deep)
        if system.options.drift == "projection":
            system.project(step)
        transitions.watch_gain(step, signs)
        if driver.trial["stuck"]:
            transitions.jam(step)
        slides = transitions.slides(step)
        held = (signs == 0) & ~slides
        ends = np.flatnonzero(held | (lengths <= step.h))
        stopped = [step.assembly.frictions[j] for j in ends]
        stopped = [friction for friction in stopped if friction.sign != 0]
        self._after_step(step, ahead, stopped, slides)
        self._watch_rest()

    def _after_step(
        self,
        step: VelocityStep,
        ahead: Ahead,
        stopped: list[Friction],
        slides: NDArray[np.bool_],
    ) -> None:
        """Steps 3 and 4, at the end of an accepted step; slides (F,), see `Transitions.slides`."""
        hits = [hit for hit in ahead.hits if hit.h <= step.h + SAME_TIME]
        losses = [loss for loss in ahead.losses if loss.h <= step.h + SAME_TIME]
        there = ahead.h <= step.h + SAME_TIME
        stops, switches = (ahead.stops, ahead.switches) if there else ([], [])
        F = self.system.external_impulse(self.system.t)
        if stopped:
            self.transitions.stick(stopped)
        self.transitions.switch(switches)
        hits += self.transitions.slide_off(losses)
        if hits or stops or F.any():
            self.transitions.impulse(hits, F, stops)
            return
        if any(abs(time - self.system.t) <= SHORTEST_STEP for time in self.system.jumps):
            self.system.log("force_jump", "")
            self.transitions.restart(1)
        if stopped or losses or switches:
            return
        self.transitions.drop_separating(step.assembly, step.gap_speed)
        for j in np.flatnonzero(slides):
            friction = step.assembly.frictions[j]
            if friction.sign == 0 and friction.row_id in self.system.graph.frictions:
                self.transitions.slip(friction, -int(np.sign(step.slip_speed[j])))

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
