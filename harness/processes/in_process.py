"""Runs of a replay in our own process, where no other can be forked: a crash ends the study.

It does what `harness.processes.isolate` does, without limits of time and memory.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

import numpy as np
from numpy.typing import NDArray

from harness.machine.threads import one_thread
from harness.passes.limits import WARM_UP, Pass
from harness.passes.measure import Outcome, Watch, pose, run_pass
from harness.processes.isolate import Task
from harness.recordings.recording import Recording
from solvers import make_solver

TELL_EVERY = 32
"""QPs between two reports of progress."""


class InProcess:
    """A recording at an accuracy, solved here.

    asked : accuracy of each QP in ‖A δx‖;  time_limit : [s] per solve

    Use it in a `with` statement: meanwhile there is one thread, and the garbage collector is spared
    from looking through all QPs before every pass.
    """

    def __init__(self, recording: Recording, asked: Sequence[float], *, time_limit: float) -> None:
        self._references = recording.references
        self._posed = pose(recording.qps, asked)
        self._time_limit = time_limit
        self._warm: set[Task] = set()
        self._meanwhile = ExitStack()

    def __enter__(self) -> InProcess:
        self._meanwhile.enter_context(one_thread())
        gc.collect()
        gc.freeze()
        self._meanwhile.callback(gc.unfreeze)
        return self

    def __exit__(self, *_: object) -> None:
        self._meanwhile.close()

    def do_pass(self, task: Task, advance: Callable[[int], None]) -> Pass:
        """A pass of `task`, warmed up before its first; `advance` is told how many QPs are done."""
        one_pass = partial(
            run_pass,
            make_solver(task.solver, **dict(task.options)),
            self._posed,
            arm=task.arm,
            references=self._references,
            time_limit=self._time_limit,
        )
        if task not in self._warm:
            one_pass(budget=WARM_UP)
            self._warm.add(task)
        return Pass(*one_pass(watch=_Teller(advance)))


class _Teller(Watch):
    """Tells now and then how many QPs more are done."""

    def __init__(self, advance: Callable[[int], None]) -> None:
        self.advance, self.count = advance, 0

    def end(self, index: int, outcome: Outcome, times: NDArray[np.float64]) -> None:
        self.count += 1
        if self.count % TELL_EVERY == 0:
            self.advance(TELL_EVERY)
