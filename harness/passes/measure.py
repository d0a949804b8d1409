"""One pass of one solver over a recorded sequence, with the clock around every call.

1. What a solve is started from is the business of `harness.passes.starts`; it is made ready before
   the clock is read.
2. The garbage collector runs before a pass and sleeps during it, so that no solver pays for
   another's litter.
3. The solver's own clocks tell build, setup and solve; ours, around the whole call, `call_time`.
   They are `believed` as far as they agree.
4. A backend that raises, or returns no Solution, loses that QP, not the pass; running out of
   memory or leaving the program (`FATAL`) is a crash.  One that has overstepped the time limit
   `PATIENCE` times in a row is not tried on the rest.
5. After the pass the QPs are compared with what they were (`Inputs`): one that a backend has
   written into, which compiled code can, is put right, and the backend loses that QP.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from harness.passes.starts import Starts
from harness.recordings.recording import Reference
from problems.qp import ContactQP, Solution, Status, Vector, WorkCounts
from solvers.base import Solver, Unsupported

PATIENCE = 20
"""Solves in a row beyond the time limit after which the rest of a pass is given up."""

FATAL = (MemoryError, SystemExit)
"""What would have ended a program that does not expect it."""

UNEXPLAINED = 0.01
"""Seconds of a call that a solver's own clocks may leave out."""

CLOCK = time.perf_counter
"""Bound once, so that a backend that puts another one into `time` does not put it here."""

WROTE = "wrote into the QP that it was given; the answer is not judged"


DISTURBED = "disturbed: "
"""What the status text begins with where it was not the solver's doing.  Such a row is not final:
it is tried again at once, and by whoever continues."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one call, without the solver's memory.

    verdict : "skipped", "failed", "timeout" or "crashed" where that is settled before any judging,
        else None
    status : name of the solver's Status, empty if it was not reached
    warm_started : whether a start was handed over
    after_restart : whether this QP of the warm group has no predecessor
    """

    verdict: str | None
    x: Vector | None = None
    found: bool = False
    status: str = ""
    status_text: str = ""
    iterations: int | None = None
    work: WorkCounts | None = None
    warm_started: bool = False
    after_restart: bool = False


class Watch:
    """Is told of a pass as it goes on, outside the clock.  This one takes no notice."""

    def begin(self, position: int) -> None:
        """The QP at this position of the order is about to be solved."""

    def end(self, index: int, outcome: Outcome, times: NDArray[np.float64]) -> None:
        """QP `index` has this outcome in these times (4,).  After the pass it may be told anew."""


UNWATCHED = Watch()


def _outcome_of(
    solution: Solution, qp: ContactQP, late: bool, warm_started: bool, alone: bool
) -> Outcome:
    """What a call returned, once it is sure to be a Solution that can be judged and stored."""
    if not isinstance(solution, Solution) or not isinstance(solution.status, Status):
        raise TypeError("the solver returned no Solution with a Status")
    x = None if solution.x is None else np.array(solution.x, dtype=np.float64)
    if x is not None and x.shape != (qp.k,):
        raise ValueError(f"the solver returned x of shape {x.shape}; expected ({qp.k},)")
    return Outcome(
        verdict="timeout" if late else None,
        x=x,
        found=solution.found,
        status=solution.status.name,
        status_text=str(solution.status_text),
        iterations=int(solution.iterations),
        work=solution.work,
        warm_started=warm_started,
        after_restart=alone,
    )


class Inputs:
    """The arrays of a sequence of QPs as they were, to tell what a backend has written into.

    They are read-only to Python, but a compiled backend need not ask.  Nor need one written in
    Python, which can put other arrays in their place.
    """

    def __init__(self, qps: Sequence[ContactQP]) -> None:
        self._kept = [[(array, array.tobytes()) for array in _arrays_of(qp)] for qp in qps]
        self._named = [(vars(qp), dict(vars(qp))) for qp in qps]

    def restore(self) -> set[int]:
        """Put right what was changed; returns the positions of the QPs concerned."""
        changed = set()
        for i, (now, before) in enumerate(self._named):
            if any(now.get(name) is not value for name, value in before.items()):
                now.update(before)
                changed.add(i)
        for i, kept in enumerate(self._kept):
            for array, content in kept:
                if array.tobytes() != content:
                    array.setflags(write=True)
                    array[...] = np.frombuffer(content, array.dtype).reshape(array.shape)
                    changed.add(i)
                array.setflags(write=False)
        return changed


def _arrays_of(qp: ContactQP) -> list[NDArray[Any]]:
    """Everything of a QP that is handed to a backend as an array."""
    A: Any = qp.A
    parts = [A.data, A.indices, A.indptr] if sp.issparse(A) else [A]
    parts += [qp.d, qp.lower, qp.upper, qp.row_id, qp.D]
    if sp.issparse(A) and "dense_A" in vars(qp):
        parts.append(qp.dense_A)
    return parts


