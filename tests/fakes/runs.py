"""Simulations that several test modules look at, each run once per test process."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from harness.recordings.recording import Recording
from harness.study.record import recording_of
from problems import Run, scene, simulate
from problems.bodies.bodies import box
from problems.bodies.forces import SpringDamper
from problems.contacts.geometry import HalfPlane
from problems.scenes import Scene
from solvers import make_solver


@cache
def scene_run(name: str, **parameters: float) -> Run:
    """One of the paper's scenes, with the paper's method in the loop."""
    return simulate(scene(name, **parameters), make_solver("glambda"))


@cache
def scene_recording(name: str) -> Recording:
    """The recording of a scene, with references."""
    return recording_of(scene_run(name), "glambda")


@cache
def short_recording(name: str, length: int) -> Recording:
    """The first QPs of a scene, with references."""
    run = scene_run(name)
    part = replace(run, qps=run.qps[:length], solutions=run.solutions[:length])
    return recording_of(part, "glambda")


def leaning_box(
    mu: float = 0.0, speed: float = 1.0, spring: bool = False, tilt: float = 0.5
) -> Scene:
    """A 1 × 3 box that leans on one corner, which slides along the ground: a smooth motion."""
    body = box(1.0, 3.0)
    c, s = np.cos(tilt), np.sin(tilt)
    corners = body.polygons[0] @ np.array([[c, s], [-s, c]])
    foot = corners[np.argmin(corners[:, 1])]
    omega = -0.3
    return Scene(
        bodies=(body,),
        q0=np.array([[0.0, -foot[1], tilt]]),
        v0=np.array([[speed, -omega * foot[0], omega]]),
        forces=(SpringDamper(0, (0.5, 1.5), (0.0, 6.0), 3.0, 2.0),) if spring else (),
        mu=mu,
        end_time=0.4,
    )


def one_box(x: float = 0.0, y: float = 0.5, angle: float = 0.0, **fields: object) -> Scene:
    """A unit box, by default standing on the ground."""
    return Scene(
        bodies=(box(1.0, 1.0),),
        q0=np.array([[x, y, angle]]),
        v0=np.array([fields.pop("v", (0.0, 0.0, 0.0))]),
        ground=(HalfPlane(),),
        **fields,  # type: ignore[arg-type]
    )
