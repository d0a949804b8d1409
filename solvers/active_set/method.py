"""Algorithm 2 for min ½‖A x + d‖², lower ≤ x ≤ upper: what `lotstedt` and `glambda` share.

Lötstedt 1984, §3.2, for bounds on both sides (§4.2) and columns scaled to length 1, compiled (see
`loop`).  Every variable is in one of three sets: F, free, whose columns A_F are independent and
have a QR factorization; X, at a bound; P, passive: between its bounds, its column dependent on
A_F, its x kept as it is.  Contacts that share a load redundantly make P.

    1.  F, its R and a feasible x from the previous QP, or cold
    2.  r = A x + d
    3.  descent direction: A_Fᵀ A_F p + A_Fᵀ r = 0                                        (3.19)
    4.  the longest step θ p, 0 ≤ θ ≤ 1, within the bounds
    5.  x := x + θ p on F, and r anew
    6.  each x_j that reached a bound moves from F to X, its column leaves the QR; back to 3
    7.  gradient Δ = Aᵀ r
    8.  the worst wrong sign over X, |Δ_j| over P: if it exceeds ε₁, j moves to F; back to 3
    9.  end

Most QPs end after one descent direction, because F of the previous step is right.

Where R comes from, and when A_F is factorized anew, is what the two differ in (`lotstedt`,
`glambda`).  Both take today's factorization for impulses.

This differs from the paper:

1. ε₀ is divided by 10 in (3.20) and in ε₁, so that sign errors, the error of p and the estimate of
   ‖R⁻¹‖, which is from below, together stay under ε₀.  Both tolerances are floored at the rounding
   of Δ, 4u‖|A||x| + |d|‖.
2. r is computed afresh in step 5, so that rounding does not gather.  Where ‖A_Fᵀ r‖ after a full
   step is still above (3.20), step 3 is repeated with the same F: refinement, not counted as
   another descent direction.
3. A passive variable at one of its bounds is tested like a member of X: an entry that could only
   be blocked at once is not tried.
4. A Δ_j below ε₁ is not enough to end: a column close to the span of A_F moves A x far on a
   small Δ_j.  Where one has the wrong sign beyond rounding, the move of A x that freeing x_j would
   give is computed, and compared with ε₀ (`loop.append_column`).
5. A variable that enters and is thrown back before A x has moved, and one whose column depends on
   A_F, are barred until A x moves (or F loses a column).  Each pass then lowers the objective,
   shrinks F or bars a variable, so that rounding cannot make it cycle.  In exact arithmetic neither
   happens: after step 7 A_Fᵀ r = 0, so that an entering variable moves off its bound, and
   a_j = A_F w gives Δ_j = wᵀ A_Fᵀ r = 0.
6. Where conjugate gradients fail although R is today's, or would end with a wrong sign that
   matters, the QP is finished with exact Q and R.  That is met with columns within 1e-6 of
   dependence, not in the paper's scenes.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.kernels.compiled import Direct
from problems.qp import (
    REAL,
    ContactQP,
    Matrix,
    Solution,
    Status,
    Vector,
    WorkCounts,
    distinct_ids,
    usual,
)
from problems.qp_kernel import WARM
from solvers.active_set.compiled import entry
from solvers.active_set.loop import CUSTOM, EXTRAPOLATED, UNCHECKED, algorithm_2, solve
from solvers.active_set.newton import MOST
from solvers.active_set.room_answer import Clock, answered, staged
from solvers.active_set.sparse.loop import TODAYS_A, sparse_algorithm_2
from solvers.active_set.sparse.pattern import is_narrow, make_pattern
from solvers.active_set.sparse.workspace import SparseWorkspace, make_sparse_workspace
from solvers.active_set.workspace import (
    AGE,
    BEFORE,
    CG_LIMIT,
    COUNTS,
    DIRECTIONS,
    FLOPS,
    INACCURATE,
    INTERVAL,
    LAST_TIME,
    MEMBER,
    OLD_K,
    OLD_MEMBER,
    OLD_ORDER,
    OLD_ROW,
    ORDER,
    PASSES,
    REALS,
    REFUSED,
    SOLVED,
    STATUS,
    TIME,
    TIME_BEFORE,
    WRONG,
    Workspace,
    X,
    make_workspace,
)
from solvers.base import Answer, Form, Solver, Start, started, usable

CROSSOVER = 48
"""Columns up to which today's factorization is faster than an old R, where A is sparse.

