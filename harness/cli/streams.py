"""Where a command's words go; whoever reads them may leave (`| head -1`)."""

from __future__ import annotations

import io
import os
import sys
from typing import Any

import typer

from harness.printable import printable


class _Forgiving(io.FileIO):
    """A stream whose reader may leave: what is written from then on is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            return memoryview(data).nbytes


def keep_stdout() -> None:
    """Keep stdout for ourselves: what packages print by themselves (HiGHS's banner) goes to stderr.

    They write to file descriptor 1, which is that of stderr from here on.
    """
    if not isinstance(sys.stdout, io.TextIOWrapper) or sys.stdout.fileno() != 1:
        return  # closed, or somebody else's
    sys.stdout.flush()
    ours = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(io.FileIO(ours, "w")),
        encoding=sys.stdout.encoding,
        errors=sys.stdout.errors,
        line_buffering=sys.stdout.line_buffering,
        write_through=sys.stdout.write_through,
    )


def outlive_readers() -> None:
    """Let a command finish its work and write its files when nobody reads its words any more."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper):
            continue  # closed, or somebody else's
        stream.flush()
        lasting = io.TextIOWrapper(
            io.BufferedWriter(_Forgiving(stream.fileno(), "w", closefd=False)),
            encoding=stream.encoding,
            errors=stream.errors,
            line_buffering=stream.line_buffering,
            write_through=stream.write_through,
        )
        setattr(sys, name, lasting)


def say(text: str = "", err: bool = False) -> None:
    """Print a line as it is, however long."""
    typer.echo(printable(text), err=err)
