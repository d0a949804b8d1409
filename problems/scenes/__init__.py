"""The scenes: the paper's four examples and whatever plug-ins add (entry points `glambda.scenes`).

A scene is made by a function of named parameters with defaults; all of them are recorded.  How
large they may be is declared by `at_most`.
"""

from problems.scenes.registry import describe_scene, scene, scene_names
from problems.scenes.scene import Scene, at_most

__all__ = ["Scene", "at_most", "describe_scene", "scene", "scene_names"]
