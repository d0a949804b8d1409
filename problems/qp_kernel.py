"""A solver's QP method as compiled steps call it: a function of one signature, and its room.

Whole steps, friction's passes and minimum norms are compiled once, with no method in them: one is
handed to them, at some 10 ns a call.  A solver that has one offers the three functions of
`CompiledSolver`.

    solve(A, d, lower, upper, row_id, S, I, eps0, mode) → whether the QP is solved

    A (m, k), d (m,), lower, upper (k,), row_id (k,) : the QP, not to be written to
    S, I : room for n ≥ m, k, a multiple of `LANES`: S (N_FLOAT_ROWS + 3 n, n), vectors and three
        matrices, and I (N_INT_ROWS, n).  It leaves x in S[X, :k], and whatever else the next QP may
        use
    eps0 : accuracy in ‖A δx‖;  negative: the solver's default
    mode : the method's own, plus `WARM` where it may start from what S and I remember; without it
        they may hold anything
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numba import types

from problems.kernels.compiled import kernel
from problems.kernels.numba_internals import function_at
from problems.qp import Indices, Solution, Vector

X = 0
"""Row of S with the answer."""
N_FLOAT_ROWS, N_INT_ROWS, LANES = 22, 17, 16
WARM = 1

_matrix, _vector = (types.Array(types.float64, n, "C", readonly=True) for n in (2, 1))
_indices = types.Array(types.int64, 1, "C", readonly=True)
_floats, _ints = types.Array(types.float64, 2, "C"), types.Array(types.int64, 2, "C")
SIGNATURE = types.boolean(
    *(_matrix, _vector, _vector, _vector, _indices),
    *(_floats, _ints, types.float64, types.int64),
)

method_at = function_at(SIGNATURE)
"""`solve` itself, from its address, which kernels are handed."""


class CompiledMethod(NamedTuple):
    """A QP method: the address of its `solve`, made by `kernels.compiled.function_decorator`, and
    its mode."""

    solve: int
    mode: int


class Room(NamedTuple):
    """S, I and the accuracy to ask for; warm : whether they remember an earlier QP."""

    S: Vector
    I: Indices
    eps0: float
    warm: bool


class CompiledSolver(Protocol):
    """A solver whose QP method can be called from compiled steps."""

    def compiled(self, k: int) -> CompiledMethod | None:
        """The method for QPs of up to k columns; None where one call per QP is no slower."""

    def room(self, m: int, k: int, eps0: float, start: Solution | None) -> Room:
        """Room for QPs of up to m rows and k columns, with what `start` remembers."""

    def last_answer(self, room: Room) -> Solution:
        """The answer to the last QP that was solved there."""


@kernel
def room_size(m, k):
    """n of a room for m rows and k columns."""
    return (max(m, k) + LANES - 1) // LANES * LANES


NO_METHOD = 0, np.zeros((1, 1)), np.zeros((1, 1), np.int64), 0.0, 0
"""solve, S, I, eps0 and mode where there is none, and QPs are asked for."""
