"""Other physics engines on this project's scenes: which there are, by name.

An engine is one line of `ENGINES`, for scenes in the plane, of `IN_SPACE`, or of both, and one file
with a class for each, derived from `harness.peers.base.Peer`.  One from elsewhere is named by its
`module:Class`.  Nothing is imported until it is asked for; an absent package is told with its
remedy.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from harness.machine.machine import problems_version, source_hash
from harness.peers.base import Peer
from harness.processes.introduction import solver_version
from problems.kernels.sources import sources
from problems.registry import load, unknown

OURS = "glambda"
ENGINES = {
    OURS: "harness.peers.ours:Glambda",
    "pymunk": "harness.peers.pymunk:Pymunk",
    "box2d": "harness.peers.box2d:Box2D2",
    "box2d3": "harness.peers.box2d3:Box2D3",
    "mujoco": "harness.peers.mujoco:MuJoCo",
    "dart": "harness.peers.dart:Dart",
    "drake": "harness.peers.drake:Drake",
    "cenic": "harness.peers.cenic:Cenic",
    "cundall": "harness.peers.cundall:Cundall",
}
"""Name → module:Class, for scenes in the plane, …"""
IN_SPACE = {
    OURS: "harness.peers.ours:GlambdaInSpace",
    "mujoco": "harness.peers.mujoco:MuJoCoInSpace",
    "dart": "harness.peers.dart:DartInSpace",
    "drake": "harness.peers.drake:DrakeInSpace",
    "bullet": "harness.peers.bullet:Bullet",
}
"""… and in space."""
NAMES = tuple(dict.fromkeys((*ENGINES, *IN_SPACE)))
REMEDY = "pip install 'glambda[peers]'"


@dataclass(frozen=True)
class EngineInfo:
    """One engine: its version and model where it is there, why not where it is absent."""

    name: str
    available: bool
    version: str = ""
    model: str = ""
    reason: str = ""


def engine_class(name: str, in_space: bool = False) -> type[Peer]:
    """Class of an engine for scenes in the plane, or in space.

    Raises ValueError for an unknown name and for one that does not take such scenes, and
    ImportError where its package is absent.
    """
    if ":" not in name and name not in NAMES:
        raise unknown("engine", name, {**ENGINES, **IN_SPACE})
    if not takes(name, in_space):
        where = "space" if in_space else "the plane"
        raise ValueError(f"engine {name!r} takes no scenes in {where}")
    found: type[Peer] = load(name if ":" in name else _table(in_space)[name])
    return found


def takes(name: str, in_space: bool) -> bool:
    """Whether an engine moves bodies in space, or in the plane."""
    if ":" not in name:
        return name in _table(in_space)
    foreign: type[Peer] = load(name)
    return foreign.in_space == in_space


def _table(in_space: bool) -> dict[str, str]:
    return IN_SPACE if in_space else ENGINES


def describe_engine(name: str) -> EngineInfo:
    """What `name` is, with its version; the reason and remedy where its package is absent.

    Raises ValueError for an unknown name; a package that is there but broken fails loudly.
    """
    try:
        cls = engine_class(name, in_space=not takes(name, in_space=False))
    except ModuleNotFoundError as error:
        return EngineInfo(name, False, reason=f"{error}; {REMEDY}")
    return EngineInfo(name, True, f"{cls.package} {metadata.version(cls.package)}", cls.model)


def engine_version(name: str, cls: type[Peer]) -> str:
    """Version of the package and of our source around it: results of another are not reused."""
    parts = [describe_engine(name).version, _source(cls)]
    if cls.package == "glambda":
        parts.append(problems_version())
    if name == OURS:
        parts.append(solver_version("glambda"))
    return "; ".join(parts)


def _source(cls: type[Peer]) -> str:
    files = {
        Path(str(sys.modules[each.__module__].__file__))
        for each in cls.__mro__[:-1]
        if each.__module__ != "abc"
    } | {Path(__file__).with_name(name) for name in ("observe.py", "in_space.py")}
    return f"source {source_hash(sources(files, ['harness']))}"
