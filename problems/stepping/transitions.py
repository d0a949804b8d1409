"""What changes J_N, J_FO and J_FW, with which jumps: steps 3 and 4 of algorithm 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from problems.contacts.assembly import Assembly
from problems.contacts.constraint_graph import Friction, Normal
from problems.contacts.geometry import Pose
from problems.formulas.step_kernels import APPROACHING, OPENING, separates
from problems.friction.impulses import solve_impulse
from problems.qp import Vector
from problems.sequence import SimulationError
from problems.stepping.events import (
    TOUCH_TOL,
    Ahead,
    Hit,
    SlideOff,
    approach_speed,
    successor,
    touching,
    touching_stops,
)
from problems.stepping.restitution import bounced, coefficients
from problems.stepping.system import System
from problems.stepping.velocity import VelocityStep

OPEN_FOR = 1e-3
"""A gap that takes this long to open at `drop_tol` is one [s]; what is thrown up so fast and falls
back has less of one."""
MAX_STANDSTILL = 200
"""Events in a row without the time moving on before the simulation gives up."""


@final
class Transitions:
    """What makes the contacts of a `System` come and go, slip, stick and jam."""

    def __init__(self, system: System) -> None:
        self.system, self.graph = system, system.graph
        self._standstill = 0
        self._told: set[tuple[int, int]] = set()

    def time_moves_on(self) -> None:
        """A step has been taken: events before it do not count any more."""
        self._standstill = 0

    def standing_event(self, ahead: Ahead) -> None:
        """Events at t_{n−1} itself."""
        self.count_standstill()
        self.switch(ahead.switches)
        hits = ahead.hits + self.slide_off(ahead.losses)
        if hits or ahead.stops:
            self.impulse(hits, np.zeros_like(self.system.q), ahead.stops)

    def switch(self, numbers: list[int]) -> None:
        """Forces whose function of the state is 0 here act from now on, or cease to: q̈ jumps."""
        for number in numbers:
            self.system.log("force_jump", self.system.switches.flip(number))
        if numbers:
            self.restart(1)

    def count_standstill(self) -> None:
        self._standstill += 1
        if self._standstill > MAX_STANDSTILL:
            raise SimulationError(
                f"t = {self.system.t:.6g}: {MAX_STANDSTILL} events in a row without time moving "
                "on; try another eps or drop_tol"
            )

    def impulse(self, hits: list[Hit], F: Vector, stops: Sequence[int] = ()) -> None:
        """Impulse of (2.13), (2.14) on J_N(t_* + 0); then drop what separates (§3.3).

        Corners that touch and approach with the new velocity join, and it is solved again.

        stops : numbers of the rows of joints that are reached
        """
        pose = self.system.pose()
        v_before = self.system.history.v
        self._drop_opened()
        for hit in hits:
            if hit.late:
                self._make_way(pose, hit)
        inserted = [
            self.system.place_name(hit.place)
            for hit in hits
            if self.graph.insert(pose, *hit.place) is not None
        ]
        for row in stops:
            self.graph.set_stop(row, True)
            inserted.append(self.system.joint_name(row))
        self._join_touching(v_before)
        while True:
            assembly = self.system.assembly()
            self.system.qps.settle(accepted=False)
            v = self._after_impulse(assembly, v_before, F)
            if not self._join_touching(v):
                break
        self.system.qps.settle(accepted=True)
        self.system.counts["impulses"] += 1
        self.system.log(
            "impulse", "; ".join(inserted) if inserted else "external" if F.any() else ""
        )
        self.system.history.restart(v)
        self.drop_separating(assembly, assembly.gap_speed(v))
        self.sort_frictions(self.system.assembly(), v)
        self.restart(0)
        self.system.record()

    def _after_impulse(self, assembly: Assembly, v: Vector, F: Vector) -> Vector:
        """q̇₊ (3n,) from q̇₋ = v."""
        system = self.system
        if not assembly.count:
            return v + F / system.D**2

        def plastic(before: Vector, F: Vector) -> tuple[Vector, Vector]:
            model = system.scene.mu_I, before, F, system.t, system.options.impulses
            return solve_impulse(system.qps, assembly, system.D, *model)

        if not system.scene.bounces:
            return plastic(v, F)[0]
        e = coefficients(assembly, system.scene.restitution_between, v, system.options.drop_tol)
        return bounced(assembly, system.D, e, v, F, plastic, system.options.restitution)

    def _make_way(self, pose: Pose, hit: Hit) -> None:
        """Drop what stands for a contact that was missed, but is on another edge."""
        depth, _ = self.graph.geometry.overlap(pose, *self.graph.pair_of(hit.corner, hit.part))
        self.system.log("overlap", f"{self.system.place_name(hit.place)}, seen late: {depth:.3g} m")
        for normal in self.graph.at(pose, hit.corner, hit.part):
            self.drop(normal, self.system.clearance(pose, normal))

    def tell_of_overlaps(self, too_deep: dict[tuple[int, int], float]) -> None:
        """Log pairs of parts that overlap far too deep, each pair once."""
        bodies = self.graph.geometry.part_body
        for pair, depth in too_deep.items():
            if pair not in self._told:
                self._told.add(pair)
                names = [self.system.body_name(int(bodies[part])) for part in pair]
                self.system.log("overlap", f"{names[0]} and {names[1]}: {depth:.3g} m")

    def _join_touching(self, v: Vector) -> bool:
        """Insert inactive corners and stops that touch and approach with velocity v; whether any
        did."""
        pose = self.system.pose()
        joined = [
            self.graph.insert(pose, *hit.place)
            for hit in touching(self.graph, self.system.q, v, self.system.slowest_approach)
        ]
        stops = touching_stops(self.graph, self.system.q, v, self.system.slowest_approach)
        for row in stops:
            self.graph.set_stop(row, True)
        return bool(stops) or any(normal is not None for normal in joined)

    def restart(self, lam_known: int) -> None:
        """Two first-order steps follow; λ is known at that many time points."""
        self.system.history.restart(self.system.history.v)
        self.system.lam_known = min(lam_known, self.system.lam_known)
        self.system.qps.restart()
        self.system.counts["restarts"] += 1

    def slide_off(self, losses: list[SlideOff]) -> list[Hit]:
        """Remove what lost its support; the ends of the edges take over, or hit."""
        if not losses:
            return []
        geometry, pose = self.graph.geometry, self.system.pose()
        hits = []
        for normal in (loss.normal for loss in losses if loss.normal.row_id in self.graph.normals):
            place = successor(geometry, pose, normal)
            if place is not None and geometry.is_round(normal.corner):
                self._roll_over(normal, place)
                continue
            self.system.log("slide_off", self.system.place_name(normal.place))
            self.graph.remove(normal, self.system.clearance(pose, normal))
            self.restart(1)
            taken = {normal.place[:2] for normal in self.graph.active()}
            if place is None or place[:2] in taken:
                continue
            speed = approach_speed(geometry, pose, self.system.history.v, *place)
            if speed < -self.system.slowest_approach:
                hits.append(Hit(0.0, *place))
                continue
            if speed <= self.system.options.drop_tol or geometry.past_tip(pose, *place):
                self.graph.insert(pose, *place)
                self.sort_frictions(self.system.assembly(), self.system.history.v)
        return hits

    def _roll_over(self, normal: Normal, place: tuple[int, int, int]) -> None:
        """What is round goes on from an edge to its end, or back: q̈ jumps, the constraint stays."""
        names = [self.system.place_name(where) for where in (normal.place, place)]
        self.system.log("roll_over", f"{names[0]} to {names[1]}")
        self.graph.hand_over({normal.row_id: place})
        self.restart(1)

    def stick(self, stopped: list[Friction]) -> None:
        """J_FW → J_FO at g_Fᵀq̇ = 0, for those that stopped and all that slip slower than ε."""
        assembly = self.system.assembly()
        for friction, speed in zip(
            assembly.frictions, assembly.slip_speed(self.system.history.v), strict=True
        ):
            slow = friction in stopped or abs(speed) <= self.system.options.eps
            if friction.sign != 0 and slow:
                friction.sign = 0
                self.system.log("slip_to_stick", self.system.contact_name(friction.contact))
        self.restart(1)

    def jam(self, step: VelocityStep) -> None:
        """After a step in which every contact could stick: which do, and the jump in q̇.

        Where all slide on there was a λ that the passes had not found, and nothing has jumped.
        """
        caught = []
        for friction, speed, slides in zip(
            step.assembly.frictions, step.slip_speed, self.slides(step), strict=True
        ):
            if friction.sign != 0 and not slides:
                caught.append(self.system.contact_name(friction.contact))
            friction.sign = -int(np.sign(speed)) if slides else 0
        if caught:
            self.system.log("jam", "; ".join(caught))
            self.restart(0)

    def slides(self, step: VelocityStep) -> NDArray[np.bool_]:
        """Which contacts of J_FO slide after all (F,): at their bound, and faster than ε."""
        return step.at_bound & (np.abs(step.slip_speed) > self.system.options.eps)

    def watch_gain(self, step: VelocityStep, signs: Vector) -> None:
        """Report a friction gain γ ≥ 1, once per episode."""
        found = self.system.gain_watch.look(step, signs)
        if found is not None:
            gain, normal = found
            self.system.log("gain", f"{self.system.contact_name(normal.contact)}: γ = {gain:.3g}")

    def drop_separating(self, assembly: Assembly, speed: Vector) -> None:
        """Step 4: contacts with g_Nᵀq̇ > drop_tol, their `speed` (N,), leave J_N.

        So do those that have opened slowly, but wide; see `separates`.  λ is not looked at: an
        interior-point method's is never exactly 0.
        """
        if speed.max(initial=0.0) <= OPENING * self.system.options.drop_tol:
            return
        wide = self.graph.geometry.tolerances(assembly.place)
        phi, threshold = assembly.columns.phi, self.system.options.drop_tol
        touching = assembly.touching
        self._drop(assembly, separates(phi[touching], speed[touching], threshold, wide))
        for i in assembly.at_stop:
            if separates(phi[i], speed[i], threshold, np.inf):
                row = int(assembly.active.feature[i, 1])
                self.system.log("drop", self.system.joint_name(row))
                self.graph.set_stop(row, False)

    def _drop_opened(self) -> None:
        """Contacts that open, be it slower than `drop_tol`, and are open already leave J_N.

        An impulse is not passed on across a gap: whether one is opened at 1.1 or at 0.9 `drop_tol`
        when a body far below is hit would decide about the rest of the motion.
        """
        assembly, slow = self.system.assembly(), self.system.options.drop_tol
        opens = assembly.gap_speed(self.system.history.v) > OPENING * slow
        is_open = assembly.columns.phi > max(TOUCH_TOL, OPEN_FOR * slow)
        self._drop(assembly, (opens & is_open)[assembly.touching])

    def _drop(self, assembly: Assembly, leaving: NDArray[np.bool_]) -> None:
        """These contacts (C,) leave J_N, unless a tip has passed them."""
        if not leaving.any():
            return
        geometry, pose = self.graph.geometry, self.system.pose()
        for normal in (assembly.normals[i] for i in np.flatnonzero(leaving)):
            gone = normal.row_id not in self.graph.normals
            if not (gone or geometry.past_tip(pose, *normal.place)):
                self.drop(normal, self.system.clearance(pose, normal))

    def drop(self, normal: Normal, clearance: float = 0.0) -> None:
        """A contact that separates leaves J_N; a clearance [m] below 0 is its level from now on."""
        self.system.log("drop", self.system.place_name(normal.place))
        self.graph.remove(normal, clearance)

    def slip(self, friction: Friction, sign: int) -> None:
        """J_FO → J_FW with s = sign."""
        friction.sign = sign
        self.system.log("stick_to_slip", self.system.contact_name(friction.contact))

    def sort_frictions(self, assembly: Assembly, v: Vector) -> None:
        """J_FO where |g_Fᵀq̇| ≤ ε, else J_FW with s = −sign(g_Fᵀq̇)."""
        for friction, speed in zip(assembly.frictions, assembly.slip_speed(v), strict=True):
            friction.sign = 0 if abs(speed) <= self.system.options.eps else -int(np.sign(speed))

    def check_constraints(self, assembly: Assembly, speed: Vector) -> None:
        """g_Nᵀq̇ ≥ 0 must hold at the start of a step, and = 0 of a joint that does not yield, as
        exactly as the QP.

        Baumgarte's stabilization closes gaps φ > 0 at φ/τ, and those of joints from both sides.
        """
        if not speed.size:
            return
        lean = assembly.columns.phi / self.system.drift_time
        closing = speed + np.maximum(lean, 0.0)
        if assembly.rows.kind.size:
            held = assembly.held
            closing[held] = -np.abs(speed[held] + lean[held])
            closing[assembly.yielding] = 0.0
        if closing.min() < -APPROACHING * self.system.options.eps:
            i = int(np.argmin(closing))
            raise SimulationError(
                f"t = {self.system.t:.6g}: {self.system.normal_name(assembly, i)} approaches "
                f"at {-closing[i]:.3g} m/s although it is active; the solver's answer was wrong"
            )
