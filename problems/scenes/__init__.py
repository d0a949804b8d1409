"""The scenes: the paper's four examples and whatever plug-ins add (entry points `glambda.scenes`).

A scene is made by a function of named parameters with defaults; all of them are recorded.
"""

from problems.scenes.registry import describe_scene, scene, scene_names
from problems.scenes.scene import Scene

__all__ = ["Scene", "describe_scene", "scene", "scene_names"]
