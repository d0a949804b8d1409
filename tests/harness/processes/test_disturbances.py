"""What befalls the machine is no crime of a solver: it is tried again, and told."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness import replay
from harness.processes import introduction, isolate
from harness.recordings.recording import write_recording
from harness.results.store import is_disturbed, read_results
from solvers import registry
from tests.fakes import disturbances
from tests.fakes.crooked import CROOKED
from tests.fakes.fake_recordings import fake_recording

pytestmark = [
    pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork"),
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc"),
]


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = {"DiesUnborn": "tests.fakes.disturbances:DiesUnborn"}
    monkeypatch.setattr(registry, "_REGISTERED", {**targets, **CROOKED})


def rows_of(name: str, folder: Path) -> pd.DataFrame:
    return replay(fake_recording(), [name], arms=["cold"], repeats=1, results=folder)


@pytest.mark.parametrize("event", disturbances.EVENTS)
def test_a_disturbed_pass_is_done_once_more(
    event: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolate, "Apart", disturbances.Once)
    monkeypatch.setattr(disturbances.Once, "event", event, raising=False)
    monkeypatch.setattr(disturbances.Once, "happened", False)
    passes = []
    take = isolate.take_pass
    monkeypatch.setattr(
        isolate, "take_pass", lambda *how, **more: passes.append(take(*how, **more)) or passes[-1]
    )
    rows = rows_of("right", tmp_path)
    assert disturbances.Once.happened
    while disturbances.STARTED:
        disturbances.STARTED.pop().wait()
    assert [one.is_final for one in passes] == [True, False, True]  # the first asks nobody
    assert (rows["verdict"] == "verified").all(), rows[["verdict", "status_text"]].to_string()


def test_who_dies_unborn_is_told_apart_and_tried_again(tmp_path: Path) -> None:
    first = rows_of("DiesUnborn", tmp_path)
    assert (first["verdict"] == "crashed").all()
    assert first["status_text"].str.startswith("disturbed: before its first QP: ").all()
    assert first["status_text"].str.contains("exit code 3").all()
    with pytest.MonkeyPatch.context() as patch:  # whatever it was has passed
        patch.setattr(registry, "_REGISTERED", {"DiesUnborn": CROOKED["right"]})
        version = first["versions"].iloc[0]
        known = introduction.about("DiesUnborn")._replace(version=version)
        patch.setattr(sys.modules["harness.study.replay"], "about", lambda name: known)
        again = rows_of("DiesUnborn", tmp_path)
    assert (again["verdict"] == "verified").all()


def test_a_disturbed_replay_ends_with_exit_code_1(tmp_path: Path) -> None:
    path = tmp_path / "fake.h5"
    write_recording(path, fake_recording())
    said = CliRunner().invoke(
        app, ["replay", str(path), "--solvers", "DiesUnborn", "-o", str(tmp_path / "results")]
    )
    assert said.exit_code == 1
    assert "DiesUnborn on fake: disturbed: before its first QP" in said.stderr
    assert "the same command tries them again" in said.stderr
    rows = read_results(tmp_path / "results")
    assert all(is_disturbed(row) for row in rows.to_dict("records"))
