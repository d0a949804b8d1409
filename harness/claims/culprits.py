"""Solvers that crash, hang, leak or lie about their time, for `checks.endures`.

Each process that is forked for one of them loads this module, and little else.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from problems.qp import ContactQP, Solution, Status, Timing
from solvers import make_solver
from solvers.base import Answer, Solver, Start

PAD = 0.01
"""CPU that is spent and not told [s]."""
KEPT: list[Any] = []


@dataclass(frozen=True)
class Culprit(Solver):
    """Right always, but for its deed at the QP of one time, or at each.

    variant : that time [s] as it is printed, or "always"
    """

    variant: str = ""

    name: ClassVar[str] = "culprit"

    def build(self, qp: ContactQP, start: Start | None) -> ContactQP:
        return qp

    def setup(self, problem: ContactQP, asked: float | None, start: Start | None) -> ContactQP:
        return problem

    def run(self, native: ContactQP) -> Any:
        if self.variant in ("always", str(native.t)):
            self.deed()
        return make_solver("glambda", accuracy=1e-13).solve(native).x

    def read(self, qp: ContactQP, native: ContactQP, result: Any) -> Answer:
        return Answer(result, Status.SOLVED)

    def deed(self) -> None:
        """Nothing."""


@dataclass(frozen=True)
class Crashes(Culprit):
    """As a package with a wrong pointer does."""

    def deed(self) -> None:
        os.abort()


@dataclass(frozen=True)
class Hangs(Culprit):
    """For ever."""

    def deed(self) -> None:
        while True:
            time.sleep(1.0)


@dataclass(frozen=True)
class Leaks(Culprit):
    """Until there is nothing left."""

    def deed(self) -> None:
        while True:
            KEPT.append(np.zeros(2**23))


@dataclass(frozen=True)
class Lies(Culprit):
    """About its time."""

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        found = super().solve(qp, start)
        return replace(found, timing=Timing(0.0, 0.0, 1e-9)) if self.variant else found

    def deed(self) -> None:
        ends = time.process_time() + PAD
        while time.process_time() < ends:
            pass


CULPRITS = {
    cls.__name__.lower(): f"{__name__}:{cls.__name__}" for cls in (Crashes, Hangs, Leaks, Lies)
}
