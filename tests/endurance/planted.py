"""Solvers with a change planted in them, for `tests/endurance/compare.py`.

They are imported by every process that runs one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from zlib import crc32

from problems.qp import ContactQP
from solvers.active_set.glambda import Glambda
from solvers.adapters.daqp import DAQP
from solvers.base import Answer, Start

SLOWDOWN = 0.2
"""Share by which setup and solve take longer."""
RISE = 0.05
"""Share by which work counts rise, on average."""


def spun(stage: Callable[..., Any], *arguments: Any) -> Any:
    """Do a stage, then wait busily for `SLOWDOWN` of what it took."""
    began = time.perf_counter()
    result = stage(*arguments)
    ended = time.perf_counter()
    until = ended + SLOWDOWN * (ended - began)
    while time.perf_counter() < until:
        pass
    return result


@dataclass(frozen=True)
class SlowDAQP(DAQP):
    """DAQP, a fifth slower."""

    def setup(self, problem: Any, asked: float | None, start: Start | None) -> Any:
        return spun(super().setup, problem, asked, start)

    def run(self, native: Any) -> Any:
        return spun(super().run, native)


@dataclass(frozen=True)
class BusyGlambda(Glambda):
    """Our method, that counts the work of some QPs twice."""

    def read(self, qp: ContactQP, native: Any, result: Any) -> Answer:
        answer = super().read(qp, native, result)
        work = answer.work
        if work is None or crc32(qp.d.tobytes()) % 1000 >= 1000 * RISE:
            return answer
        doubled = type(work)(*(2 * count for count in vars(work).values()))
        return answer._replace(work=doubled, iterations=2 * answer.iterations)
