"""Scenes, solvers and engines by name: where each is found, "module:attribute".

Nothing is imported until it is asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from importlib import metadata
from typing import Any


def with_plug_ins(kind: str, built_in: Mapping[str, str]) -> dict[str, str]:
    """{name: target} of the built-in ones and of the entry points of the group `glambda.{kind}s`.

    Raises ValueError where a name is taken.
    """
    targets = dict(built_in)
    for entry in sorted(metadata.entry_points(group=f"glambda.{kind}s"), key=lambda e: e.name):
        if entry.name in targets:
            raise ValueError(f"two {kind}s are called {entry.name!r}; rename the plug-in's")
        targets[entry.name] = entry.value
    return targets


def unknown(kind: str, name: str, targets: Mapping[str, str]) -> ValueError:
    """The error of a name that there is not."""
    return ValueError(f"unknown {kind} {name!r}; there are: {', '.join(targets)}")


def load(target: str) -> Any:
    """What is found at "module:attribute".  Raises ImportError where a package is absent."""
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
