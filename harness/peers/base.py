"""What every engine is asked: build a scene, move it on, tell where everything is.

An engine is one class, one file.  It gets the scene as it is: convex parts, masses, moments of
inertia, friction, half planes, gravity, positions and velocities; restitution 0; no sleeping.
Beside what is swept, its step or its accuracy, it has named `settings`: what it comes with
(`stock`), and what its manual recommends for accuracy, with several numbers of iterations where it
iterates.  What its model of contact does differently is said in `model`.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from problems import Scene
from problems.bodies.shapes import box_corners
from problems.qp import Vector
from problems.space.scene import SpaceScene

Settings = Mapping[str, Mapping[str, Any]]
"""Name → options of an engine's constructor."""

STEPS = tuple(1 / (60 * 2**k) for k in range(9))
"""Steps that are swept [s]: 1/60 … 1/15,360."""
REST_STEP = 1 / 240
"""Step for scenes at rest [s]."""
GROUND_DEPTH = 10.0
"""Thickness of the ground in engines without half planes [m]."""
GROUND_MARGIN = 20.0
"""By how much such a ground is wider than the scene [m]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What an engine made of a scene at the times asked for.

    q, v : (times, n, 3) [m, m, rad], per second; in space (times, n, 12) and (times, n, 6), see
        `harness.peers.in_space`
    cpu : of the stepping alone [s];  steps : taken
    """

    q: Vector
    v: Vector
    cpu: float
    steps: int


class Peer(ABC):
    """One scene in one engine.

    package : on the package index;  settings : name → options of the constructor
    model : how its model of contact differs from rigid bodies, in words that follow its name
    swept : "h" [s], or "accuracy" or "ε" where the engine controls the error of a step
    resolutions : values of it, coarse first;  middling : two of them, for whole motions
    resting : settings for scenes at rest, None for the same;  rest : value of what is swept there
    in_space : it takes a `SpaceScene`, not a `Scene`
    """

    package: ClassVar[str]
    settings: ClassVar[Settings]
    model: ClassVar[str]
    swept: ClassVar[str] = "h"
    resolutions: ClassVar[Sequence[float]] = STEPS
    middling: ClassVar[Sequence[float]] = (1 / 240, 1 / 960)
    resting: ClassVar[Settings | None] = None
    rest: ClassVar[float] = REST_STEP
    in_space: ClassVar[bool] = False

    @abstractmethod
    def __init__(self, scene: Any, resolution: float, **options: Any):
        """Build `scene`."""

    @classmethod  # noqa: B027  most engines need nothing
    def prepare(cls) -> None:
        """What a machine needs once, before anything is timed or limited."""

    @abstractmethod
    def run(self, times: Sequence[float]) -> Motion:
        """Move on from t = 0, once; the states at ascending times [s]."""


class Stepped(Peer):
    """An engine that is told to step."""

    def __init__(self, h: float) -> None:
        self.h, self.steps = h, 0

    @abstractmethod
    def step(self) -> None:
        """Advance by h."""

    @abstractmethod
    def state(self) -> tuple[Vector, Vector]:
        """Positions and velocities of the bodies, as in a `Motion`."""

    def advance(self, t: float) -> None:
        """Step until t [s], a multiple of h."""
        last = round(t / self.h)
        for _ in range(last - self.steps):
            self.step()
        self.steps = last

    def run(self, times: Sequence[float]) -> Motion:
        states, spent = [], 0
        for t in times:
            start = time.process_time_ns()
            self.advance(t)
            spent += time.process_time_ns() - start
            states.append(self.state())
        q, v = (np.array(part) for part in zip(*states, strict=True))
        return Motion(q, v, 1e-9 * spent, self.steps)


def one_friction(scene: Scene | SpaceScene) -> float:
    """The friction coefficient of all pairs, since engines give it to bodies.

    Raises ValueError for what engines are not given: friction by pairs, forces beside gravity,
    discs, ellipses, joints or impacts that bounce; in space pins and polyhedra.
    """
    if isinstance(scene, SpaceScene):
        if scene.pins or not all(solid.radius or solid.is_box for solid in scene.solids):
            what = "pins" if scene.pins else "polyhedra"
            raise ValueError(f"scene {scene.label!r} has {what}; engines are given balls and boxes")
        return scene.mu
    if any(body.is_round for body in scene.bodies):
        oblong = any(a > b for a, b in (body.semi_axes for body in scene.bodies))
        what = "ellipses" if oblong else "discs"
        raise ValueError(f"scene {scene.label!r} has {what}; engines are given polygons alone")
    if scene.joints or scene.bounces:
        what = "joints" if scene.joints else "impacts that bounce"
        raise ValueError(f"scene {scene.label!r} has {what}; engines are given plastic contacts")
    if scene.mu_pairs:
        raise ValueError(f"scene {scene.label!r} has friction by pairs, which engines do not have")
    if scene.forces:
        raise ValueError(f"scene {scene.label!r} has forces beside gravity; choose one without")
    return scene.mu


def gravity_of(scene: Scene | SpaceScene) -> tuple[float, float, float]:
    """Acceleration (3,) [m/s²]: along −y of the plane, −z of space."""
    g = -scene.gravity
    return (0.0, 0.0, g) if isinstance(scene, SpaceScene) else (0.0, g, 0.0)


class GroundBox(NamedTuple):
    """A half plane as a box: middle, sides and angle [m, rad], and corners (4, 2)."""

    centre: Vector
    size: Vector
    angle: float
    corners: Vector


def ground_boxes(scene: Scene) -> list[GroundBox]:
    """A box for each half plane, `GROUND_DEPTH` thick, its upper side on the surface.

    It spans the scene and `GROUND_MARGIN` more on either side: single precision wants it short.
    """
    reach = max(body.radius for body in scene.bodies) + GROUND_MARGIN
    boxes = []
    for plane in scene.ground:
        normal = np.array(plane.normal) / np.hypot(*plane.normal)
        along = np.array([normal[1], -normal[0]])
        places = (scene.q0[:, :2] - plane.point) @ along
        first, last = places.min() - reach, places.max() + reach
        size = np.array([last - first, GROUND_DEPTH])
        centre = plane.point + 0.5 * (first + last) * along - 0.5 * GROUND_DEPTH * normal
        angle = float(np.arctan2(along[1], along[0]))
        turned = box_corners(*size) @ np.array([along, normal])
        boxes.append(GroundBox(centre, size, angle, centre + turned))
    return boxes


def is_box(part: Vector) -> bool:
    """Whether a convex part (c, 2) is a rectangle along the axes of its body."""
    return len(part) == 4 and len(set(part[:, 0])) == 2 and len(set(part[:, 1])) == 2


def centre_and_size(part: Vector, engine: str) -> tuple[Vector, Vector]:
    """Middle and sides of a rectangular part [m].

    Raises ValueError for another part, which `engine` is not given.
    """
    if not is_box(part):
        raise ValueError(f"{engine} is given boxes only; leave it out with --engines")
    return part.mean(axis=0), np.ptp(part, axis=0)
