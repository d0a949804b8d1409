"""A recording in a folder: used again where it is current, else made.

It is current if it was made by this version of the code from the same scene, run in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from harness.names import METHOD
from harness.recordings.recording import Recording, RecordingError, read_recording, write_recording
from harness.results.store import Store
from harness.study.record import code_version
from problems.stepping.options import StepperOptions


class Difference(NamedTuple):
    """A parameter that a recording has another value of than what is asked for."""

    name: str
    kept: Any
    asked: Any


def kept_recording(path: Path) -> Recording | None:
    """The recording that is there; None where there is none, or a damaged one, to be made anew."""
    try:
        return read_recording(path)
    except RecordingError:
        return None


def how_run(
    scene: Any, eps: float | None = None, until: float | None = None, **options: Any
) -> dict[str, Any]:
    """{option: value} of a run with these settings of `problems.simulate`, defaults among them.

    None stands for a default.  Raises ValueError for bad settings.
    """
    given = {name: value for name, value in options.items() if value is not None}
    settings = StepperOptions.of(scene.eps if eps is None else eps, **given)
    return {"until": float(scene.end_time if until is None else until), **asdict(settings)}


def first_difference(recording: Recording, scene: Any, how: Mapping[str, Any]) -> Difference | None:
    """Whether it is of another scene than this, or was run otherwise; how : see `how_run`."""
    asked = {**scene.parameters, **{f"run.{name}": value for name, value in how.items()}}
    for name, value in asked.items():
        kept = recording.parameters.get(name)
        if kept != value:
            return Difference(name, kept, value)
    return None


def recording_in(
    folder: Path,
    scene: Any,
    how: Mapping[str, Any],
    make: Callable[[], Recording],
) -> Recording:
    """The recording by our method from RESULTS/recordings, `folder`, or else by `make`.

    how : see `how_run`

    Raises StoreError where another recording of the scene is there.
    """
    path = folder / f"{scene.label}.h5"
    kept = kept_recording(path)
    if (
        kept is not None
        and kept.code_version == code_version(METHOD)
        and first_difference(kept, scene, how) is None
    ):
        return kept
    made = make()
    if kept is None:
        write_recording(path, made)
    else:
        Store(folder.parent).add_recording(made)  # the same content keeps its file
    return made
