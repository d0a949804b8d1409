"""Motions that are compared with a reference, between impacts.

1. Two bounds of h: the stepper's own, `STOCK`, where ε alone decides; and h ≤ 0.3 √ε, as in
   `harness.peers.ours`.  (3.5) sees q⃛ of the steps that were taken.  Where that is about 0 and then
   jumps, as when a contact lets go, the step across has h_max and an error of O(h_max²).
2. Poses and velocities are read at the same times, `TIMES` of them, off both runs by cubic
   interpolation.  The error of a body is ‖δ(x, y)‖ + R |δφ|, and the same of q̇, see
   `harness.motions.motion_error`; the largest one over bodies counts.
3. Four stretches of time: until a step before the first event of any kind, if that is no impact;
   until the first impact; from it to the `LATE`th; later.  Times within `CLEAR` of an impact of the
   reference are left out: q̇ jumps there, and the times of two impacts differ.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.motions.hermite import hermite
from harness.motions.motion_error import displacement, motion_of
from harness.peers.ours import BOUNDED, FIRST_STEP, LARGEST_BOUND, LARGEST_STEP, SHARE
from problems import Run, Scene, scene, simulate
from problems.qp import Vector
from problems.scenes.labels import parse_label
from problems.sequence import SolvesQPs

REFERENCE = 1e-8
"""ε of the reference, with the bound of h that goes with it."""
DROP_TOL = 1e-3
"""Speed at which contacts are dropped, the same for all ε [m/s]."""
REST_SPEED = 1e-9
"""No run ends before its time [kg^½ m/s]."""
ENDS = {"fig2": 2.0, "fig3": 3.0, "fig4": 1.8, "fig5": 0.82, "tower": 0.5, "wall": 0.3}
"""Ends of the motions [s]: those of the paper's scenes go through several impacts."""
LATEST = 1.0
"""End of other scenes [s], if their own is not earlier."""
STOCK = f"h ≤ {LARGEST_STEP:g}"
BOUNDS = (STOCK, BOUNDED)
STRETCHES = ("smooth", "before", "after", "late")
"""Until the first event, until the first impact, after it, after some more."""
LATE = 4
"""Number of the impact after which it is late; those within `CLEAR` of each other count as one."""
TIMES = 600
"""Times at which poses and velocities are compared."""
CLEAR = 5e-3
"""Time around an impact that is left out [s]."""
EARLY = 0.01
"""Events up to here belong to the start [s]."""


class Case(NamedTuple):
    """One scene of the campaign: its label, and the end of its motion [s]."""

    label: str
    scene: Scene
    until: float


def cases_of(labels: Sequence[str]) -> list[Case]:
    """Cases by labels such as "wall,bodies=6".

    Raises ValueError for an unknown scene or parameter.
    """
    cases = []
    for label in labels:
        name, parameters = parse_label(label)
        made = scene(name, **parameters)
        cases.append(Case(label, made, ENDS.get(name, min(made.end_time, LATEST))))
    return cases


def longest_step(eps: float, bound: str) -> float:
    """h_max [s] of a run by one of `BOUNDS`."""
    return LARGEST_STEP if bound == STOCK else min(SHARE * sqrt(eps), LARGEST_BOUND)


def run_case(
    case: Case, solver: SolvesQPs, eps: float, bound: str = BOUNDED, **options: Any
) -> tuple[Run, float]:
    """A run, and the CPU time that it took [s]."""
    h_max = longest_step(eps, bound)
    start = time.process_time()
    run = simulate(
        case.scene,
        solver,
        eps=eps,
        until=case.until,
        drop_tol=DROP_TOL,
        rest_speed=REST_SPEED,
        h_max=h_max,
        h_first=min(FIRST_STEP, h_max),
        **{"keep_qps": False, **options},
    )
    return run, time.process_time() - start


class Reference(NamedTuple):
    """The motion that is taken for exact.

    times : (n,) [s] at which runs are compared;  q, v : (n, bodies, 3);  radius : (bodies,) [m]
    ends : of the stretches [s]: first event, first and `LATE`th impact
    energy : T + V at the end [J], and the largest T
    """

    times: Vector
    q: Vector
    v: Vector
    radius: Vector
    ends: tuple[float, float, float]
    energy: tuple[float, float]

    def within(self, stretch: str) -> NDArray[np.bool_]:
        """Which times (n,) belong to one of `STRETCHES`."""
        first, impact, late = self.ends
        if stretch == "late":
            return self.times > late
        if stretch == "after":
            return (self.times > impact) & (self.times <= late)
        if stretch == "before":
            return self.times < impact
        # steps reach across the event
        return (self.times < first - LARGEST_BOUND) & (first < impact)

    def errors(self, run: Run) -> tuple[Vector, Vector]:
        """Largest error over bodies, of q [m] and q̇ [m/s], at each time (n,)."""
        q, v = hermite(run.t, run.q, run.v, self.times)
        pose = displacement(q - self.q, self.radius).max(axis=1)
        return pose, displacement(v - self.v, self.radius).max(axis=1)


def reference_of(case: Case, solver: SolvesQPs) -> Reference:
    """The reference of a case, from a run at `REFERENCE`."""
    run, _ = run_case(case, solver, REFERENCE)
    motion = motion_of(run)
    impacts = np.array([event.t for event in run.event_log if event.kind == "impulse"])
    happens = [event.t for event in run.event_log if event.t > EARLY and event.kind != "gain"]
    times = np.linspace(0.0, case.until, TIMES)
    near = np.abs(times[:, None] - impacts[None, :]).min(axis=1, initial=np.inf) < CLEAR
    times = times[~near]
    q, v = hermite(run.t, run.q, run.v, times)
    T = run.kinetic_energy()
    last = float(T[-1] + run.potential_energy()[-1])
    apart = impacts[np.diff(impacts, prepend=-np.inf) > CLEAR]
    apart = apart[apart >= motion.first_impact]
    late = float(apart[LATE - 1]) if len(apart) >= LATE else case.until
    ends = (min([*happens, case.until]), motion.first_impact, late)
    return Reference(times, q, v, motion.radius, ends, (last, float(T.max())))
