"""Bullet, by PyBullet: impulses by Gauss–Seidel, or by Dantzig's pivoting.

Bodies in space alone.  The friction of a pair is the product of the two, so each has the root of
it.  Damping and sleeping are off.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pybullet

from harness.peers.base import Settings, Stepped, gravity_of, one_friction
from harness.peers.in_space import state_of
from problems.qp import Vector
from problems.space.attitude import rotations
from problems.space.scene import SpaceScene

TIGHT = 1e-14
"""Residual at which sweeps end, where it is not stock."""


class Bullet(Stepped):
    package = "pybullet"
    settings: ClassVar[Settings] = {
        "stock": {},
        "1000 iterations": {"iterations": 1000},
        "Dantzig": {"solver": "LCP_DANTZIG"},
    }
    model = "removes a share of the overlap at each step, in stock by q̇ itself"
    in_space = True

    def __init__(self, scene: SpaceScene, h: float, iterations: int = 0, solver: str = "") -> None:
        super().__init__(h)
        self.client = pybullet.connect(pybullet.DIRECT)
        self._call("setGravity", *gravity_of(scene))
        self._call("setPhysicsEngineParameter", fixedTimeStep=h, numSubSteps=0)
        if iterations:
            self._call("setPhysicsEngineParameter", numSolverIterations=iterations,
                       solverResidualThreshold=TIGHT)  # fmt: skip
        if solver:
            kind = getattr(pybullet, f"CONSTRAINT_SOLVER_{solver}")
            self._call("setPhysicsEngineParameter", constraintSolverType=kind)
        self.root_mu = float(np.sqrt(one_friction(scene)))
        for plane in scene.planes:
            shape = self._shape(pybullet.GEOM_PLANE, planeNormal=plane.normal)
            self._surface(self._call("createMultiBody", 0.0, shape, basePosition=plane.point))
        self.bodies = [self._body(scene, number) for number in range(len(scene.solids))]

    def __del__(self) -> None:
        if pybullet.isConnected(self.client):
            pybullet.disconnect(self.client)

    def _call(self, name: str, *given: Any, **named: Any) -> Any:
        return getattr(pybullet, name)(*given, **named, physicsClientId=self.client)

    def _shape(self, kind: int, **sizes: Any) -> int:
        return int(self._call("createCollisionShape", kind, **sizes))

    def _body(self, scene: SpaceScene, number: int) -> int:
        solid, at = scene.solids[number], scene.centres[number].tolist()
        shape = (
            self._shape(pybullet.GEOM_BOX, halfExtents=[0.5 * side for side in solid.sides])
            if solid.is_box
            else self._shape(pybullet.GEOM_SPHERE, radius=solid.radius)
        )
        turned = np.roll(scene.attitudes[number], -1).tolist()  # Bullet: (x, y, z, w)
        body = int(self._call("createMultiBody", solid.mass, shape, -1, at, turned))
        v, spin = scene.v0[number, :3].tolist(), scene.v0[number, 3:].tolist()
        self._call("resetBaseVelocity", body, v, spin)
        self._call("changeDynamics", body, -1, localInertiaDiagonal=solid.inertia)
        self._surface(body)
        return body

    def _surface(self, body: int) -> None:
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        self._call("changeDynamics", body, -1, lateralFriction=self.root_mu, restitution=0.0,
                   rollingFriction=0.0, spinningFriction=0.0, linearDamping=0.0,
                   angularDamping=0.0, activationState=awake)  # fmt: skip

    def step(self) -> None:
        pybullet.stepSimulation(physicsClientId=self.client)

    def state(self) -> tuple[Vector, Vector]:
        at = [self._call("getBasePositionAndOrientation", body) for body in self.bodies]
        v = [np.concatenate(self._call("getBaseVelocity", body)) for body in self.bodies]
        R = rotations(np.roll([turned for _, turned in at], 1, axis=1))
        return state_of(np.array([centre for centre, _ in at]), R), np.array(v)
