"""Solvers in whose first pass something happens to the machine, by their own hand.

Each does it once in the life of the process that replays, which a file remembers.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fakes.crooked import Right

STANDSTILL = 2.5
"""How long the process that replays is stopped [s]."""


def replaying() -> int:
    """Process id of whoever replays: the parent of the server, which is ours."""
    stat = Path(f"/proc/{os.getppid()}/stat").read_text()
    return int(stat.rpartition(")")[2].split()[1])


def marker(name: str, pid: int) -> Path:
    return Path(tempfile.gettempdir()) / f"glambda-once-{pid}-{name}"


def first_time(name: str) -> bool:
    path = marker(name, replaying())
    if path.exists():
        return False
    path.touch()
    return True


@dataclass(frozen=True)
class Disturbed(Right):
    """Answers rightly; `happens` before the QP at 0.03 s is answered for the first time."""

    def run(self, native: Any) -> Any:
        if native[0].t >= 0.03 and first_time(type(self).__name__):
            self.happens()
        return super().run(native)

    def happens(self) -> None:
        raise NotImplementedError


class ServerIsKilled(Disturbed):
    def happens(self) -> None:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(10)


class IsKilled(Disturbed):
    def happens(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class AllStandStill(Disturbed):
    def happens(self) -> None:
        os.kill(replaying(), signal.SIGSTOP)
        time.sleep(STANDSTILL)
        os.kill(replaying(), signal.SIGCONT)


@dataclass(frozen=True)
class DiesUnborn(Right):
    """Dies as it is made, in the process that it is to solve in."""

    def __post_init__(self) -> None:
        super().__post_init__()
        with open("/proc/self/cmdline", "rb") as file:
            if b"harness.processes.forkserver" in file.read():
                os._exit(3)


NAMES = ("ServerIsKilled", "IsKilled", "AllStandStill", "DiesUnborn")
