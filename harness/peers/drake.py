"""Drake: compliant contacts, made discrete and solved as a convex program.

Bodies have planar joints; boxes have unit depth.  Two boxes have one contact point in Drake's point
contact, on which they rock, so, as in Drake's own examples, corners carry small spheres instead,
which touch the other boxes; the alternative are patches (hydroelastic contact).  Springs are as
hard as SAP takes them: it bounds them by the step (`sap_near_rigid_threshold`).
"""

# pydrake's stubs type arrays too narrowly
# mypy: disable-error-code="arg-type, call-overload"
from __future__ import annotations

import logging
from typing import Any, ClassVar

import numpy as np
import pydrake.geometry as geometry
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import PlanarJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from harness.peers.base import (
    Settings,
    Stepped,
    centre_and_size,
    gravity_of,
    ground_boxes,
    one_friction,
)
from harness.peers.in_space import state_of
from problems.qp import Vector
from problems.space.attitude import rotations
from problems.space.scene import SpaceScene

logging.getLogger("drake").setLevel(logging.ERROR)

HARDEST = 1e10
"""Stiffness of a point [N/m]."""
DISSIPATION = 10.0
"""Of Hunt and Crossley [s/m]: as good as inelastic."""
FINE = 0.1
"""Side of the triangles of a sphere with patches, over its radius."""


class Drake(Stepped):
    """corner : radius of the spheres [m], 0 for none;  modulus : of patches [Pa], 0 for points."""

    package = "drake"
    settings: ClassVar[Settings] = {
        "stock": {"scheme": "lagged", "stiffness": None},
        "SAP, corners 0.1 mm": {"corner": 1e-4},
        "SAP, corners 1 mm": {"corner": 1e-3},
        "lagged, corners 0.1 mm": {"scheme": "lagged", "corner": 1e-4},
        "SAP, patches": {"modulus": 1e8, "stiffness": None},
    }
    model = (
        "has contacts that are damped springs, at corners that are rounded; relaxes Coulomb's law "
        "to a convex one, by which sliding contacts lift, less so if lagged"
    )

    def __init__(
        self, scene: Any, h: float, scheme: str = "sap", corner: float = 0.0,
        stiffness: float | None = HARDEST, modulus: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(h)
        self.corner = corner
        self.material = one_friction(scene), stiffness, modulus
        model = "hydroelastic" if modulus else "point"
        config = MultibodyPlantConfig(
            time_step=h, contact_model=model, discrete_contact_approximation=scheme
        )
        builder = DiagramBuilder()
        self.plant, graph = AddMultibodyPlant(config, builder)
        self.plant.mutable_gravity_field().set_gravity_vector(gravity_of(scene))
        self.boxes, self.corners = geometry.GeometrySet(), geometry.GeometrySet()
        self._build(scene)
        if corner:
            apart = geometry.CollisionFilterDeclaration().ExcludeWithin(self.corners)
            graph.collision_filter_manager().Apply(apart.ExcludeWithin(self.boxes))
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())
        self.context = self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        self._start(scene)

    def _build(self, scene: Any) -> None:
        for box in ground_boxes(scene):
            ground = self.plant.world_body(), box.centre, geometry.Box(*box.size, 1.0)
            self.boxes.Add(self._register(*ground, box.angle))
        for number, body in enumerate(scene.bodies):
            gyration = UnitInertia(*[body.inertia / body.mass] * 3)
            inertia = SpatialInertia(body.mass, np.zeros(3), gyration)
            made = self.plant.AddRigidBody(f"body {number}", inertia)
            frames = self.plant.world_frame(), made.body_frame()
            self.plant.AddJoint(PlanarJoint(f"joint {number}", *frames, np.zeros(3)))
            for part in body.polygons:
                self._add(made, part)

    def _start(self, scene: Any) -> None:
        self.plant.SetPositions(self.context, scene.q0.ravel())
        self.plant.SetVelocities(self.context, scene.v0.ravel())

    def _add(self, body: Any, part: Vector) -> None:
        centre, size = centre_and_size(part, "Drake")
        self.boxes.Add(self._register(body, centre, geometry.Box(*size, 1.0)))
        for point in part if self.corner else ():
            inset = point - self.corner * np.sign(point - centre)
            self.corners.Add(self._register(body, inset, geometry.Sphere(self.corner)))

    def _register(self, body: Any, place: Vector, shape: Any, angle: float = 0.0) -> Any:
        pose = RigidTransform(RotationMatrix.MakeZRotation(angle), (*place, 0.0))
        return self._geometry(body, pose, shape)

    def _geometry(self, body: Any, pose: Any, shape: Any) -> Any:
        name = f"{self.plant.num_collision_geometries()}"
        properties = contact_properties(*self.material, shape)
        return self.plant.RegisterCollisionGeometry(body, pose, shape, name, properties)

    def step(self) -> None:
        self.advance((self.steps + 1) * self.h)

    def advance(self, t: float) -> None:
        self.steps = round(t / self.h)
        # Drake updates at 0, h, 2h, …; half a step keeps clear of rounding
        self.simulator.AdvanceTo((self.steps - 0.5) * self.h)

    def state(self) -> tuple[Vector, Vector]:
        q = self.plant.GetPositions(self.context).reshape(-1, 3)
        return q.copy(), self.plant.GetVelocities(self.context).reshape(-1, 3).copy()


