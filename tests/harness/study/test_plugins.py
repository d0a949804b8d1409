"""A solver and a scene of somebody else's, named by the entry points of his package."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import metadata
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from problems import Scene, scene
from problems.bodies.bodies import box
from problems.scenes import registry as scenes
from solvers import make_solver
from solvers import registry as solvers
from solvers.active_set.lotstedt import Lotstedt

SOLVERS, SCENES = "glambda.solvers", "glambda.scenes"
NO_SOLVER = "not a class"


def lone_box(height: float = 1.0) -> Scene:
    """A box of our own."""
    return Scene((box(1.0, height),), np.array([[0.0, height / 2, 0.0]]), np.zeros((1, 3)))


def no_scene() -> int:
    return 3


@pytest.fixture
def declared(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, dict[str, str]]]:
    """{group: {name: target}} of what a package declares; to be filled before anything is asked."""
    given: dict[str, dict[str, str]] = {SOLVERS: {}, SCENES: {}}

    def entry_points(group: str) -> list[metadata.EntryPoint]:
        return [metadata.EntryPoint(name, at, group) for name, at in given[group].items()]

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    for registry in (solvers, scenes):
        registry._targets.cache_clear()
    yield given
    monkeypatch.undo()
    for registry in (solvers, scenes):
        registry._targets.cache_clear()


def test_plug_ins_are_listed_and_made(declared: dict[str, dict[str, str]]) -> None:
    declared[SOLVERS]["mine"] = "solvers.active_set.lotstedt:Lotstedt"
    declared[SCENES]["lone"] = "tests.harness.study.test_plugins:lone_box"
    assert "mine" in CliRunner().invoke(app, ["solvers"]).stdout
    listed = CliRunner().invoke(app, ["scenes"]).stdout
    assert "lone" in listed and "A box of our own." in listed
    assert isinstance(make_solver("mine[exact_qr]"), Lotstedt)
    made = scene("lone", height=2)
    assert made.label == "lone,height=2.0" and made.q0[0, 1] == 1.0


@pytest.mark.parametrize(
    ("group", "name", "target", "ask", "words"),
    [
        (SOLVERS, "daqp", "a:B", lambda: make_solver("daqp"), "two solvers are called 'daqp'"),
        (SCENES, "fig2", "a:b", lambda: scene("fig2"), "two scenes are called 'fig2'"),
        (
            *(SCENES, "odd", "tests.harness.study.test_plugins:no_scene", lambda: scene("odd")),
            "'odd' made a int, not a problems.Scene",
        ),
        (
            *(
                SOLVERS,
                "odd",
                "tests.harness.study.test_plugins:NO_SOLVER",
                lambda: make_solver("odd"),
            ),
            "is not a class derived from solvers.base.Solver",
        ),
    ],
    ids=["solver of another's name", "scene of another's name", "no scene", "no solver"],
)
def test_bad_plug_ins_are_told(
    declared: dict[str, dict[str, str]], group: str, name: str, target: str, ask: Any, words: str
) -> None:
    declared[group][name] = target
    with pytest.raises((ValueError, ImportError), match=words):
        ask()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("lotstedt[exact_qr", {}, "lacks its closing bracket"),
        ("scipy_bvls[fast]", {}, "'scipy_bvls' has no variants"),
        ("daqp", {"speed": 3}, "'daqp' has no option 'speed'; its options are"),
    ],
)
def test_bad_names_and_options_are_told(name: str, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make_solver(name, **options)
