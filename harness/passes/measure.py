"""One pass over a recorded sequence: each QP is asked when the one before is answered.

1. Who is asked knows a QP when it is asked, and no other one; its answer is kept here, and it does
   not come to it again.
2. Beside the times that are told stand those that are seen: from asking to the answer, by our
   clock, and the CPU that was used until the next was asked.
3. One that has overstepped the time limit `PATIENCE` times in a row is not asked the rest.
4. Who is lost over a QP loses that QP; the next is asked of another one, which has no predecessor
   to start from.  After `MOST_LOST` losses the rest of the pass is given up.
5. What is not the solver's doing ends the pass, and is told as such.
"""

from __future__ import annotations

import abc
import gc
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from harness.machine.unrest import Unrest
from harness.passes.bench import Bench
from harness.passes.limits import Loss, Pass
from harness.passes.outcome import DISTURBED, Outcome
from harness.passes.starts import SEED, after_restart, check_arm, order_of
from harness.passes.wire import TOLD, Question, outcome_of, packed
from harness.recordings.recording import Reference
from problems.qp import ContactQP
from problems.sequence import WARM_KINDS
from solvers.base import Solver

PATIENCE = 20
"""Solves in a row beyond the time limit after which the rest of a pass is given up."""
MOST_LOST = 3
"""Processes that a pass may lose before the rest of it is given up."""
LONG_AGO = 1e3
"""How much earlier [s] the QPs of a warm-up say they are posed."""
TELL_EVERY = 32
"""QPs between two reports of progress."""
SEEN = ("wall", "waited", "cpu")
"""Times that are seen from outside, behind `wire.TOLD`: from asking to the answer; what of it the
asked, or who asks, has waited for a processor; CPU from asking to the next question."""


class Reply(NamedTuple):
    """What comes of a question: an outcome, or a loss, or one that has cost the process.

    told : `wire.TOLD`;  seen : the first two of `SEEN` [s]
    stood_still : whether the machine did, meanwhile
    """

    outcome: Outcome | None
    told: tuple[float, ...]
    seen: tuple[float, float]
    loss: Loss | None = None
    stood_still: bool = False


class Asked(abc.ABC):
    """Whoever answers.

    cpu : of each QP by its number, the CPU [s] from its question to the next, where it is known
    unrest : what else the machine was doing, once it has ended
    """

    def __init__(self) -> None:
        self.cpu: dict[int, float] = {}
        self.unrest = Unrest()

    @abc.abstractmethod
    def ask(self, question: Question) -> Reply:
        """The answer to a question."""

    def end(self) -> Loss | None:
        """Nothing more is asked; what is found out in the end."""
        return None

    def close(self) -> None:  # noqa: B027  not everybody has something to end
        """It is not needed any more."""


class Here(Asked):
    """A solver in our own process, where a debugger can follow, and where a crash is a crash."""

    def __init__(self, solver: Solver, arm: str) -> None:
        super().__init__()
        self._bench = Bench(solver, arm)

    def ask(self, question: Question) -> Reply:
        message = packed(question)
        began = time.perf_counter()
        answer = self._bench.answer(message)
        wall = time.perf_counter() - began
        return Reply(*outcome_of(answer), (wall, 0.0))


def run_pass(
    solver: Solver, qps: Sequence[ContactQP], arm: str, **options: Any
) -> tuple[Sequence[Outcome], NDArray[np.float64]]:
    """A pass in our own process: outcomes, and times (n, 8) [s] as in `Pass`.

    options : as for `take_pass`
    """
    done = take_pass(Here(solver, arm), qps, arm, **options)
    return done.outcomes, done.times


def take_pass(
    asked: Asked,
    qps: Sequence[ContactQP],
    arm: str,
    *,
    references: Sequence[Reference | None] | None = None,
    time_limit: float = float("inf"),
    advance: Callable[[int], None] = lambda count: None,
    again: bool = False,
) -> Pass:
    """Ask all QPs in the order of the arm (`harness.passes.starts.EVERY_ARM`).

    references : the oracle's answers, one per QP; the arm "exact" is given them, one at a time
    time_limit : [s] beyond which a solve is a timeout, looked at after the call
    advance : told now and then how many more QPs are done
    again : whether the pass was disturbed before; then a doubtful loss is the solver's

    Raises ValueError for an unknown arm.
    """
    check_arm(arm)
    order = order_of(arm, len(qps))
    book = _Book(qps, order, time_limit)
    with without_litter():
        for position, i in enumerate(order):
            known = references[i] if references is not None and arm == "exact" else None
            x = None if known is None else known.x
            reply = asked.ask(Question(i, qps[i], x, bool(book.alone[i]), book.fresh))
            book.enter(i, reply, again)
            if book.closed(position, reply):
                break
            if position % TELL_EVERY == TELL_EVERY - 1:
                advance(TELL_EVERY)
    loss = asked.end()
    if loss is not None and not book.lost:
        book.lose(order[-1], loss)
    return book.as_pass(asked.cpu)._replace(unrest=asked.unrest)


