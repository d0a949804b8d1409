"""Backends that commit, on purpose, what a backend may do to a study; and what becomes of each.

Every one answers rightly but for the QP at the time `SCENE`, where it commits its crime, once per
pass.  `CRIMES` says what is to be found in the row of that QP.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

from harness.passes.wire import READY
from harness.processes.confined import is_confined
from problems.qp import ContactQP, Solution, Status, Timing, WorkCounts
from solvers.active_set.glambda import Glambda
from solvers.base import Answer, Solver, Unsupported

SCENE = 0.02
"""Time of the QP at which crimes are committed [s]: the third of a fake recording."""
MEMORY_LIMIT = 0.5
"""For the study of crimes [GiB]: enough for the honest."""
KEPT: list[Any] = []
DOUBT = "its own clock is not believed"


@dataclass(frozen=True)
class Honest(Solver):
    """Right always; the base of the criminals."""

    name: ClassVar[str] = "honest"
    warm_start: ClassVar[str] = "x"

    def build(self, qp: ContactQP, start: Any) -> Any:
        return qp

    def setup(self, problem: Any, asked: float | None, start: Any) -> Any:
        return problem

    def run(self, native: Any) -> Any:
        if native.t == SCENE:
            self.crime(native)
        return self.answer(native, Glambda(1e-13).solve(native).x)

    def crime(self, qp: ContactQP) -> None:
        """Nothing."""

    def answer(self, qp: ContactQP, x: Any) -> Any:
        return self.wrong(qp, x) if qp.t == SCENE else x

    def wrong(self, qp: ContactQP, x: Any) -> Any:
        """What it answers at the scene of the crime."""
        return x

    def read(self, qp: ContactQP, native: Any, result: Any) -> Answer:
        return Answer(result, Status.SOLVED, iterations=3)


def committing(crime: Callable[[ContactQP], Any]) -> type[Honest]:
    """A solver that does `crime(qp)` before it answers."""
    return _made(crime.__name__, crime=lambda self, qp: crime(qp))


def answering(wrong: Callable[[ContactQP, Any], Any]) -> type[Honest]:
    """A solver that answers `wrong(qp, x)`."""
    return _made(wrong.__name__, wrong=lambda self, qp, x: wrong(qp, x))


def solving(change: Callable[[Solution], Any]) -> type[Honest]:
    """A solver that returns `change(solution)`."""

    def solve(self: Honest, qp: ContactQP, start: Solution | None = None) -> Any:
        solution = Solver.solve(self, qp, start)
        return change(solution) if qp.t == SCENE else solution

    return _made(change.__name__, solve=solve)


def as_it_is(solver: type[Honest]) -> type[Honest]:
    """A solver that is written out."""
    return solver


def _made(name: str, **methods: Any) -> type[Honest]:
    return dataclass(frozen=True)(type(name, (Honest,), {"__module__": __name__, **methods}))


class Crime(NamedTuple):
    """A criminal, and what is to be found: verdict and status text, a regular expression.

    at_the_end : it is found out when the pass is over, so the row is that of the last QP
    """

    solver: type[Honest]
    verdict: str
    text: str
    at_the_end: bool

    def row(self, rows: pd.DataFrame) -> pd.Series:
        """The row of the crime, of one solver's rows in order."""
        return rows[rows["t"] == SCENE].iloc[0] if not self.at_the_end else rows.iloc[-1]


CRIMES: dict[str, Crime] = {}


def crime(
    verdict: str,
    text: str = "",
    by: Callable[[Any], type[Honest]] = committing,
    at_the_end: bool = False,
) -> Callable[[Any], type[Honest]]:
    """Enter what is decorated into `CRIMES`."""

    def enter(what: Any) -> type[Honest]:
        solver = by(what)
        CRIMES[what.__name__] = Crime(solver, verdict, text, at_the_end)
        return solver

    return enter


def targets() -> dict[str, str]:
    """Name → "module:Class" of the honest one and all criminals."""
    return {name: f"{__name__}:{name}" for name in ("Honest", *CRIMES)}


# It dies.


@crime("crashed", "SIGSEGV")
def segfault(qp: ContactQP) -> None:
    ctypes.string_at(0)


@crime("crashed", "SIGABRT: free\\(\\): invalid pointer")
def abort(qp: ContactQP) -> None:
    os.write(2, b"free(): invalid pointer\n")
    os.abort()


