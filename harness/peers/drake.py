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

from harness.peers.base import Settings, Stepped, centre_and_size, ground_boxes, one_friction
from problems import Scene
from problems.qp import Vector

logging.getLogger("drake").setLevel(logging.ERROR)

HARDEST = 1e10
"""Stiffness of a point [N/m]."""
DISSIPATION = 10.0
"""Of Hunt and Crossley [s/m]: as good as inelastic."""


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
        self, scene: Scene, h: float, scheme: str = "sap", corner: float = 0.0,
        stiffness: float | None = HARDEST, modulus: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(h)
        self.corner = corner
        self.properties = contact_properties(one_friction(scene), stiffness, modulus)
        model = "hydroelastic" if modulus else "point"
        config = MultibodyPlantConfig(
            time_step=h, contact_model=model, discrete_contact_approximation=scheme
        )
        builder = DiagramBuilder()
        self.plant, graph = AddMultibodyPlant(config, builder)
        self.plant.mutable_gravity_field().set_gravity_vector((0.0, -scene.gravity, 0.0))
        self.boxes, self.corners = geometry.GeometrySet(), geometry.GeometrySet()
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
        if corner:
            apart = geometry.CollisionFilterDeclaration().ExcludeWithin(self.corners)
            graph.collision_filter_manager().Apply(apart.ExcludeWithin(self.boxes))
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())
        self.context = self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
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
        name = f"{self.plant.num_collision_geometries()}"
        return self.plant.RegisterCollisionGeometry(body, pose, shape, name, self.properties)

    def step(self) -> None:
        self.advance((self.steps + 1) * self.h)

    def advance(self, t: float) -> None:
        self.steps = round(t / self.h)
        # Drake updates at 0, h, 2h, …; half a step keeps clear of rounding
        self.simulator.AdvanceTo((self.steps - 0.5) * self.h)

    def state(self) -> tuple[Vector, Vector]:
        q = self.plant.GetPositions(self.context).reshape(-1, 3)
        return q.copy(), self.plant.GetVelocities(self.context).reshape(-1, 3).copy()


def contact_properties(mu: float, stiffness: float | None, modulus: float) -> Any:
    """Of every geometry; the friction of a pair is the harmonic mean."""
    properties = geometry.ProximityProperties()
    if modulus:
        geometry.AddCompliantHydroelasticProperties(1.0, modulus, properties)
    geometry.AddContactMaterial(
        dissipation=DISSIPATION,
        point_stiffness=stiffness,
        friction=CoulombFriction(mu, mu),
        properties=properties,
    )
    properties.AddProperty("material", "relaxation_time", 0.0)
    return properties
