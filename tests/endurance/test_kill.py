"""Studies that are killed go on to the same end; `tests/endurance/kill.py` does it at length."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

IN_PLACE = """
import sys
from tests.endurance import kill
import harness.results.store, harness.recordings.recording

def write_in_place(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    with kill.whole_files.open(path, "wb") as file:
        file.write(content)

kill.whole_files.open = open
harness.results.store.write_whole = harness.recordings.recording.write_whole = write_in_place
sys.exit(kill.main(["--operations=3", "--seed=4", "--random=0", "--isolated=0"]))
"""


def benchmark(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300
    )


@pytest.fixture(scope="module")
def some() -> subprocess.CompletedProcess[str]:
    """Some are killed, others interrupted."""
    return benchmark("-m", "tests.endurance.kill", "--operations=2", "--random=1", "--isolated=2")


def test_a_killed_study_goes_on_to_the_same_end(some: subprocess.CompletedProcess[str]) -> None:
    assert some.returncode == 0, some.stdout + some.stderr
    assert "| all" in some.stdout


def test_an_interrupted_study_goes_on_to_the_same_end_and_leaves_no_process(
    some: subprocess.CompletedProcess[str],
) -> None:
    assert some.returncode == 0, some.stdout + some.stderr
    assert "| a random moment, solvers apart |       2 |" in some.stdout, some.stdout


def test_writing_in_place_would_be_noticed() -> None:
    run = benchmark("-c", IN_PLACE)
    assert run.returncode == 1, run.stdout + run.stderr
    assert re.search("FAILED: killed at (open|half a write): half written", run.stdout)