@crime("crashed", "SIG(SEGV|BUS)")
def stack_overflow(qp: ContactQP) -> None:
    sys.setrecursionlimit(10**9)
    nested: tuple[Any, ...] = ()
    for _ in range(10**6):
        nested = (nested,)
    hash(nested)


@crime("crashed", "left with exit code 0")
def leaves_at_once(qp: ContactQP) -> None:
    os._exit(0)


@crime("crashed", "SystemExit: 3")
def wants_to_leave(qp: ContactQP) -> None:
    sys.exit(3)


@crime("crashed", "left with exit code 1: .*KeyboardInterrupt")
def interrupts(qp: ContactQP) -> None:
    raise KeyboardInterrupt


@crime("crashed", r"SIGABRT: more and more \| more and more \| the last line$")
def screams_and_aborts(qp: ContactQP) -> None:
    for _ in range(30):
        os.write(1, b"more and more\n" * 10_000)
    os.write(2, b"the last line\n")
    os.abort()


@crime("crashed", "SIGABRT", by=as_it_is)
class dies_at_each(Honest):
    """It is given up after some."""

    def run(self, native: Any) -> Any:
        os.abort()


# It does not come back.


@crime("timeout", "killed: not back after")
def endless_loop(qp: ContactQP) -> None:
    while True:
        pass


@crime("timeout", "killed: not back after")
def endless_native_call_with_the_gil(qp: ContactQP) -> None:
    ctypes.PyDLL(None).sleep(100_000)


@crime("timeout", "killed: not back after")
def deaf_to_sigterm(qp: ContactQP) -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals))
    while True:
        os.kill(os.getpid(), signal.SIGTERM)


@crime("timeout", "killed: not back after")
def stops_itself(qp: ContactQP) -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


@crime("verified")
def hangs_at_the_exit(qp: ContactQP) -> None:
    atexit.register(time.sleep, 100_000)


# It takes what is not its own.


@crime("crashed", "MemoryError")
def memory_hog(qp: ContactQP) -> None:
    """Twice what it may take: at the limit itself, what the process gave back before decides."""
    KEPT.append(np.zeros(int(2.0 * MEMORY_LIMIT * 2**30 / 8)))


@crime("crashed", "MemoryError", by=as_it_is)
class leaks(Honest):
    """Some more at each QP, until it is too much at the third that a process solves."""

    def setup(self, problem: Any, asked: float | None, start: Any) -> Any:
        KEPT.append(np.zeros(int(0.4 * MEMORY_LIMIT * 2**30 / 8)))
        return problem


@crime("crashed", "left processes of its own behind: 3", at_the_end=True)
def forks(qp: ContactQP) -> None:
    for _ in range(3):
        if os.fork() == 0:
            _sleep_deaf()


@crime("crashed", "left processes of its own behind: 7", at_the_end=True)
def forks_forks(qp: ContactQP) -> None:
    """A bomb, but for its end: 7 processes, all of which are there when it goes on."""
    us = os.getpid()
    heard, said = os.pipe()
    for _ in range(3):
        os.fork()
    if os.getpid() != us:
        os.write(said, b".")
        _sleep_deaf()
    for _ in range(7):
        os.read(heard, 1)


@crime("crashed", "left processes of its own behind: 1", at_the_end=True)
def forks_a_daemon(qp: ContactQP) -> None:
    child = os.fork()
    if child == 0:
        os.setsid()
        if os.fork() == 0:
            _sleep_deaf()
        os._exit(0)
    os.waitpid(child, 0)


@crime("crashed", "SIGSEGV")
def forks_and_dies(qp: ContactQP) -> None:
    forks_a_daemon.crime(None, qp)  # type: ignore[arg-type]
    if os.fork() == 0:
        _sleep_deaf()
    ctypes.string_at(0)


def _sleep_deaf() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals))
    while True:
        time.sleep(1000)


@crime(
    *(
        ("failed", "PermissionError")
        if is_confined()
        else ("crashed", "the server of all processes")
    )
)
def kills_its_parent(qp: ContactQP) -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(100)


# It speaks out of turn.


@crime("verified")
def prints_megabytes(qp: ContactQP) -> None:
    for _ in range(3000):
        print("x" * 1000)
        print("y" * 1000, file=sys.stderr)


@crime("failed", "RuntimeError: x+$")
def raises_a_long_story(qp: ContactQP) -> None:
    raise RuntimeError("x" * 10**7)


@crime("failed", "Surprise: unheard of")
def raises_a_base_exception(qp: ContactQP) -> None:
    raise type("Surprise", (BaseException,), {})("unheard of")


