"""Our own method, built on the paper's algorithm 2; the default everywhere.

From the paper (Lötstedt 1984, §3.2) it takes algorithm 2 itself, steps 1 to 9, with the sets F, X
and P and the start from the previous working set (`method`), and for large QPs the old R that
preconditions conjugate gradients, ended by (3.20).

Not from the paper is what outlives a QP, which goes by size, and when R is given up:

1. Up to `CROSSOVER` columns, cold up to `COLD_CROSSOVER`, where A is thin up to `THIN_CROSSOVER`,
   where it is dense up to `DENSE_CROSSOVER` or `FULL_CROSSOVER`, F and x only, and no conjugate
   gradients.  A_F is factorized anew at every QP, by normal equations: on the last F by itself
   (`settled`), by Newton steps that change many rows at once (`newton`), and by QR where these do
   not end it.
2. Beyond, where A is dense, R as in the paper, but given up by the online rule (`online_rule`) and
   not by (2 C_QR/C_IT)^½.
3. Beyond, where A is sparse, a sparse R by Cholesky, given up by the online rule; x of the start is
   extrapolated; F may hold dependent columns, so that there is no P; many rows change sides at
   once (`sparse.loop`); after tens of directions interior points choose F (`sparse.interior`).
4. Up to `SMALL_CALLS` columns whole steps and collisions are taken in one call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from problems.qp import Solution, Status
from problems.qp_kernel import CompiledMethod, Room
from solvers.active_set.loop import CUSTOM, EXTRAPOLATED, GRAM, ONLINE, TODAYS_QR, solve
from solvers.active_set.method import (
    COLD_CROSSOVER,
    CROSSOVER,
    DENSE_CROSSOVER,
    FULL_CROSSOVER,
    THIN_CROSSOVER,
    ActiveSet,
    Modes,
    room_after,
)
from solvers.active_set.workspace import (
    COUNTS,
    OLD_K,
    OLD_MEMBER,
    OLD_ROW,
    Workspace,
    X,
    make_workspace,
)

SMALL_CALLS = 96
"""Columns up to which whole steps and collisions are taken in one call."""


@dataclass(frozen=True)
class Glambda(ActiveSet):
    """Our active-set method: today's factorization if small, else an old R by the online rule.

    iteration_limit : passes of the main loop before giving up; None: 50 + 20 k

    Raises ValueError for a negative limit.
    """

    name: ClassVar[str] = "glambda"

    def modes(self) -> Modes:
        """By size, see the module's list."""
        mode = ONLINE if self.iteration_limit is None else ONLINE | CUSTOM
        small, sparse = mode | TODAYS_QR | GRAM, mode | EXTRAPOLATED
        crossovers = CROSSOVER, COLD_CROSSOVER, THIN_CROSSOVER, DENSE_CROSSOVER, FULL_CROSSOVER
        return Modes(small, mode, sparse, *crossovers)

    def compiled(self, k: int) -> CompiledMethod | None:
        """Algorithm 2 for whole steps and collisions in one call, up to `SMALL_CALLS` columns.

        With today's factorization also somewhat beyond `CROSSOVER`: what a step costs in Python is
        more than what a kept R would save.
        """
        mode = self._modes.small
        return None if mode & CUSTOM or k > SMALL_CALLS else CompiledMethod(solve.address, mode)

    def room(self, m: int, k: int, eps0: float, start: Solution | None) -> Room:
        """A workspace for m rows and k columns, with what `start` remembers."""
        eps0 = eps0 if self._eps0 is None else self._eps0
        known = None if start is None else room_after(start, m, k)
        room = make_workspace(m, k) if known is None else known
        return Room(room.S, room.I, eps0, known is not None)

    def last_answer(self, room: Room) -> Solution:
        """What was solved last in a room."""
        S, I = room.S, room.I
        last = max(int(I[COUNTS, OLD_K]), 0)
        return Solution(
            x=S[X, :last].copy(),
            row_id=I[OLD_ROW, :last].copy(),
            status=Status.SOLVED,
            working_set=I[OLD_MEMBER, :last].astype(np.int8),
            memory=Workspace(S, I, S.shape[1]),
        )
