"""Closed loops in processes of their own: a crash or a hang costs one loop.

A process (`harness.processes.process`) says through its link how far it has come, and nothing else;
it writes its result (`harness.motions.loop_store`) into its own folder, the only one where it may
write, from where it is filed when it is sound.  Its last words explain a death.
"""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from harness.motions.loop import Loop, LoopResult, run_loop
from harness.motions.loop_store import load_loop, write_loop
from harness.passes.limits import MEMORY_LIMIT
from harness.processes.confined import confine
from harness.processes.own_process import limit
from harness.processes.process import Process, ServerLost
from harness.progress import Progress
from harness.results.shard_file import StoreError
from problems.kernels.compiled import FOLDERS
from problems.kernels.numba_internals import keep_nothing
from problems.registry import load
from solvers.active_set import method  # noqa: F401  its kernels are loaded once for all processes
from solvers.registry import BUILT_IN, register, target_of

POLL = 0.2
"""Seconds between two looks at what is running."""
GRACE = 60.0
"""[s] A process has this much, and twice the loop's time limit, before it is killed: a loop looks
at the clock before each QP and ends by itself, unless one QP takes for ever."""
TOLD = struct.Struct("<d")
"""What a process says: t [s]."""
GIB = 2**30


@dataclass
class _Running:
    loop: Loop
    process: Process
    reached: float = 0.0
    ended: bool = False
    began: float = field(default_factory=time.monotonic)

    @property
    def share(self) -> float:
        """Part of the motion that is done."""
        return min(1.0, self.reached / self.loop.until)

    @property
    def too_much(self) -> tuple[str, str] | None:
        """Verdict and reason of one that is to be killed."""
        if time.monotonic() - self.began > 2 * self.loop.time_limit + GRACE:
            return "timeout", "one QP took so long that the process was killed"
        if self.process.memory() > MEMORY_LIMIT * GIB:
            return "crashed", f"killed: it took more than {MEMORY_LIMIT:g} GiB of memory"
        return None

    def hear(self) -> None:
        """Take what it says; the last t counts."""
        try:
            said = self.process.link.recv(1 << 16)
        except TimeoutError:
            return
        except OSError:
            said = b""
        self.ended = not said
        whole = len(said) // TOLD.size * TOLD.size
        if whole:
            (self.reached,) = TOLD.unpack_from(said, whole - TOLD.size)


def run_isolated(
    loops: Sequence[Loop],
    folder: Path,
    workers: int = 1,
    done: int = 0,
    progress: Progress | None = None,
    work: str = f"{__name__}:run_and_keep",
) -> None:
    """Run the loops, `workers` at a time; afterwards each has a result in the folder.

    done : loops of the whole that were there before, for the progress that is told
    work : "module:function" that a process calls with the loop, its folder, and whom to tell t
    """
    total, waiting = float(done + len(loops)), list(loops)
    running: list[_Running] = []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                loop = waiting.pop(0)
                arguments = {"called": work, "loop": asdict(loop), "target": _target_of(loop)}
                ahead = (__name__,)
                running.append(_Running(loop, Process(f"{__name__}:_work", arguments, ahead)))
            for link in wait([each.process.link for each in running], timeout=POLL):
                next(each for each in running if each.process.link is link).hear()
            for each in list(running):
                why = None if each.ended else each.too_much
                if each.ended or why is not None:
                    _settle(each, folder, why)
                    running.remove(each)
                    done += 1
            if progress is not None:
                now = ", ".join(f"{e.loop.scene} {e.loop.solver}" for e in running)
                progress(now, done + sum(each.share for each in running), total)
    finally:
        for each in running:
            each.process.kill()


def _target_of(loop: Loop) -> str:
    try:
        return target_of(loop.solver)
    except ValueError:  # one of the loop's own
        return ""


def run_and_keep(loop: Loop, folder: Path, told: Callable[[float], None]) -> None:
    """Run the loop and write its result."""
    write_loop(folder, run_loop(loop, told))


def _work(link: socket.socket, called: str, loop: dict[str, Any], target: str) -> None:
    """What a process does: `called`, with t told now and then."""
    home = Path(os.environ["HOME"])
    if target and target not in BUILT_IN.values():
        keep_nothing()
        confine([home])
    else:
        confine([home, *FOLDERS])
    limit(int(MEMORY_LIMIT * GIB))
    if target:
        register(loop["solver"].partition("[")[0], target)
    last = 0.0

    def told(t: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > POLL:
            last = now
            link.sendall(TOLD.pack(t))

    load(called)(Loop(**loop), home, told)


def _settle(ended: _Running, folder: Path, why: tuple[str, str] | None) -> None:
    """End a process with all that it has forked; file its result, or say in one why it has none."""
    if why is None:
        try:
            why = "crashed", ended.process.cause_of_death()[1]
        except ServerLost:
            why = "crashed", "the server of all processes is gone"
    result = LoopResult(ended.loop, *why, ended.reached, {}, None)
    try:
        result = load_loop(ended.process.folder, ended.loop) or result
    except StoreError as error:
        result = LoopResult(ended.loop, "crashed", str(error), ended.reached, {}, None)
    ended.process.kill()
    write_loop(folder, result)
