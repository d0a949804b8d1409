"""Backends whose work is done by processes that they fork."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Any, ClassVar

from problems.qp import ContactQP
from tests.fakes.crimes import Honest

THIRD = 350 << 20
WORK = 0.03
"""CPU that a grandchild uses per QP [s]."""


@dataclass(frozen=True)
class FourByAThird(Honest):
    """Each of four children holds a third of a GiB, for longer than anybody waits."""

    name: ClassVar[str] = "FourByAThird"

    def crime(self, qp: ContactQP) -> None:
        for _ in range(4):
            if os.fork() == 0:
                held = bytearray(THIRD)
                held[:: os.sysconf("SC_PAGESIZE")] = b"1" * len(held[:: os.sysconf("SC_PAGESIZE")])
                time.sleep(600)
        for _ in range(4):
            os.wait()


@dataclass(frozen=True)
class GrandchildThatWorks(Honest):
    """A grandchild, which it never waits for, uses CPU after each answer."""

    name: ClassVar[str] = "GrandchildThatWorks"

    def answer(self, qp: ContactQP, x: Any) -> Any:
        child = os.fork()
        if child == 0:
            if os.fork() == 0:
                ends = time.process_time() + WORK
                while time.process_time() < ends:
                    pass
            os._exit(0)
        os.waitpid(child, 0)
        return x
