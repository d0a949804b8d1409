"""Other physics engines on this project's scenes: which there are, by name.

An engine is one line of `ENGINES` and one file with a class derived from `harness.peers.base.Peer`.
One from elsewhere is named by its `module:Class`.  Nothing is imported until it is asked for; an
absent package is told with its remedy.
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
"""Name → module:Class."""
REMEDY = "pip install 'glambda[peers]'"


@dataclass(frozen=True)
class EngineInfo:
    """One engine: its version and model where it is there, why not where it is absent."""

    name: str
    available: bool
    version: str = ""
    model: str = ""
    reason: str = ""


def engine_class(name: str) -> type[Peer]:
    """Class of an engine.

    Raises ValueError for an unknown name and ImportError where its package is absent.
    """
    target = ENGINES.get(name, name)
    if ":" not in target:
        raise unknown("engine", name, ENGINES)
    found: type[Peer] = load(target)
    return found


def describe_engine(name: str) -> EngineInfo:
    """What `name` is, with its version; the reason and remedy where its package is absent.

    Raises ValueError for an unknown name; a package that is there but broken fails loudly.
    """
    try:
        cls = engine_class(name)
    except ModuleNotFoundError as error:
        return EngineInfo(name, False, reason=f"{error}; {REMEDY}")
    return EngineInfo(name, True, f"{cls.package} {metadata.version(cls.package)}", cls.model)


def engine_version(name: str) -> str:
    """Version of the package and of our source around it: results of another are not reused."""
    parts = [describe_engine(name).version, _source(name)]
    if engine_class(name).package == "glambda":
        parts.append(problems_version())
    if name == OURS:
        parts.append(solver_version("glambda"))
    return "; ".join(parts)


def _source(name: str) -> str:
    files = {
        Path(str(sys.modules[cls.__module__].__file__))
        for cls in engine_class(name).__mro__[:-1]
        if cls.__module__ != "abc"
    } | {Path(__file__).with_name("observe.py")}
    return f"source {source_hash(sources(files, ['harness']))}"
