"""Physics → quadratic programs: bodies, contacts, the stepper and its scenes.

They are loaded on first use: who is handed a QP needs no stepper.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from problems.qp import ContactQP as ContactQP
    from problems.qp import Solution as Solution
    from problems.qp import Status as Status
    from problems.scenes import Scene as Scene
    from problems.scenes import describe_scene as describe_scene
    from problems.scenes import scene as scene
    from problems.scenes import scene_names as scene_names
    from problems.simulation import simulate as simulate
    from problems.stepping.run import Run as Run

ROOMS = {
    "qp": ("ContactQP", "Solution", "Status"),
    "scenes": ("Scene", "describe_scene", "scene", "scene_names"),
    "simulation": ("simulate",),
    "stepping.run": ("Run",),
}
"""Module → what it has for others."""
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


def __getattr__(name: str) -> Any:
    for room, names in ROOMS.items():
        if name in names:
            return getattr(importlib.import_module(f"problems.{room}"), name)
    raise AttributeError(f"module 'problems' has no attribute {name!r}")
