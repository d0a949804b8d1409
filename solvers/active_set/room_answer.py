"""The answer of algorithm 2, read out of a copy of its room only as far as it is asked for.

A QP of eight columns takes less time than to write out all that a `Solution` tells about it.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from problems.qp import Indices, Solution, Status, Timing, WorkCounts
from problems.qp_kernel import N_INT_ROWS
from solvers.active_set.sparse.workspace import SparseWorkspace
from solvers.active_set.workspace import COUNTS, DIRECTIONS, FLOPS, MEMBER, Workspace, X

FLOATS = np.dtype(np.float64)
"""Made once: to be told the type of a number instead costs a tenth of a microsecond."""
Clock = tuple[float, float, float]
"""When a solve began, when its room was ready, and when the kernel had ended [s]."""


def staged(clock: Clock) -> Timing:
    """Finding room, and the kernel, which is also what its own clock says."""
    began, ready, done = clock
    return Timing(0.0, ready - began, done - ready, done - ready)


class RoomAnswer(Solution):
    """A `Solution` that is solved; other parts than x are made when they are first looked at."""

    status = Status.SOLVED
    _integers: bytes
    _clock: Clock

    @cached_property
    def _rows(self) -> Indices:
        rows: Indices = np.frombuffer(self._integers, np.int64).reshape(N_INT_ROWS, -1)
        return rows

    @cached_property
    def working_set(self) -> NDArray[np.int8]:
        """(k,) int8."""
        members = self._rows[MEMBER, : self.row_id.size].astype(np.int8)
        members.setflags(write=False)
        return members

    @cached_property
    def work(self) -> WorkCounts:
        """What was counted."""
        return WorkCounts(*self._rows[COUNTS, DIRECTIONS : FLOPS + 1].tolist())

    @cached_property
    def iterations(self) -> int:
        """Descent directions."""
        return self.work.descent_directions

    @cached_property
    def timing(self) -> Timing:
        """Finding room, and the kernel."""
        return staged(self._clock)


def answered(room: Workspace | SparseWorkspace, row_id: Indices, clock: Clock) -> RoomAnswer:
    """The answer that has just been left in `room`."""
    made: RoomAnswer = object.__new__(RoomAnswer)
    parts, k = made.__dict__, row_id.size
    if type(room) is Workspace:
        parts["x"] = np.frombuffer(room.x.tobytes(), FLOATS, k)  # not writable
        parts["_integers"] = room.I.tobytes()
    else:
        parts["x"] = np.frombuffer(room.S[X, :k].tobytes(), FLOATS)
        parts["working_set"] = members = room.I[MEMBER, :k].astype(np.int8)
        members.setflags(write=False)
        parts["_rows"] = room.I[: COUNTS + 1, : FLOPS + 1].copy()  # all that is left to tell
    parts["row_id"] = row_id
    parts["memory"] = room
    parts["_clock"] = clock
    return made
