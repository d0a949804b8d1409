"""Box2D 3, by pyb2d3: soft contacts relaxed in sub-steps, one iteration in each.

In single precision.  Sub-steps play the part of iterations.  Contacts are as hard as the sub-step
allows (`SetContactTuning`; Box2D bounds their frequency by a quarter of the sub-steps' own).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pyb2d3

from harness.peers.base import Settings, Stepped, ground_boxes, one_friction
from problems import Scene
from problems.qp import Vector

HARDEST, DAMPING, PUSH = 1e9, 10.0, 3.0
"""Frequency of contacts [Hz], beyond any bound; stock damping ratio and push-out speed [m/s]."""


class Box2D3(Stepped):
    package = "pyb2d3"
    settings: ClassVar[Settings] = {
        "stock, 4 sub-steps": {"substeps": 4, "stock": True},
        "1 sub-step": {"substeps": 1},
        "4 sub-steps": {"substeps": 4},
        "16 sub-steps": {"substeps": 16},
    }
    model = "computes in single precision; its contacts are damped springs that harden with h"

    def __init__(self, scene: Scene, h: float, substeps: int, stock: bool = False) -> None:
        super().__init__(h)
        friction = one_friction(scene)  # of a pair: the geometric mean
        self.world = pyb2d3.World(gravity=(0.0, -scene.gravity))
        self.world.sleeping_enabled = False
        if not stock:
            self.world.set_contact_tuning(HARDEST, DAMPING, PUSH)
        self.arguments = (h, substeps)
        material = pyb2d3.surface_material(friction=friction, restitution=0.0)
        self.shape = pyb2d3.shape_def(density=1.0, material=material)
        ground = self.world.create_static_body()
        for box in ground_boxes(scene):
            self._add(ground, box.corners)
        self.bodies = []
        for body, q, v in zip(scene.bodies, scene.q0.tolist(), scene.v0.tolist(), strict=True):
            made = self.world.create_dynamic_body(
                position=(q[0], q[1]),
                rotation=q[2],
                linear_velocity=(v[0], v[1]),
                angular_velocity=v[2],
            )
            for part in body.polygons:
                self._add(made, part)
            mass = made.mass_data
            mass.mass, mass.rotational_inertia = body.mass, body.inertia
            made.mass_data = mass
            self.bodies.append(made)

    def _add(self, body: Any, corners: Vector) -> None:
        body.create_shape(self.shape, pyb2d3.polygon(points=corners, radius=0.0))

    def step(self) -> None:
        self.world.step(*self.arguments)

    def state(self) -> tuple[Vector, Vector]:
        q = np.array([(*body.position, body.angle) for body in self.bodies])
        v = np.array([(*body.linear_velocity, body.angular_velocity) for body in self.bodies])
        return q, v
