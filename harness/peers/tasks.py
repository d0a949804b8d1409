"""What the engines are asked to do.

    motion   a scene to its first impact, or beyond as far as its pose is determined: error of the
             pose against CPU time
    whole    the scene beyond it: how deep bodies overlap, whether energy is gained
    rest     a tower that stands still, 100 steps of 1/240: does it?

Engines start from no impulse, so every one of them, ours too, starts from the velocities that our
stepper finds after external impulses at t = 0, by the paper's model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from harness.peers.base import REST_STEP
from harness.peers.ours import NO_TIME
from problems import Scene, simulate
from problems import scene as make_scene
from problems.scenes.labels import parse_label
from problems.space.scene import SpaceScene
from solvers import make_solver

Kind = Literal["motion", "whole", "rest"]

FRAME = 1 / 60
"""Times at which states are looked at are multiples of this [s]."""
MOST_SAMPLES = 16
"""States of a motion that are compared."""
WHOLE = 3.0
"""Longest whole motion [s]."""
REST_STEPS = 100
AT_REST = "rest"
COARSE_EPS = 1e-4
"""ε for finding the first impact."""
TOWER = "tower,bodies={},jitter=0.0,speed={},mu=0.5@rest"
DEFAULT = (
    *("fig2@0.8", "fig2@1.0", "fig4", "fig4@3.0"),
    *(TOWER.format(bodies, 0.0) for bodies in (10, 100, 1000)),
    TOWER.format(1000, 1e-6),
    *("bowl@1.0", "bowl,speed=0.0,angle=0.3@1.0", "skid,spin=6.0@0.3"),
    *(f"space_tower,bodies={bodies}@rest" for bodies in (5, 10, 20, 40)),
)
"""Scenes where nobody names any.  fig2 has its first impact at 0.91; fig4 at 0.13, and comes to
rest at 2.2 after dozens, in which all that take contacts as rigid agree.  The last tower of the
plane starts with a shake.  In space a ball slides until it rolls, one rolls down a slope, a box
slides and spins, and towers stand."""


@dataclass(frozen=True)
class Task:
    """One scene and what is asked of it; `until` [s]."""

    kind: Kind
    scene: str
    until: float

    @property
    def name(self) -> str:
        return (
            f"{self.scene} at rest" if self.kind == "rest" else f"{self.scene} to {self.until:.3g}"
        )

    @property
    def times(self) -> list[float]:
        """When states are looked at [s], ascending to `until`."""
        if self.kind == "rest":
            return [REST_STEP * step for step in range(10, REST_STEPS + 1, 10)]
        frames = round(self.until / FRAME)
        strides = [
            s for s in range(1, frames + 1) if frames % s == 0 and frames <= s * MOST_SAMPLES
        ]
        stride = strides[0] if self.kind == "motion" else 1
        return [FRAME * frame for frame in range(stride, frames + 1, stride)]

    @property
    def in_space(self) -> bool:
        return isinstance(self.start(), SpaceScene)

    def start(self) -> Scene | SpaceScene:
        """The scene with the velocities after external impulses at t = 0, which are left out.

        It does not stop at rest, since no engine does.
        """
        return started(self.scene)


def digest_of(scene: Scene | SpaceScene) -> str:
    """Of all that engines are given of a scene."""
    given: tuple[Any, ...]
    ground: list[tuple[float, ...]]
    if isinstance(scene, SpaceScene):
        ground = [(*plane.point, *plane.normal) for plane in scene.planes]
        solids = [(s.mass, *s.inertia, s.radius, *s.sides) for s in scene.solids]
        given = solids, scene.centres, scene.attitudes
    else:
        ground = [(*plane.point, *plane.normal) for plane in scene.ground]
        parts = [part for body in scene.bodies for part in body.polygons]
        given = *parts, [(body.mass, body.inertia) for body in scene.bodies], scene.q0
    found = hashlib.sha256()
    for each in (*given, scene.v0, ground, (scene.mu, scene.gravity)):
        found.update(np.array(each, dtype=np.float64).tobytes())
    return found.hexdigest()[:16]


@cache
def started(label: str) -> Scene | SpaceScene:
    """See `Task.start`."""
    name, parameters = parse_label(label)
    scene = make_scene(name, **parameters)
    if isinstance(scene, SpaceScene):
        return scene
    scene = replace(scene, stop_at_rest=False)
    if not scene.impulses:
        return scene
    if any(impulse.t > 0 for impulse in scene.impulses):
        raise ValueError(f"scene {label!r} has an impulse after t = 0, which engines are not given")
    run = simulate(scene, make_solver("glambda"), until=NO_TIME, keep_qps=False)
    return replace(scene, v0=run.v[-1], impulses=())


def tasks_of(named: Sequence[str]) -> list[Task]:
    """Tasks for scenes such as "fig2@0.8", "fig4" (to its first impact) or "tower,…@rest".

    Each scene that moves is also run whole.  Raises ValueError for a name that is no scene, a time
    that is no multiple of 1/60, or a first impact before 1/60.
    """
    motions, wholes, rests = [], [], []
    for name in named:
        label, at, text = name.partition("@")
        scene = started(label)
        if text == AT_REST:
            rests.append(Task("rest", scene.label, REST_STEPS * REST_STEP))
            continue
        until = _time(name, text) if at else first_impact(scene)
        motions.append(Task("motion", scene.label, until))
        whole = Task("whole", scene.label, FRAME * int(min(WHOLE, scene.end_time) / FRAME))
        if whole not in wholes:
            wholes.append(whole)
    return [*motions, *wholes, *rests]


def _time(name: str, text: str) -> float:
    try:
        until = float(text)
    except ValueError:
        raise ValueError(f"{name!r}: behind @ stands a time or rest, as in fig2@0.8") from None
    if not until > 0 or abs(until / FRAME - round(until / FRAME)) > 1e-6:
        raise ValueError(f"{name!r}: {until:g} s is no multiple of 1/60 s, which all steps divide")
    return until


def first_impact(scene: Scene | SpaceScene) -> float:
    """The last multiple of 1/60 before the first impact [s], or the end of the whole motion."""
    until = min(WHOLE, scene.end_time)
    run = simulate(scene, make_solver("glambda"), eps=COARSE_EPS, until=until, keep_qps=False)
    impacts = [event.t for event in run.event_log if event.kind == "impulse" and event.t > 0]
    frames = int((min(impacts) if impacts else until) / FRAME)
    if frames < 1:
        raise ValueError(
            f"scene {scene.label!r} has its first impact at {min(impacts):.3g} s; "
            f"say to when the motion is compared, such as {scene.label}@0.5"
        )
    return FRAME * frames
