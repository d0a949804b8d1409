"""Where a command's words go; whoever reads them may leave (`| head -1`)."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from typing import Any

import typer

from harness.files.printable import printable

SOON = 0.1
"""[s] after which a lost interrupt comes once more."""


class _Forgiving(io.FileIO):
    """A stream whose reader may leave: what is written from then on is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            return memoryview(data).nbytes


def guard_streams() -> None:
    """Let a command finish its work when nobody reads its words, and keep stdout for those.

    What packages print by themselves (HiGHS's banner) goes to file descriptor 1, which is that of
    stderr from here on; ours go to a copy of the one that there was.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper):
            continue  # closed, or somebody else's
        stream.flush()
        descriptor = stream.fileno()
        if descriptor == 1:
            descriptor = os.dup(1)
            os.dup2(2, 1)
        lasting = io.TextIOWrapper(
            io.BufferedWriter(_Forgiving(descriptor, "w", closefd=False)),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.line_buffering,
            write_through=stream.write_through,
        )
        setattr(sys, name, lasting)


def say(text: str = "", err: bool = False) -> None:
    """Print a line as it is, however long."""
    typer.echo(printable(text), err=err)


def heed_interrupts() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, and no interrupt be lost that comes in a
    callback of the garbage collector, which passes nothing on: it comes once more."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.default_int_handler)
    told = sys.unraisablehook

    def once_more(event: Any) -> None:
        if isinstance(event.exc_value, KeyboardInterrupt) and hasattr(signal, "pthread_kill"):
            main = threading.main_thread().ident or 0
            threading.Timer(SOON, signal.pthread_kill, (main, signal.SIGINT)).start()
        else:
            told(event)

    sys.unraisablehook = once_more