Measured, µs per QP, on frictionless towers / walls of this many columns, as k: today's by normal
equations, old R dense, old R sparse.  16: 2.7, 3.7, 10 / 2.2, 6.9, 9.3.  32 / 36: 7.8, 7.1, 12 /
5.7, 23, 12.  48 / 50: 18, 14, 15 / 8.1, 50, 14.  80 / 100: 68, 32, 19 / 32, 20, 24.
"""
THIN_CROSSOVER, THIN = 80, 0.1
"""The same where a sparse A has no more than this share of entries, and no more columns than rows:
there columns that are neighbours are, and L is narrow.

Measured, µs per QP, warm, today's / sparse: tower of 20 with friction (45 columns) 7 / 11, heap of
50 with friction (75) 34 / 50, 80 columns of cubes in space 5 / 10, tower of 50 (100) 20 / 18.  But
51 columns of a robot's joints, a share of 0.13, 17 / 11; 64 of walls, more than rows, 29 / 16.
"""
COLD_CROSSOVER = 160
"""The same for a cold start, which has no pattern, no order of elimination and no R yet.

Measured, µs per QP, sparse / by normal equations: heap of 57 columns 482 / 59, tower of 80
458 / 76; with friction tower of 103 100 / 71, heap of 128 313 / 194, tower of 150 359 / 262; heap
of 160 287 / 273, tower of 220 372 / 416.  A sparse A with more columns than rows stays sparse:
there a load is spread over all contacts that share it, and the QPs that follow are soon done from
that.
"""
FULL = 0.25
"""Share of entries beyond which a sparse A is solved as a dense one.

Measured, µs, dense / sparse, cold, of random A with half of the entries: 30 by 100: 196 / 2,271,
60 by 200: 518 / 17,205; with 0.15 of them 259 / 1,074 and 531 / 4,571.  But of cubes on each other,
each with 12 of 60 entries, dense / sparse, warm: 120 columns 39 / 21.
"""
DENSE_CROSSOVER, FULL_CROSSOVER = MOST, 100
"""The same as `CROSSOVER` where A is a dense array; and where it is full and the start warm.

