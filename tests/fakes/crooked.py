"""Solvers for tests of the replay: a right one, and some that are not.

They are imported by every process that runs one, so this imports little.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from problems.qp import ContactQP, Solution, Status
from solvers.active_set.glambda import Glambda
from solvers.base import Answer, Solver, Unsupported


@dataclass(frozen=True)
class Right(Solver):
    """Right always, with its starts to be seen; its words are the accuracy that it was asked."""

    name: ClassVar[str] = "right"
    warm_start: ClassVar[str] = "x"
    starts: ClassVar[list[tuple[ContactQP, Solution | None]]] = []

    def build(self, qp: ContactQP, start: Any) -> Any:
        return qp

    def setup(self, problem: Any, asked: float | None, start: Any) -> Any:
        return problem, asked

    def run(self, native: Any) -> Any:
        return self.answer(native[0])

    def answer(self, qp: ContactQP) -> Any:
        """x."""
        return Glambda(1e-14).solve(qp).x

    def read(self, qp: ContactQP, native: Any, result: Any) -> Answer:
        return Answer(result, Status.SOLVED, 3, repr(native[1]), memory="kept")

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        self.starts.append((qp, start))
        return super().solve(qp, start)


@dataclass(frozen=True)
class Liar(Right):
    """Claims success with something else."""

    def answer(self, qp: ContactQP) -> Any:
        return super().answer(qp) + 1.0


@dataclass(frozen=True)
class Choosy(Right):
    """Raises Unsupported for impulses, and something of its own at the second QP."""

    warm_start: ClassVar[str] = "none"

    def build(self, qp: ContactQP, start: Any) -> Any:
        if qp.kind == "impulse":
            raise Unsupported("no impulses")
        if qp.t == 0.01:
            raise RuntimeError("native failure")
        return qp


@dataclass(frozen=True)
class Slow(Right):
    """Takes 20 ms."""

    def answer(self, qp: ContactQP) -> Any:
        time.sleep(0.02)
        return super().answer(qp)


@dataclass(frozen=True)
class Silent(Right):
    """Has no answer, or one of NaN."""

    def answer(self, qp: ContactQP) -> Any:
        return None if qp.t < 0.02 else np.full(qp.k, np.nan)


@dataclass(frozen=True)
class Scribbler(Right):
    """Writes into what it is given, past the read-only flag, as compiled code can."""

    warm_start: ClassVar[str] = "none"

    def answer(self, qp: ContactQP) -> Any:
        x = super().answer(qp)
        if qp.t in (0.01, 0.02):
            qp.d.setflags(write=True)
            qp.d[:] = 0.0
        return x


@dataclass(frozen=True)
class Empty(Right):
    """Returns nothing, not even a Solution; at one QP it wants to leave the program."""

    warm_start: ClassVar[str] = "none"

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Any:
        if qp.t == 0.01:
            raise SystemExit(3)
        return None


CROOKED = {
    cls.__name__.lower(): f"{__name__}:{cls.__name__}"
    for cls in (Right, Liar, Choosy, Slow, Silent, Scribbler, Empty)
}
"""Name → where it is found."""
