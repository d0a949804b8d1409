"""What is measured of a motion, from positions and velocities alone, by our own geometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from harness.peers import in_space
from harness.peers.base import Motion, Peer
from harness.peers.tasks import Task
from problems import Scene
from problems.bodies.bodies import mass_diagonal
from problems.contacts.geometry import Geometry
from problems.qp import Vector
from problems.space.scene import SpaceScene

REPEATS = 3
"""Passes of each run; the least CPU time counts."""
ENOUGH = 5.0
"""CPU time of passes beyond which they are not repeated [s]."""


def observe(
    cls: type[Peer],
    options: dict[str, Any],
    resolution: float,
    task: Task,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Run one engine on one task and measure.

    tell : told "built" and "passed" as each pass begins and ends

    Returns cpu [s], steps, repeats, and what belongs to the task:
        motion  q, the positions at the task's times, and energy then, over that at the start
        whole   gain, the largest rise of energy, over that at the start
        rest    drift, how far each body has moved [m];  turn, by how much [rad]
    and penetration [m], the deepest overlap at any of the times.

    Raises FloatingPointError where the motion is not finite.
    """
    scene = task.start()
    passes: list[Motion] = []
    while len(passes) < REPEATS and sum(motion.cpu for motion in passes) <= ENOUGH:
        built = cls(scene, resolution, **options)
        tell("built")
        passes.append(built.run(task.times))
        tell("passed")
    motion = passes[-1]
    if not (np.isfinite(motion.q).all() and np.isfinite(motion.v).all()):
        raise FloatingPointError("positions or velocities are not finite numbers")
    first = in_space.first_state(scene) if isinstance(scene, SpaceScene) else scene.q0
    start = energy(scene, first[None], scene.v0[None])[0]
    relative = energy(scene, motion.q, motion.v) / start
    found: dict[str, Any] = {
        "cpu": min(each.cpu for each in passes),
        "steps": motion.steps,
        "repeats": len(passes),
        "penetration": penetration(scene, motion.q),
    }
    if task.kind == "motion":
        found |= {"q": motion.q.tolist(), "energy": relative.tolist()}
    elif task.kind == "whole":
        lowest = np.minimum.accumulate(np.concatenate([[1.0], relative]))
        found["gain"] = float((relative - lowest[:-1]).max(initial=0.0))
    else:
        found["drift"], found["turn"] = moved(scene, motion.q[-1])
    return found


def energy(scene: Scene | SpaceScene, q: Vector, v: Vector) -> Vector:
    """T + V of gravity from y = 0, in space z = 0, for the states of a `Motion`, (times,) [J]."""
    if isinstance(scene, SpaceScene):
        return in_space.energy(scene, q, v)
    M = mass_diagonal(scene.bodies).reshape(-1, 3)
    return (0.5 * M * v**2).sum(axis=(1, 2)) + scene.gravity * q[:, :, 1] @ M[:, 1]


def penetration(scene: Scene | SpaceScene, q: Vector) -> float:
    """The deepest overlap of two bodies, or of one and the ground, at any time [m]; at least 0."""
    if isinstance(scene, SpaceScene):
        return in_space.penetration(scene, q)
    geometry = Geometry(scene.bodies, scene.ground)
    deepest = 0.0
    for state in q:
        pose = geometry.pose(state.ravel())
        pairs = geometry.near_pairs(pose, 0.0)
        deepest = max([deepest, *(geometry.penetration(pose, pair) for pair in pairs)])
    return float(deepest)


def moved(scene: Scene | SpaceScene, state: Vector) -> tuple[list[float], list[float]]:
    """How far each body has moved along an axis since t = 0 [m], and by how much turned [rad]."""
    if isinstance(scene, SpaceScene):
        return in_space.moved(scene, state)
    apart = np.abs(state - scene.q0)
    return apart[:, :2].max(axis=1).tolist(), apart[:, 2].tolist()
