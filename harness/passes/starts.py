"""What each solve of a pass is started from: the arms of a replay.

    cold          nothing: every object of the package is made afresh
    kept          nothing, but the memory of the last solve: its object is kept and updated
    warm          the solver's own last solution, with whatever memory the solver put into it

so that from cold to kept is what a kept object is worth, and from kept to warm what a start is.
Beside them are arms that differ from `warm` in one thing, the quality of x and of the working set:

    exact         those of the reference: what does it cost to verify an answer?
    extrapolated  the last x, continued linearly in t from the last solution of an earlier time
    stale5        those of the solver's own solution of 5 QPs ago
    stale20       of 20 QPs ago
    corrupted     the last x moved by ‖x‖ in a random direction, the working set at random

and two that check on the method:

    bare          as warm, without memory: what is memory worth, and what x and the working set?
    shuffled      as warm, the QPs visited in random order: a start should *not* help

What holds for all of them:

1. Only QPs of the warm group (step, iteration, corrector) are started, from solutions of that group
   within one stretch between restarts; the first of a stretch is cold in every arm, and so are
   impulses and minimum-norm problems.  `shuffled` knows no stretches: it starts all but its first.
2. Rows are mapped by `row_id`, and x is clipped to today's bounds, by the solver (`solvers.base`).
3. In `kept` x is the feasible point nearest to 0 and no row is in the working set.
4. **Memory** (a native workspace, multipliers) is that of the last solve in every arm but `cold`
   and `bare`: a start that spares a set-up is not comparable to one that does not.  Where x is
   another's, the solver is told so, on the clock, and makes its memory agree with it
   (`Solver.adopt`): multipliers are −Δ of that x, an old R is dropped.  Solvers whose warm start
   carries no x (`carries_x`) have none of the arms that replace it, and no `bare`; what is called
   `warm` of them is `kept`.
5. Where an arm cannot be had (fewer than 5 solutions yet, no reference), the solve is cold and not
   counted as warm-started.  `extrapolated` is `warm` where time stood still.
6. Everything random is seeded by the number of the QP, so that all solvers meet the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.passes.wire import Question
from problems.qp import (
    AT_LOWER,
    AT_UPPER,
    FREE,
    ContactQP,
    Solution,
    Status,
    Vector,
    positions_of,
    working_set_of,
)
from problems.sequence import WARM_KINDS
from solvers.base import Solver, usable

ARMS = ("cold", "warm")
"""The two arms that everything is compared in."""
STUDY_ARMS = ("cold", "kept", "warm")
"""The arms of a study."""
FARTHEST = 20
SEED = 1984


class Past(NamedTuple):
    """A QP of the stretch and the solver's own solution of it, without memory."""

    qp: ContactQP
    solution: Solution


class Moment(NamedTuple):
    """What is known when a QP is about to be solved.

    number : of the QP in the recording;  past : of its stretch, oldest first, not empty
    reference : (k,) x, in the arm that starts from it
    """

    number: int
    qp: ContactQP
    reference: Vector | None
    past: Sequence[Past]


def _stale(count: int) -> Callable[[Moment], Solution | None]:
    """Own solution of `count` QPs ago."""
    return lambda now: now.past[-count].solution if len(now.past) >= count else None


def exact(now: Moment) -> Solution | None:
    """The reference's x and working set, where there is a reference."""
    if now.reference is None:
        return None
    x = now.reference.copy()
    return Solution(x, now.qp.row_id, Status.SOLVED, working_set_of(now.qp, x))


def extrapolated(now: Moment) -> Solution | None:
    """x + w (x − x_before), w = (t_n − t)/(t − t_before); rows that x_before lacks stay."""
    last = now.past[-1]
    earlier = [past for past in now.past if past.qp.t < last.qp.t and past.solution.x is not None]
    if not earlier or now.qp.t <= last.qp.t or last.solution.x is None:
        return last.solution
    before = earlier[-1]
    assert before.solution.x is not None
    w = (now.qp.t - last.qp.t) / (last.qp.t - before.qp.t)
    place = positions_of(last.solution.row_id, before.solution.row_id)
    known = place >= 0
    x = last.solution.x.copy()
    x[known] += w * (x[known] - before.solution.x[place[known]])
    return replace(last.solution, x=x)