class DrakeInSpace(Drake):
    in_space = True

    def _build(self, scene: SpaceScene) -> None:
        world = self.plant.world_body()
        for plane in scene.planes:
            pose = geometry.HalfSpace.MakePose(plane.normal, plane.point)
            self.boxes.Add(self._geometry(world, pose, geometry.HalfSpace()))
        for number, solid in enumerate(scene.solids):
            gyration = UnitInertia(*(np.array(solid.inertia) / solid.mass))
            inertia = SpatialInertia(solid.mass, np.zeros(3), gyration)
            body = self.plant.AddRigidBody(f"body {number}", inertia)
            if not solid.is_box:
                self._geometry(body, RigidTransform(), geometry.Sphere(solid.radius))
                continue
            self.boxes.Add(self._geometry(body, RigidTransform(), geometry.Box(*solid.sides)))
            for point in solid.corners() if self.corner else ():
                place = RigidTransform(point - self.corner * np.sign(point))
                self.corners.Add(self._geometry(body, place, geometry.Sphere(self.corner)))

    def _start(self, scene: SpaceScene) -> None:
        q, v = (scene.attitudes, scene.centres), (scene.v0[:, 3:], scene.v0[:, :3])
        self.plant.SetPositions(self.context, np.hstack(q).ravel())
        self.plant.SetVelocities(self.context, np.hstack(v).ravel())

    def state(self) -> tuple[Vector, Vector]:
        q = self.plant.GetPositions(self.context).reshape(-1, 7)
        v = self.plant.GetVelocities(self.context).reshape(-1, 6)
        return state_of(q[:, 4:], rotations(q[:, :4])), np.hstack([v[:, 3:], v[:, :3]])


def contact_properties(mu: float, stiffness: float | None, modulus: float, shape: Any) -> Any:
    """Of a geometry; the friction of a pair is the harmonic mean.  A half space is not soft."""
    properties = geometry.ProximityProperties()
    if modulus and isinstance(shape, geometry.HalfSpace):
        geometry.AddRigidHydroelasticProperties(properties)
    elif modulus:
        fineness = FINE * shape.radius() if isinstance(shape, geometry.Sphere) else 1.0
        geometry.AddCompliantHydroelasticProperties(fineness, modulus, properties)
    geometry.AddContactMaterial(
        dissipation=DISSIPATION,
        point_stiffness=stiffness,
        friction=CoulombFriction(mu, mu),
        properties=properties,
    )
    properties.AddProperty("material", "relaxation_time", 0.0)
    return properties
