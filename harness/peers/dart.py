"""DART: impulses by a boxed linear complementarity problem, or with exact friction cones.

Each body is a skeleton of one planar joint; boxes have unit depth.  Stock is the pivoting method of
Dantzig and, where it fails, as on aligned boxes, 30 iterations of Gauss–Seidel, which are swept.
Collisions are FCL's, the stock ones and the most accurate of the four that DART offers.
"""

from __future__ import annotations

from typing import Any, ClassVar

import dartpy
import numpy as np
from numpy.typing import ArrayLike

from harness.peers.base import (
    Settings,
    Stepped,
    centre_and_size,
    gravity_of,
    ground_boxes,
    one_friction,
)
from harness.peers.in_space import slabs, state_of
from problems.qp import Vector
from problems.space.attitude import rotations
from problems.space.scene import SpaceScene

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
        self, scene: Any, h: float, iterations: int = 0, sweeps: int = 0, split: bool = False
    ) -> None:
        super().__init__(h)
        self.mu = one_friction(scene)  # of a pair: the smaller one
        self.world = dartpy.simulation.World()
        self.skeletons: list[Any] = []
        self.world.setGravity(gravity_of(scene))
        self.world.setTimeStep(h)
        self.world.getDeactivationOptions().mEnabled = False  # no sleeping
        constraints = self.world.getConstraintSolver()
        constraints.getCollisionOption().maxNumContacts = 100 * (len(scene.v0) + 10)
        constraints.setSplitImpulseEnabled(split)
        if iterations:
            option = dartpy.constraint.PgsBoxedLcpSolverOption(iterations, TIGHT, TIGHT)
            constraints.getSecondaryBoxedLcpSolver().setOption(option)
        if sweeps:
            options = dartpy.constraint.NsgsFrictionSolver.Options()
            options.maxSweeps, options.tolerance = sweeps, TIGHT
            constraints.setBoxedLcpSolver(dartpy.constraint.NsgsFrictionSolver(options))
        ground = dartpy.dynamics.Skeleton("ground")
        _, self.fixed = ground.createWeldJointAndBodyNodePair()
        self._build(scene)
        self.world.addSkeleton(ground)
        for skeleton in self.skeletons:
            self.world.addSkeleton(skeleton)

    def _build(self, scene: Any) -> None:
        for box in ground_boxes(scene):
            self._add(self.fixed, box.centre, box.size, box.angle)
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
            self.skeletons.append(skeleton)

    def _add(self, node: Any, centre: Vector, size: Vector, angle: float = 0.0) -> None:
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self._shape(node, dartpy.dynamics.BoxShape((*size, 1.0)), (*centre, 0.0), R)

    def _shape(self, node: Any, shape: Any, centre: ArrayLike, R: Vector) -> None:
        shape = node.createShapeNode(shape)
        shape.setRelativeRotation(R)
        shape.setRelativeTranslation(centre)
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


class DartInSpace(Dart):
    in_space = True

    def _build(self, scene: SpaceScene) -> None:
        for slab in slabs(scene):
            self._shape(self.fixed, dartpy.dynamics.BoxShape(slab.size), slab.centre, slab.R)
        starts = zip(scene.centres, rotations(scene.attitudes), scene.v0, strict=True)
        for number, (solid, (centre, R, v)) in enumerate(zip(scene.solids, starts, strict=True)):
            skeleton = dartpy.dynamics.Skeleton(f"body {number}")
            joint, node = skeleton.createFreeJointAndBodyNodePair()
            moments = np.diag(solid.inertia)
            node.setInertia(dartpy.dynamics.Inertia(solid.mass, np.zeros(3), moments))
            shape = (
                dartpy.dynamics.BoxShape(solid.sides)
                if solid.is_box
                else dartpy.dynamics.SphereShape(solid.radius)
            )
            self._shape(node, shape, (0.0, 0.0, 0.0), np.eye(3))
            at = dartpy.math.Isometry3()
            at.set_rotation(R)
            at.set_translation(centre)
            joint.setPositions(dartpy.dynamics.FreeJoint.convertToPositions(at))
            joint.setLinearVelocity(v[:3])
            joint.setAngularVelocity(v[3:])
            self.skeletons.append(skeleton)

    def state(self) -> tuple[Vector, Vector]:
        nodes = [skeleton.getBodyNode(0) for skeleton in self.skeletons]
        at = [node.getWorldTransform() for node in nodes]
        centres, R = np.array([t.translation() for t in at]), np.array([t.rotation() for t in at])
        v = [[*node.getLinearVelocity(), *node.getAngularVelocity()] for node in nodes]
        return state_of(centres, R), np.array(v)
