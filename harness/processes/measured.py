"""What goes on in the process of a solver: it answers what it is asked, and knows nothing else.

1. It begins as `harness.processes.own_process` says, gives up what it can (`confined`), and only
   then imports the solver, whatever that does as it is imported.
2. It has limits: of memory (`RLIMIT_AS`, which macOS does not heed), and of new processes and
   threads (`RLIMIT_NPROC`, which root is not held to).
3. It says `READY`, and then answers one question after the other (`harness.passes.wire`), until
   there is nobody to ask it.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import resource
import socket
import sys
from pathlib import Path
from typing import Any

import psutil

from harness.machine.threads import one_thread
from harness.passes.bench import Bench, Nobody
from harness.passes.wire import LENGTH, READY
from harness.processes.confined import confine
from harness.processes.introduction import said_of
from solvers import make_solver
from solvers.active_set import method  # noqa: F401  its kernels are loaded once for all processes
from solvers.registry import register

NEW_TASKS = 256
"""Processes and threads that may be added to the user's while a process lives."""


def _tasks_of(user: int) -> int:
    """Processes and threads of a user."""
    count = 0
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.uids().real == user:
                count += process.num_threads()
    return count


TASKS = _tasks_of(os.getuid()) if os.getuid() else 0
"""Of the user, when the server was started."""


def work(
    link: socket.socket,
    solver: str,
    target: str,
    options: dict[str, Any],
    arm: str,
    memory_limit: int,
    hidden: list[str],
) -> None:
    """Answer what comes through `link`.

    target : where the solver is found; empty: nobody is asked;  memory_limit : [bytes]
    hidden : what it may not read
    """
    confine([Path(os.environ["HOME"])], map(Path, hidden))
    if target:
        register(solver.partition("[")[0], target)
    made = make_solver(solver, **options) if target else Nobody()
    _limit(memory_limit)
    gc.collect()
    gc.freeze()  # whatever is there is no litter of a pass
    gc.disable()
    bench = Bench(made, arm)
    with one_thread():
        link.sendall(READY)
        while message := _received(link):
            link.sendall(bench.answer(message))


def introduce(link: socket.socket, solver: str, target: str, options: dict[str, Any]) -> None:
    """Say through `link` what the solver says of itself (`harness.processes.introduction`)."""
    confine([Path(os.environ["HOME"])])
    register(solver.partition("[")[0], target)
    link.sendall(json.dumps(said_of(solver, options)).encode())


def _received(link: socket.socket) -> bytearray:
    """The next question; empty where there is none any more."""
    return _exactly(link, int.from_bytes(_exactly(link, LENGTH), "little"))


def _exactly(link: socket.socket, count: int) -> bytearray:
    """So many bytes, or none where the link has ended."""
    message = bytearray(count)
    whole = count and link.recv_into(message, count, socket.MSG_WAITALL) == count
    return message if whole else bytearray()


def _limit(memory: int) -> None:
    """Limit what the process may take: `memory` [bytes] beyond what it has."""
    if sys.platform == "linux":
        _lower(resource.RLIMIT_AS, psutil.Process().memory_info().vms + memory)
    if os.getuid() != 0:
        _lower(resource.RLIMIT_NPROC, TASKS + NEW_TASKS)


def _lower(which: int, value: int) -> None:
    """Set a limit, unless a lower one is there."""
    _, most = resource.getrlimit(which)
    if most == resource.RLIM_INFINITY or value < most:
        resource.setrlimit(which, (value, value))
