"""A study that is written down: a `StudyPlan` as a TOML file.

    scenes = ["fig4", "tower,bodies=40,mu=0.5"]   # labels; or kinds of `glambda scenes`, or "all"
    solvers = ["glambda", "daqp", "osqp"]         # left out: every backend that is installed
    settings = ["paper", "1e-6"]
    arms = ["cold", "warm"]
    repeats = 5

Fields are those of `StudyPlan`; what is left out is as in the plan that it is read upon.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import fields, replace
from math import inf
from pathlib import Path
from typing import Any, get_type_hints

from harness.files.plain_files import Unreadable, open_plain
from harness.judging.facts import setting_names
from harness.passes.starts import check_arm
from harness.processes.introduction import about
from harness.study.study import StudyPlan
from problems import scene
from problems.registry import meant
from problems.scenes.labels import parse_label
from problems.scenes.registry import chosen_scenes

LONGEST = 100_000
"""Bytes that are read of a file."""
KINDS: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    tuple[str, ...]: (
        "a list of texts",
        lambda value: isinstance(value, list) and all(isinstance(each, str) for each in value),
    ),
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a whole number", lambda value: type(value) is int),
    float: ("a number", lambda value: type(value) in (int, float)),
    float | None: ("a number", lambda value: type(value) in (int, float)),
}
"""Type of a field → what its value must be, in words, and whether one is."""
POSITIVE = ("until", "repeats", "time_limit", "slow_pass")


def read_plan(path: Path, upon: StudyPlan) -> tuple[StudyPlan, bytes]:
    """The plan of a file, with what it leaves out from another one, and the file.

    Raises ValueError, naming file, field and remedy, for what is no plan, and OSError where there
    is no file.
    """
    try:
        with open_plain(path, LONGEST) as file:
            text = file.read()
        return replace(upon, **_checked(tomllib.loads(text.decode()))), text
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: is no TOML: {error}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is no text in UTF-8; write it as TOML") from None
    except ImportError as error:
        raise ValueError(
            f"{path}: solvers: {error}; install its package, or leave it out"
        ) from None
    except (Unreadable, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    """Fields of a `StudyPlan`, whose values can be what they are."""
    kinds = get_type_hints(StudyPlan)
    names = [field.name for field in fields(StudyPlan)]
    for name, value in given.items():
        if name not in names:
            raise ValueError(
                f"{name} is no field of a study; {meant(name, names)}it has: {', '.join(names)}"
            )
        words, fits = KINDS[kinds[name]]
        if not fits(value):
            raise ValueError(f"{name} = {value!r}; it must be {words}")
        if name in POSITIVE and not 0 < value < inf:
            raise ValueError(f"{name} = {value!r}; it must be above 0, and finite")
    made = dict(given)
    for name, check in CHECKS.items():
        if name in made:
            try:
                made[name] = tuple(check(made[name]))
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
    return made


def _scenes(labels: list[str]) -> list[str]:
    """Labels, kinds written out.  Raises ValueError for one that cannot be made."""
    chosen = [label for text in labels for label in chosen_scenes(text)]
    for label in chosen:
        name, parameters = parse_label(label)
        scene(name, **parameters)
    return chosen


def _solvers(names: list[str]) -> list[str]:
    """The same.  Raises ValueError for one that there is not."""
    for name in names:
        about(name)
    return names


def _arms(arms: list[str]) -> list[str]:
    """The same.  Raises ValueError for one that there is not."""
    for arm in arms:
        check_arm(arm)
    return arms


CHECKS: dict[str, Callable[[list[str]], list[str]]] = {
    "scenes": _scenes,
    "solvers": _solvers,
    "settings": setting_names,
    "arms": _arms,
}
"""What lists of names are, written out, if they are right."""
