"""Physics → quadratic programs: bodies, contacts, the stepper and its scenes."""

from problems.qp import ContactQP, Solution, Status
from problems.scenes import Scene, describe_scene, scene, scene_names
from problems.simulation import simulate
from problems.stepping.run import Run

__all__ = [
    "ContactQP",
    "Run",
    "Scene",
    "Solution",
    "Status",
    "describe_scene",
    "scene",
    "scene_names",
    "simulate",
]
