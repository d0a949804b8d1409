"""How good is the clock, and does the machine keep its pace?

1. `clock_facts` measures what no solver can be blamed for: the resolution of the clock, what
   reading it costs, and what a solve costs that does nothing (`Solver.solve` around four empty
   stages).  Times of that order say nothing.
2. `calibrate` times a fixed piece of work.  The replay runs it before every pass: where it takes
   longer the machine was slower, whoever was being timed.  It is neither compiled by us nor
   threaded, half interpreter and half memory, as a solver's call from Python is.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from problems.qp import ContactQP, Status, Vector
from solvers.base import Answer, Solver, Start

SIZE = 20_000
"""Numbers that the calibration sorts, and additions that it makes."""
TRIALS = 3
"""Runs of the calibration; the least time counts."""
READS = 20_000
CALLS = 2_000


class ClockFacts(NamedTuple):
    """Limits of every time that is measured here [s].

    resolution : least difference between two readings of the clock that differ
    reading : what one reading costs
    empty_call : median of a whole solve that does nothing: what `call_time` holds of ours
    empty_runtime : median of what such a solve books as setup + solve
    """

    resolution: float
    reading: float
    empty_call: float
    empty_runtime: float


def calibrate() -> float:
    """Seconds that a fixed piece of work takes now: the least of `TRIALS`."""
    numbers = _numbers()
    clock = time.perf_counter
    least = float("inf")
    for _ in range(TRIALS):
        began = clock()
        np.sort(numbers)
        total = 0
        for i in range(SIZE):
            total += i
        least = min(least, clock() - began)
    return least


def clock_facts() -> ClockFacts:
    """Measure the clock and an empty solve; it takes some ten milliseconds."""
    clock = time.perf_counter
    readings = np.array([clock() for _ in range(READS)])
    steps = np.diff(readings)
    solver, qp = _Nothing(), ContactQP(np.ones((1, 1)), np.zeros(1), np.zeros(1), np.ones(1))
    calls, runtimes = np.empty(CALLS), np.empty(CALLS)
    for i in range(CALLS):
        began = clock()
        timing = solver.solve(qp).timing
        calls[i] = clock() - began
        runtimes[i] = timing.setup + timing.solve
    return ClockFacts(
        resolution=float(steps[steps > 0].min()),
        reading=float(readings[-1] - readings[0]) / (READS - 1),
        empty_call=float(np.median(calls)),
        empty_runtime=float(np.median(runtimes)),
    )


@cache
def _numbers() -> Vector:
    return np.random.default_rng(1984).random(SIZE)


@dataclass(frozen=True)
class _Nothing(Solver):
    """Solves nothing, by the same stages as every solver."""

    name = "nothing"

    def build(self, qp: ContactQP, start: Start | None) -> Any:
        return None

    def setup(self, problem: Any, asked: float | None, start: Start | None) -> Any:
        return None

    def run(self, native: Any) -> Any:
        return None

    def read(self, qp: ContactQP, native: Any, result: Any) -> Answer:
        return Answer(None, Status.FAILED)
