"""Rigid bodies in space (§6): attitudes, M = M(q), contacts of balls, polyhedra and planes."""

from problems.space.scene import Pin, Plane, SpaceScene
from problems.space.solids import Solid, ball, block, polyhedron

__all__ = ["Pin", "Plane", "Solid", "SpaceScene", "ball", "block", "polyhedron"]
