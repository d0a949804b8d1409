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
    while two edges lie on each other is handed over to the coincident corner, without an event;
 2. t_* is refined from the inverse linear interpolation, collisions and slide-offs are located on
    the position polynomial before any QP is solved;
 3. the threshold of step 4 is a parameter of its own, `drop_tol`, by default ε;
 4. with slip → stick, every contact that slips slower than ε sticks with it;
 5. events at less than `SHORTEST_STEP` are handled where they are, with no step;
 6. corrected friction, see `problems.friction`;
 7. jamming: sliding forces s μ λ with s kept may feed back on λ with a gain ≥ 1, and then no λ
    meets both laws at any h (Painlevé).  Where the passes have failed for `JAM_TRIALS` lengths,
    the integration restarts at t_{n−1} with a short step in which every contact may stick: some
    catch, q̇ jumps, and it restarts once more.  Gains ≥ 1 are events, see `problems.gain`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from problems.assembly import Assembly
from problems.bodies import mass_diagonal
from problems.constraint_graph import ConstraintGraph, Contact, Friction, Normal
from problems.contacts import Geometry
from problems.drift import DRIFT_RULES, DRIFT_TIME, DriftRule, correction
from problems.events import (
    SAME_TIME,
    Arrival,
    Hit,
    SlideOff,
    approach_speed,
    look_ahead,
    successor,
    touching,
)
from problems.forces import Force
from problems.friction import FrictionRule
from problems.gain import GainWatch
from problems.impulses import ImpulseRule, solve_impulse
from problems.multistep import (
    GROWTH,
    SAFETY,
    SHORTEST_STEP,
    History,
    first_order_step,
)
from problems.qp import Vector
from problems.quiet import Shapes, quiet_solver, take_quiet_steps
from problems.run import NO_MULTIPLIERS, Event, Multipliers, Run
from problems.scenes import Scene
from problems.sequence import QPSequence, SimulationError, SolvesQPs
from problems.step_kernels import fastest_body
from problems.velocity import NOTHING, STUCK, VelocityEquations, VelocityStep

MAX_TRIES = 60
"""Trials of one step before the simulation gives up."""
MAX_STANDSTILL = 200
"""Events in a row without the time moving on before the simulation gives up."""
PENETRATION_TOL = 1e-7
"""Initial overlap of two parts that is still taken for contact [m]."""
JAM_TRIALS = 2
"""Trials of a step in which the friction passes may fail to settle before contacts jam."""
JAM_STEP = 1e-4
"""Longest step in which contacts catch [s]: the jump in q̇ does not depend on it."""
REST_HORIZON = 0.3
"""At rest, no body would double its `rest_speed` in this time if it kept its acceleration [s]."""


@dataclass(frozen=True)
class StepperOptions:
    """Settings of algorithm 1.

    eps : ε of (3.5), (3.13) and the tolerance for g_Fᵀq̇ = 0
    drop_tol : separation speed at which a contact is dropped (step 4); default ε
    friction : "corrected" or "paper", see `problems.friction`
    fixed_step : a constant h [s] without error control, cut only by events; None: (3.5)
    h_first, h_max : first and largest step [s]
    order : r of AB-r and BDF-r once it has started, 1 or 2
    impulses : "paper" or "newton_coulomb", see `problems.impulses`
    rest_speed : at rest, ‖q̇_i‖_M ≤ rest_speed and ‖q̈_i‖_M ≤ rest_speed / `REST_HORIZON` for every
        body; default 2 ε
    drift, drift_time : "none", "baumgarte" with τ = drift_time [s], or "projection", see
        `problems.drift`
    """

    eps: float
    drop_tol: float
    friction: FrictionRule = "corrected"
    fixed_step: float | None = None
    h_first: float = 1e-3
    h_max: float = 0.02
    rest_speed: float = 0.0
    order: int = 2
    impulses: ImpulseRule = "paper"
    drift: DriftRule = "none"
    drift_time: float = DRIFT_TIME

    def __post_init__(self) -> None:
        for name in ("eps", "drop_tol", "h_first", "h_max", "rest_speed", "drift_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value!r}; it must be a positive number")
        if self.fixed_step is not None and not 0 < self.fixed_step < np.inf:
            raise ValueError(f"fixed_step = {self.fixed_step!r}; it must be a positive number")
        if self.impulses not in ("paper", "newton_coulomb"):
            raise ValueError(f'impulses = {self.impulses!r}; choose "paper" or "newton_coulomb"')
        if self.drift not in DRIFT_RULES:
            raise ValueError(f"drift = {self.drift!r}; choose one of {', '.join(DRIFT_RULES)}")
        if self.order not in (1, 2):
            raise ValueError(f"order = {self.order!r}; choose 1 or 2")
        if self.friction not in ("paper", "corrected"):
            raise ValueError(f'friction = {self.friction!r}; choose "paper" or "corrected"')


