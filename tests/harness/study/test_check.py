"""Is a plug-in or a file right? What is wrong is found, and what is right is not blamed."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.recordings.recording import write_recording
from harness.study import check
from harness.study.check import check_recording, check_scene, check_solver, odd_qps
from harness.study.record import record
from problems import scene as make_scene
from solvers import registry
from tests.endurance.forged_recordings import forge
from tests.fakes.crooked import CROOKED
from tests.fakes.runs import one_box


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Crooked solvers beside the real ones, and one short motion."""
    monkeypatch.setattr(registry, "_REGISTERED", dict(CROOKED))
    monkeypatch.setattr(check, "SCENES", (("tower,bodies=2", 0.05),))


def wrong(findings: object) -> dict[str, str]:
    return {f.question: f.words for f in findings if not f.right}  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["glambda", "quadprog"])
def test_sound_solvers_are_not_blamed(name: str) -> None:
    found = list(check_solver(name))
    assert wrong(found) == {}
    assert len(found) >= 3 + len(odd_qps())


def test_a_solver_that_lies_is_found() -> None:
    found = wrong(check_solver("liar"))
    assert "claimed_wrong" in found["solves tower,bodies=2, cold"]
    assert "claimed_wrong" in found["solves redundant contacts"]
    assert "solves a QP without columns" not in found


def test_a_solver_that_returns_nothing_or_leaves_is_found() -> None:
    assert "failed" in wrong(check_solver("empty"))["solves free rows"]
    assert "failed" in wrong(check_solver("silent"))["solves two bounds"]


def test_odd_qps_are_odd() -> None:
    odd = odd_qps()
    assert odd["a QP without columns"].k == 0
    redundant = odd["redundant contacts"].dense_A
    assert np.linalg.matrix_rank(redundant) < redundant.shape[1]


def test_sound_scenes_are_not_blamed() -> None:
    assert wrong(check_scene("tower,bodies=2", until=0.05)) == {}


def test_a_scene_that_is_not_made_alike_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    heights = iter((0.5, 0.6))
    monkeypatch.setattr(check, "make_scene", lambda name: one_box(y=next(heights)))
    assert "seed" in wrong(check_scene("fig3", until=0.01))["is made alike twice"]


def test_recordings(tmp_path: Path) -> None:
    path = tmp_path / "fake.h5"
    write_recording(path, record(make_scene("tower", bodies=2), until=0.05))
    assert wrong(check_recording(path)) == {}

    def other_references(file: h5py.File) -> None:
        file["references/Ax"][...] = 2.0 * file["references/Ax"][()] + 1.0

    forge(path, other_references)
    assert "are not what the oracle finds" in wrong(check_recording(path))["its references hold"]
    path.write_bytes(path.read_bytes()[:-1])
    assert "seal" in wrong(check_recording(path))["can be read"]


def test_the_command(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["check", "scene", "tower,bodies=2", "--until", "0.05"])
    assert run.exit_code == 0 and "ok     is made alike twice: yes" in run.output
    path = tmp_path / "foreign.h5"
    run = CliRunner().invoke(app, ["check", "recording", str(path)])
    assert run.exit_code == 2 and "foreign.h5" in run.output
    path.write_text("not a recording")
    run = CliRunner().invoke(app, ["check", "recording", str(path)])
    assert run.exit_code == 1 and "WRONG  can be read" in run.output
    run = CliRunner().invoke(app, ["check", "solver", "nobody"])
    assert run.exit_code == 2 and "unknown solver 'nobody'" in run.output