def run_pass(
    solver: Solver,
    qps: Sequence[ContactQP],
    *,
    arm: str,
    references: Sequence[Reference | None] | None = None,
    time_limit: float = float("inf"),
    budget: float = float("inf"),
    first: int = 0,
    watch: Watch = UNWATCHED,
) -> tuple[list[Outcome], NDArray[np.float64]]:
    """Solve the sequence, in the order of the arm.

    arm : what each solve is started from, one of `harness.passes.starts.EVERY_ARM`
    references : the oracle's answers, one per QP; the arm "exact" starts from them
    time_limit : [s] beyond which a solve is a timeout, looked at after the call
    budget : [s] after which the pass ends early; the warm-up uses it
    first : where in the order to begin; what lies before it counts as never solved
    watch : told of each QP

    Returns the outcomes of the QPs that were come to, in the order of the recording, and the times
    of all (n, 4) [s]: build, setup, solve, call; NaN where unknown.
    Raises ValueError for an unknown arm.
    """
    starts = Starts(solver, arm, qps, references, first)
    outcomes: dict[int, Outcome] = {}
    times = np.full((len(qps), 4), np.nan)
    solution: Solution | None
    slow, clock = 0, CLOCK
    inputs = Inputs(qps)
    gc.collect()
    was_enabled = gc.isenabled()
    gc.disable()

    def come_to(i: int, outcome: Outcome) -> None:
        outcomes[i] = outcome
        watch.end(i, outcome, times[i])

    began = clock()
    try:
        for position, i in enumerate(starts.order[first:], first):
            qp, alone = qps[i], bool(starts.alone[i])
            start = starts.of(i)
            if slow >= PATIENCE:
                text = f"not tried: {PATIENCE} solves in a row took more than {time_limit:g} s"
                come_to(i, Outcome("timeout", status_text=text, after_restart=alone))
                continue
            watch.begin(position)
            t0 = clock()
            try:
                solution = solver.solve(qp, start)
                t1 = clock()
                outcome = _outcome_of(solution, qp, t1 - t0 > time_limit, start is not None, alone)
                timing = solution.timing
                times[i] = timing.build, timing.setup, timing.solve, t1 - t0
            except Unsupported as reason:
                come_to(i, Outcome("skipped", status_text=str(reason), after_restart=alone))
                continue
            except KeyboardInterrupt:
                raise
            # Any backend may raise anything, a panic of Rust or SystemExit too; the study goes on.
            except BaseException as error:
                t1 = clock()
                times[i, 3] = t1 - t0
                verdict = "crashed" if isinstance(error, FATAL) else "failed"
                text = " ".join(f"{type(error).__name__}: {error}".split())
                outcome = Outcome(verdict, status_text=text, after_restart=alone)
                solution = None
            come_to(i, outcome)
            slow = slow + 1 if t1 - t0 > time_limit else 0
            starts.take(i, solution)
            if t1 - began > budget:
                break
    finally:
        if was_enabled:
            gc.enable()
    for i in inputs.restore():
        if i in outcomes:
            come_to(i, replace(outcomes[i], verdict="failed", status_text=WROTE, x=None))
    return [outcomes[i] for i in sorted(outcomes)], times


def pose(qps: Sequence[ContactQP], asked: Sequence[float]) -> list[ContactQP]:
    """The QPs with the accuracies that are asked of them, in ‖A δx‖."""
    pairs = zip(qps, asked, strict=True)
    return [qp if qp.eps0 == eps0 else qp.with_accuracy(eps0) for qp, eps0 in pairs]


def believed(times: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[int]]:
    """Times (n, 4) [s] less what cannot be: a solver's own clocks hold only within ours.

    Build, setup and solve become NaN, so that the whole call counts,

    1. where they are impossible: negative or not finite, or nothing for setup and solve together,
       or more than the call;
    2. where they leave more than half of the call and more than `UNEXPLAINED` out.  That need be no
       lie: it can be an interruption by the system.

    What an adapter hides beyond that shows in `call_time`, which tables have beside `runtime`.
    Returns these times and the positions of the impossible.
    """
    own, call = times[:, :3], times[:, 3]
    total = own.sum(axis=1)
    with np.errstate(invalid="ignore"):
        possible = (own >= 0).all(axis=1) & (own[:, 1] + own[:, 2] > 0) & (total <= call)
        explained = call - total <= np.maximum(UNEXPLAINED, call / 2)
        nonsense = ~((call >= 0) & (call < np.inf))
    impossible = ~possible & ~np.isnan(own).all(axis=1)
    cleared = times.copy()
    cleared[~(possible & explained), :3] = np.nan
    cleared[nonsense, 3] = np.nan
    return cleared, np.flatnonzero(impossible).tolist()