def simulate(
    scene: Scene,
    solver: SolvesQPs,
    *,
    eps: float | None = None,
    until: float | None = None,
    drop_tol: float | None = None,
    friction: FrictionRule = "corrected",
    fixed_step: float | None = None,
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
        to the solver where it can take them, see `problems.quiet`
    progress : called with t after every accepted step, or after some at once

    Raises ValueError for bad settings or bodies that overlap at the start, `SimulationError` where
    the simulation cannot go on.
    """
    eps = scene.eps if eps is None else eps
    options = StepperOptions(
        eps=eps,
        drop_tol=eps if drop_tol is None else drop_tol,
        friction=friction,
        fixed_step=fixed_step,
        h_first=h_first,
        h_max=h_max,
        rest_speed=2 * eps if rest_speed is None else rest_speed,
        order=order,
        impulses=impulses,
        drift=drift,
        drift_time=drift_time,
    )
    end = scene.end_time if until is None else float(until)
    if not (np.isfinite(end) and end > 0):
        raise ValueError(f"until = {until!r}; it must be a positive time")
    stepper = Stepper(scene, solver, options, keep_qps)
    stepper.start()
    while stepper.t < end - SHORTEST_STEP and not stepper.at_rest:
        stepper.advance(end)
        if progress is not None:
            progress(stepper.t)
    return stepper.finish()


class Stepper:
    """The state of one simulation; `start` once, then `advance` step by step."""

    def __init__(
        self, scene: Scene, solver: SolvesQPs, options: StepperOptions, keep_qps: bool = True
    ):
        self.scene, self.options = scene, options
        self.D = np.sqrt(mass_diagonal(scene.bodies))
        self.D.setflags(write=False)
        self.graph = ConstraintGraph(Geometry(scene.bodies, scene.ground), scene.mu_between)
        self.qps = QPSequence(solver, keep_qps)
        self.forces = forces = scene.all_forces()
        self._steady = [force for force in forces if getattr(force, "constant", False)]
        self._varying = [force for force in forces if not getattr(force, "constant", False)]
        self._jumps = sorted({time for force in forces for time in force.jumps})
        self._constant: dict[int, Vector] = {}
        self._impulses = sorted(scene.impulses, key=lambda impulse: (impulse.t, impulse.body))
        self.equations = VelocityEquations(
            D=self.D,
            forces=self.force,
            velocity_dependent=any(force.velocity_dependent for force in forces),
            eps=options.eps,
            friction=options.friction,
            drift_time=options.drift_time if options.drift == "baumgarte" else np.inf,
        )
        self.gain_watch = GainWatch(self.D, self.equations.velocity_dependent)
        self.t = 0.0
        self.q = scene.q0.ravel().copy()
        self.history = History(scene.v0.ravel().copy(), options.order)
        self.lam_known = 0
        self.h_last = options.h_first
        self.slowest_approach = 1e-3 * options.drop_tol
        self.counts = dict.fromkeys(("steps", "rejected_steps", "restarts", "impulses"), 0)
        self.event_log: list[Event] = []
        self._standstill = 0
        self._last: VelocityStep | None = None
        self.at_rest = False
        self.states: list[tuple[float, Vector, Vector, Multipliers, float]] = []
        self.shapes = Shapes.of(self.graph.geometry)
        self._quiet = quiet_solver(self)

    def force(self, q: Vector, v: Vector, t: float) -> Vector:
        """f(q, q̇, t) of (2.1), (3n,); those that are constant between jumps are summed once."""
        interval = bisect_left(self._jumps, t)
        if interval not in self._constant:
            self._constant[interval] = _sum_of(self._steady, q, v, t, np.zeros_like(q))
        constant = self._constant[interval]
        return _sum_of(self._varying, q, v, t, constant.copy()) if self._varying else constant

    # --- start and finish ------------------------------------------------------------------------

    def start(self) -> None:
        """J_N at t = 0, after the impulse that the initial velocities or F call for (§3.1).

        Raises ValueError, with the pair and the depth, where parts overlap.
        """
        geometry = self.graph.geometry
        pose = geometry.pose(self.q)
        for pair in geometry.near_pairs(pose, geometry.contact_tol):
            depth = geometry.penetration(pose, pair)
            if depth > PENETRATION_TOL:
                names = [self._body_name(int(geometry.part_body[p])) for p in pair]
                raise ValueError(
                    f"scene {self.scene.name!r}: {names[0]} and {names[1]} overlap by "
                    f"{depth:.3g} m at the start; move them apart"
                )
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

    def finish(self) -> Run:
        """Everything that the simulation left behind."""
        t, q, v, multipliers, gaps = zip(*self.states, strict=True)
        shape = (len(t), len(self.scene.bodies), 3)
        return Run(
            scene=self.scene,
            t=np.array(t),
            q=np.array(q).reshape(shape),
            v=np.array(v).reshape(shape),
            multiplier_rows=multipliers,
            gaps=np.array(gaps),
            event_log=self.event_log,
            qps=self.qps.qps,
            solutions=self.qps.solutions,
            counts=self.counts | {"qps": self.qps.count},
            options=asdict(self.options),
        )

    # --- algorithm 1 -----------------------------------------------------------------------------

    def advance(self, end: float) -> None:
        """One accepted step, some quiet ones, or one event where no time passes."""
        if self._quiet is not None and take_quiet_steps(self, self._quiet, end):
            self._after_quiet_steps()
            return
        here, gap_speed, slip_before = self._here()
        self._check_constraints(here, gap_speed)
        self._sort_signs(here, slip_before)
        path = self.history.path(self.q)
        signs = np.array([friction.sign for friction in here.frictions], dtype=np.float64)
        known = self.lam_known
        h_full = self._step_length()
        h = min(h_full, min([*self.scheduled(), end]) - self.t)
        unsettled = 0
        for _ in range(MAX_TRIES):
            arrival, hits, losses = look_ahead(self.graph, path, h, self.slowest_approach)
            if hits or losses:
                h_event = min([*(hit.h for hit in hits), *(loss.h for loss in losses)])
                hits = [hit for hit in hits if hit.h <= h_event + SAME_TIME]
                losses = [loss for loss in losses if loss.h <= h_event + SAME_TIME]
                if h_event < SHORTEST_STEP:
                    self._standing_event(hits, losses)
                    return
                if h_event < h:
                    h = h_event
                    arrival, _, _ = look_ahead(self.graph, path, h, np.inf)
            step = self._try_velocity(arrival, signs, known)
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
            shorter = self._rejected_length(step, h, known == STUCK)
            if shorter is not None:
                h, h_full = shorter, min(h_full, shorter)
                self._reject()
                continue
            lengths = self._stopping_lengths(step, signs, slip_before)
            h_stick = lengths.min(initial=np.inf)
            if h_stick < SHORTEST_STEP:
                self._reject()
                self._count_standstill()
                self._stick([here.frictions[j] for j in np.flatnonzero(lengths <= h_stick)])
                return
            if h_stick < h * (1 - 1e-6):
                h = h_stick
                self._reject()
                continue
            self._accept(step, arrival, h_full)
            self._watch_gain(step, signs)
            if known == STUCK:
                self._jam(step)
            stopped = [here.frictions[j] for j in np.flatnonzero(lengths <= h)]
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
        h = min(
            self.h_last if self.history.steps == 0 else GROWTH * self.h_last, self.options.h_max
        )
        if self.history.steps:
            h = min(h, SAFETY * self.history.largest_step(self.options.eps, self.equations.norm))
        return max(h, 10 * SHORTEST_STEP)

    def _try_velocity(
        self,
        arrival: Arrival,
        signs: Vector,
        known: int,
    ) -> VelocityStep:
        """Step 2."""
        h = arrival.h
        step = self.equations.solve(
            self.qps,
            Assembly(self.graph, arrival.q, arrival.handed_over, arrival.pose),
            self.history,
            self.q,
            self.t + h,
            h,
            signs,
            known,
        )
        if known == STUCK and h <= 100 * SHORTEST_STEP:  # that short it is taken as it is
            return step._replace(settled=True)
        return step

    def _rejected_length(self, step: VelocityStep, h: float, caught: bool) -> float | None:
        """A shorter step where the trial does not do, else None.

        The iteration did not settle, or it is the first step after a restart, whose local error
        is known only now.
        """
        if not step.settled:
            return h / 2
        if self.history.steps == 0 and self.options.fixed_step is None and not caught:
            largest = first_order_step(self.equations.norm(step.a), self.options.eps)
            if h > largest and h > 100 * SHORTEST_STEP:
                return SAFETY * largest
        return None

    def _reject(self) -> None:
        self.qps.settle(accepted=False)
        self.counts["rejected_steps"] += 1

    def _accept(self, step: VelocityStep, arrival: Arrival, h_full: float) -> None:
        self.qps.settle(accepted=True)
        self._last = step
        self.t, self.q = self.t + step.h, step.q
        self.history.push(step.h, step.v, step.a)
        self.h_last = max(h_full, step.h)
        # λ from before a restart is never extrapolated: (4.4), (4.3), (4.2) after a jump in q̇, and
        # (4.3), (4.3), (4.2) after one in q̈
        self.lam_known = min(self.lam_known + 1, self.history.steps, 2)
        self.graph.note_multipliers(step.lam_N)
        for row_id, place in arrival.handed_over.items():
            normal = self.graph.normals[row_id]
            self._log("hand_over", f"{self._place_name(normal.place)} to {self._place_name(place)}")
            self.graph.hand_over(normal, place)
        self.graph.active_set()  # what was handed over is not free
        self.graph.candidates.note_clearances(arrival.clearance)
        gaps = step.assembly.columns.phi
        if self.options.drift == "projection":
            gaps = self._project(step)
        self.counts["steps"] += 1
        self._standstill = 0
        self._record(step, gaps)

    def _project(self, step: VelocityStep) -> Vector:
        """Close the gaps of the contacts that bear a load; φ (N,) of all after it."""
        assembly = step.assembly
        loaded = np.flatnonzero(step.lam_N > 0)
        sticking = np.flatnonzero([friction.sign == 0 for friction in assembly.frictions])
        wanted = np.concatenate([-assembly.columns.phi[loaded], np.zeros(sticking.size)])
        A = assembly.scaled(loaded, sticking, self.D)
        self.q, self._last = self.q + correction(A, self.D, wanted), None
        return Assembly(self.graph, self.q).columns.phi

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
        for j in np.flatnonzero(step.at_bound):
            friction, speed = step.assembly.frictions[j], step.slip_speed[j]
            alive = friction.row_id in self.graph.frictions
            if alive and friction.sign == 0 and abs(speed) > self.options.eps:
                friction.sign = -int(np.sign(speed))
                self._log("stick_to_slip", self._contact_name(friction.contact))

    def _after_quiet_steps(self) -> None:
        """Step 4 after steps in which nothing else happened."""
        self._standstill = 0
        assembly, gap_speed, _ = self._here()
        self._check_constraints(assembly, gap_speed)
        self._drop_separating(assembly, gap_speed)
        self._watch_rest()

    def _standing_event(self, hits: list[Hit], losses: list[SlideOff]) -> None:
        """Events at t_{n−1} itself."""
        self._count_standstill()
        hits += self._slide_off(losses)
        if hits:
            self._impulse(hits, np.zeros_like(self.q))

    def _count_standstill(self) -> None:
        self._standstill += 1
        if self._standstill > MAX_STANDSTILL:
            raise SimulationError(
                f"t = {self.t:.6g}: {MAX_STANDSTILL} events in a row without time moving on; "
                "try another eps or drop_tol"
            )

    # --- events ----------------------------------------------------------------------------------

    def _impulse(self, hits: list[Hit], F: Vector) -> None:
        """Impulse of (2.13), (2.14) on J_N(t_* + 0); then drop what separates (§3.3).

        Corners that touch and approach with the new velocity join, and it is solved again.
        """
        pose = self.graph.geometry.pose(self.q)
        v_before = self.history.v
        inserted = [
            self._place_name((hit.corner, hit.part, hit.edge))
            for hit in hits
            if self.graph.insert(pose, hit.corner, hit.part, hit.edge) is not None
        ]
        self._join_touching(v_before)
        while True:
            assembly = Assembly(self.graph, self.q)
            self.qps.settle(accepted=False)
            if assembly.normals:
                v, _ = solve_impulse(
                    self.qps,
                    assembly,
                    self.D,
                    self.scene.mu_I,
                    v_before,
                    F,
                    self.t,
                    self.options.impulses,
                )
            else:
                v = v_before + F / self.D**2
            if not self._join_touching(v):
                break
        self.qps.settle(accepted=True)
        self.counts["impulses"] += 1
        self._log("impulse", "; ".join(inserted) if inserted else "external" if F.any() else "")
        self.history.restart(v)
        self._drop_separating(assembly, assembly.gap_speed(v))
        self._sort_frictions(Assembly(self.graph, self.q), v)
        self._restart(0)
        self._record()

    def _join_touching(self, v: Vector) -> bool:
        """Insert inactive corners that touch and approach with velocity v; whether any did."""
        pose = self.graph.geometry.pose(self.q)
        joined = [
            self.graph.insert(pose, hit.corner, hit.part, hit.edge)
            for hit in touching(self.graph, self.q, v, self.slowest_approach)
        ]
        return any(normal is not None for normal in joined)

    def _restart(self, lam_known: int) -> None:
        """Two first-order steps follow; λ is known at that many time points."""
        self.history.restart(self.history.v)
        self.lam_known = min(lam_known, self.lam_known)
        self.qps.restart()
        self.counts["restarts"] += 1

    def _slide_off(self, losses: list[SlideOff]) -> list[Hit]:
        """Remove what lost its support; the ends of the edges take over, or hit."""
        geometry, pose = self.graph.geometry, self.graph.geometry.pose(self.q)
        hits = []
        for normal in (loss.normal for loss in losses if loss.normal.row_id in self.graph.normals):
            self._log("slide_off", self._place_name(normal.place))
            place = successor(geometry, pose, normal)
            self.graph.remove(normal, self._clearance(normal))
            self._restart(1)
            if place is None or place[:2] in {normal.place[:2] for normal in self.graph.active()}:
                continue
            speed = approach_speed(geometry, pose, self.history.v, *place)
            if speed < -self.slowest_approach:
                hits.append(Hit(0.0, *place))
            elif speed <= self.options.drop_tol:
                self.graph.insert(pose, *place)
                self._sort_frictions(Assembly(self.graph, self.q), self.history.v)
        return hits

    def _stick(self, stopped: list[Friction]) -> None:
        """J_FW → J_FO at g_Fᵀq̇ = 0, for those that stopped and all that slip slower than ε."""
        assembly = Assembly(self.graph, self.q)
        for friction, speed in zip(
            assembly.frictions, assembly.slip_speed(self.history.v), strict=True
        ):
            slow = friction in stopped or abs(speed) <= self.options.eps
            if friction.sign != 0 and slow:
                friction.sign = 0
                self._log("slip_to_stick", self._contact_name(friction.contact))
        self._restart(1)

    def _stopping_lengths(self, step: VelocityStep, signs: Vector, slip_before: Vector) -> Vector:
        """h at which each sliding contact stops (F,), by linear interpolation of g_Fᵀq̇; else ∞.

        A contact that slips slower than 0.01 ε at h has stopped there.
        """
        after = step.slip_speed
        lengths = np.full(signs.size, np.inf)
        if not signs.any():
            return lengths
        turned = (signs != 0) & (slip_before * after < 0)
        lengths[turned] = step.h * slip_before[turned] / (slip_before - after)[turned]
        lengths[(signs != 0) & (np.abs(after) <= 0.01 * self.options.eps)] = step.h
        return lengths

    def _jam(self, step: VelocityStep) -> None:
        """After a step in which every contact could stick: which do, and the jump in q̇."""
        caught = []
        for friction, speed, bound in zip(
            step.assembly.frictions, step.slip_speed, step.at_bound, strict=True
        ):
            slides_on = bound and abs(speed) > self.options.eps
            if friction.sign != 0 and not slides_on:
                caught.append(self._contact_name(friction.contact))
            friction.sign = -int(np.sign(speed)) if slides_on else 0
        self._log("jam", "; ".join(caught))
        self._restart(0)

    def _watch_gain(self, step: VelocityStep, signs: Vector) -> None:
        """Report a friction gain γ ≥ 1, once per episode."""
        found = self.gain_watch.look(step, signs)
        if found is not None:
            gain, normal = found
            self._log("gain", f"{self._contact_name(normal.contact)}: γ = {gain:.3g}")

    def _drop_separating(self, assembly: Assembly, speed: Vector) -> None:
        """Step 4: contacts with g_Nᵀq̇ > drop_tol, their `speed` (N,), leave J_N.

        λ is not looked at: an interior-point method's is never exactly 0.
        """
        for i in np.flatnonzero(speed > self.options.drop_tol):
            normal = assembly.normals[i]
            if normal.row_id in self.graph.normals:
                self._log("drop", self._place_name(normal.place))
                self.graph.remove(normal, self._clearance(normal))

    def _sort_frictions(self, assembly: Assembly, v: Vector) -> None:
        """J_FO where |g_Fᵀq̇| ≤ ε, else J_FW with s = −sign(g_Fᵀq̇)."""
        for friction, speed in zip(assembly.frictions, assembly.slip_speed(v), strict=True):
            friction.sign = 0 if abs(speed) <= self.options.eps else -int(np.sign(speed))

    def _sort_signs(self, assembly: Assembly, slip: Vector) -> None:
        """Signs s_i such that (2.9b) is satisfied at t_{n−1}."""
        for friction, speed in zip(assembly.frictions, slip, strict=True):
            if friction.sign != 0 and speed != 0:
                friction.sign = -int(np.sign(speed))

    def _check_constraints(self, assembly: Assembly, speed: Vector) -> None:
        """g_Nᵀq̇ ≥ 0 must hold at the start of a step, to the accuracy of the QP."""
        if speed.size and speed.min() < -10 * self.options.eps:
            i = int(np.argmin(speed))
            raise SimulationError(
                f"t = {self.t:.6g}: {self._place_name(assembly.places[i])} approaches at "
                f"{-speed[i]:.3g} m/s although it is active; the solver's answer was wrong"
            )

    def scheduled(self) -> list[float]:
        """Times ahead at which a force jumps or an external impulse acts."""
        times = [*self._jumps, *(impulse.t for impulse in self._impulses)]
        return [time for time in times if time > self.t + SHORTEST_STEP]

    def _external_impulse(self, t: float) -> Vector:
        F = np.zeros_like(self.q)
        for impulse in self._impulses:
            if abs(impulse.t - t) <= SHORTEST_STEP:
                F[3 * impulse.body : 3 * impulse.body + 3] += impulse.value
        return F

    # --- records ---------------------------------------------------------------------------------

    def _record(self, step: VelocityStep | None = None, gaps: Vector = NOTHING) -> None:
        """Keep the state; no array of it is written to again."""
        rows, gap = NO_MULTIPLIERS, np.inf
        if step is not None:
            active = step.assembly.active
            rows = Multipliers(active.normal_ids, active.friction_ids, step.lam_N, step.lam_F)
            if step.lam_N.size:
                gap = float(gaps.min())
        self.states.append((self.t, self.q, self.history.v, rows, gap))

    def _watch_rest(self) -> None:
        """Whether all bodies are still, and nothing that is ahead or acts on them changes that."""
        if not self.scene.stop_at_rest or not self.history.a or self.scheduled():
            return
        fastest = fastest_body(self.D, self.history.v)
        if max(fastest, REST_HORIZON * fastest_body(self.D, self.history.a[0])) <= (
            self.options.rest_speed
        ):
            self.at_rest = True
            self._log("rest", "")

    def _log(self, kind: str, detail: str) -> None:
        self.event_log.append(Event(self.t, kind, detail))

    def _clearance(self, normal: Normal) -> float:
        geometry = self.graph.geometry
        one = np.array([normal.corner]), np.array([normal.part])
        return float(geometry.clearance(geometry.pose(self.q), *one)[0])

    def _body_name(self, body: int) -> str:
        return f"body {body + 1}" if body >= 0 else "the ground"

    def _place_name(self, place: tuple[int, int, int]) -> str:
        body, corner, other, edge, _ = self.graph.geometry.feature(place, 0)
        return f"corner {corner} of {self._body_name(body)} on edge {edge} of " + self._body_name(
            other
        )

    def _contact_name(self, contact: Contact) -> str:
        names = [self._body_name(int(self.graph.geometry.part_body[p])) for p in contact.pair]
        return f"{names[0]} and {names[1]}"


def _sum_of(forces: Sequence[Force], q: Vector, v: Vector, t: float, f: Vector) -> Vector:
    for force in forces:
        force.add(f, q, v, t)
    return f
