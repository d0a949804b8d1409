"""Every run of a replay in a live process of its own, so that a crash or a hang is a row.

A *task* is a solver in an arm; a *block* is a recording at an accuracy.  One process per task is
forked from a server (`harness.processes.forkserver`) when its first pass is due.  It waits,
blocked, until it is told to do a pass; the parent tells one at a time and watches it.

1. **Time.** A solve beyond `hard_limit(time_limit)` is killed: verdict `timeout`.  The first solve
   of a process may take `FIRST_CALL` more, since packages import and compile on their first call.
2. **Memory.** A process may have `memory_limit` beyond what it starts with.  What it is refused
   shows as MemoryError or in what the package makes of it; beyond it, it is killed.  Either way
   the verdict is `crashed`.
3. **Death.** Signals, exits and babble are `crashed`, with the signal's name and the last words on
   stderr.  What was answered before is kept (`harness.processes.sheet`).
4. **Disturbances.** A process that dies before its first QP, and a time-out while this process
   stood still as well (a suspended machine), are not the solver's doing; a SIGKILL of it or of the
   server need not be.  The pass is done once more.  What is disturbed again is told as such
   (`DISTURBED`) and is not final; a second SIGKILL is taken for the solver's.
5. The pass goes on with the next QP in a fresh process, which has no predecessor to start from.
   After `MOST_LOST` losses the rest of the pass is given up.
6. Processes that a backend has forked and not ended are killed after the pass: `crashed`.

What is not there: without /proc (macOS) memory is limited by `RLIMIT_AS` alone, which macOS does
not heed, and what leaves its session is not found; without fork (Windows) there is no isolation,
and `replay` runs in its own process.
"""

from __future__ import annotations

import os
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from harness.passes.limits import WARM_UP, Limits, Pass, Task, hard_limit
from harness.passes.measure import DISTURBED, Outcome
from harness.passes.starts import after_restart, order_of
from harness.processes.live_process import Loss, Process, Server, ServerLost, server
from harness.processes.sheet import Layout, Sheet
from harness.recordings.recording import Recording

FIRST_CALL = 20.0
"""What the first solve of a process may take beyond the limit [s]."""
STANDSTILL = 60.0
"""Longest that a process may take to get ready for a pass [s]."""
WATCH = 0.1
"""Seconds between two looks at a process that computes."""
MOST_LOST = 3
"""Processes that a pass may lose before the rest of it is given up."""
STOOD_STILL = 1.0
"""Seconds longer than asked for that a wait takes only if this process stood still."""
MOST_LIVE = 64
"""Processes that may live at once.  One holds 10 to 20 MB of its own."""
GIB = 2.0**30


def is_available() -> bool:
    """Whether processes can be forked here."""
    return hasattr(os, "fork")


