"""The bodies of one simulation in motion: their state, what acts on them and what is recorded."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from math import inf
from typing import final

import numpy as np

from problems.bodies.bodies import mass_diagonal
from problems.bodies.forces import Force
from problems.contacts.active_kernels import JOINT
from problems.contacts.assembly import Assembly
from problems.contacts.constraint_graph import ConstraintGraph, Contact, Normal
from problems.contacts.geometry import Geometry, Pose, Shapes
from problems.formulas.multistep import SHORTEST_STEP, History
from problems.joints.joints import all_rows, kept_apart
from problems.qp import Vector
from problems.scenes import Scene
from problems.sequence import QPSequence, SimulationError, SolvesQPs
from problems.stepping.drift import closing_motion
from problems.stepping.events import DRIFT_ALLOWED, LEAST_ALLOWED
from problems.stepping.gain import GainWatch
from problems.stepping.options import StepperOptions
from problems.stepping.run import Event, Run, Stretch
from problems.stepping.switches import Switches
from problems.stepping.velocity import VelocityStep

MAX_CRAWL, CRAWLING = 20_000, 2e-8
"""So many steps that are shorter than this on average [s]: the simulation gives up."""
NO_ROWS = np.zeros(0, dtype=np.int64)


@final
class System:
    """State, forces, constraint graph and records of one simulation; see
    `problems.stepping.stepper`.

    varying : the forces that are not constant between their jumps
    """

    def __init__(
        self, scene: Scene, solver: SolvesQPs, options: StepperOptions, keep_qps: bool = True
    ):
        self.scene, self.options = scene, options
        self.D = np.sqrt(mass_diagonal(scene.bodies))
        self.D.setflags(write=False)
        rows = all_rows(scene.joints, scene.q0.ravel())
        geometry = Geometry(scene.bodies, scene.ground, kept_apart(scene.joints))
        self.graph = ConstraintGraph(geometry, scene.mu_between, rows)
        self.qps = QPSequence(solver, keep_qps)
        forces = scene.all_forces()
        self.switches = Switches(forces, scene.q0.ravel(), scene.v0.ravel())
        forces = self.switches.held
        self._steady: list[Force] = []
        self.varying: list[Force] = []
        for force in forces:
            (self._steady if getattr(force, "constant", False) else self.varying).append(force)
        self.jumps = sorted({time for force in forces for time in force.jumps})
        self._constant: dict[int, Vector] = {}
        in_order = sorted(scene.impulses, key=lambda impulse: (impulse.t, impulse.body))
        self._impulses = deque(in_order)
        self._times = sorted({*self.jumps, *(impulse.t for impulse in self._impulses)})
        self.velocity_dependent = any(force.velocity_dependent for force in forces)
        self.drift_time = options.drift_time if options.drift == "baumgarte" else inf
        self.gain_watch = GainWatch(self.D, self.velocity_dependent)
        self.t = 0.0
        self.q = scene.q0.ravel().copy()
        self.history = History(scene.v0.ravel().copy())
        self.lam_known = 0
        self.h_last = options.h_first
        self.slowest_approach = 1e-3 * options.drop_tol
        self.allowed_overlap = max(DRIFT_ALLOWED * options.eps, LEAST_ALLOWED)
        self.counts = dict.fromkeys(("steps", "rejected_steps", "restarts", "impulses"), 0)
        self.event_log: list[Event] = []
        self._looked_at = 0, 0.0  # steps and t when progress was last looked at
        self.rest_since = np.inf
        self.stretches: list[Stretch] = []
        self._here: Assembly | None = None
        self.shapes = Shapes.of(self.graph.geometry)

    def force(self, q: Vector, v: Vector, t: float) -> Vector:
        """f(q, q̇, t) of (2.1), (3n,); those that are constant between jumps are summed once."""
        interval = bisect_left(self.jumps, t)
        if interval not in self._constant:
            self._constant[interval] = _sum_of(self._steady, q, v, t, np.zeros_like(q))
        constant = self._constant[interval]
        return _sum_of(self.varying, q, v, t, constant.copy()) if self.varying else constant

    def assembly(self) -> Assembly:
        """The columns at q, the same until something changes; no array q is written to again."""
        active, here = self.graph.active_set(), self._here
        if here is None or here.q is not self.q or here.active is not active:
            here = self._here = Assembly(self.graph, self.q, active)
        return here

    def pose(self) -> Pose:
        """Where everything is at q."""
        here = self._here
        if here is not None and here.q is self.q:
            return here.pose
        return self.graph.geometry.pose(self.q)

    def finish(self) -> Run:
        """Everything that the simulation left behind."""
        t, q, v, gaps = (
            np.concatenate([stretch[part] for stretch in self.stretches]) for part in range(4)
        )
        shape = (len(t), len(self.scene.bodies), 3)
        return Run(
            scene=self.scene,
            t=t,
            q=q.reshape(shape),
            v=v.reshape(shape),
            gaps=gaps,
            stretches=self.stretches,
            event_log=self.event_log,
            qps=self.qps.qps,
            solutions=self.qps.solutions,
            counts=self.counts | {"qps": self.qps.count},
            options=asdict(self.options),
        )

    def scheduled(self) -> float:
        """The next time at which a force jumps or an external impulse acts; ∞ where none is left.

        No step ends beyond it, not by rounding either: forces are those of the step's end.
        """
        ahead = bisect_right(self._times, self.t + SHORTEST_STEP)
        return self._times[ahead] if ahead < len(self._times) else inf

    def watch_progress(self) -> None:
        """Raise SimulationError where steps have become so short that there is no end to them."""
        steps, t = self._looked_at
        taken, passed = self.counts["steps"] - steps, self.t - t
        if taken < MAX_CRAWL:
            return
        if self.options.fixed_step is None and passed < CRAWLING * taken:
            b = int(np.argmax(self.D[::3]))
            raise SimulationError(
                f"t = {self.t:.6g}: the last {taken:,} steps were {passed / taken:.2g} s long; "
                f"{self.body_name(b)}, of {self.D[3 * b] ** 2:.3g} kg, counts most in their error "
                "(3.5): choose a larger eps, or a larger unit of mass"
            )
        self._looked_at = self.counts["steps"], self.t

    def external_impulse(self, t: float) -> Vector:
        """F (3n,) of the impulses up to t [s] that have not acted yet."""
        F = np.zeros(self.q.size)
        while self._impulses and self._impulses[0].t <= t + SHORTEST_STEP:
            impulse = self._impulses.popleft()
            F[3 * impulse.body : 3 * impulse.body + 3] += impulse.value
        return F

    def record(self) -> None:
        """Keep the state; no array of it is written to again."""
        self.stretches.append(
            Stretch(
                *(np.array([self.t]), self.q[None], self.history.v[None], np.array([inf])),
                *(NO_ROWS, NO_ROWS, np.zeros((1, 0))),
            )
        )

    def log(self, kind: str, detail: str) -> None:
        self.event_log.append(Event(self.t, kind, detail))

    def clearance(self, pose: Pose, normal: Normal) -> float:
        one = np.array([normal.corner]), np.array([normal.part])
        return float(self.graph.geometry.clearance(pose, *one)[0])

    def body_name(self, body: int) -> str:
        return f"body {body + 1}" if body >= 0 else "the ground"

    def place_name(self, place: tuple[int, int, int]) -> str:
        geometry, (corner, part, edge) = self.graph.geometry, place
        one, two = (
            self.body_name(int(geometry.corner_body[corner])),
            self.body_name(int(geometry.part_body[part])),
        )
        who = f"{geometry.corner_number[corner]} of {one}"
        own = one if geometry.is_round(corner) else f"corner {who}"
        if edge >= geometry.edge_offset.shape[1]:
            first = geometry.first_edge[part] - geometry.edge_offset.shape[1]
            return f"{own} on corner {first + edge} of {two}"
        if not geometry.edge_normal[part, edge].any():
            return f"{own} on {two}"
        return f"{own} on edge {geometry.first_edge[part] + edge} of {two}"

    def joint_name(self, row: int) -> str:
        """A row of a joint, by its number, as people read it."""
        one, two = (self.body_name(int(body)) for body in self.graph.rows.bodies[row])
        return f"{'the stop' if self.graph.rows.stop[row] else 'a joint'} of {one} and {two}"

    def normal_name(self, assembly: Assembly, number: int) -> str:
        """A contact, or a row of a joint, by its number in an assembly."""
        if number < len(assembly.normals):
            return self.place_name(assembly.place[number].tolist())
        return self.joint_name(int(assembly.active.feature[number, 1]))

    def contact_name(self, contact: Contact) -> str:
        names = [self.body_name(int(self.graph.geometry.part_body[p])) for p in contact.pair]
        return f"{names[0]} and {names[1]}"

    def project(self, step: VelocityStep) -> None:
        """Close the gaps of joints, and of contacts that bear a load, where the step has ended."""
        assembly = step.assembly
        loaded = np.flatnonzero((step.lam_N > 0) | (assembly.friction_of == JOINT))
        sticking = np.flatnonzero([friction.sign == 0 for friction in assembly.frictions])
        A = assembly.scaled(loaded, sticking, self.D)
        self.q = self.q + closing_motion(assembly, A, self.D, np.arange(loaded.size), loaded)
        gap = self.assembly().columns.phi[assembly.touching].min(initial=inf)
        self.stretches[-1] = self.stretches[-1]._replace(q=self.q[None], gaps=np.array([gap]))


def _sum_of(forces: Sequence[Force], q: Vector, v: Vector, t: float, f: Vector) -> Vector:
    for force in forces:
        force.add(f, q, v, t)
    return f
