"""MuJoCo: soft contacts as a convex program, solved by Newton's method.

The plane is made of slides along x and y and a hinge about z for each body; boxes have unit depth,
other parts are meshes.  In space bodies have free joints.  For accuracy: elliptic cones, a tight
tolerance, an impedance near 1 and a time constant of two steps, the least that the manual allows,
so that contacts harden with h.  Newton's method converges in a few iterations, so their number is
not swept.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from harness.peers.base import Settings, Stepped, gravity_of, is_box, one_friction
from harness.peers.in_space import frame_of, state_of
from problems.qp import Vector
from problems.space.attitude import attitudes_of, rotations
from problems.space.scene import SpaceScene

TOLERANCE, ITERATIONS, FRICTION_OVER_NORMAL = 1e-12, 100, 100.0
"""Of Newton's method, and `impratio`: how much harder friction is than the normal."""


class MuJoCo(Stepped):
    package = "mujoco"
    settings: ClassVar[Settings] = {
        "stock": {},
        "hard": {"impedance": 0.95},
        "harder": {"impedance": 0.9999},
        "harder, RK4": {"impedance": 0.9999, "integrator": "RK4"},
    }
    model = (
        "has contacts that are critically damped springs, whose time constant is 2 h if hard; "
        "relaxes Coulomb's law to a convex one, by which sliding contacts lift"
    )

    def __init__(
        self, scene: Any, h: float, impedance: float = 0.0, integrator: str = "IMPLICITFAST"
    ) -> None:
        super().__init__(h)
        self.spec, self.mu, self.impedance = mujoco.MjSpec(), one_friction(scene), impedance
        option = self.spec.option
        option.timestep, option.gravity = h, gravity_of(scene)
        if impedance:
            option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
            option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
            option.iterations, option.tolerance = ITERATIONS, TOLERANCE
            option.impratio = FRICTION_OVER_NORMAL
        self._build(scene)
        self.compiled = self.spec.compile()
        self.data = mujoco.MjData(self.compiled)
        self._start(scene)

    def _build(self, scene: Any) -> None:
        for plane in scene.ground:
            x, y = np.array(plane.normal) / np.hypot(*plane.normal)
            made = self._geom(self.spec.worldbody, mujoco.mjtGeom.mjGEOM_PLANE, (0.0, 0.0, 1.0))
            made.pos, made.quat = (*plane.point, 0.0), (1.0, -y, x, 0.0)  # z turned to the normal
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        for number, body in enumerate(scene.bodies):
            made = self._body(body.mass, [body.inertia] * 3)
            for kind, axis in ((slide, (1, 0, 0)), (slide, (0, 1, 0)), (hinge, (0, 0, 1))):
                made.add_joint(type=kind, axis=axis)
            for place, part in enumerate(body.polygons):
                self._add(made, part, f"part {place} of {number}")

    def _start(self, scene: Any) -> None:
        self.data.qpos[:], self.data.qvel[:] = scene.q0.ravel(), scene.v0.ravel()

    def _body(self, mass: float, inertia: Sequence[float]) -> Any:
        made = self.spec.worldbody.add_body(mass=mass, inertia=inertia)
        made.explicitinertial = True
        return made

    def _geom(self, body: Any, kind: Any, size: tuple[float, float, float]) -> Any:
        geom = body.add_geom(type=kind, size=size, density=0.0)
        geom.friction = (self.mu, 0.0, 0.0)  # of a pair: the larger one
        geom.condim = 3 if self.mu else 1
        if self.impedance:
            geom.solref = (2 * self.h, 1.0)
            geom.solimp = (self.impedance, self.impedance, 1e-3, 0.5, 2.0)
        return geom

    def _add(self, body: Any, part: Vector, name: str) -> None:
        if is_box(part):
            x, y = np.ptp(part, axis=0) / 2
            geom = self._geom(body, mujoco.mjtGeom.mjGEOM_BOX, (x, y, 0.5))
            geom.pos = (*part.mean(axis=0), 0.0)
            return
        prism = [(x, y, z) for x, y in part.tolist() for z in (-0.5, 0.5)]
        self.spec.add_mesh(name=name, uservert=np.ravel(prism))
        self._geom(body, mujoco.mjtGeom.mjGEOM_MESH, (0.0, 0.0, 0.0)).meshname = name

    def step(self) -> None:
        mujoco.mj_step(self.compiled, self.data)

    def state(self) -> tuple[Vector, Vector]:
        return self.data.qpos.reshape(-1, 3).copy(), self.data.qvel.reshape(-1, 3).copy()


class MuJoCoInSpace(MuJoCo):
    in_space = True

    def _build(self, scene: SpaceScene) -> None:
        kinds = mujoco.mjtGeom
        for plane in scene.planes:
            made = self._geom(self.spec.worldbody, kinds.mjGEOM_PLANE, (0.0, 0.0, 1.0))
            made.pos, made.quat = plane.point, attitudes_of(frame_of(plane.normal))
        for solid in scene.solids:
            body = self._body(solid.mass, solid.inertia)
            body.add_freejoint()
            if solid.is_box:
                x, y, z = (0.5 * side for side in solid.sides)
                self._geom(body, kinds.mjGEOM_BOX, (x, y, z))
            else:
                self._geom(body, kinds.mjGEOM_SPHERE, (solid.radius, 0.0, 0.0))

    def _start(self, scene: SpaceScene) -> None:
        self.data.qpos[:] = np.hstack([scene.centres, scene.attitudes]).ravel()
        own = np.einsum("nji,nj->ni", rotations(scene.attitudes), scene.v0[:, 3:])
        self.data.qvel[:] = np.hstack([scene.v0[:, :3], own]).ravel()  # ω in axes of the body

    def state(self) -> tuple[Vector, Vector]:
        q, v = self.data.qpos.reshape(-1, 7), self.data.qvel.reshape(-1, 6)
        R = rotations(q[:, 3:])
        turning = np.einsum("nij,nj->ni", R, v[:, 3:])
        return state_of(q[:, :3], R), np.hstack([v[:, :3], turning])