class Block:
    """A recording at an accuracy, and the live processes that solve it.

    path : where the recording is stored;  asked : accuracy of each QP in ‖A δx‖

    Use it in a `with` statement: all processes end with it.
    """

    def __init__(
        self, recording: Recording, path: Path, asked: Sequence[float], limits: Limits
    ) -> None:
        self._recording, self._path, self._asked = recording, path, list(asked)
        self._limits, self._memory = limits, int(min(limits.memory * GIB, 2.0**60))
        self._layout = Layout([qp.k for qp in recording.qps])
        self._alone = after_restart(recording.qps)
        self._live: OrderedDict[Task, Process] = OrderedDict()
        self._server: Server | None = None
        self._sheet: Sheet  # together with the server
        self._stood_still = False

    def __enter__(self) -> Block:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if self._server is None:
            return
        if error is not None:
            self._server.close()  # whatever was going on, it ends
        for process in self._live.values():
            process.kill()
        for process in self._live.values():
            process.wait()
        self._live.clear()
        self._sheet.close()

    def do_pass(self, task: Task, advance: Callable[[int], None]) -> Pass:
        """Let the process of `task` do a pass; one that is not there is started and warmed up.

        advance : told now and then how many more QPs are done

        Raises IsolationError where no process can be started, and OSError on a full disk.
        """
        done = self._try_pass(task, advance, again=False)
        if done.is_final:
            return done
        return self._try_pass(task, lambda _: None, again=True)

    def _try_pass(self, task: Task, advance: Callable[[int], None], again: bool) -> Pass:
        """A trial of a pass, which ends where it is disturbed; `again`: the second one."""
        count, order = self._layout.count, order_of(task.arm, self._layout.count)
        outcomes: dict[int, Outcome] = {}
        times = np.full((count, 4), np.nan)
        lost: list[int] = []
        first, self._stood_still = 0, False
        while first < count:
            loss = self._go_on(task, first, advance, warm_up=not lost)
            answered = self._sheet.read()
            for i, (outcome, seconds) in answered.items():
                outcomes[i], times[i] = outcome, seconds
            if loss is None:
                break
            first = max(self._sheet.position(), first)
            index = order[first]
            if loss.blame == "outside" or (loss.blame == "unknown" and not again):
                outcomes.pop(index, None)
                self._fill(outcomes, order[first:], loss.verdict, DISTURBED + loss.text)
                break
            if loss.text or index not in answered:
                outcomes[index] = self._lost(index, loss.verdict, loss.text)
            if index not in answered:
                times[index, 3] = loss.seconds
            lost.append(index)
            first += 1
            if len(lost) == MOST_LOST:
                text = f"not tried: {MOST_LOST} processes were lost in this pass"
                self._fill(outcomes, order[first:], loss.verdict, text)
                break
        self._fill(outcomes, order, "crashed", "has left no outcome")
        if self._stood_still:
            for i, outcome in outcomes.items():
                if outcome.verdict == "timeout":
                    text = f"{DISTURBED}the machine stood still; {outcome.status_text}"
                    outcomes[i] = replace(outcome, status_text=text)
        return Pass([outcomes[i] for i in range(count)], times, lost)

    def _lost(self, index: int, verdict: str, text: str) -> Outcome:
        return Outcome(verdict, status_text=text, after_restart=bool(self._alone[index]))

    def _fill(
        self, outcomes: dict[int, Outcome], which: Sequence[int], verdict: str, text: str
    ) -> None:
        """Give those of `which` that have no outcome this one."""
        for i in which:
            outcomes.setdefault(i, self._lost(i, verdict, text))

    def _go_on(
        self, task: Task, first: int, advance: Callable[[int], None], warm_up: bool
    ) -> Loss | None:
        """Do the pass from position `first`, as far as one process gets; its loss, or None.

        If the process is lost as it warms up, what it has answered counts.
        """
        try:
            process = self._process(task)
            loss = None
            if process.fresh and warm_up:
                loss = self._watch(process, first, WARM_UP, lambda _: None)
            if loss is None:
                loss = self._watch(process, first, None, advance)
        except ServerLost:
            self._live.clear()
            return Loss("crashed", "the server of all processes is gone", blame="unknown")
        if loss is not None:
            del self._live[task]
            process.kill()
            process.wait()
        return loss

    def _process(self, task: Task) -> Process:
        """The live process of `task`; a fresh one if there is none."""
        self._load()
        assert self._server is not None
        process = self._live.pop(task, None)
        if process is None or not process.is_alive:
            if len(self._live) >= MOST_LIVE:
                _, oldest = self._live.popitem(last=False)
                oldest.kill()
                oldest.wait()
            process = Process(self._server, task, self._memory)
        self._live[task] = process
        return process

    def _load(self) -> None:
        """See to it that there is a server and that it has this block."""
        current = server()
        if current is self._server:
            return
        if self._server is not None:
            self._live.clear()
            self._sheet.close()
        self._sheet = Sheet(current.folder / "sheet", self._layout)
        self._server = current
        current.order(
            "load",
            recording=str(self._path.resolve()),
            digest=self._recording.digest,
            asked=self._asked,
            sheet=str(self._sheet.path),
            time_limit=self._limits.time,
        )
        current.await_event("loaded")

    def _watch(
        self, process: Process, first: int, budget: float | None, advance: Callable[[int], None]
    ) -> Loss | None:
        """Let a process go on with a pass from `first`, until it ends, or is to be ended."""
        assert self._server is not None
        clock, limit = time.monotonic, hard_limit(self._limits.time)
        token = os.urandom(8).hex()
        self._sheet.clear()
        self._server.order("pass", pid=process.pid, first=first, budget=budget, token=token)
        position, moved = -1, clock()
        while True:
            before = clock()
            event = self._server.event(WATCH)
            waited = clock() - before
            if waited > WATCH + STOOD_STILL:
                self._stood_still = True
                moved += waited
            if event is not None and event["pid"] == process.pid:
                process.fresh = False
                loss = process.loss_of(event)
                if event["is"] == "dead" and loss is not None and self._sheet.position() < 0:
                    text = f"before its first QP: {loss.text}"
                    loss = loss._replace(text=text, blame="outside")
                return loss
            now = self._sheet.position()
            if now != position:
                advance(now - max(position, first))
                position, moved = now, clock()
            allowed = STANDSTILL if position < 0 else limit
            if process.fresh and position == first:
                allowed += FIRST_CALL
            if clock() - moved > allowed:
                text = f"killed: not back after {allowed:g} s"
                return Loss("timeout", text + process.words.last(), clock() - moved)
            if process.memory() > self._memory:
                text = f"killed: it took more than {self._limits.memory:g} GiB of memory"
                return Loss("crashed", text + process.words.last())
            process.words.trim()
