"""Files that others may have put there: read are regular ones of bounded size, and nothing else.

A pipe waits for ever for somebody who writes into it, and a device such as /dev/zero never ends.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO


class Unreadable(ValueError):
    """What is wrong with a file, without its name."""


def open_plain(path: Path, limit: int) -> BinaryIO:
    """A regular file of at most `limit` bytes, open for reading.

    Raises Unreadable for another kind of file and for a larger one, OSError where there is none.
    """
    how = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, how)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise Unreadable("is no file, but a folder, a pipe or a device")
        if found.st_size > limit:
            raise Unreadable(f"has {found.st_size:,} bytes, more than {limit:,}")
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise
