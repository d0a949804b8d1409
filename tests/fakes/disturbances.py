"""What befalls a process that is asked, the server, or all: once, before the QP numbered `AT`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import psutil

from harness.passes.measure import Reply
from harness.passes.wire import Question
from harness.processes import isolate
from harness.processes.process import Process, server
from tests.fakes.crooked import Right

AT = 3
STOP = """
import os, signal, sys, time
us, child = map(int, sys.argv[1:])
os.kill(us, signal.SIGSTOP)
time.sleep(2.5)
os.kill(us, signal.SIGCONT)
time.sleep(0.5)
os.kill(child, signal.SIGCONT)
"""
STARTED: list[subprocess.Popen[bytes]] = []


def server_is_killed(process: Process) -> None:
    os.kill(server()._process.pid, signal.SIGKILL)
    _wait_for_the_end_of(process)  # it ends with its server


def is_killed(process: Process) -> None:
    os.kill(process.pid, signal.SIGKILL)
    _wait_for_the_end_of(process)


def _wait_for_the_end_of(process: Process) -> None:
    while psutil.pid_exists(process.pid):
        with suppress(psutil.NoSuchProcess):
            if psutil.Process(process.pid).status() == psutil.STATUS_ZOMBIE:
                return
        time.sleep(0.01)


def all_stand_still(process: Process) -> None:
    os.kill(process.pid, signal.SIGSTOP)
    STARTED.append(
        subprocess.Popen([sys.executable, "-c", STOP, str(os.getpid()), str(process.pid)])
    )


EVENTS = (server_is_killed, is_killed, all_stand_still)


class Once(isolate.Apart):
    """Lets `event` happen before QP `AT` is asked, once."""

    event: Callable[[Process], None]
    happened = False

    def _ask(self, process: Process, question: Question) -> Reply:
        scored = question.qp.t >= 0 and self._arguments["target"]
        if scored and question.number == AT and not Once.happened:
            Once.happened = True
            Once.event(process)
        return super()._ask(process, question)


@dataclass(frozen=True)
class DiesUnborn(Right):
    """Dies as it is made, in the process that it is to solve in, and not where it is introduced."""

    def __post_init__(self) -> None:
        super().__post_init__()
        frame = sys._getframe()
        while frame.f_back is not None:
            frame = frame.f_back
            if frame.f_code.co_name == "work":
                os._exit(3)
