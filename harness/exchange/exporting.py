"""Recordings written for the tools of others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from harness.exchange import benchopt, fclib, npz, qpbenchmark
from harness.recordings.recording import Recording

WRITERS: Mapping[str, ModuleType] = {
    "npz": npz,
    "qpbenchmark": qpbenchmark,
    "fclib": fclib,
    "benchopt": benchopt,
}
"""Name → module whose `write` takes a folder and a recording and returns what it wrote."""


def export(recording: Recording, form: str, folder: str | Path) -> list[Path]:
    """Write a recording in a form of `WRITERS` into a folder; returns the files.

    Raises ValueError for an unknown form, and for QPs that the form cannot hold.
    """
    if form not in WRITERS:
        raise ValueError(f"form {form!r} is unknown; choose from {', '.join(WRITERS)}")
    written: list[Path] = WRITERS[form].write(Path(folder), recording)
    return written
