"""Whose clock counts: what a process tells of a solve is held against what is seen of it.

A call cannot have begun before its QP was handed over, nor have ended after its answer came.  What
is seen of a solve is therefore the greater of

    wall   from asking to the answer, but for what either side has waited for a processor
    cpu    of all its threads, from asking to the next question; forked processes that have ended
           count in equal parts for all QPs

less what asking takes by itself: the same, of `bench.Nobody`, who is asked the same QPs in the same
arm in every round, just as long as the machine is as it is.  Who gives no answer has all of the
time that was waited for it, which is then beyond the limit (`harness.study.replay.is_done`).

1. The call that is told counts where no more is seen but for `slack`, that is `SLACK`, the scatter
   of asking, and asking once more, as it takes longer after a long solve; else what is seen is the
   call.
2. What build, setup and solve leave of that call, beyond what reading an answer may take, is
   charged: it is added to runtime.  Where that is more than they are, or where they are impossible
   (negative, not finite, nothing at all, more than the call), the whole call is.
3. The package's own clock is kept where it is within the call; it decides nothing.
4. The stages are those of our adapters.  Of a stranger's backend building counts as setting up:
   where it does its work is for it to choose, and its own clock is not asked.

So nobody is charged less than it has taken, but for tens of microseconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.qp import Vector

SLACK = 2e-5
"""[s] that may always be missing."""
PARALLEL = 0.25
"""Part of the call that its CPU may exceed it by: what is done between calls is done cold."""
READING, BUSY = 3.0, 10.0
"""Times of asking that reading an answer and mapping a start may take, where that is no longer than
so many times its CPU: that hardly grows while others keep the machine busy."""


class Asking(NamedTuple):
    """What asking takes by itself: (n, 2) [s] wall and CPU, and how far they scatter (2,)."""

    times: Vector
    scatter: Vector

    @classmethod
    def nothing(cls, count: int) -> Asking:
        """No time, for that many QPs: where nobody looks at the clock."""
        return cls(np.zeros((count, 2)), np.zeros(2))

    @classmethod
    def of(cls, times: Vector, before: Asking | None = None) -> Asking:
        """That of a pass (n, 8) of nobody: of each QP the least so far, or what is usual now."""
        times = np.nan_to_num(times)
        found = times[:, [-3, -1]]
        least = found if before is None else np.minimum(found, before.times)
        middle, often = np.quantile(seen(times), (0.5, 0.95), axis=0)
        return cls(np.maximum(least, np.median(found, axis=0)), often - middle)


class Counted(NamedTuple):
    """What counts of a pass.

    times : (n, 6) [s] build, setup, solve, call, charged, inside
    impossible : QPs whose stages are
    """

    times: Vector
    impossible: list[int]


def seen(times: Vector) -> Vector:
    """(n, 2) [s] wall and CPU of a pass (n, 8); CPU that is not known is none."""
    wall, waited, cpu = times[:, -3:].T
    return np.column_stack([wall - np.minimum(waited, wall), np.nan_to_num(cpu)])


def counted(times: Vector, asking: Asking, stranger: bool = False) -> Counted:
    """What counts of the times of a pass.

    times : (n, 8) [s] as in `harness.passes.limits.Pass`
    stranger : whether the backend is none of ours
    """
    own, call, ask = times[:, :3], times[:, 3], asking.times[:, 0]
    total = own.sum(axis=1)
    with np.errstate(invalid="ignore"):
        wall, cpu = (seen(times) - np.where(np.isnan(call)[:, None], 0.0, asking.times)).T
        slack = SLACK + ask + asking.scatter[0]
        busy = cpu - asking.scatter[1] > wall + slack + PARALLEL * np.fmax(call, 0.0)
        outside = np.maximum(np.where(busy, cpu, wall), 0.0)
        nonsense = ~((call > 0) & (call <= times[:, -3]))
        whole = np.where(nonsense | (outside - call > slack), outside, call)
        worked = asking.times[:, 1]
        reading = READING * np.where(worked > 0, np.minimum(ask, BUSY * worked), ask)
        missing = whole - total
        charged = np.where(missing > SLACK + reading, missing - reading, 0.0)
        possible = (own >= 0).all(axis=1) & (own[:, 1] + own[:, 2] > 0) & (total <= call)
        gross = ~possible | (charged > total)
        inside = np.where((times[:, 4] >= 0) & (times[:, 4] <= call), times[:, 4], np.nan)
    impossible: NDArray[np.bool_] = ~possible & ~np.isnan(own).all(axis=1)
    found = np.column_stack([own, whole, np.where(gross, 0.0, charged), inside])
    found[gross, :3] = np.nan
    if stranger:
        found[:, 1] += found[:, 0]
        found[:, 0] *= 0.0
        found[:, 5] = np.nan
    return Counted(found, np.flatnonzero(impossible).tolist())
