"""pymunk, the binding of Chipmunk2D: impulses by Gauss–Seidel, in double precision.

Its best settings are no allowed overlap (`collision_slop`) and many iterations.  Overlap is removed
at the stock rate, 10 % in 1/60 s (`collision_bias`); other rates were no better.
"""

from __future__ import annotations

from math import sqrt
from typing import ClassVar

import numpy as np
import pymunk

from harness.peers.base import Settings, Stepped, ground_boxes, one_friction
from problems import Scene
from problems.qp import Vector


class Pymunk(Stepped):
    package = "pymunk"
    settings: ClassVar[Settings] = {
        "stock, 10 iterations": {"iterations": 10, "slop": 0.1},
        "10 iterations": {"iterations": 10},
        "100 iterations": {"iterations": 100},
        "1000 iterations": {"iterations": 1000},
    }
    model = "removes overlap after it has come, by velocities that it keeps apart from q̇"

    def __init__(self, scene: Scene, h: float, iterations: int, slop: float = 0.0) -> None:
        super().__init__(h)
        friction = sqrt(one_friction(scene))  # of a pair: the product
        self.space = pymunk.Space()
        self.space.gravity = (0.0, -scene.gravity)
        self.space.iterations = iterations
        self.space.collision_slop = slop
        self.bodies = []
        for box in ground_boxes(scene):
            self._add(self.space.static_body, box.corners, friction)
        for body, q, v in zip(scene.bodies, scene.q0.tolist(), scene.v0.tolist(), strict=True):
            made = pymunk.Body(body.mass, body.inertia)
            made.position, made.angle = (q[0], q[1]), q[2]
            made.velocity, made.angular_velocity = (v[0], v[1]), v[2]
            self.space.add(made)
            self.bodies.append(made)
            for part in body.polygons:
                self._add(made, part, friction)

    def _add(self, body: pymunk.Body, corners: Vector, friction: float) -> None:
        shape = pymunk.Poly(body, [(x, y) for x, y in corners.tolist()], radius=0.0)
        shape.friction, shape.elasticity = friction, 0.0
        self.space.add(shape)

    def step(self) -> None:
        self.space.step(self.h)

    def state(self) -> tuple[Vector, Vector]:
        q = np.array([(*body.position, body.angle) for body in self.bodies])
        v = np.array([(*body.velocity, body.angular_velocity) for body in self.bodies])
        return q, v
