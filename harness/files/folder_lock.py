"""One writer at a time in a folder, across processes.

The lock is the kernel's (filelock), on a file `.lock` in the folder, and so ends with the process
that holds it, however that ends: a file that is left behind locks nobody out.  It belongs to the
process, not to its children, so that a solver that hangs on after its study was killed does not
hold it either.  Within one process everybody shares it.

Into the file goes the number of the process, so that others can say who it is.  A file of that name
that is somebody else's is refused and not written to: a link, another name of some file, a folder,
a pipe, or what holds anything but a number.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from harness.files.whole_files import clear_leftovers

NAME = ".lock"


class Locked(ValueError):
    """Another process writes into the folder, with its number where it is known."""


class ForeignLock(ValueError):
    """There is something of the lock's name that is somebody else's."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is no lock of glambda; remove it, or use another folder")


def lock_folder(folder: Path, writer: str) -> BaseFileLock:
    """The right to write into a folder, held as long as what is returned lives.

    The folder is made if it is missing.  writer : what a second one is called, such as "study"

    Raises Locked where another process has it, and ForeignLock or OSError where none can be had.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder.resolve() / NAME
    said = _said(path)
    lock = FileLock(
        path, 0, thread_local=False, is_singleton=True, fallback_to_soft=False, on_acquired=_sign
    )
    try:
        lock.acquire()
    except Timeout:
        raise Locked(
            f"{folder}: another {writer}{f' (process {said})' if said else ''} is writing there; "
            "wait until it has ended, or use another results folder"
        ) from None
    return lock


def _sign(descriptor: int) -> None:
    """Write the number of this process into the lock's file."""
    os.ftruncate(descriptor, 0)
    os.write(descriptor, str(os.getpid()).encode())


def _said(path: Path) -> str:
    """The number of a process that stands in the lock's file, or nothing.

    Raises ForeignLock where something else is there.
    """
    try:
        found = path.lstat()
        said = path.read_text(errors="replace") if stat.S_ISREG(found.st_mode) else "no file"
    except (FileNotFoundError, PermissionError):  # the lock itself says what that is worth
        return ""
    if found.st_nlink > 1 or not (said == "" or said.isdecimal()):
        raise ForeignLock(path)
    return said


@contextmanager
def sole_writer(folder: Path, part: str) -> Iterator[None]:
    """Hold the folder of a campaign; what killed writers left in its subfolder `part` is removed.

    Raises what `lock_folder` does.
    """
    lock = lock_folder(folder, "campaign")
    clear_leftovers(folder / part)
    yield
    del lock