@crime("failed", "RecursionError")
def recurses(qp: ContactQP) -> None:
    recurses.crime(None, qp)  # type: ignore[arg-type]


@crime("crashed", "left with exit code 1")
def closes_its_files(qp: ContactQP) -> None:
    os.closerange(0, 256)


@crime("crashed", "wrote into the pipe to its parent")
def babbles(qp: ContactQP) -> None:
    for number in range(3, 64):
        with contextlib.suppress(OSError):
            os.write(number, b"\x00\xffnonsense")


@crime("crashed", "wrote into the pipe to its parent")
def says_that_it_is_done(qp: ContactQP) -> None:
    for number in range(3, 64):
        with contextlib.suppress(OSError):
            os.write(number, READY)


# What it returns is no answer.


@crime("failed", by=answering)
def nan(qp: ContactQP, x: Any) -> Any:
    return np.full(qp.k, np.nan)


@crime("failed", by=answering)
def nothing(qp: ContactQP, x: Any) -> Any:
    return None


@crime("failed", "returned x of shape", by=answering)
def wrong_shape(qp: ContactQP, x: Any) -> Any:
    return np.append(x, 0.0)


@crime("failed", "ValueError: could not convert string", by=answering)
def words_for_numbers(qp: ContactQP, x: Any) -> Any:
    return ["one"] * qp.k


@crime("failed", "TypeError: the solver returned no Solution", by=solving)
def wrong_type(solution: Solution) -> Any:
    return {"x": solution.x}


@crime("failed", "what it recorded is no answer", by=solving)
def counts_beyond_all_bounds(solution: Solution) -> Any:
    return replace(solution, iterations=10**30)


@crime("failed", "what it recorded is no answer", by=solving)
def counts_in_words(solution: Solution) -> Any:
    return replace(solution, work=WorkCounts(flops="many"))  # type: ignore[arg-type]


# What it returns is an answer, and wrong.


@crime("claimed_wrong", by=answering)
def lies(qp: ContactQP, x: Any) -> Any:
    return x + 1.0


@crime("claimed_wrong", by=answering)
def wrong_signs(qp: ContactQP, x: Any) -> Any:
    """At the bounds, where any gradient could be carried if signs did not matter."""
    return np.where(np.isfinite(qp.lower), qp.lower, np.where(np.isfinite(qp.upper), qp.upper, x))


@crime("claimed_wrong", by=answering)
def easier_problem(qp: ContactQP, x: Any) -> Any:
    """Without the bounds: its residual is as small as can be."""
    return np.linalg.lstsq(qp.dense_A, -qp.d, rcond=None)[0]


@crime("claimed_wrong", by=as_it_is)
class previous_answer(Honest):
    """What it answered before, with zeros where there are more rows now."""

    def wrong(self, qp: ContactQP, x: Any) -> Any:
        return np.resize(np.append(KEPT[-1], np.zeros(qp.k)), qp.k)

    def answer(self, qp: ContactQP, x: Any) -> Any:
        KEPT.append(super().answer(qp, x))
        return KEPT[-1]


@crime("skipped", "not one that is so hard")
def picks_and_chooses(qp: ContactQP) -> None:
    raise Unsupported("not one that is so hard")


@crime("failed", "wrote into the QP that it was given")
def overwrites_its_input(qp: ContactQP) -> None:
    address = qp.d.ctypes.data
    ctypes.memset(address, 0, qp.d.nbytes)


# It lies about the time.


@crime("verified", DOUBT, by=solving)
def negative_time(solution: Solution) -> Any:
    return replace(solution, timing=Timing(1e-6, 1e-6, -1e-3))


@crime("verified", DOUBT, by=solving)
def no_time(solution: Solution) -> Any:
    return replace(solution, timing=Timing(0.0, 0.0, 0.0))


@crime("verified", DOUBT, by=solving)
def nan_for_a_time(solution: Solution) -> Any:
    return replace(solution, timing=Timing(1e-6, 1e-6, float("nan")))


@crime("verified", DOUBT, by=solving)
def more_time_than_there_was(solution: Solution) -> Any:
    return replace(solution, timing=Timing(0.0, 0.0, 1e6))


@crime("verified", by=solving)
def works_off_the_clock(solution: Solution) -> Any:
    time.sleep(0.03)
    return solution


@crime("verified", DOUBT, at_the_end=True)
def puts_back_the_clock(qp: ContactQP) -> None:
    time.perf_counter = lambda: 0.0
