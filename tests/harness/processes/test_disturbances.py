"""What befalls the machine is no crime of a solver: it is tried again, and told."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness import replay
from harness.processes import isolate
from harness.processes.sheet import Layout, Sheet
from harness.recordings.recording import write_recording
from harness.results.store import is_disturbed, read_results
from solvers import registry
from tests.fakes import disturbances
from tests.fakes.fake_recordings import fake_recording

pytestmark = [
    pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork"),
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc"),
]


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    targets = {name: f"tests.fakes.disturbances:{name}" for name in disturbances.NAMES}
    monkeypatch.setattr(registry, "_REGISTERED", targets)
    yield
    for name in disturbances.NAMES:
        disturbances.marker(name, os.getpid()).unlink(missing_ok=True)


def rows_of(name: str, folder: Path) -> pd.DataFrame:
    return replay(fake_recording(), [name], arms=["cold"], repeats=1, results=folder)


@pytest.mark.parametrize("name", ["ServerIsKilled", "IsKilled", "AllStandStill"])
def test_a_disturbed_pass_is_done_once_more(name: str, tmp_path: Path) -> None:
    rows = rows_of(name, tmp_path)
    assert disturbances.marker(name, os.getpid()).exists(), "nothing has happened"
    assert (rows["verdict"] == "verified").all(), rows[["verdict", "status_text"]].to_string()


def test_who_dies_unborn_is_told_apart_and_tried_again(tmp_path: Path) -> None:
    first = rows_of("DiesUnborn", tmp_path)
    assert (first["verdict"] == "crashed").all()
    assert first["status_text"].str.startswith("disturbed: before its first QP: ").all()
    assert first["status_text"].str.contains("exit code 3").all()
    with pytest.MonkeyPatch.context() as patch:  # whatever it was has passed
        patch.setattr(registry, "_REGISTERED", {"DiesUnborn": "tests.fakes.crooked:Right"})
        version = first["versions"].iloc[0]
        patch.setattr(sys.modules["harness.study.replay"], "solver_version", lambda name: version)
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


class FullDisk:
    """A file without a buffer on a disk with `room` bytes: it takes a part, then refuses."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, content: Any) -> int:
        if self._room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = min(self._room, len(content))
        self._room -= taken
        return int(self._file.write(bytes(content[:taken])))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.mark.parametrize("room", [0, 100, 4096])
def test_a_sheet_that_does_not_fit_is_refused(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*how: Any, **more: Any) -> FullDisk:
        return FullDisk(open(*how, **more), room)

    monkeypatch.setattr("harness.processes.sheet.open", opened, raising=False)
    path = tmp_path / "sheet"
    with pytest.raises(OSError, match="No space left on device; make room there, or set TMPDIR"):
        Sheet(path, Layout([100] * 10))
    assert not path.exists()
