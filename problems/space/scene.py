"""A scene in space: bodies with six degrees of freedom, and everything that acts on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from problems.qp import Vector
from problems.short import Short
from problems.space.solids import Solid, Triple

FACES = (0, 4, 8, 16)
"""What `SpaceScene.faces` may be."""


@dataclass(frozen=True)
class Plane:
    """A half space that does not move, behind a point; normal : out of it, made a unit vector."""

    point: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not (np.isfinite(length) and length > 0):
            raise ValueError(f"Plane: normal = {self.normal}; it must have a length")
        x, y, z = (float(part / length) for part in self.normal)
        object.__setattr__(self, "normal", (x, y, z))


@dataclass(frozen=True)
class Pin:
    """A point of a body that is held where it is at t = 0: a bilateral constraint, no bounds on λ.

    body : its index;  point : in axes of the body [m]
    """

    body: int
    point: Triple


@dataclass(frozen=True, eq=False, repr=False)
class SpaceScene(Short):
    """Bodies in space, their initial state, and everything that acts on them.

    solids : the bodies, numbered from 1 in everything that people read
    centres : (n, 3) [m];  attitudes : (n, 4) unit quaternions
    v0 : (n, 6) velocity [m/s] and angular velocity [rad/s], in axes of the world
    planes : half spaces that do not move;  pins : points that are held
    mu : friction coefficient;  mu_I : of impulses, of contacts with mu > 0
    faces : how a friction force is bounded.  0: by Coulomb's disc (6.1); 4, 8 or 16: by a regular
        polygon in that disc, see `problems.space.friction`
    gravity : [m/s²], along −z
    h_max : longest step [s];  eps : ε of (3.5);  end_time : [s]
    name, parameters : the function that made it and all its named parameters

    Raises ValueError, naming the field, for wrong shapes, NaN or numbers out of range.
    """

    solids: tuple[Solid, ...]
    centres: Vector
    attitudes: Vector
    v0: Vector
    planes: tuple[Plane, ...] = (Plane(),)
    pins: tuple[Pin, ...] = ()
    mu: float = 0.0
    mu_I: float = 0.0
    faces: int = 0
    gravity: float = 9.81
    h_max: float = 0.02
    eps: float = 1e-3
    end_time: float = 1.0
    name: str = "space"
    label: str = ""
    parameters: Mapping[str, float | int | bool | str] = field(default_factory=dict)

    bodies = ()

    def __post_init__(self) -> None:
        n = len(self.solids)
        if n == 0:
            raise ValueError("solids is empty; a scene needs at least one body")
        for name, width in (("centres", 3), ("attitudes", 4), ("v0", 6)):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (n, width) or not np.isfinite(value).all():
                raise ValueError(f"{name} needs {(n, width)} finite numbers; got {value.shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if np.abs(np.linalg.norm(self.attitudes, axis=1) - 1).max() > 1e-9:
            raise ValueError("attitudes holds a quaternion that is not of unit length")
        for name in ("mu", "mu_I", "gravity", "eps", "end_time", "h_max"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} = {value!r}; it must be a finite number, not negative")
        if min(self.eps, self.h_max, self.end_time) == 0:
            raise ValueError("eps, h_max and end_time must be positive")
        if self.faces not in FACES:
            raise ValueError(f"faces = {self.faces}; choose one of {FACES}")
        if any(not 0 <= pin.body < n for pin in self.pins):
            raise ValueError(f"pins holds a body that there is not; there are {n}, from 0")
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def _title(self) -> str:
        return self.label

    def _sizes(self) -> dict[str, Any]:
        return {"bodies": len(self.solids), "mu": f"{self.mu:g}", "end": f"{self.end_time:g} s"}

    def mu_between(self, a: int, b: int) -> float:
        """Friction coefficient of two bodies."""
        return self.mu
