"""The measured side: a solver that is asked one QP at a time, and answers.

1. What a solve is started from is made ready by `harness.passes.starts` before the clock is read;
   what the solver itself does to make use of it (`Solver.adopt`) is within the call.
2. The clock is read again when x has become an array of float64 of the right shape: whoever
   calculates later pays for it.
3. The garbage collector runs before a pass and sleeps during it.
4. A backend that raises, or returns no Solution, loses that QP; running out of memory or leaving
   the program (`FATAL`) is a crash.  So does one that has written into the QP, which compiled code
   can: it has its own copy, and harms nobody.

Whatever is said here is not believed by itself: who asks has clocks of his own (`clocks`).
"""

from __future__ import annotations

import gc
import time
import zlib
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from harness.passes.outcome import Outcome
from harness.passes.starts import Starts
from harness.passes.wire import Question, answered, unpacked
from problems.qp import ContactQP, Solution, Status, Vector
from solvers.base import Answer, Solver, Unsupported

FATAL = (MemoryError, SystemExit)
"""What would have ended a program that does not expect it."""
CLOCK = time.perf_counter
"""Bound once, so that a backend that puts another one into `time` does not put it here."""
WROTE = "wrote into the QP that it was given; the answer is not judged"


class Bench:
    """A solver in an arm, asked by `answer`."""

    def __init__(self, solver: Solver, arm: str) -> None:
        self._solver, self._arm = solver, arm
        self._starts = Starts(solver, arm)

    def answer(self, message: bytearray) -> bytes:
        """The answer to a question, both as bytes (`harness.passes.wire`)."""
        before = zlib.crc32(message)
        question = unpacked(message)
        if question.fresh:
            self._starts = Starts(self._solver, self._arm)
            gc.collect()
        outcome, told = self._solve(question)
        if zlib.crc32(message) != before:
            outcome = replace(outcome, verdict="failed", status_text=WROTE, x=None)
        return answered(message, outcome, told, question.qp.k)

    def _solve(self, question: Question) -> tuple[Outcome, tuple[float, ...]]:
        """Outcome and times (`wire.TOLD`) of one solve."""
        qp, solver, clock = question.qp, self._solver, CLOCK
        start, adopt = self._starts.of(question)
        solution: Solution | None = None
        nothing = (np.nan,) * 3
        t0 = clock()
        try:
            if adopt:
                assert start is not None
                start = replace(start, memory=solver.adopt(start.memory, start))
            solution = solver.solve(qp, start)
            x = _array(solution, qp)
            t1 = clock()
            outcome = _outcome(solution, x, start is not None)
            timing = solution.timing
            told = timing.build, timing.setup, timing.solve, t1 - t0, timing.inside
        except Unsupported as reason:
            return Outcome("skipped", status_text=str(reason)), (*nothing, np.nan, np.nan)
        except KeyboardInterrupt:
            raise
        # Any backend may raise anything, a panic of Rust or SystemExit too; the study goes on.
        except BaseException as error:
            told = (*nothing, clock() - t0, np.nan)
            verdict = "crashed" if isinstance(error, FATAL) else "failed"
            text = " ".join(f"{type(error).__name__}: {error}".split())
            outcome, solution = Outcome(verdict, status_text=text), None
        self._starts.take(qp, solution)
        return outcome, told


def _array(solution: Solution, qp: ContactQP) -> Vector | None:
    """x of a Solution, as a new array.  Raises TypeError or ValueError where there is none."""
    if not isinstance(solution, Solution) or not isinstance(solution.status, Status):
        raise TypeError("the solver returned no Solution with a Status")
    given = solution.x
    if given is None:
        return None
    x = np.array(given, dtype=np.float64)
    if x.shape != (qp.k,):
        raise ValueError(f"the solver returned x of shape {x.shape}; expected ({qp.k},)")
    return x


def _outcome(solution: Solution, x: Vector | None, warm_started: bool) -> Outcome:
    return Outcome(
        verdict=None,
        x=x,
        found=solution.found,
        status=solution.status.name,
        status_text=str(solution.status_text),
        iterations=int(solution.iterations),
        work=solution.work,
        warm_started=warm_started,
    )


@dataclass(frozen=True)
class Nobody(Solver):
    """Answers 0 at once: what it takes is what asking takes."""

    name: ClassVar[str] = ""
    warm_start: ClassVar[str] = "x"

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        return Solution(np.zeros(qp.k), qp.row_id, Status.SOLVED, np.zeros(qp.k, np.int8))

    def build(self, *_: Any) -> Any: ...
    def setup(self, *_: Any) -> Any: ...
    def run(self, *_: Any) -> Any: ...
    def read(self, *_: Any) -> Answer:
        raise NotImplementedError
