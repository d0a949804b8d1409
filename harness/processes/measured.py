"""What goes on in the process of a solver: it answers what it is asked, and knows nothing else.

1. It begins as `harness.processes.own_process` says, gives up what it can (`confined`), and only
   then imports the solver, whatever that does as it is imported.  Ours alone may keep the machine
   code of our kernels.
2. It has limits of memory, processes and threads.
3. It says `READY`, and then answers one question after the other (`harness.passes.wire`), until
   there is nobody to ask it.
"""

from __future__ import annotations

import gc
import json
import os
import socket
from pathlib import Path
from typing import Any

from harness.machine.threads import one_thread
from harness.passes.bench import Bench, Nobody
from harness.passes.wire import LENGTH, READY
from harness.processes.confined import confine
from harness.processes.introduction import said_of
from harness.processes.own_process import limit
from problems.kernels.compiled import FOLDERS
from problems.kernels.numba_internals import keep_nothing
from solvers import make_solver
from solvers.registry import BUILT_IN, register


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
    home = Path(os.environ["HOME"])
    if target and target not in BUILT_IN.values():
        keep_nothing()
        confine([home], map(Path, hidden))
    else:
        confine([home, *FOLDERS], map(Path, hidden))
    if target:
        register(solver.partition("[")[0], target)
    made = make_solver(solver, **options) if target else Nobody()
    limit(memory_limit)
    gc.freeze()  # whatever is there is no litter of a pass
    gc.disable()
    bench = Bench(made, arm)
    with one_thread():
        link.sendall(READY)
        while message := _received(link):
            link.sendall(bench.answer(message))


def introduce(link: socket.socket, solver: str, target: str, options: dict[str, Any]) -> None:
    """Say through `link` what the solver says of itself (`harness.processes.introduction`)."""
    keep_nothing()
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
