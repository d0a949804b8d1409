"""Box2D 2, by pybox2d: impulses by Gauss–Seidel with a block solver, positions corrected after.

In single precision.  A skin of 1 cm that rounds polygons and an allowed overlap of 5 mm are
compiled in; the skin can be taken off (`radius`), the overlap cannot.
"""

from __future__ import annotations

import warnings
from typing import Any, ClassVar

import numpy as np

from harness.peers.base import Settings, Stepped, ground_boxes, one_friction
from problems import Scene
from problems.qp import Vector

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # where warnings are errors, this import ends the process
    import Box2D


class Box2D2(Stepped):
    package = "box2d"
    settings: ClassVar[Settings] = {
        "stock, 8 and 3 iterations": {"velocity": 8, "position": 3, "skin": True},
        "8 and 3 iterations": {"velocity": 8, "position": 3},
        "50 and 20 iterations": {"velocity": 50, "position": 20},
        "500 and 100 iterations": {"velocity": 500, "position": 100},
    }
    model = "computes in single precision, and leaves up to 5 mm of overlap alone"

    def __init__(
        self, scene: Scene, h: float, velocity: int, position: int, skin: bool = False
    ) -> None:
        super().__init__(h)
        self.friction = one_friction(scene)  # of a pair: the geometric mean
        self.skin = skin
        self.world = Box2D.b2World(gravity=(0.0, -scene.gravity), doSleep=False)
        self.arguments = (h, velocity, position)
        ground = self.world.CreateStaticBody()
        for box in ground_boxes(scene):
            self._add(ground, box.corners)
        self.bodies = []
        for body, q, v in zip(scene.bodies, scene.q0.tolist(), scene.v0.tolist(), strict=True):
            made = self.world.CreateDynamicBody(
                position=q[:2], angle=q[2], linearVelocity=v[:2], angularVelocity=v[2]
            )
            for part in body.polygons:
                self._add(made, part)
            made.massData = Box2D.b2MassData(mass=body.mass, center=(0.0, 0.0), I=body.inertia)
            self.bodies.append(made)

    def _add(self, body: Any, corners: Vector) -> None:
        shape = Box2D.b2PolygonShape(vertices=corners.tolist())
        if not self.skin:
            shape.radius = 0.0
        body.CreateFixture(shape=shape, density=1.0, friction=self.friction, restitution=0.0)

    def step(self) -> None:
        self.world.Step(*self.arguments)

    def state(self) -> tuple[Vector, Vector]:
        q = np.array([(*body.position, body.angle) for body in self.bodies])
        v = np.array([(*body.linearVelocity, body.angularVelocity) for body in self.bodies])
        return q, v
