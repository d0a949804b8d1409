"""Scenes by name: the built-in ones and entry points of the group `glambda.scenes`."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from problems.networks.network import Network
from problems.registry import load, meant, unknown, with_plug_ins
from problems.scenes.scene import Scene
from problems.space.scene import SpaceScene

PAPER = {
    "fig2": "problems.scenes.fig2:fig2",
    "fig3": "problems.scenes.fig3:fig3",
    "fig4": "problems.scenes.fig4:fig4",
    "fig5": "problems.scenes.fig5:fig5",
}
"""The paper's examples."""
FAMILIES = {
    "tower": "problems.scenes.families:tower",
    "wall": "problems.scenes.families:wall",
    "pyramid": "problems.scenes.families:pyramid",
    "heap": "problems.scenes.families:heap",
}
"""Scenes of any number of bodies."""
FALLING = {"rain": "problems.scenes.falling:rain"}
"""Scenes of any number of bodies that do not touch at the start."""
STUDIES = {"painleve": "problems.scenes.painleve:painleve"}
"""Scenes of a question of their own."""
WHEELS = {
    "rolling": "problems.scenes.wheels:rolling",
    "bowling": "problems.scenes.wheels:bowling",
    "discs": "problems.scenes.wheels:discs",
    "wheel_edge": "problems.scenes.wheels:wheel_edge",
    "rocking": "problems.scenes.ellipses:rocking",
    "pebbles": "problems.scenes.ellipses:pebbles",
}
"""Scenes of discs and ellipses."""
LINKAGES = {
    "slider_crank": "problems.scenes.linkages:slider_crank",
    "double_pendulum": "problems.scenes.linkages:double_pendulum",
    "skate": "problems.scenes.linkages:skate",
    "bungee": "problems.scenes.linkages:bungee",
    "motor": "problems.scenes.linkages:motor",
    "bounce": "problems.scenes.linkages:bounce",
    "arm": "problems.scenes.machines:arm",
    "vehicle": "problems.scenes.machines:vehicle",
    "human": "problems.scenes.machines:human",
    "frame": "problems.scenes.machines:frame",
}
"""Scenes with joints, and with forces that switch."""
NETWORKS = {
    "half_wave": "problems.networks.half_wave:half_wave",
    "bridge": "problems.networks.bridge:bridge",
    "boost": "problems.networks.boost:boost",
}
"""Electrical networks with diodes: no bodies, the same QP (§6.2)."""
SPACE = {
    "free_top": "problems.space.scenes.top:free_top",
    "heavy_top": "problems.space.scenes.top:heavy_top",
    "slope": "problems.space.scenes.sliding:slope",
    "skid": "problems.space.scenes.sliding:skid",
    "bowl": "problems.space.scenes.sliding:bowl",
    "space_tower": "problems.space.scenes.stacks:space_tower",
    "space_pyramid": "problems.space.scenes.stacks:space_pyramid",
    "stones": "problems.space.scenes.stacks:stones",
}
"""Bodies with six degrees of freedom (§6)."""
CASES = {
    "ramp": "problems.scenes.cases.ramp:ramp",
    "braking": "problems.scenes.cases.braking:braking",
    "mass_ratio": "problems.scenes.cases.mass_ratio:mass_ratio",
    "arch": "problems.scenes.cases.arch:arch",
    "cards": "problems.scenes.cases.cards:cards",
    "dominoes": "problems.scenes.cases.dominoes:dominoes",
    "sunk": "problems.scenes.cases.sunk:sunk",
}
"""Scenes whose answer is known."""
BY_KIND = {
    "paper": PAPER,
    "families": FAMILIES,
    "falling": FALLING,
    "studies": STUDIES,
    "wheels": WHEELS,
    "linkages": LINKAGES,
    "networks": NETWORKS,
    "space": SPACE,
    "cases": CASES,
}
BUILT_IN = {name: target for scenes in BY_KIND.values() for name, target in scenes.items()}


@cache
def _targets() -> dict[str, str]:
    return with_plug_ins("scene", BUILT_IN)


def scene_names() -> list[str]:
    """Names of all scenes."""
    return list(_targets())


def scene_kinds() -> dict[str, list[str]]:
    """Names of all scenes by kind; those of others are of the kind "plug-ins"."""
    kinds = {kind: list(scenes) for kind, scenes in BY_KIND.items()}
    others = [name for name in scene_names() if name not in BUILT_IN]
    return kinds | ({"plug-ins": others} if others else {})


def chosen_scenes(text: str) -> tuple[str, ...]:
    """Labels with spaces between; a kind stands for its scenes, "all" for those of every kind."""
    kinds = scene_kinds()
    kinds["all"] = [name for scenes in kinds.values() for name in scenes]
    return tuple(label for word in text.split() for label in kinds.get(word, [word]))


def _maker(name: str) -> Callable[..., Any]:
    if name not in _targets():
        raise unknown("scene", name, _targets())
    maker: Callable[..., Any] = load(_targets()[name])
    return maker


def describe_scene(name: str) -> tuple[str, dict[str, Any]]:
    """First line of the scene's docstring, and its parameters with their defaults."""
    maker = _maker(name)
    defaults = {p.name: p.default for p in inspect.signature(maker).parameters.values()}
    return (inspect.getdoc(maker) or "no description").splitlines()[0], defaults


def scene(name: str, **parameters: Any) -> Any:
    """Make the scene called `name`, a `Scene`, a `Network` or a `SpaceScene`.

    Parameters left out have their defaults, which are the paper's in the paper's scenes.

    Raises ValueError for an unknown scene or parameter, or a value of the wrong kind or beyond what
    the scene declares with `at_most`.
    """
    _, defaults = describe_scene(name)
    limits: Mapping[str, float] = getattr(_maker(name), "at_most", {})
    for key, value in parameters.items():
        if key not in defaults:
            raise ValueError(
                f"scene {name!r} has no parameter {key!r}; {meant(key, defaults)}it has: "
                f"{', '.join(defaults)}"
            )
        parameters[key] = _like(value, defaults[key], f"scene {name!r}: {key}")
        if parameters[key] > limits.get(key, math.inf):
            raise ValueError(f"scene {name!r}: {key} = {value}; it may be {limits[key]} at most")
    made = _maker(name)(**parameters)
    if not isinstance(made, Scene | Network | SpaceScene):
        raise ValueError(f"scene {name!r} made a {type(made).__name__}, not a problems.Scene")
    changed = {k: v for k, v in parameters.items() if v != defaults[k]}
    label = ",".join([name, *(f"{k}={changed[k]}" for k in defaults if k in changed)])
    return replace(made, name=name, label=label, parameters={**defaults, **parameters})


def _like(value: Any, default: Any, what: str) -> Any:
    """`value` as the type of `default`."""
    kind = type(default)
    try:
        made = value if isinstance(value, kind) else kind(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{what} = {value!r}; it must be of type {kind.__name__}") from None
    if kind is bool and value not in (0, 1):
        raise ValueError(f"{what} = {value!r}; it must be true or false")
    if isinstance(made, float) and not math.isfinite(made):
        raise ValueError(f"{what} = {value!r}; it must be finite")
    if kind is int and float(value) != made:
        raise ValueError(f"{what} = {value!r}; it must be a whole number")
    return made
