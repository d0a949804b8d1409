"""Files that are whole or absent, whatever happens while they are written.

1. The bytes go into a temporary file beside the target, and from there to the disk (fsync).
2. The temporary is renamed over the target: to every reader that is one step.
3. The folder goes to the disk as well, so that the new name survives a loss of power.

What a killed writer leaves is a temporary, whose name ends in `TEMPORARY`; nobody reads it.
"""

from __future__ import annotations

import os
from pathlib import Path

TEMPORARY = ".tmp"


def write_whole(path: Path, content: bytes) -> None:
    """Make `path` hold `content`, at once or not at all; folders are made where they are missing.

    Raises OSError with the target's name: no space left, read-only folder, …
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        try:
            temporary.unlink(missing_ok=True)
            with open(temporary, "xb") as file:  # "x": not through a link that stands there
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        if os.name == "posix":  # elsewhere a folder cannot be opened
            _sync_folder(path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def clear_leftovers(folder: Path) -> None:
    """Remove what killed writers have left in `folder`.  To be called by its only writer."""
    for leftover in folder.glob(f".*{TEMPORARY}"):
        leftover.unlink(missing_ok=True)
