"""A whole sequence of QPs in one compiled call, each warm from the one before it.

Called from Python, a QP of eight columns takes several times as long as its kernel.  Here the QPs
lie one after the other in flat arrays, and Python is entered once.  The answers are those of
`solver.solve(qp, last)`, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.kernels.numba_internals import in_place, in_rows, lent, read_only
from problems.qp import ContactQP, Indices, Vector
from problems.qp_kernel import WARM, X, method_at
from problems.short import Short
from solvers.active_set.compiled import kernel
from solvers.active_set.glambda import SMALL_CALLS, Glambda
from solvers.active_set.workspace import COUNTS, DIRECTIONS, make_workspace


class Flat(NamedTuple):
    """The arrays of `PackedQPs`, as compiled code takes them."""

    m: Indices
    k: Indices
    A: Vector
    d: Vector
    lower: Vector
    upper: Vector
    row_id: Indices
    eps0: Vector


class PackedQPs(Short, Flat):
    """QPs one after the other in flat arrays, of Σmk, Σm and Σk entries.

    m, k : (n,) rows and columns of each
    A : of each its m k entries, row by row
    d, lower, upper, row_id : of each
    eps0 : (n,) accuracy in ‖A δx‖ asked of each; negative: the method's default
    """

    @classmethod
    def of(cls, qps: Iterable[ContactQP]) -> PackedQPs:
        """These QPs, in this order."""
        listed = list(qps)

        def joined(parts: list[Any], dtype: type) -> Any:
            return np.concatenate([np.zeros(0), *parts]).astype(dtype)

        return cls(
            np.array([qp.m for qp in listed], np.int64),
            np.array([qp.k for qp in listed], np.int64),
            joined([qp.dense_A.ravel() for qp in listed], np.float64),
            joined([qp.d for qp in listed], np.float64),
            joined([qp.lower for qp in listed], np.float64),
            joined([qp.upper for qp in listed], np.float64),
            np.concatenate([np.zeros(0, np.int64), *(qp.row_id for qp in listed)]),
            np.array([qp.eps0 for qp in listed]),
        )

    def _title(self) -> str:
        return "packed"

    def _sizes(self) -> dict[str, Any]:
        return {"QPs": self.m.size, "columns": int(self.k.max(initial=0))}


@dataclass(frozen=True, eq=False, repr=False)
class SequenceSolution(Short):
    """What was found for `PackedQPs`.

    values : (Σk,) x of each, one after the other
    k : (n,) columns of each
    solved : (n,) bool, the method's own word, as ever to be judged by A x
    directions : (n,) descent directions that each took
    """

    values: Vector
    k: Indices
    solved: NDArray[np.bool_]
    directions: Indices

    @cached_property
    def x(self) -> list[Vector]:
        """(k,) for each QP."""
        return np.split(self.values, np.cumsum(self.k)[:-1]) if self.k.size else []

    def _title(self) -> str:
        return "sequence"

    def _sizes(self) -> dict[str, Any]:
        return {"QPs": self.k.size, "solved": int(self.solved.sum())}


class Found(NamedTuple):
    """What is found: x of all, and of each whether it was solved and its descent directions."""

    x: Vector
    solved: NDArray[np.bool_]
    directions: Indices


@kernel
def solve_all(method, qps, found, S, I, mode, warm):
    """Each QP by the method at an address, in a room that is large enough for all.

    qps : `Flat`;  found : `Found`, which is written to
    """
    solve, S, I = method_at(method), lent(S), lent(I)
    qps, found = in_place(lent(qps)), in_place(lent(found))
    m, k = qps.m, qps.k
    entry = row = column = 0
    for i in range(m.size):
        end_row, end = row + m[i], column + k[i]
        found.solved[i] = solve(
            read_only(in_rows(qps.A[entry : entry + m[i] * k[i]], m[i], k[i])),
            read_only(qps.d[row:end_row]),
            read_only(qps.lower[column:end]),
            read_only(qps.upper[column:end]),
            read_only(qps.row_id[column:end]),
            S,
            I,
            qps.eps0[i],
            mode | WARM if warm and i > 0 else mode,
        )
        found.directions[i] = I[COUNTS, DIRECTIONS]
        for j in range(k[i]):
            found.x[column + j] = S[X, j]
        entry, row, column = entry + m[i] * k[i], end_row, end


def solve_sequence(
    qps: Iterable[ContactQP] | PackedQPs, *, accuracy: float | None = None, warm: bool = True
) -> SequenceSolution:
    """Solve QPs by our own method, one after the other, in one compiled call.

    qps : of up to `SMALL_CALLS` columns; packed beforehand, no time is spent on that
    accuracy : in ‖A δx‖; None: each QP's own `eps0`
    warm : whether each starts from the answer to the one before it, by `row_id`

    Raises ValueError for a QP of more columns, and for an accuracy that is not positive.
    """
    packed = qps if isinstance(qps, PackedQPs) else PackedQPs.of(qps)
    largest = int(packed.k.max(initial=0))
    method = Glambda(accuracy).compiled(largest)
    if method is None:
        raise ValueError(
            f"a QP of the sequence has {largest} columns, and one call takes up to {SMALL_CALLS}; "
            'solve it by make_solver("glambda"), which is no slower then'
        )
    n = packed.m.size
    found = Found(np.empty(packed.k.sum()), np.zeros(n, np.bool_), np.zeros(n, np.int64))
    room = make_workspace(int(packed.m.max(initial=0)), largest)
    asked = Flat(*packed)
    if accuracy is not None:
        asked = asked._replace(eps0=np.full(n, float(accuracy)))
    solve_all(method.solve, asked, found, room.S, room.I, method.mode, warm)
    return SequenceSolution(found.x, packed.k, found.solved, found.directions)
