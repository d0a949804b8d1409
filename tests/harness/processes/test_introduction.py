"""Plug-ins are imported elsewhere: what their import does is told, and befalls nobody here."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness import replay
from harness.processes import introduction, isolate
from harness.processes.introduction import about, available, described
from harness.recordings.recording import write_recording
from solvers import registry
from tests.fakes.crooked import CROOKED
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.hostile_imports import FATAL, SILENT, targets

pytestmark = pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork")
SHORT = 3.0
"""What importing one may take that hangs [s]; the others have what everybody has."""


@pytest.fixture(scope="module", autouse=True)
def known() -> Iterator[None]:
    introduction.forget()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_REGISTERED", targets() | {"right": CROOKED["right"]})
        yield
    introduction.forget()


def ours() -> dict[str, Any]:
    """What an import could change here."""
    mask = os.umask(0o22)
    os.umask(mask)
    return {
        "folder": os.getcwd(),
        "umask": mask,
        "signals": [signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD)],
        "timer": signal.getitimer(signal.ITIMER_REAL),
        "errors": np.geterr(),
        "denormals": float(np.float64(5e-324) * 1.0),
        "rounding": 0.1 + 0.2,
        "files": [os.fstat(number).st_dev for number in range(3)],
    }


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    before, folder = ours(), tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(introduction, "IMPORTING", SHORT)
        assert about("hangs").broken  # which is known from here on
    names = [*targets(), "right"]
    rows = replay(fake_recording(), names, arms=["cold"], repeats=1, results=folder)
    assert ours() == before
    for path in folder.rglob("*.parquet"):
        assert path.stat().st_mode & 0o600 == 0o600
    return rows


@pytest.mark.parametrize("name", FATAL)
def test_who_ends_its_process_has_rows_that_say_so(study: pd.DataFrame, name: str) -> None:
    rows = study[study["solver"] == name]
    assert (rows["verdict"] == "crashed").all() and len(rows) == 11
    assert rows["status_text"].str.startswith("cannot be imported: ").all()
    words = {
        "leaves": "left with exit code 0",
        "wants_to_leave": "left with exit code",
        "segfault": "SIGSEGV",
        "hangs": f"took more than {SHORT:g} s",
    }
    assert rows["status_text"].str.contains(words[name]).all()


@pytest.mark.parametrize("name", SILENT)
def test_what_others_do_befalls_themselves_at_most(study: pd.DataFrame, name: str) -> None:
    rows = study[study["solver"] == name]
    assert rows["verdict"].isin(["verified", "failed"]).all() and len(rows) == 11
    if name != "errors":  # its own arithmetic may raise
        assert (rows["verdict"] == "verified").all()


def test_the_others_lose_nothing_and_the_judge_is_ours(study: pd.DataFrame) -> None:
    assert (study.loc[study["solver"] == "right", "verdict"] == "verified").all()
    wrong = study[(study["solver"] == "wrong_judge") & (study["k"] > 0)]
    assert (wrong["verdict"] != "verified").all()


def test_the_list_says_why_one_is_absent(study: pd.DataFrame) -> None:
    there = available()
    assert "right" in there and not set(FATAL) & set(there) and set(SILENT) <= set(there)
    info = described("segfault")
    assert not info.available and info.reason == "cannot be imported: SIGSEGV"
    with pytest.raises(ValueError, match="'right' has no option 'speed'"):
        about("right", speed=3)
    assert about("right").arms[:3] == ("cold", "kept", "warm")


def test_a_study_with_a_broken_plug_in_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "fake.h5"
    write_recording(path, fake_recording())
    asked = [
        "replay",
        str(path),
        "--solvers",
        "segfault,right",
        "--arms",
        "cold",
        "--settings",
        "high",
    ]
    said = CliRunner().invoke(app, [*asked, "-o", str(tmp_path / "results")])
    assert said.exit_code == 1
    assert "segfault: cannot be imported: SIGSEGV" in said.stderr
    assert len(list((tmp_path / "results" / "solves").glob("*.parquet"))) == 2
