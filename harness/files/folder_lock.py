"""One writer at a time in a folder, across processes.

The lock is the kernel's, on a file `.lock` in the folder, and so ends with the process that holds
it, however that ends: a file that is left behind locks nobody out.  It belongs to the process, not
to its children, so that a solver that hangs on after its study was killed does not hold it either.
Within one process everybody shares it.  Where there are no such locks (Windows) nobody is kept out.

Into the file goes the number of the process, so that others can say who it is.  A file of that name
that is somebody else's is refused and not written to: a link, another name of some file, a folder,
a pipe, or what holds anything but a number.
"""

from __future__ import annotations

import errno
import os
import stat
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.files.whole_files import clear_leftovers

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

NAME = ".lock"
NUMBER = 20
"""Longest number of a process [digits]."""

_held: weakref.WeakValueDictionary[Path, FolderLock] = weakref.WeakValueDictionary()


class Locked(ValueError):
    """Another process writes into the folder, with its number where it is known."""


class ForeignLock(ValueError):
    """There is something of the lock's name that is somebody else's."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is no lock of glambda; remove it, or use another folder")


class FolderLock:
    """The right to write into a folder, held as long as this object lives."""

    def __init__(self, folder: Path, writer: str) -> None:
        descriptor = _open(folder / NAME)
        self._release = weakref.finalize(self, os.close, descriptor)
        try:
            if fcntl is not None:
                fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            process = _said(descriptor)
            self._release()
            raise Locked(
                f"{folder}: another {writer}{f' (process {process})' * process.isdecimal()} is "
                "writing there; wait until it has ended, or use another results folder"
            ) from None
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, str(os.getpid()).encode())


def _open(path: Path) -> int:
    """The lock's file, made if it is missing.  Raises ForeignLock where something else is there."""
    try:
        how = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
        descriptor = os.open(path, how, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise ForeignLock(path) from None
        raise
    found = os.fstat(descriptor)
    said = _said(descriptor) if stat.S_ISREG(found.st_mode) else "a pipe or a device"
    if found.st_nlink > 1 or not (said == "" or said.isdecimal()):
        os.close(descriptor)
        raise ForeignLock(path)
    return descriptor


def _said(descriptor: int) -> str:
    """What stands in the lock's file: the number of a process, or nothing."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    return os.read(descriptor, NUMBER + 1).decode(errors="replace")


def lock_folder(folder: Path, writer: str) -> FolderLock:
    """The lock on a folder, this process's own if it has it already.

    The folder is made if it is missing.  writer : what a second one is called, such as "study"

    Raises Locked where another process has it, and ForeignLock or OSError where none can be had.
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

    Raises what `lock_folder` does.
    """
    lock = lock_folder(folder, "campaign")
    clear_leftovers(folder / part)
    yield
    del lock
