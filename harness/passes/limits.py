"""What a pass may take, what one process is told to do, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from harness.machine.unrest import Unrest
from harness.passes.outcome import DISTURBED, Outcome

TIME_LIMIT, MEMORY_LIMIT = 1.0, 4.0
"""`Limits` if nothing else is said [s, GiB]."""
WARM_UP = 0.05
"""Longest warm-up of a process [s]; with 0.03 to 0.3 times are the same."""


def hard_limit(time_limit: float) -> float:
    """Seconds after which a solve is killed; `time_limit` itself is looked at after the call."""
    return 10.0 * time_limit + 1.0


class Limits(NamedTuple):
    """What a solver may take: time [s] per solve, and memory [GiB] beyond what it starts with."""

    time: float
    memory: float


class Task(NamedTuple):
    """What a process does: a solver by name, its options as (name, value) pairs, in an arm."""

    solver: str
    options: tuple[tuple[str, Any], ...]
    arm: str


class Loss(NamedTuple):
    """A process that was lost.

    verdict : of the QP that it worked on;  text : why, or empty if its own outcome says it
    seconds : how long that was waited for
    blame : whose doing it is: "solver", "outside", or "unknown"
    """

    verdict: str
    text: str
    seconds: float = float("nan")
    blame: str = "solver"


class Pass(NamedTuple):
    """What came of a pass.

    outcomes : one per QP
    times : (n, 8) [s] build, setup, solve, call and inside as told (`wire.TOLD`), and what is seen
        from outside (`measure.SEEN`); NaN where unknown
    lost : the QPs that have cost a process
    unrest : what else the machine was doing
    """

    outcomes: Sequence[Outcome]
    times: NDArray[Any]
    lost: Sequence[int] = ()
    unrest: Unrest = Unrest()

    @property
    def is_final(self) -> bool:
        """Whether nothing of it was disturbed."""
        return not any(outcome.status_text.startswith(DISTURBED) for outcome in self.outcomes)
