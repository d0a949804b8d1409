"""A process that may write nowhere but in its folder, and sees nothing of the study.

Landlock (Linux ≥ 5.13) lets a process give up rights for good, for itself and all that it forks:

1. It may list all folders and read all files but those that are `hidden`: what lies beside the way
   to them is granted, one by one.
2. It may write below the paths it is given, and to /dev/null.
3. It cannot send signals to processes outside (Linux ≥ 6.12), nor look into their memory.
4. Its System V shared memory is its own, where the system lets it have that, and ends with it.

Where the system has no Landlock nothing is given up (`is_confined`).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

CREATE, ADD_RULE, RESTRICT = 444, 445, 446
"""Numbers of the system calls, on every architecture."""
WRITE_FILE, READ_FILE, LIST = 1 << 1, 1 << 2, 1 << 3
MAKE_AND_REMOVE = sum(1 << bit for bit in range(4, 13))
REFER, TRUNCATE = 1 << 13, 1 << 14
SIGNALS = 1 << 1
NO_NEW_PRIVILEGES, NEW_IPC = 38, 0x08000000

_libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def _call(number: int, *arguments: object) -> int:
    assert _libc is not None
    return int(_libc.syscall(number, *arguments))


def _version() -> int:
    """What Landlock the system has; 0: none."""
    return 0 if _libc is None else max(0, _call(CREATE, None, 0, 1))


def is_confined() -> bool:
    """Whether processes can be confined here."""
    return _version() > 0


def confine(writable: Iterable[Path], hidden: Iterable[Path] = ()) -> None:
    """Give up the rights of this process for good.

    writable : folders below which it may write;  hidden : paths that it may not read
    """
    version = _version()
    if not version:
        return
    assert _libc is not None
    _libc.unshare(NEW_IPC)
    _libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    writing = WRITE_FILE | MAKE_AND_REMOVE
    writing |= (REFER if version >= 2 else 0) | (TRUNCATE if version >= 3 else 0)
    rules = dict.fromkeys(granted({Path(os.path.realpath(p)) for p in hidden}), READ_FILE)
    rules |= dict.fromkeys(writable, READ_FILE | writing)
    rules |= {Path("/"): rules.get(Path("/"), 0) | LIST, Path(os.devnull): READ_FILE | writing}
    attributes = struct.pack("<QQQ", READ_FILE | LIST | writing, 0, SIGNALS if version >= 6 else 0)
    size = 24 if version >= 6 else 16 if version >= 4 else 8
    ruleset = _call(CREATE, attributes, size, 0)
    if ruleset < 0:
        raise OSError(ctypes.get_errno(), "Landlock refuses its rules")
    for path, rights in rules.items():
        _grant(ruleset, path, rights)
    if _call(RESTRICT, ruleset, 0) < 0:
        raise OSError(ctypes.get_errno(), "Landlock refuses to restrict this process")
    os.close(ruleset)


def _grant(ruleset: int, path: Path, rights: int) -> None:
    with contextlib.suppress(OSError):  # what is gone, or not ours, needs no rights
        at = os.open(path, os.O_PATH | os.O_CLOEXEC)
        if not path.is_dir():
            rights &= WRITE_FILE | READ_FILE | TRUNCATE
        _call(ADD_RULE, ruleset, 1, struct.pack("<Qi", rights, at), 0)
        os.close(at)


def granted(hidden: set[Path], at: Path = Path("/")) -> Iterator[Path]:
    """Paths that hold everything below `at` but what is hidden, by their real names."""
    if at in hidden:
        return
    if not any(at in path.parents for path in hidden):
        yield at
        return
    with contextlib.suppress(OSError):
        for entry in os.scandir(at):
            if not entry.is_symlink():
                yield from granted(hidden, at / entry.name)
