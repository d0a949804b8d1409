"""What changes J_N, J_FO and J_FW, with which jumps: steps 3 and 4 of algorithm 1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from problems.contacts.assembly import Assembly
from problems.contacts.constraint_graph import Friction, Normal
from problems.contacts.geometry import Pose
from problems.formulas.step_kernels import APPROACHING, OPENING, separates
from problems.friction.impulses import solve_impulse
from problems.qp import Vector
from problems.sequence import SimulationError
from problems.stepping.events import TOUCH_TOL, Hit, SlideOff, approach_speed, successor, touching
from problems.stepping.system import System
from problems.stepping.velocity import VelocityStep

OPEN_FOR = 1e-3
"""A gap that takes this long to open at `drop_tol` is one [s]; what is thrown up so fast and falls
back has less of one."""
MAX_STANDSTILL = 200
"""Events in a row without the time moving on before the simulation gives up."""


class Transitions(System):
    """A `System` whose contacts come and go, slip, stick and jam."""

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

    def _impulse(self, hits: list[Hit], F: Vector) -> None:
        """Impulse of (2.13), (2.14) on J_N(t_* + 0); then drop what separates (§3.3).

        Corners that touch and approach with the new velocity join, and it is solved again.
        """
        pose = self.graph.geometry.pose(self.q)
        v_before = self.history.v
        self._drop_opened()
        for hit in hits:
            if hit.late:
                self._make_way(pose, hit)
        inserted = [
            self._place_name(hit.place)
            for hit in hits
            if self.graph.insert(pose, *hit.place) is not None
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

    def _make_way(self, pose: Pose, hit: Hit) -> None:
        """Drop what stands for a contact that was missed, but is on another edge."""
        depth, _ = self.graph.geometry.overlap(pose, *self.graph.pair_of(hit.corner, hit.part))
        self._log("overlap", f"{self._place_name(hit.place)}, seen late: {depth:.3g} m")
        for normal in self.graph.at(pose, hit.corner, hit.part):
            self.drop(normal, self._clearance(pose, normal))

    def _tell_of_overlaps(self, too_deep: dict[tuple[int, int], float]) -> None:
        """Log pairs of parts that overlap far too deep, each pair once."""
        bodies = self.graph.geometry.part_body
        for pair, depth in too_deep.items():
            if pair not in self._told:
                self._told.add(pair)
                names = [self._body_name(int(bodies[part])) for part in pair]
                self._log("overlap", f"{names[0]} and {names[1]}: {depth:.3g} m")

    def _join_touching(self, v: Vector) -> bool:
        """Insert inactive corners that touch and approach with velocity v; whether any did."""
        pose = self.graph.geometry.pose(self.q)
        joined = [
            self.graph.insert(pose, *hit.place)
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
        if not losses:
            return []
        geometry, pose = self.graph.geometry, self.graph.geometry.pose(self.q)
        hits = []
        for normal in (loss.normal for loss in losses if loss.normal.row_id in self.graph.normals):
            self._log("slide_off", self._place_name(normal.place))
            place = successor(geometry, pose, normal)
            self.graph.remove(normal, self._clearance(pose, normal))
            self._restart(1)
            if place is None or place[:2] in {normal.place[:2] for normal in self.graph.active()}:
                continue
            speed = approach_speed(geometry, pose, self.history.v, *place)
            if speed < -self.slowest_approach:
                hits.append(Hit(0.0, *place))
                continue
            if speed <= self.options.drop_tol or geometry.past_tip(pose, *place):
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

    def _jam(self, step: VelocityStep) -> None:
        """After a step in which every contact could stick: which do, and the jump in q̇.

        Where all slide on there was a λ that the passes had not found, and nothing has jumped.
        """
        caught = []
        for friction, speed, slides in zip(
            step.assembly.frictions, step.slip_speed, self._slides(step), strict=True
        ):
            if friction.sign != 0 and not slides:
                caught.append(self._contact_name(friction.contact))
            friction.sign = -int(np.sign(speed)) if slides else 0
        if caught:
            self._log("jam", "; ".join(caught))
            self._restart(0)

    def _slides(self, step: VelocityStep) -> NDArray[np.bool_]:
        """Which contacts of J_FO slide after all (F,): at their bound, and faster than ε."""
        return step.at_bound & (np.abs(step.slip_speed) > self.options.eps)

    def _watch_gain(self, step: VelocityStep, signs: Vector) -> None:
        """Report a friction gain γ ≥ 1, once per episode."""
        found = self.gain_watch.look(step, signs)
        if found is not None:
            gain, normal = found
            self._log("gain", f"{self._contact_name(normal.contact)}: γ = {gain:.3g}")

    def _drop_separating(self, assembly: Assembly, speed: Vector) -> None:
        """Step 4: contacts with g_Nᵀq̇ > drop_tol, their `speed` (N,), leave J_N.

        So do those that have opened slowly, but wide; see `separates`.  λ is not looked at: an
        interior-point method's is never exactly 0.
        """
        wide = self.graph.geometry.tolerances(assembly.place)
        gap, threshold = assembly.columns.phi, self.options.drop_tol
        self._drop(assembly, separates(gap, speed, threshold, wide))

    def _drop_opened(self) -> None:
        """Contacts that open, be it slower than `drop_tol`, and are open already leave J_N.

        An impulse is not passed on across a gap: whether one is opened at 1.1 or at 0.9 `drop_tol`
        when a body far below is hit would decide about the rest of the motion.
        """
        assembly, slow = Assembly(self.graph, self.q), self.options.drop_tol
        opens = assembly.gap_speed(self.history.v) > OPENING * slow
        is_open = assembly.columns.phi > max(TOUCH_TOL, OPEN_FOR * slow)
        self._drop(assembly, opens & is_open)

    def _drop(self, assembly: Assembly, leaving: NDArray[np.bool_]) -> None:
        """These normals (N,) leave J_N, unless a tip has passed them."""
        if not leaving.any():
            return
        geometry, pose = self.graph.geometry, self.graph.geometry.pose(self.q)
        for normal in (assembly.normals[i] for i in np.flatnonzero(leaving)):
            gone = normal.row_id not in self.graph.normals
            if not (gone or geometry.past_tip(pose, *normal.place)):
                self.drop(normal, self._clearance(pose, normal))

    def drop(self, normal: Normal, clearance: float = 0.0) -> None:
        """A contact that separates leaves J_N; a clearance [m] below 0 is its level from now on."""
        self._log("drop", self._place_name(normal.place))
        self.graph.remove(normal, clearance)

    def slip(self, friction: Friction, sign: int) -> None:
        """J_FO → J_FW with s = sign."""
        friction.sign = sign
        self._log("stick_to_slip", self._contact_name(friction.contact))

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
        """g_Nᵀq̇ ≥ 0 must hold at the start of a step, to the accuracy of the QP.

        Baumgarte's stabilization closes gaps φ > 0 at φ/τ.
        """
        if not speed.size:
            return
        speed = speed + np.maximum(assembly.columns.phi, 0.0) / self.equations.drift_time
        if speed.min() < -APPROACHING * self.options.eps:
            i = int(np.argmin(speed))
            raise SimulationError(
                f"t = {self.t:.6g}: {self._place_name(assembly.places[i])} approaches at "
                f"{-speed[i]:.3g} m/s although it is active; the solver's answer was wrong"
            )
