"""Rigid bodies of the plane, and the mass matrix M = DᵀD of a system of them (2.1), (2.2).

A body has the coordinates (x, y, φ): the centre of gravity [m] and the angle [rad].  Its shape is
one convex polygon, or several when it is not convex, in coordinates about its centre of gravity; or
a disc or an ellipse about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from problems.bodies.checks import check_number
from problems.bodies.shapes import (
    box_corners,
    convex_polygon,
    polygon_area,
    polygon_centroid,
    polygon_second_moment,
    semi_axes,
)
from problems.qp import Vector

GROUND = -1
"""Body index of whatever does not move."""


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body.

    polygons : convex parts, each (c, 2) [m], counter-clockwise about the centre of gravity; a disc
        is one part of one corner, (radius, 0), an ellipse one of two, (a, 0) and (0, b), a ≥ b
    mass : [kg] (per metre of depth)
    inertia : moment of inertia about the centre of gravity [kg·m²]

    Raises ValueError, naming the field, for a mass or inertia that is not positive and finite, and
    without a polygon.
    """

    polygons: tuple[Vector, ...]
    mass: float
    inertia: float

    def __post_init__(self) -> None:
        check_number("Body", mass=self.mass, inertia=self.inertia)
        if not (self.mass > 0 and self.inertia > 0):
            kept = f"mass = {self.mass:g}, inertia = {self.inertia:g}"
            raise ValueError(f"Body: {kept}; both must be positive")
        if not self.polygons:
            raise ValueError("Body: polygons is empty; a body needs at least one convex part")
        if any(len(part) < 3 for part in self.polygons) and not _is_one_round(self.polygons):
            raise ValueError(
                "Body: polygons has a part of less than three corners; that is a disc, which is a "
                "body of its own, with the corner (radius, 0), or an ellipse, with the corners "
                "(a, 0) and (0, b), a at least b"
            )

    @property
    def semi_axes(self) -> tuple[float, float]:
        """a ≥ b of a disc or an ellipse, along the x- and y-axis of the body [m]; 0 of others."""
        return semi_axes(self.polygons[0]) if len(self.polygons[0]) < 3 else (0.0, 0.0)

    @property
    def is_round(self) -> bool:
        """Whether it is a disc or an ellipse."""
        return self.semi_axes[1] > 0

    @property
    def radius(self) -> float:
        """Distance of the farthest corner from the centre of gravity [m]."""
        return max(float(np.linalg.norm(part, axis=1).max()) for part in self.polygons)


def _is_one_round(polygons: Sequence[Vector]) -> bool:
    """Whether these are the one part of a disc or an ellipse."""
    part = np.asarray(polygons[0], dtype=np.float64)
    if len(polygons) > 1 or part.shape not in ((1, 2), (2, 2)):
        return False
    a, b = semi_axes(part)
    return np.array_equal(part, np.diag([a, b])[: len(part)]) and bool(0 < b <= a < np.inf)


def polygon_body(parts: Any, density: float = 1.0) -> Body:
    """Body of uniform `density` [kg/m²] from one convex polygon, or several that do not overlap.

    parts : corners (c, 2) of a convex polygon, or a sequence of such arrays.  They are shifted so
        that the centre of gravity becomes the origin.

    Raises ValueError for no polygon, one that is not convex or a density that is not positive.
    """
    if not (np.isfinite(density) and density > 0):
        raise ValueError(f"density = {density:g}; it must be positive")
    if not len(parts):
        raise ValueError("a body needs at least one convex part")
    single = not isinstance(parts, (list, tuple)) or np.ndim(parts[0]) == 1
    polygons = [convex_polygon(part) for part in ([parts] if single else parts)]
    areas = np.array([polygon_area(part) for part in polygons])
    centroids = np.array([polygon_centroid(part) for part in polygons])
    centre = areas @ centroids / areas.sum()
    polygons = [part - centre for part in polygons]
    for part in polygons:
        part.setflags(write=False)
    inertia = density * sum(polygon_second_moment(part) for part in polygons)
    return Body(tuple(polygons), density * float(areas.sum()), float(inertia))


def box(width: float, height: float, density: float = 1.0) -> Body:
    """Upright box, `width` × `height` [m].

    Raises ValueError for sides or a density that are not positive.
    """
    if not (0 < width < np.inf and 0 < height < np.inf):
        raise ValueError(f"a box needs positive sides; got {width:g} × {height:g}")
    return polygon_body(box_corners(width, height), density)


def disc(radius: float, density: float = 1.0) -> Body:
    """Disc of `radius` [m] and uniform `density` [kg/m²]: mass ρπr², moment of inertia ½mr².

    Raises ValueError for a radius or density that is not positive.
    """
    if not (0 < radius < np.inf and 0 < density < np.inf):
        raise ValueError(f"radius = {radius:g}, density = {density:g}; both must be positive")
    rim = np.array([(radius, 0.0)])
    rim.setflags(write=False)
    mass = float(density * np.pi * radius * radius)
    return Body((rim,), mass, 0.5 * mass * radius * radius)


def ellipse(a: float, b: float, density: float = 1.0) -> Body:
    """Ellipse with the semi-axes a ≥ b [m] along the x- and y-axis of the body.

    density : uniform [kg/m²]: mass ρπab, moment of inertia m(a² + b²)/4

    Raises ValueError for semi-axes or a density that are not positive, and for a less than b.
    """
    if not (0 < b <= a < np.inf and 0 < density < np.inf):
        raise ValueError(
            f"a = {a:g}, b = {b:g}, density = {density:g}; they must be positive, and a at least b"
        )
    rim = np.diag([float(a), float(b)])
    rim.setflags(write=False)
    mass = float(density * np.pi * a * b)
    return Body((rim,), mass, 0.25 * mass * (a * a + b * b))


def mass_diagonal(bodies: Sequence[Body]) -> Vector:
    """Diagonal of M, (3n,): m, m, I of each body."""
    return np.array([value for body in bodies for value in (body.mass, body.mass, body.inertia)])