def corrupted(now: Moment) -> Solution | None:
    """x + ‖x‖ u with a random unit vector u, and each row in a random one of its possible sets."""
    qp, last = now.past[-1]
    if last.x is None:
        return None
    rng = np.random.default_rng([SEED, now.number])
    noise = rng.standard_normal(qp.k)
    noise *= np.linalg.norm(last.x) / max(float(np.linalg.norm(noise)), 1e-300)
    drawn = rng.integers(-1, 2, qp.k)
    impossible = ((drawn == AT_LOWER) & np.isinf(qp.lower)) | (
        (drawn == AT_UPPER) & np.isinf(qp.upper)
    )
    drawn[impossible] = FREE
    drawn[qp.lower == qp.upper] = AT_LOWER
    return replace(last, x=last.x + noise, working_set=drawn.astype(np.int8))


def nothing(now: Moment) -> Solution:
    """x nearest to 0 within the bounds, every row free."""
    qp = now.qp
    x = np.clip(np.zeros(qp.k), qp.lower, qp.upper)
    return Solution(x, qp.row_id, Status.SOLVED, np.full(qp.k, FREE, np.int8))


QUALITIES: dict[str, Callable[[Moment], Solution | None]] = {
    "exact": exact,
    "extrapolated": extrapolated,
    "stale5": _stale(5),
    "stale20": _stale(FARTHEST),
    "corrupted": corrupted,
}
"""Arm → the x and working set that replace the last ones; best first, roughly."""
REPLACED = {**QUALITIES, "kept": nothing}
EVERY_ARM = (*STUDY_ARMS, *QUALITIES, "bare", "shuffled")


def carries_x(solver: type[Solver]) -> bool:
    """Whether a warm start of this solver carries x or a working set, not its workspace alone."""
    return solver.warm_start not in ("none", "workspace")


def check_arm(arm: str) -> None:
    """Raise ValueError for an unknown arm."""
    if arm not in EVERY_ARM:
        raise ValueError(f"arm {arm!r} is unknown; choose from {', '.join(EVERY_ARM)}")


def has_arm(solver: type[Solver], arm: str) -> bool:
    """Whether a solver can be run in an arm.

    Raises ValueError for an unknown arm.
    """
    check_arm(arm)
    if arm in REPLACED or arm == "bare":
        return carries_x(solver)
    return arm == "cold" or solver.warm_start != "none"


def order_of(arm: str, count: int) -> list[int]:
    """Positions of the QPs in the order in which an arm visits them."""
    if arm == "shuffled":
        shuffled: list[int] = np.random.default_rng(SEED).permutation(count).tolist()
        return shuffled
    return list(range(count))


def after_restart(qps: Sequence[ContactQP]) -> NDArray[np.bool_]:
    """Which QPs of the warm group have no predecessor: the first of each stretch."""
    first = np.zeros(len(qps), bool)
    fresh = True
    for i, qp in enumerate(qps):
        if qp.kind in WARM_KINDS:
            first[i] = fresh or qp.restart
            fresh = False
    return first


class Starts:
    """Hands out the starts of one pass in one arm, and is told every solution."""

    def __init__(self, solver: Solver, arm: str) -> None:
        self._solver, self._arm = solver, arm
        self._make = REPLACED.get(arm)
        self._last: Solution | None = None
        self._past: deque[Past] = deque(maxlen=FARTHEST)

    def of(self, question: Question) -> tuple[Solution | None, bool]:
        """What the next QP is started from, and whether its memory is of another x (`adopt`)."""
        qp = question.qp
        if qp.kind not in WARM_KINDS:
            return None, False
        if question.alone and self._arm != "shuffled":
            self._last = None
            self._past.clear()
        last = usable(self._last)
        if last is None or self._make is None:
            return last, False
        made = self._make(Moment(question.number, qp, question.reference, self._past))
        made = usable(made)
        return (None, False) if made is None else (replace(made, memory=last.memory), True)

    def take(self, qp: ContactQP, solution: Solution | None) -> None:
        """The solver's own solution of that QP; None where it raised."""
        if qp.kind not in WARM_KINDS or self._arm == "cold":
            return
        self._last = solution
        if solution is None:
            self._past.clear()
        elif self._make is not None:
            self._past.append(Past(qp, replace(solution, memory=None)))
        elif self._arm == "bare":
            self._last = replace(solution, memory=None)