@contextmanager
def without_litter() -> Iterator[None]:
    """The garbage collector sleeps meanwhile: in a large process it takes a second."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Book:
    """What comes of the questions of a pass.

    alone : (n,) which QPs have no predecessor;  fresh : whether the next one is the first of a pass
    """

    def __init__(self, qps: Sequence[ContactQP], order: Sequence[int], time_limit: float) -> None:
        self._qps, self._order, self._limit = qps, order, time_limit
        self.alone = after_restart(qps)
        self.times = np.full((len(qps), len(TOLD) + len(SEEN)), np.nan)
        self.lost: list[int] = []
        self._outcomes: dict[int, Outcome] = {}
        self._slow, self._stood_still, self._disturbed = 0, False, ""
        self.fresh = True
        self._begin_at(0)

    def _begin_at(self, position: int) -> None:
        """The QP at this position is the first of a process, and no other was before it."""
        self.fresh = True
        for i in self._order[position:]:
            if self._qps[i].kind in WARM_KINDS:
                self.alone[i] = True
                break

    def enter(self, i: int, reply: Reply, again: bool) -> None:
        """QP `i` has this reply; `again` as for `take_pass`."""
        self.fresh = False
        self._stood_still |= reply.stood_still
        if reply.outcome is None or reply.outcome.verdict != "skipped":
            self.times[i, :-1] = *reply.told, *reply.seen
        late = reply.seen[0] > self._limit
        self._slow = self._slow + 1 if late else 0
        loss = reply.loss
        if loss is not None and (
            loss.blame == "outside" or (loss.blame == "unknown" and not again)
        ):
            self._disturbed = DISTURBED + loss.text
        if reply.outcome is not None:
            verdict = reply.outcome.verdict or ("timeout" if late else None)
            self._put(i, replace(reply.outcome, verdict=verdict))
        if loss is not None:
            self.lose(i, loss)

    def lose(self, i: int, loss: Loss) -> None:
        """The process was lost over QP `i`."""
        self.lost.append(i)
        if loss.text or i not in self._outcomes:
            self._put(i, Outcome(loss.verdict, status_text=loss.text))

    def closed(self, position: int, reply: Reply) -> bool:
        """Whether the pass ends after this position; the rest is filled in then."""
        if reply.loss is not None:
            self._begin_at(position + 1)
        if self._disturbed:
            self._fill(position, reply.loss.verdict if reply.loss else "crashed", self._disturbed)
        elif len(self.lost) == MOST_LOST:
            verdict = reply.loss.verdict if reply.loss else "crashed"
            text = f"not tried: {MOST_LOST} processes were lost in this pass"
            self._fill(position + 1, verdict, text)
        elif self._slow == PATIENCE:
            text = f"not tried: {PATIENCE} solves in a row took more than {self._limit:g} s"
            self._fill(position + 1, "timeout", text)
        else:
            return False
        return True

    def _put(self, i: int, outcome: Outcome) -> None:
        self._outcomes[i] = replace(outcome, after_restart=bool(self.alone[i]))

    def _fill(self, position: int, verdict: str, text: str) -> None:
        for i in self._order[position:]:
            self._put(i, Outcome(verdict, status_text=text))

    def as_pass(self, cpu: dict[int, float]) -> Pass:
        """All of it."""
        for i, seconds in cpu.items():
            self.times[i, -1] = seconds
        if self._stood_still:
            for i, outcome in self._outcomes.items():
                if outcome.verdict == "timeout":
                    text = f"{DISTURBED}the machine stood still; {outcome.status_text}"
                    self._put(i, replace(outcome, status_text=text))
        return Pass([self._outcomes[i] for i in range(len(self._qps))], self.times, self.lost)


def pose(qps: Sequence[ContactQP], asked: Sequence[float]) -> list[ContactQP]:
    """The QPs with the accuracies that are asked of them, in ‖A δx‖."""
    pairs = zip(qps, asked, strict=True)
    return [qp if qp.eps0 == eps0 else qp.with_accuracy(eps0) for qp, eps0 in pairs]


def others(qps: Iterable[ContactQP]) -> Iterator[ContactQP]:
    """QPs of the same structure with other numbers and other answers, to warm up on.

    Columns of A are scaled, entries of d shuffled, and time is another, all by a fixed seed.
    """
    rng = np.random.default_rng(SEED)
    for qp in qps:
        scale = rng.uniform(0.5, 2.0, qp.k)
        A: Any = qp.A
        A = A.multiply(scale).tocsc() if sp.issparse(A) else A * scale
        d = rng.permutation(qp.d) * rng.choice([-1.0, 1.0], qp.m)
        yield replace(qp, A=A, d=d, t=qp.t - LONG_AGO)
