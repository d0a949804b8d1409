"""What a process has answered, one row per QP, in a file that it shares with the parent.

The process maps the file into its memory and fills in a row after each solve, outside the clock, so
that what it has answered survives whatever it dies of.  The parent reads the file and maps nothing:
whatever stands in it, even if it was cut short, decodes to outcomes.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.passes.measure import Outcome, Watch
from problems.qp import Status, WorkCounts

COUNTS = tuple(WorkCounts.__dataclass_fields__)
TEXT = 400
"""Longest status text that is kept [bytes]."""
HEADER = 8
"""Bytes of the header: the position of the QP under way, in the order of the pass."""
ROW = np.dtype(
    [
        ("written", "?"),
        ("has_x", "?"),
        ("has_iterations", "?"),
        ("has_work", "?"),
        ("found", "?"),
        ("warm_started", "?"),
        ("after_restart", "?"),
        ("verdict", "S9"),
        ("status", "S16"),
        ("text", f"S{TEXT}"),
        ("iterations", "i8"),
        ("work", "i8", len(COUNTS)),
        ("times", "f8", 4),
    ],
    align=True,
)
SETTLED = ("", "skipped", "failed", "timeout", "crashed")
"""What a row may say before any judging."""
NONSENSE = "what it recorded is no answer"


class Lost(Exception):
    """A solve would have ended the process (no memory, an exit): a fresh one goes on."""


class Layout:
    """Where things stand in the sheet of a sequence of QPs.

    sizes : k of each QP
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.count = len(sizes)
        self.start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.answers = HEADER + self.count * ROW.itemsize
        self.bytes = self.answers + 8 * int(self.start[-1])


class Pen(Watch):
    """The process's side: writes outcomes as a pass goes on."""

    def __init__(self, path: str | os.PathLike[str], layout: Layout) -> None:
        with open(path, "r+b") as file:
            shared = mmap.mmap(file.fileno(), layout.bytes)
        self._start = layout.start
        self._at = np.frombuffer(shared, np.int64, 1)
        self._rows = np.frombuffer(shared, ROW, layout.count, HEADER)
        self._x = np.frombuffer(shared, np.float64, layout.start[-1], layout.answers)

    def begin(self, position: int) -> None:
        """The QP at this position of the pass is about to be solved."""
        self._at[0] = position

    def end(self, index: int, outcome: Outcome, times: NDArray[np.float64]) -> None:
        """QP `index` has this outcome, in these times.

        Raises Lost if the solve would have ended the process.
        """
        try:
            self._write(index, outcome, times)
        except (TypeError, ValueError, OverflowError, AttributeError) as error:
            text = f"{NONSENSE}: {error}"
            self._write(index, Outcome("failed", status_text=text), times)
        if outcome.verdict == "crashed":
            raise Lost

    def _write(self, index: int, outcome: Outcome, times: NDArray[np.float64]) -> None:
        if outcome.x is not None:
            self._x[self._start[index] : self._start[index + 1]] = outcome.x
        work = outcome.work
        self._rows[index] = (
            True,
            outcome.x is not None,
            outcome.iterations is not None,
            work is not None,
            outcome.found,
            outcome.warm_started,
            outcome.after_restart,
            (outcome.verdict or "").encode(),
            outcome.status.encode(),
            " ".join(outcome.status_text.split()).encode(errors="replace"),
            outcome.iterations or 0,
            tuple(0 if work is None else getattr(work, name) for name in COUNTS),
            tuple(times),
        )


class Sheet:
    """The parent's side: makes the file, clears it and reads it.

    Raises OSError where there is no room for the file.
    """

    _file: Any

    def __init__(self, path: Path, layout: Layout) -> None:
        self.path, self._layout = path, layout
        self._file = open(path, "w+b", buffering=0)  # noqa: SIM115 (closed by `close`)
        try:
            self.clear()
        except OSError as error:
            self.close()
            why = f"{error.strerror}; make room there, or set TMPDIR to another folder"
            raise OSError(error.errno, why, str(path.parent)) from None

    def clear(self) -> None:
        """No QP is under way and none is answered."""
        self._file.seek(0)
        rest = memoryview(np.int64(-1).tobytes() + bytes(self._layout.bytes - HEADER))
        while rest:  # a file without a buffer may take a part, and say why at the next
            rest = rest[self._file.write(rest) :]

    def position(self) -> int:
        """Position in the pass of the QP under way; −1 before the first."""
        self._file.seek(0)
        return self._position(self._file.read(HEADER))

    def _position(self, header: bytes) -> int:
        (position,) = np.frombuffer(header.ljust(HEADER, b"\0"), np.int64)
        return int(np.clip(position, -1, self._layout.count - 1))

    def read(self) -> dict[int, tuple[Outcome, NDArray[np.float64]]]:
        """Outcome and times (4,) of each QP that is answered, by its index."""
        self._file.seek(0)
        data = self._file.read(self._layout.bytes).ljust(self._layout.bytes, b"\0")
        rows = np.frombuffer(data, ROW, self._layout.count, HEADER)
        x = np.frombuffer(data, np.float64, self._layout.start[-1], self._layout.answers)
        answers = np.split(x, self._layout.start[1:-1])
        return {
            int(i): (_outcome(rows[i], answers[i]), rows[i]["times"].copy())
            for i in np.flatnonzero(rows["written"])
        }

    def close(self) -> None:
        """Delete the file."""
        self._file.close()
        self.path.unlink(missing_ok=True)


def _outcome(row: np.void, x: NDArray[np.float64]) -> Outcome:
    verdict, status, text = (
        bytes(row[name]).decode(errors="replace") for name in ("verdict", "status", "text")
    )
    if verdict not in SETTLED or status not in ("", *Status.__members__):
        return Outcome("crashed", status_text=NONSENSE)
    return Outcome(
        verdict=verdict or None,
        x=x.copy() if row["has_x"] else None,
        found=bool(row["found"]),
        status=status,
        status_text=text,
        iterations=int(row["iterations"]) if row["has_iterations"] else None,
        work=WorkCounts(*map(int, row["work"])) if row["has_work"] else None,
        warm_started=bool(row["warm_started"]),
        after_restart=bool(row["after_restart"]),
    )
