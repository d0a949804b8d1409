"""Closed loops in processes of their own: a crash or a hang costs one loop.

A process (`harness.processes.own_process`) tells how far it has come through shared memory, keeps
its result itself (`harness.motions.loop_store`) and says nothing else; its last words explain a
death.
"""

from __future__ import annotations

import multiprocessing as mp
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from harness.motions.loop import Loop, LoopResult, run_loop
from harness.motions.loop_store import load_loop, loop_path, write_loop
from harness.processes.own_process import OwnProcess, start_method
from harness.progress import Progress

POLL = 0.2
"""Seconds between two looks at what is running."""
GRACE = 60.0
"""[s] A process has this much, and twice the loop's time limit, before it is killed: a loop looks
at the clock before each QP and ends by itself, unless one QP takes for ever."""


Work = Callable[[Loop, Path, Callable[[float], None]], None]
"""Called with a loop, the folder, and whom to tell t."""


@dataclass
class _Running:
    loop: Loop
    process: OwnProcess
    reached: Any
    began: float = field(default_factory=time.monotonic)

    @property
    def share(self) -> float:
        """Part of the motion that is done."""
        return min(1.0, self.reached.value / self.loop.until)

    @property
    def late(self) -> bool:
        return time.monotonic() - self.began > 2 * self.loop.time_limit + GRACE


def run_and_keep(loop: Loop, folder: Path, told: Callable[[float], None]) -> None:
    """Run the loop and write its result."""
    write_loop(folder, run_loop(loop, told))


def run_isolated(
    loops: Sequence[Loop],
    folder: Path,
    workers: int = 1,
    done: int = 0,
    progress: Progress | None = None,
    work: Work = run_and_keep,
) -> None:
    """Run the loops, `workers` at a time; afterwards each has a result in the folder.

    done : loops of the whole that were there before, for the progress that is told
    work : what a process does; a function of a module
    """
    if not loops:
        return
    total, waiting = float(done + len(loops)), list(loops)
    running: list[_Running] = []
    with tempfile.TemporaryDirectory() as scratch:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    running.append(_start(work, waiting.pop(0), folder, Path(scratch)))
                wait([each.process.sentinel for each in running], timeout=POLL)
                for each in list(running):
                    if each.late or not each.process.is_alive:
                        _settle(each, folder)
                        running.remove(each)
                        done += 1
                if progress is not None:
                    now = ", ".join(f"{e.loop.scene} {e.loop.solver}" for e in running)
                    progress(now, done + sum(each.share for each in running), total)
        finally:
            for each in running:
                each.process.kill()


def _start(work: Work, loop: Loop, folder: Path, scratch: Path) -> _Running:
    reached = mp.get_context(start_method()).Value("d", 0.0, lock=False)
    words = scratch / f"{loop_path(folder, loop).stem}.txt"
    return _Running(loop, OwnProcess(words, _work, work, loop, folder, reached), reached)


def _work(work: Work, loop: Loop, folder: Path, reached: Any) -> None:
    """What a process does: `work`, with the clock of the motion in shared memory."""

    def told(t: float) -> None:
        reached.value = t

    work(loop, folder, told)


def _settle(ended: _Running, folder: Path) -> None:
    """End a process with all that it has forked; where it left no result, say why in one."""
    late = ended.process.is_alive
    ended.process.kill()
    if load_loop(folder, ended.loop) is not None:
        return
    verdict, reason = "timeout", "one QP took so long that the process was killed"
    if not late:
        verdict, reason = "crashed", ended.process.cause_of_death()
    reached = float(ended.reached.value)
    write_loop(folder, LoopResult(ended.loop, verdict, reason, reached, {}, None))
