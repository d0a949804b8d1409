"""Run a scene and keep every QP of it, each with a reference answer.

1. `problems.simulate` runs the scene; it keeps the QPs and the solver's answers.
2. The oracle finds A x* of each QP and says how sure it is (`harness.judging.oracle`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.judging.oracle import reference
from harness.machine.machine import problems_version
from harness.names import METHOD
from harness.processes.introduction import solver_version
from harness.progress import Progress
from harness.recordings.layout import SpaceMotion
from harness.recordings.recording import Recording
from problems import simulate
from problems.qp import TANGENT, ContactQP, Vector
from problems.space.run import SpaceRun
from problems.stepping.run import Event
from solvers import make_solver


def record(
    scene: Any,
    solver: Any = None,
    *,
    eps: float | None = None,
    until: float | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Recording:
    """Simulate `scene` and return the recording of its QPs.

    scene : a `problems.Scene`
    solver : drives the simulation; default: our method, `METHOD`
    eps, until, options : handed to `problems.simulate`; default: the scene's own
    progress : called with "simulate" (seconds of motion) and "reference" (QPs)
    """
    end = float(until if until is not None else scene.end_time)

    def step(t: float) -> None:
        if progress is not None:
            progress("simulate", t, end)

    solver = make_solver(METHOD) if solver is None else solver
    run = simulate(scene, solver, eps=eps, until=until, progress=step, **options)
    return recording_of(run, solver.name, until=end, progress=progress)


def recording_label(scene: Any, friction: str) -> str:
    """The label of a recording, by which it and its results are filed."""
    return scene.label + ("" if friction == "corrected" else f",friction={friction}")


def code_version(solver_name: str) -> str:
    """Of the code that makes a recording with this solver in the loop."""
    return f"problems: {problems_version()}; {solver_name}: {solver_version(solver_name)}"


def recording_of(
    run: Any,
    solver_name: str,
    *,
    until: float | None = None,
    progress: Progress | None = None,
) -> Recording:
    """The recording of a finished `problems.Run`, with references.

    How it was run joins the scene's parameters, as "run.solver", "run.until", "run.friction", …
    """
    references = []
    for i, (qp, solution) in enumerate(zip(run.qps, run.solutions, strict=True)):
        if progress is not None and i % 20 == 0:
            progress("reference", i, len(run.qps))
        references.append(reference(qp, start=solution.x))
    if progress is not None:
        progress("reference", len(run.qps), len(run.qps))
    scene = run.scene
    how = {"solver": solver_name, "until": until, **run.options}
    return Recording(
        scene=recording_label(scene, run.options["friction"]),
        parameters={
            **scene.parameters,
            **{f"run.{name}": value for name, value in how.items() if value is not None},
        },
        eps=float(run.options["eps"]),
        gravity=float(scene.gravity),
        code_version=code_version(solver_name),
        qps=tuple(run.qps),
        solutions=tuple(run.solutions),
        references=tuple(references),
        mu=tuple(_friction_coefficients(scene, qp) for qp in run.qps),
        polygons=tuple(tuple(body.polygons) for body in scene.bodies),
        t=run.t,
        q=run.q,
        v=run.v,
        events=tuple(Event(float(e.t), str(e.kind), str(e.detail)) for e in run.event_log),
        counts={name: int(count) for name, count in run.counts.items()},
        space=_in_space(run) if isinstance(run, SpaceRun) else None,
        discs=tuple(run.discs) if isinstance(run, SpaceRun) else (),
    )


def _in_space(run: SpaceRun) -> SpaceMotion:
    return SpaceMotion.of(run.scene.solids, run.poses, run.velocities, run.reactions)


def _friction_coefficients(scene: Any, qp: ContactQP) -> Vector:
    """mu of the bodies in contact for the tangent rows of `qp`, 0 for the others.  (k,)"""
    mu = np.zeros(qp.k)
    for row in np.flatnonzero(qp.feature[:, 4] == TANGENT):
        corner_body, _, edge_body, *_ = qp.feature[row].tolist()
        mu[row] = scene.mu_between(corner_body, edge_body)
    return mu
