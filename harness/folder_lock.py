"""One writer at a time in a folder, across processes.

The lock is the kernel's, on a file `.lock` in the folder, and so ends with the process that holds
it, however that ends: a file that is left behind locks nobody out.  It belongs to the process, not
to its children, so that a solver that hangs on after its study was killed does not hold it either.
Within one process everybody shares it.  Where there are no such locks (Windows) nobody is kept out.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.whole_files import clear_leftovers

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME = ".lock"

_held: weakref.WeakValueDictionary[Path, FolderLock] = weakref.WeakValueDictionary()


class Locked(ValueError):
    """Another process writes into the folder, with its number where it is known."""


class FolderLock:
    """The right to write into a folder, held as long as this object lives."""

    def __init__(self, folder: Path, writer: str) -> None:
        descriptor = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o666)
        self._release = weakref.finalize(self, os.close, descriptor)
        try:
            if fcntl is not None:
                fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            process = os.read(descriptor, 20).decode(errors="replace")
            self._release()
            raise Locked(
                f"{folder}: another {writer}{f' (process {process})' * process.isdecimal()} is "
                "writing there; wait until it has ended, or use another results folder"
            ) from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())


def lock_folder(folder: Path, writer: str) -> FolderLock:
    """The lock on a folder, this process's own if it has it already.

    The folder is made if it is missing.  writer : what a second one is called, such as "study"

    Raises Locked where another process has it, and OSError where none can be had.
    """
    folder.mkdir(parents=True, exist_ok=True)
    place = folder.resolve()
    lock = _held.get(place)
    if lock is None:
        lock = _held[place] = FolderLock(folder, writer)
    return lock


@contextmanager
def sole_writer(folder: Path, part: str) -> Iterator[None]:
    """Hold the folder of a campaign; what killed writers left in its subfolder `part` is removed.

    Raises Locked and OSError as `lock_folder` does.
    """
    lock = lock_folder(folder, "campaign")
    clear_leftovers(folder / part)
    yield
    del lock
