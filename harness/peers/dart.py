"""DART: impulses by a boxed linear complementarity problem, or with exact friction cones.

Each body is a skeleton of one planar joint; boxes have unit depth.  Stock is the pivoting method of
Dantzig and, where it fails, as on aligned boxes, 30 iterations of Gauss–Seidel, which are swept.
Collisions are FCL's, the stock ones and the most accurate of the four that DART offers.
"""

from __future__ import annotations

from typing import Any, ClassVar

import dartpy
import numpy as np

from harness.peers.base import Settings, Stepped, centre_and_size, ground_boxes, one_friction
from problems import Scene
from problems.qp import Vector

TIGHT = 1e-12
"""Tolerance of everything that iterates, where it is not stock."""


class Dart(Stepped):
    package = "dartpy"
    settings: ClassVar[Settings] = {
        "stock": {},
        "split impulse": {"split": True},
        "300 iterations": {"iterations": 300},
        "NSGS, 1000 sweeps": {"sweeps": 1000},
    }
    model = "removes overlap at up to 0.1 m/s, in stock by q̇ itself"

    def __init__(
        self, scene: Scene, h: float, iterations: int = 0, sweeps: int = 0, split: bool = False
    ) -> None:
        super().__init__(h)
        self.mu = one_friction(scene)  # of a pair: the smaller one
        self.world, self.skeletons = dartpy.simulation.World(), []
        self.world.setGravity((0.0, -scene.gravity, 0.0))
        self.world.setTimeStep(h)
        self.world.getDeactivationOptions().mEnabled = False  # no sleeping
        constraints = self.world.getConstraintSolver()
        constraints.getCollisionOption().maxNumContacts = 100 * (len(scene.bodies) + 10)
        constraints.setSplitImpulseEnabled(split)
        if iterations:
            option = dartpy.constraint.PgsBoxedLcpSolverOption(iterations, TIGHT, TIGHT)
            constraints.getSecondaryBoxedLcpSolver().setOption(option)
        if sweeps:
            options = dartpy.constraint.NsgsFrictionSolver.Options()
            options.maxSweeps, options.tolerance = sweeps, TIGHT
            constraints.setBoxedLcpSolver(dartpy.constraint.NsgsFrictionSolver(options))
        ground = dartpy.dynamics.Skeleton("ground")
        _, fixed = ground.createWeldJointAndBodyNodePair()
        for box in ground_boxes(scene):
            self._add(fixed, box.centre, box.size, box.angle)
        self.world.addSkeleton(ground)
        for number, body in enumerate(scene.bodies):
            skeleton = dartpy.dynamics.Skeleton(f"body {number}")
            joint, node = skeleton.createPlanarJointAndBodyNodePair()
            joint.setXYPlane()
            moments = body.inertia * np.eye(3)
            node.setInertia(dartpy.dynamics.Inertia(body.mass, np.zeros(3), moments))
            for part in body.polygons:
                self._add(node, *centre_and_size(part, "DART"))
            skeleton.setPositions(scene.q0[number])
            skeleton.setVelocities(scene.v0[number])
            self.world.addSkeleton(skeleton)
            self.skeletons.append(skeleton)

    def _add(self, node: Any, centre: Vector, size: Vector, angle: float = 0.0) -> None:
        shape = node.createShapeNode(dartpy.dynamics.BoxShape((*size, 1.0)))
        c, s = np.cos(angle), np.sin(angle)
        shape.setRelativeRotation(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
        shape.setRelativeTranslation((*centre, 0.0))
        shape.createCollisionAspect()
        shape.createDynamicsAspect()
        shape.getDynamicsAspect().setFrictionCoeff(self.mu)
        shape.getDynamicsAspect().setRestitutionCoeff(0.0)

    def step(self) -> None:
        self.world.step()

    def state(self) -> tuple[Vector, Vector]:
        q = np.array([skeleton.getPositions() for skeleton in self.skeletons])
        v = np.array([skeleton.getVelocities() for skeleton in self.skeletons])
        return q, v