Measured, µs per QP, cold / warm, old R, by normal equations: with friction tower of 100 columns
450 / 68, 46 / 37, pyramid of 180 2,825 / 716, 227 / 520, wall of 172 2,001 / 425, 395 / 305; cubes
in space, 240 columns 2,627 / 192, 321 / 112; wall of 172 without friction 6,938 / 3,515,
9,217 / 2,309.  But of random numbers, which are full, 200 by 120 1,530 / 166, 333 / 311, 300 by 240
6,818 / 991, 1,763 / 1,652.
"""
BY_QR = 300
"""Columns up to which a sparse A whose x is not accurate is solved once more, by QR as dense: L of
A_FᵀA_F cannot tell columns apart that differ by 1e-6, and QR can.  At most it takes a second."""
EXACT_KINDS = ("impulse", "minimum_norm")
HANDED_OVER = CUSTOM | EXTRAPOLATED
"""Bits of a kernel that looks for what `ActiveSet.hand_over` writes."""
DEFAULT = -1.0
"""As an accuracy: `loop.default_accuracy`."""
STATUSES = {SOLVED: Status.SOLVED, INACCURATE: Status.INACCURATE}


def compile_dense() -> None:
    """Have what solves dense QPs as machine code, of the cache or new, before the first call."""
    global run_dense
    _ = solve.address
    run_dense = entry(
        algorithm_2,
        *("matrix", "vector", "vector", "vector", "indices", "floats", "ints", "float", "int"),
    )


def _compiled_first(*arguments: Any) -> None:
    compile_dense()
    run_dense(*arguments)


run_dense: Callable[..., Any] = _compiled_first
run_sparse = Direct(sparse_algorithm_2)
"""Both as callables that trust their arguments: `ContactQP` has made sure of them."""


def is_small_or_full(A: Matrix) -> bool:
    """Whether A is a dense array, or might as well be: of `CROSSOVER` columns at most, or full."""
    return (
        isinstance(A, np.ndarray)
        or A.shape[1] <= CROSSOVER
        or A.nnz > FULL * A.shape[0] * A.shape[1]
    )


def is_thin(A: Matrix) -> bool:
    """Whether A is sparse, of `THIN` entries."""
    return not isinstance(A, np.ndarray) and A.nnz <= THIN * A.shape[0] * A.shape[1]


def is_full(A: Vector) -> bool:
    """Whether a dense array might not as well be sparse."""
    return bool(np.count_nonzero(A) > FULL * A.size)


class Modes(NamedTuple):
    """The bits that the kernels are called with, but for `WARM`.

    small : for up to `crossover` columns, cold for up to `cold`, where A is thin for up to `thin`,
        where it is dense for up to `array`, or `full`, and for `EXACT_KINDS` of any size
    dense, sparse : for the others
    """

    small: int
    dense: int
    sparse: int
    crossover: int
    cold: int
    thin: int
    array: int
    full: int

    def narrow(self, qp: ContactQP, warm: bool) -> bool:
        """Whether columns are few, of a sparse A."""
        k = qp.lower.size
        few = k <= (self.crossover if warm else self.cold)
        return few or (k <= self.thin and is_thin(qp.A))

    def factorizes(self, A: Vector, warm: bool) -> bool:
        """Whether A, a dense array, is factorized anew at every QP."""
        k = A.shape[1]
        return k <= self.full or (k <= self.array and not (warm and is_full(A)))

    def dense_is_better(self, qp: ContactQP, warm: bool) -> bool:
        """Whether A is a dense array, or a sparse one that is solved as one."""
        return is_small_or_full(qp.A) or (qp.k <= qp.m and self.narrow(qp, warm))


PLAIN = 0x101
"""Bits of `ndarray.flags.num`: in C order, and aligned."""


def are_plain(A: Any, d: Any, lower: Any, upper: Any) -> bool:
    """Whether these are arrays that compiled code may be handed, of sizes that agree."""
    array = np.ndarray
    return (
        (A.__class__ is d.__class__ is lower.__class__ is upper.__class__ is array)
        and (A.dtype is d.dtype is lower.dtype is upper.dtype is REAL)
        and A.flags.num & d.flags.num & lower.flags.num & upper.flags.num & PLAIN == PLAIN
        and A.ndim == 2
        and d.shape == A.shape[:1]
        and lower.shape == upper.shape == A.shape[1:]
    )


Call = tuple[tuple[Any, ...], Workspace | SparseWorkspace]
"""The arguments of `algorithm_2` or of `sparse_algorithm_2`, and the room among them."""


def check_limit(option: str, value: float | None) -> None:
    """Raise ValueError where a limit is neither None nor a number ≥ 0."""
    if value is not None and not value >= 0:
        raise ValueError(f"{option} = {value!r}; give a number ≥ 0, or None")


def remember(room: Workspace | SparseWorkspace, start: Start) -> None:
    """Make `room` as if the solution of `start`, which is not from such a room, had been there."""
    k = start.x.size
    counts = room.I[COUNTS]
    counts[OLD_K], counts[OLD_ORDER], counts[AGE] = k, -1, 0
    room.I[OLD_ROW, :k] = start.previous
    room.I[OLD_MEMBER, :k] = start.working_set
    room.S[X, :k] = start.x
    room.S[BEFORE, :k] = np.nan
    room.S[REALS, [LAST_TIME, TIME_BEFORE]] = np.inf


def dense_room(m: int, k: int, start: Start) -> Workspace:
    """A workspace that holds what `start` remembers."""
    room = start.memory
    if not isinstance(room, Workspace):
        room = make_workspace(0, start.x.size)
        remember(room, start)
    return make_workspace(m, k, room)


def room_after(start: Solution, m: int, k: int) -> Workspace | None:
    """The workspace of `start` if it is one and large enough, else one that holds what it knows.

    None where it knows nothing.  What a workspace remembers is finite.
    """
    room = start.memory
    if type(room) is Workspace and room.n >= k and room.n >= m:
        return room
    known = usable(start)
    if known is None or known.x is None:
        return None
    return dense_room(m, k, Start(known.x, known.working_set, known.row_id, room))


def kept_room(start: Solution | None, A: Matrix) -> SparseWorkspace | None:
    """The workspace of `start` if it is of the pattern of A: who went sparse before, goes so now.

    What it remembers is finite where it was solved.
    """
    if start is None or type(start.memory) is not SparseWorkspace or not start.found:
        return None
    fits = not isinstance(A, np.ndarray) and start.memory.pattern.fits(A)
    return start.memory if fits else None


def sparse_room(A: sp.csc_array, start: Start | None) -> tuple[SparseWorkspace, bool] | None:
    """A workspace of the pattern of A with what `start` remembers; whether it holds its L too.

    None where a column of A has more than `WIDEST` entries.
    """
    before = None if start is None else start.memory
    if not isinstance(before, SparseWorkspace):
        before = None
    elif before.pattern.fits(A):
        return before, True
    if not is_narrow(A):
        return None
    old_k = 0 if start is None else start.x.size
    room = make_sparse_workspace(max(A.shape[0], old_k), make_pattern(A), before)
    if before is None:
        room.I[COUNTS, ORDER] = A.shape[1] + 1
        if start is not None:
            remember(room, start)
    return room, False


@dataclass(frozen=True)
class ActiveSet(Solver):
    """Algorithm 2, compiled; `modes` tells which of its inner parts are used.

    iteration_limit : passes of the main loop before giving up; None: 50 + 20 k

    Raises ValueError for a negative limit.
    """

    iteration_limit: int | None = None
    _modes: Modes = field(init=False, repr=False, compare=False)
    _eps0: float | None = field(init=False, repr=False, compare=False)

    form: ClassVar[Form] = "least_squares"
    warm_start: ClassVar[str] = "working set and factorisation"
    maps_rows: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_limit("iteration_limit", self.iteration_limit)
        object.__setattr__(self, "_modes", self.modes())
        asked = DEFAULT if self.accuracy == "default" else self.accuracy
        object.__setattr__(self, "_eps0", None if asked is None else float(asked))

    @abc.abstractmethod
    def modes(self) -> Modes:
        """The bits for this solver's options, `CUSTOM` among them where it has any."""

    def adopt(self, memory: Any, start: Solution) -> Any:
        """The room of the last solve, if that was not sparse, with x and F of `start` and no R."""
        if not isinstance(memory, Workspace) or start.x is None:
            return None
        room = make_workspace(0, start.x.size, memory)
        remember(room, Start(start.x, start.working_set, start.row_id, None))
        return room

    def build(self, qp: ContactQP, start: Start | None) -> ContactQP:
        """Nothing: A and d are the method's own form."""
        return qp

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """As every solver's, without what the general form of its stages would cost."""
        eps0 = qp.eps0 if self._eps0 is None else self._eps0
        began = perf_counter()
        dense = isinstance(qp.A, np.ndarray)
        kept = None if dense else kept_room(start, qp.A)
        room: Workspace | SparseWorkspace
        if kept is not None:
            arguments, room = self._sparse(qp, eps0, kept, True, True)
            ready = perf_counter()
            run_sparse(*arguments)
        elif dense or self._modes.dense_is_better(qp, start is not None):
            old = None if start is None else room_after(start, qp.d.size, qp.lower.size)
            arguments, room = self._dense(qp, eps0, old)
            ready = perf_counter()
            run_dense(*arguments)
        else:
            arguments, room = self.setup(qp, eps0, started(start))
            ready = perf_counter()
            self.run((arguments, room))
        status = room.I.item(STATUS)  # of row COUNTS, which is the first
        if status == INACCURATE and type(room) is SparseWorkspace and qp.lower.size <= BY_QR:
            arguments, room = self._dense(qp, eps0, None)
            run_dense(*arguments)
            status = room.I.item(STATUS)
        clock = began, ready, perf_counter()
        if status == SOLVED:
            return answered(room, qp.row_id, clock)
        return self._read_out(qp, (arguments, room), clock)

    def solve_arrays(
        self,
        A: Any,
        d: Any,
        lower: Any,
        upper: Any,
        *,
        row_id: Any = None,
        start: Solution | None = None,
        t: float = 0.0,
        eps0: float = 1e-9,
    ) -> Solution:
        """As every solver's; float64 arrays in C order are not copied, and the kernel checks them.

        What it does not like, fixed rows among it, a `ContactQP` takes or refuses.
        """
        plain = are_plain(A, d, lower, upper) and 0.0 < eps0 < inf and -inf < t < inf
        if not plain or self._modes.small & HANDED_OVER:
            return self.solve(ContactQP(A, d, lower, upper, row_id, t=t, eps0=eps0), start)
        began = perf_counter()
        m, k = A.shape
        rows = usual("row_id", k) if row_id is None else distinct_ids(row_id, A)
        room = None if start is None else room_after(start, m, k)
        modes = self._modes
        mode = UNCHECKED | (modes.small if modes.factorizes(A, room is not None) else modes.dense)
        if room is None:
            room = make_workspace(m, k)
        else:
            mode |= WARM
        asked = eps0 if self._eps0 is None else self._eps0
        arguments = A, d, lower, upper, rows, room.S, room.I, asked, mode
        ready = perf_counter()
        run_dense(*arguments)
        clock = began, ready, perf_counter()
        status = room.I.item(STATUS)
        if status == SOLVED:
            return answered(room, rows, clock)
        qp = ContactQP(A, d, lower, upper, row_id, t=t, eps0=eps0)
        if status == REFUSED:
            return self.solve(qp, start)
        return self._read_out(qp, (arguments, room), clock)

    def _read_out(self, qp: ContactQP, call: Call, clock: Clock) -> Solution:
        """The answer that a call has left in its room, all of it."""
        answer, room = self.read(qp, call, None), call[1]
        assert answer.working_set is not None
        return Solution(
            *(answer.x, qp.row_id, answer.status, answer.working_set, answer.iterations),
            *(answer.status_text, answer.work, staged(clock), room),
        )

    def _dense(self, qp: ContactQP, eps0: float, room: Workspace | None) -> Call:
        """The call of `algorithm_2`, its workspace a new one, or what it remembers."""
        A, d, lower, modes = qp.dense_A, qp.d, qp.lower, self._modes
        small = modes.factorizes(A, room is not None) or qp.kind in EXACT_KINDS
        mode = modes.small if small else modes.dense
        if room is None:
            room = make_workspace(d.size, lower.size)
        else:
            mode |= WARM
        if mode & HANDED_OVER:
            self.hand_over(room, qp.t)
        return (A, d, lower, qp.upper, qp.row_id, room.S, room.I, eps0, mode), room

    def _sparse(
        self, qp: ContactQP, eps0: float, room: SparseWorkspace, kept: bool, warm: bool
    ) -> Call:
        """The call of `sparse_algorithm_2` in a room that holds L, or does not."""
        mode = self._modes.sparse
        if qp.kind == "minimum_norm":
            mode |= TODAYS_A
        if warm:
            mode |= WARM
        if mode & HANDED_OVER:
            self.hand_over(room, qp.t)
        A = qp.A.data, qp.d, qp.lower, qp.upper, qp.row_id
        return (*A, room.pattern, room.Bx, room.Lx, room.S, room.I, kept, eps0, mode), room

    def setup(self, problem: ContactQP, asked: float | None, start: Start | None) -> Call:
        """Find room; everything else is part of `run`."""
        eps0 = DEFAULT if asked is None else asked
        if not self._modes.dense_is_better(problem, start is not None):
            found = sparse_room(problem.A, start)
            if found is not None:
                return self._sparse(problem, eps0, *found, start is not None)
        room = None if start is None else dense_room(problem.m, problem.k, start)
        return self._dense(problem, eps0, room)

    def hand_over(self, room: Workspace | SparseWorkspace, t: float) -> None:
        """Write the options, and the time t of the QP, to where the kernels look for them."""
        reals, counts = room.S[REALS], room.I[COUNTS]
        reals[TIME] = t
        counts[PASSES] = -1 if self.iteration_limit is None else self.iteration_limit
        counts[INTERVAL], reals[CG_LIMIT] = 0, -1.0

    def run(self, native: Call) -> None:
        """Algorithm 2."""
        arguments, room = native
        if type(room) is Workspace:
            run_dense(*arguments)
        else:
            run_sparse(*arguments)

    def read(self, qp: ContactQP, native: Call, result: Any) -> Answer:
        """x, the working set and the counts out of the workspace."""
        room, k = native[1], qp.k
        counts = room.I[COUNTS].tolist()
        work = WorkCounts(*counts[DIRECTIONS : FLOPS + 1])
        status = STATUSES.get(counts[STATUS], Status.ITERATION_LIMIT)
        complaint = ""
        if status is Status.INACCURATE:
            complaint = f"largest wrong gradient {room.S[REALS, WRONG]:.1e}"
        elif status is Status.ITERATION_LIMIT:
            complaint = f"{work.descent_directions} descent directions were not enough"
        return Answer(
            x=room.S[X, :k].copy(),
            status=status,
            iterations=work.descent_directions,
            status_text=complaint,
            working_set=room.I[MEMBER, :k].astype(np.int8),
            work=work,
            memory=room,
        )
