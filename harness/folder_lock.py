"""One writer at a time in a folder, across processes.

The lock is the kernel's, on a file `.lock` in the folder, and so ends with the process that holds
it, however that ends: a file that is left behind locks nobody out.  It belongs to the process, not
to its children, so that a solver that hangs on after its study was killed does not hold it either.
Within one process everybody shares it.  Where there are no such locks (Windows) nobody is kept out.
"""

from __future__ import annotations

import os
import weakref
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME = ".lock"

_held: weakref.WeakValueDictionary[Path, FolderLock] = weakref.WeakValueDictionary()


class Locked(Exception):
    """Another process writes into the folder; `process` is its number, or empty if unknown."""

    def __init__(self, process: str) -> None:
        self.process = process


class FolderLock:
    """The right to write into a folder, held as long as this object lives."""

    def __init__(self, folder: Path) -> None:
        descriptor = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o666)
        self._release = weakref.finalize(self, os.close, descriptor)
        try:
            if fcntl is not None:
                fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            process = os.read(descriptor, 20).decode(errors="replace")
            self._release()
            raise Locked(process if process.isdecimal() else "") from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())


def lock_folder(folder: Path) -> FolderLock:
    """The lock on an existing folder, this process's own if it has it already.

    Raises Locked where another process has it, and OSError where none can be had.
    """
    place = folder.resolve()
    lock = _held.get(place)
    if lock is None:
        lock = _held[place] = FolderLock(place)
    return lock
