"""One closed loop: a solver at a setting drives a scene, and what came of it is measured.

A loop that the stepper cannot go on with is repeated up to where it came to: what it did until then
is measured like everything else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from harness.motions.in_loop import InLoop
from harness.motions.motion_error import Motion, motion_of
from harness.motions.run_physics import accuracy_of_answers, physics_of
from problems import Run, simulate
from problems import scene as make_scene
from problems.scenes.labels import parse_label
from problems.sequence import SimulationError

VERDICTS = ("finished", "stopped", "refused", "timeout", "crashed")
"""It came to its end; the stepper could not go on with the answers; the solver does not take such
QPs; the time limit; the process died."""


@dataclass(frozen=True)
class Loop:
    """One solver driving one scene.

    scene : label, such as "fig4,mu_I=0.8";  solver, setting : see `harness.motions.in_loop`
    eps : ε of the stepper;  drop_tol, rest_speed : its thresholds [m/s], [‖q̇‖_M]
    until : [s];  time_limit : [s] of wall time
    """

    scene: str
    solver: str
    setting: str
    eps: float
    drop_tol: float
    rest_speed: float
    until: float
    time_limit: float

    @property
    def name(self) -> str:
        """File name of the result, without its ending."""
        parts = (self.scene, self.solver, self.setting, f"{self.eps:g}")
        return "__".join(parts).replace("/", "-")


@dataclass(frozen=True, eq=False)
class LoopResult:
    """What came of a `Loop`.

    verdict : one of `VERDICTS`;  reason : why it did not finish;  reached : t it came to [s]
    measures : numbers by name: counts, times, physics and accuracy; empty if nothing is known
    motion : what was accepted, or None
    """

    loop: Loop
    verdict: str
    reason: str
    reached: float
    measures: Mapping[str, float]
    motion: Motion | None


def run_loop(loop: Loop, told: Callable[[float], None] = lambda t: None) -> LoopResult:
    """Simulate in this process and measure.

    told : called with t after accepted steps, the last one among them
    """
    reached = 0.0

    def step(t: float) -> None:
        nonlocal reached
        reached = t
        told(t)

    solver = InLoop(loop.solver, loop.setting, loop.time_limit)
    began = time.perf_counter()
    run, verdict, reason = None, "finished", ""
    try:
        run = _simulate(loop, solver, loop.until, step)
    except SimulationError as error:
        verdict, reason = "stopped", str(error)
        if solver.refused:
            verdict, reason = "refused", solver.refused
        elif solver.out_of_time:
            verdict, reason = "timeout", f"{loop.time_limit:g} s were not enough"
        until_then: Run | None = getattr(error, "run", None)
        if until_then is not None:
            step(float(until_then.t[-1]))
        if verdict != "timeout":
            run = until_then
    spent = time.perf_counter() - began
    measures = {
        "wall_time": spent,
        "call_time": solver.call_time,
        "solve_time": solver.solve_time,
        "calls": solver.calls,
    }
    if run is not None:
        measures |= {**run.counts, **physics_of(run), **accuracy_of_answers(run)}
    motion = None if run is None else motion_of(run)
    return LoopResult(loop, verdict, reason, reached, measures, motion)


def _simulate(
    loop: Loop, solver: InLoop, until: float, progress: Callable[[float], None] | None = None
) -> Run:
    name, parameters = parse_label(loop.scene)
    return simulate(
        make_scene(name, **parameters),
        solver,
        eps=loop.eps,
        until=until,
        drop_tol=loop.drop_tol,
        rest_speed=loop.rest_speed,
        progress=progress,
    )
