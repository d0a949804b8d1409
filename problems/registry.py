"""Scenes, solvers and engines by name: where each is found, "module:attribute".

Nothing is imported until it is asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
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
    listed = ", ".join(targets)
    return ValueError(f"unknown {kind} {name!r}; {meant(name, targets)}there are: {listed}")


def meant(name: str, names: Iterable[str]) -> str:
    """ "did you mean …? " with the name that is nearest, nothing where none is near."""
    alike = {each.lower(): each for each in names}
    near = get_close_matches(name.lower(), alike, n=1)
    return f"did you mean {alike[near[0]]!r}? " if near else ""


def load(target: str) -> Any:
    """What is found at "module:attribute".  Raises ImportError where a package is absent."""
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
