"""Where the kernels keep their numbers: one float and one integer array, rows with names.

Few arrays cross the boundary into compiled code, because each costs 50 ns there.  `S` (rows, n) and
`I` (rows, n) hold everything that a solve needs and everything that the next one may use; n is at
least m and k.  A vector is a row.  The matrices are rows of S too, column after column, so that a
column is contiguous; each has n rows from its first on:

    B0 = N_FLOAT_ROWS          B   A with columns of length 1
    W0 = N_FLOAT_ROWS + n      W   Householder vectors of today's A_F, zeros above their first entry
    R0 = N_FLOAT_ROWS + 2 n    R   R of today's or an earlier A_F

Rows of m entries are continued with zeros up to a multiple of `LANES`, and loops along them run
that far: so that they are whole vector instructions even where m is 9.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from sys import getrefcount

import numpy as np
from numpy.typing import NDArray

from problems.qp import Vector
from problems.qp_kernel import LANES, N_FLOAT_ROWS, N_INT_ROWS, X

# rows of S
STEP, Z, LENGTH, LOWER, UPPER, GRADIENT, P, Y, RESIDUAL, FRESH = range(X + 1, 11)
NORM2, TAU, SEARCH, V, REMAINDER, REALS, MOMENTUM, SIZES, BEFORE = range(11, 20)
ALONE, ALONE2 = range(20, N_FLOAT_ROWS)  # of `gram`

# rows of I
COUNTS, F, MEMBER, OLD_ROW, OLD_MEMBER, OLD_F, PREVIOUS, TODAY, MARK = range(9)
TOUCHED, FROM, PAST, SORTED, EDGE, BEFORE_IT, FIRST, ALONE_IN = range(9, N_INT_ROWS)  # of `gram`

# entries of row REALS
INVERSE_NORM, GROWN_NORM, WRONG, CG_LIMIT, SHIFT = range(5)
STEPS, SPENT, FACTORIZATION_COST, PATIENCE, YOUNG = range(5, 10)  # of the online rule
TIME, LAST_TIME, TIME_BEFORE = range(10, 13)  # of this QP, and of rows X and BEFORE
FACTORIZATION_FLOPS = 13
# entries of row COUNTS: what is remembered …
OLD_K, OLD_ORDER, AGE, ORDER, STATUS = range(5)
# … and what is counted, in the order of `WorkCounts`
DIRECTIONS, CHANGES, FACTORIZATIONS, UPDATES, CG_ITERATIONS, FLOPS = range(5, 11)
# … and options that replace the paper's; negative passes: the default
INTERVAL, PASSES = 11, 12
# … and what the online rule remembers
DUE, CAP, CYCLES = 13, 14, 15
SOLVED, INACCURATE, OUT_OF_PASSES, REFUSED = range(4)
"""What row COUNTS holds at STATUS."""


ONCE = 2
"""What `getrefcount` says of a variable, or of an attribute, that nobody else holds."""


@dataclass(eq=False)
class Workspace:
    """S (rows, n) float64, I (rows, n) int64; handed on from solve to solve, updated in place."""

    S: Vector
    I: NDArray[np.int64]
    n: int
    x: Vector = field(init=False)
    """The row that begins with x."""

    def __post_init__(self) -> None:
        self.x = self.S[X]


_MADE: list[Workspace] = []
"""The last few rooms that were made."""
MOST_MADE, LARGEST = 2, 1 << 23
"""How many, and of how many bytes: beyond, memory would be kept for little."""


def _room(n: int) -> Workspace:
    """A room of n columns, or somewhat more, that holds anything.

    One that nobody holds any more, if there is one.  Of a small QP new arrays would take as long
    as the QP (k = 10, 1.1 µs), and of a larger one the system may have its memory back by then: a
    cold start in fresh memory takes five times as long (k = 65 in a heap of 50 boxes, 150 and
    30 µs).
    """
    for _ in range(len(_MADE)):
        room = _MADE.pop(0)  # of two threads, one has it
        free = (
            n <= room.n <= 2 * n
            and getrefcount(room) == getrefcount(room.x) == getrefcount(room.I) == ONCE
            and getrefcount(room.S) == ONCE + 1  # x is a row of it
        )
        _MADE.append(room)
        if free:
            return room
    S, I = np.empty((N_FLOAT_ROWS + 3 * n, n)), np.empty((N_INT_ROWS, n), dtype=np.int64)
    room = Workspace(S, I, n)
    if S.nbytes <= LARGEST:
        _MADE.append(room)
        del _MADE[:-MOST_MADE]
    return room


def make_workspace(m: int, k: int, previous: Workspace | None = None) -> Workspace:
    """Room for a QP of m rows and k columns, with what `previous` remembers.

    The same object where it is large enough already; then its content is used up.
    """
    n = m if m > k else k
    if previous is not None and previous.n >= n:
        return previous
    n = (n + n // 2) // LANES * LANES + LANES  # contacts come in ones and twos
    made = _room(n)
    if previous is not None:
        n, old = made.n, previous.n
        made.I[:, :old] = previous.I
        made.S[:N_FLOAT_ROWS, :old] = previous.S[:N_FLOAT_ROWS]
        first, before = N_FLOAT_ROWS + 2 * n, N_FLOAT_ROWS + 2 * old
        made.S[first : first + old, :old] = previous.S[before:]
    return made
