"""Packages that print whatever they are told."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

_FLUSH = ctypes.CDLL(None).fflush if os.name == "posix" else lambda stream: None


@contextmanager
def quietly() -> Iterator[None]:
    """Nothing that compiled code prints in here, in its way or in Python's, reaches the console."""
    sys.stdout.flush()
    _FLUSH(None)
    stdout, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        with redirect_stdout(StringIO()):
            yield
    finally:
        _FLUSH(None)
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(nowhere)
