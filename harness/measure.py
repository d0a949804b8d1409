"""One pass of one solver over a recorded sequence, with the clock around every call.

1. A warm start is the solver's own last solution of the group step, iteration, corrector; it is
   dropped at a restart.  Impulses and minimum-norm QPs start cold, as does every QP of a cold arm.
2. The garbage collector runs before a pass and sleeps during it, so that no solver pays for
   another's litter.
3. The solver's own clocks tell build, setup and solve; ours, around the whole call, `call_time`.
4. A backend that raises loses that QP, not the pass.  One that has overstepped the time limit
   `PATIENCE` times in a row is not tried on the rest.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from problems.qp import ContactQP, Solution, Vector, WorkCounts
from problems.sequence import WARM_KINDS
from solvers.base import Solver, Unsupported

PATIENCE = 20
"""Solves in a row beyond the time limit after which the rest of a pass is given up."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one call, without the solver's memory.

    verdict : "skipped", "failed" or "timeout" where that is settled before any judging, else None
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


def run_pass(
    solver: Solver,
    qps: Sequence[ContactQP],
    *,
    warm: bool,
    time_limit: float = float("inf"),
    budget: float = float("inf"),
    advance: Callable[[int], None] | None = None,
) -> tuple[list[Outcome], NDArray[np.float64]]:
    """Solve the sequence in order.

    time_limit : [s] beyond which a solve is a timeout, looked at after the call
    budget : [s] after which the pass ends early; the warm-up uses it
    advance : told now and then how many more QPs are done

    Returns the outcomes and their times (n, 4) [s]: build, setup, solve, call; NaN where unknown.
    """
    outcomes: list[Outcome] = []
    times = np.full((len(qps), 4), np.nan)
    last: Solution | None = None
    fresh, slow, told = True, 0, 0
    clock = time.perf_counter
    gc.collect()
    was_enabled = gc.isenabled()
    gc.disable()
    began = clock()
    try:
        for i, qp in enumerate(qps):
            grouped = qp.kind in WARM_KINDS
            if grouped and qp.restart:
                last, fresh = None, True
            start = last if warm and grouped else None
            alone = grouped and fresh
            fresh = fresh and not grouped
            if slow >= PATIENCE:
                text = f"not tried: {PATIENCE} solves in a row took more than {time_limit:g} s"
                outcomes.append(Outcome("timeout", status_text=text, after_restart=alone))
                continue
            t0 = clock()
            try:
                solution = solver.solve(qp, start)
            except Unsupported as reason:
                outcomes.append(Outcome("skipped", status_text=str(reason), after_restart=alone))
                continue
            except Exception as error:  # any backend may raise anything; the study goes on
                times[i, 3] = clock() - t0
                text = f"{type(error).__name__}: {error}"
                outcomes.append(Outcome("failed", status_text=text, after_restart=alone))
                last = None if grouped else last
                continue
            t1 = clock()
            timing = solution.timing
            times[i] = timing.build, timing.setup, timing.solve, t1 - t0
            late = t1 - t0 > time_limit
            slow = slow + 1 if late else 0
            if grouped:
                last = solution
            outcomes.append(
                Outcome(
                    verdict="timeout" if late else None,
                    x=solution.x,
                    found=solution.found,
                    status=solution.status.name,
                    status_text=solution.status_text,
                    iterations=solution.iterations,
                    work=solution.work,
                    warm_started=start is not None,
                    after_restart=alone,
                )
            )
            if advance is not None and (i & 31) == 31:
                advance(i + 1 - told)
                told = i + 1
            if t1 - began > budget:
                break
    finally:
        if was_enabled:
            gc.enable()
    if advance is not None:
        advance(len(outcomes) - told)
    return outcomes, times
