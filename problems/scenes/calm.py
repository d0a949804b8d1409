"""Families of scenes as solvers are compared on them: slow, and short.

By default a tower, wall, pyramid or heap collapses.  Here its bodies creep for a fraction of a
second, so that A varies a little from one step to the next, a sequence of QPs is worth warm starts,
and sizes from five bodies to thousands pose QPs of one kind.
"""

from __future__ import annotations

from typing import Any

from problems.scenes.registry import scene
from problems.scenes.scene import Scene

CALM: dict[str, dict[str, float]] = {
    "tower": {"speed": 0.01, "end_time": 0.3},
    "wall": {"speed": 0.01, "end_time": 0.3},
    "pyramid": {"speed": 0.01, "end_time": 0.3},
    "heap": {"speed": 0.01, "room": 0.0, "end_time": 0.2},
}
"""Family → what its parameters are, where nothing else is said."""


def calm_scene(name: str, **parameters: Any) -> Scene:
    """`scene(name, **parameters)`; one of the families is slow and short unless they say otherwise.

    Raises ValueError as `scene` does.
    """
    made: Scene = scene(name, **{**CALM.get(name, {}), **parameters})
    return made
