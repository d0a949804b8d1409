"""A recording in a folder is used again where it is current, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.recordings.recording import Recording, write_recording
from harness.results.store import StoreError
from harness.study.kept_recording import first_difference, how_run, kept_recording, recording_in
from harness.study.record import record
from problems import scene

UNTIL = 0.01
FIG2 = scene("fig2")
HOW = how_run(FIG2, until=UNTIL)


@pytest.fixture(scope="module")
def made() -> Recording:
    return record(FIG2, until=UNTIL)


def never() -> Recording:
    raise AssertionError("a recording that is current was made anew")


def test_what_is_current_is_not_made_again(made: Recording, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    recording_in(folder, FIG2, HOW, lambda: made)
    assert recording_in(folder, FIG2, HOW, never).digest == made.digest


def test_a_damaged_one_is_made_anew(made: Recording, tmp_path: Path) -> None:
    path = tmp_path / "recordings" / "fig2.h5"
    write_recording(path, made)
    path.write_bytes(path.read_bytes()[:1000])
    assert kept_recording(path) is None
    recording_in(path.parent, FIG2, HOW, lambda: made)
    kept = kept_recording(path)
    assert kept is not None and kept.digest == made.digest


def test_one_by_other_code_keeps_its_file_if_it_is_the_same(
    made: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "recordings" / "fig2.h5"
    write_recording(path, replace(made, code_version="earlier"))
    before = path.read_bytes()
    assert recording_in(path.parent, FIG2, HOW, lambda: made) is made
    assert path.read_bytes() == before
    with pytest.raises(StoreError, match="another recording of this scene"):
        recording_in(path.parent, FIG2, HOW, lambda: replace(made, eps=2e-3))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("until", 0.02),
        ("eps", 1e-4),
        ("fixed_step", 0.005),
        ("stops", "held"),
        ("impulses", "newton_coulomb"),
        ("drift", "projection"),
        ("order", 1),
    ],
)
def test_what_was_run_otherwise_is_told_by_its_difference(
    made: Recording, name: str, value: Any
) -> None:
    assert first_difference(made, FIG2, HOW) is None
    options: dict[str, Any] = {"until": UNTIL, name: value}
    asked = first_difference(made, FIG2, how_run(FIG2, **options))
    other = record(FIG2, **options)
    kept = first_difference(other, FIG2, HOW)
    assert asked is not None and kept is not None
    assert (asked.name, asked.asked) == (kept.name, kept.kept) == (f"run.{name}", value)


def test_another_scene_differs_by_its_parameters(made: Recording) -> None:
    name, values = next(iter(FIG2.parameters.items()))
    other = replace(FIG2, parameters={**FIG2.parameters, name: "another"})
    assert first_difference(made, other, HOW) == (name, values, "another")
