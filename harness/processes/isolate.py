"""Every pass of a replay in a process of its own, so that a crash or a hang is a row.

A *task* is a solver in an arm; a *block* is a recording at an accuracy.  A process is forked
(`harness.processes.process`) for a pass, warmed up on other QPs than those that count, asked one QP
at a time, and ended with the pass.  So one solver lives at a time, and what it learns in a pass
serves no other one.

1. **Time.** A solve beyond `hard_limit(time_limit)` is killed: verdict `timeout`.  The first solve
   of a process may take `FIRST_CALL` more, since packages import and compile on their first call.
2. **Memory.** A process, with all that it forks, may have `memory_limit` beyond what it starts
   with.  What it is refused shows as MemoryError or in what the package makes of it; beyond it, it
   is killed.  Either way the verdict is `crashed`.  Where there are control groups
   (`harness.processes.cgroup`), the system sees to this and counts the CPU of forks.
3. **Death.** Signals, exits and babble are `crashed`, with the signal's name and the last words on
   stderr.  What was answered before is kept: it is here.
4. **Disturbances.** A process that dies before its first QP, and a time-out while this process
   stood still as well (a suspended machine), are not the solver's doing; a SIGKILL of it or of the
   server need not be.  The pass is done once more.  What is disturbed again is told as such
   (`DISTURBED`) and is not final; a second SIGKILL is taken for the solver's.
5. The pass goes on with the next QP in a fresh process (`harness.passes.measure`).
6. Processes that a backend has forked and not ended are killed after the pass: `crashed`.  What it
   has written is deleted, where it cannot write elsewhere (`harness.processes.confined`).

What is not there: without /proc (macOS) memory is limited by `RLIMIT_AS` alone, which macOS does
not heed, and what leaves its session is not found; without fork (Windows) there is no isolation,
and passes are taken in our own process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from harness.machine.threads import one_thread
from harness.machine.unrest import Reading, between, read
from harness.passes.bench import Nobody
from harness.passes.clocks import Asking
from harness.passes.limits import WARM_UP, Limits, Loss, Pass, Task, hard_limit
from harness.passes.measure import Asked, Here, Reply, others, pose, take_pass
from harness.passes.wire import (
    LENGTH,
    READY,
    TOKEN,
    TOLD,
    Question,
    answer_size,
    outcome_of,
    packed,
)
from harness.processes.process import WATCH, Process, ServerLost
from harness.recordings.recording import Recording
from problems.qp import ContactQP
from solvers import make_solver
from solvers.registry import BUILT_IN, target_of

FIRST_CALL = 20.0
"""What the first solve of a process may take beyond the limit [s]."""
STANDSTILL = 60.0
"""Longest that a process may take to get ready for a pass [s]."""
STOOD_STILL = 1.0
"""Seconds longer than asked for that a wait takes only if this process stood still."""
GIB = 2.0**30
WORK = "harness.processes.measured:work"
OUR_KERNELS = "harness.processes.our_kernels"
NO_ONE = "nobody"
"""Name of the task of who answers at once."""


def is_available() -> bool:
    """Whether processes can be forked here."""
    return hasattr(os, "fork")


class Block:
    """A recording at an accuracy, and passes over it.

    asked : accuracy of each QP in ‖A δx‖;  hidden : files and folders of the study
    isolate : whether each pass has a process of its own, if the system can fork
    timed : whether anybody looks at the clock; if not, there is no warm-up, nor is asking timed
    """

    def __init__(
        self,
        recording: Recording,
        asked: Sequence[float],
        limits: Limits,
        hidden: Iterable[Path] = (),
        isolate: bool = True,
        timed: bool = True,
    ) -> None:
        self._references, self._limits = recording.references, limits
        self._posed = pose(recording.qps, asked)
        self._hidden, self._isolate = list(hidden), isolate and is_available()
        self._timed = timed
        self._asking: dict[str, Asking] = {}

    def do_pass(self, task: Task, advance: Callable[[int], None] = lambda count: None) -> Pass:
        """A pass of a task; once more where it is disturbed.

        advance : told now and then how many more QPs are done

        Raises IsolationError where no process can be started, and OSError on a full disk.
        """
        done = self._take(task, advance, again=False)
        return done if done.is_final else self._take(task, lambda count: None, again=True)

    def asking(self, arm: str, again: bool = False) -> Asking:
        """What asking takes by itself; `again`: measured once more."""
        if not self._timed:
            return Asking.nothing(len(self._posed))
        if again or arm not in self._asking:
            done = self.do_pass(Task(NO_ONE, (), arm))
            self._asking[arm] = Asking.of(done.times, self._asking.get(arm))
        return self._asking[arm]

    def _take(self, task: Task, advance: Callable[[int], None], again: bool) -> Pass:
        asked: Asked
        if self._isolate:
            asked = Apart(task, self._limits, self._posed, self._hidden, self._timed)
        else:
            asked = here(task, self._posed)
        with one_thread(), contextlib.closing(asked):
            return take_pass(
                asked,
                self._posed,
                task.arm,
                references=self._references,
                time_limit=self._limits.time,
                advance=advance,
                again=again,
            )


def here(task: Task, qps: Sequence[ContactQP]) -> Here:
    """A task in our own process, warmed up."""
    made = make_solver(task.solver, **dict(task.options)) if task.solver != NO_ONE else Nobody()
    asked, ends = Here(made, task.arm), time.monotonic() + WARM_UP
    for number, qp in enumerate(others(qps)):
        asked.ask(Question(number, qp, fresh=not number))
        if time.monotonic() > ends:
            break
    return asked


class Apart(Asked):
    """A task in a process of its own; the next one where it is lost.

    qps : that it is asked, for others like them to warm up on, if it is `timed`
    hidden : what it may not read
    """

    def __init__(
        self,
        task: Task,
        limits: Limits,
        qps: Sequence[ContactQP],
        hidden: Sequence[Path],
        timed: bool = True,
    ) -> None:
        super().__init__()
        self._limits, self._qps = limits, qps
        self._memory = int(min(limits.memory * GIB, 2.0**60))
        target = "" if task.solver == NO_ONE else target_of(task.solver)
        self._ahead = [WORK.partition(":")[0], OUR_KERNELS]
        if target in BUILT_IN.values():
            self._ahead.append(target.partition(":")[0])
        self._arguments: dict[str, Any] = {
            "solver": task.solver,
            "target": target,
            "options": dict(task.options),
            "arm": task.arm,
            "memory_limit": self._memory,
            "hidden": [str(path) for path in hidden],
        }
        self._process: Process | None = None
        self._asked_last: tuple[int, float] | None = None
        self._before: Reading | None = None
        self._cold, self._called = not timed, False

    def ask(self, question: Question) -> Reply:
        try:
            process = self._process or self._begin(warm_up=not self._cold)
            reply = self._ask(process, question)
        except _Lost as lost:
            loss = lost.loss
        except ServerLost:
            loss = Loss("crashed", "the server of all processes is gone", blame="unknown")
        else:
            if reply.loss is None:
                return reply
            self._lose()
            return reply
        self._lose()
        return Reply(None, (np.nan,) * len(TOLD), (loss.seconds, 0.0), loss)

    def end(self) -> Loss | None:
        process = self._process
        if process is None:
            return None
        if self._before is not None:
            self.unrest = between(self._before, read(process.pid))
        self._count_cpu(process, None)
        extra = process.cpu_of_forks() / max(len(self.cpu), 1)
        self.cpu = {number: seconds + extra for number, seconds in self.cpu.items()}
        if left := process.end_forks():
            return Loss("crashed", f"left processes of its own behind: {left}")
        process.link.setblocking(False)
        with contextlib.suppress(OSError):
            if process.link.recv(1):
                return BABBLED
        return None

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            self._waited.close()
            process.kill()

    def _lose(self) -> None:
        self._cold, self._asked_last, self._before = True, None, None
        self.close()

    def _begin(self, warm_up: bool) -> Process:
        """Start a process and warm it up; if it is lost over that, one that is not.

        Raises _Lost where it does not get ready.
        """
        process = self._process = Process(WORK, self._arguments, self._ahead, self._memory)
        self._waited = Waited(process.pid)
        self._called = False
        try:
            answer, *_ = self._exchange(process, b"", len(READY), STANDSTILL)
        except _TooLarge:
            raise
        except _Lost as lost:
            loss = lost.loss
            blame = "outside" if loss.verdict == "crashed" else loss.blame
            loss = loss._replace(text=f"before its first QP: {loss.text}", blame=blame)
            raise _Lost(loss) from None
        if answer != READY:
            raise _Lost(BABBLED)
        if warm_up:
            try:
                self._warm_up(process)
            except _Lost:
                self.close()
                return self._begin(warm_up=False)
            self._before = read(process.pid)
        return process

    def _warm_up(self, process: Process) -> None:
        ends = time.monotonic() + WARM_UP
        for number, qp in enumerate(others(self._qps)):
            if self._ask(process, Question(number, qp, fresh=not number)).loss is not None:
                raise _Lost(BABBLED)
            if time.monotonic() > ends:
                break
        self._asked_last = None
        self.cpu.clear()

    def _ask(self, process: Process, question: Question) -> Reply:
        message = packed(question)
        limit = hard_limit(self._limits.time) + FIRST_CALL * (not self._called)
        self._count_cpu(process, question.number)
        framed = len(message).to_bytes(LENGTH, "little") + message
        answer, seen, still = self._exchange(process, framed, answer_size(question.qp.k), limit)
        self._called = True
        if answer[:TOKEN] != message[:TOKEN]:
            raise _Lost(BABBLED)
        outcome, told = outcome_of(answer)
        loss = Loss("crashed", "") if outcome.verdict == "crashed" else None
        return Reply(outcome, told, seen, loss, still)

    def _count_cpu(self, process: Process, number: int | None) -> None:
        """QP `number` is about to be asked: what was used since the last one is that one's."""
        now = process.cpu()
        if self._asked_last is not None:
            last, before = self._asked_last
            self.cpu[last] = now - before
        self._asked_last = None if number is None else (number, now)

    def _exchange(
        self, process: Process, message: bytes, size: int, limit: float
    ) -> tuple[bytes, tuple[float, float], bool]:
        """Send a message and read `size` bytes; also [s] that it took and were waited, and whether
        the machine stood still.

        Raises _Lost if that takes longer than `limit` [s], or the process is lost.
        """
        clock, rest, answer = time.perf_counter, memoryview(message), bytearray(size)
        got, still = 0, 0.0
        before = self._waited.so_far()
        began = now = clock()
        while got < size:
            try:
                if rest:
                    rest = rest[process.link.send(rest) :]
                elif more := process.link.recv_into(memoryview(answer)[got:]):
                    got += more
                else:
                    raise self._end_of(process)
            except TimeoutError:
                self._look_at(process)
            except OSError:
                raise self._end_of(process) from None
            then, now = now, clock()
            if now - then > WATCH + STOOD_STILL and got < size:
                still += now - then
            if got < size and now - began - still > limit:
                text = f"killed: not back after {limit:g} s" + process.words.last()
                raise _Lost(Loss("timeout", text, now - began))
        return bytes(answer), (now - began, self._waited.so_far() - before), still > 0

    def _look_at(self, process: Process) -> None:
        """Raises _Lost where a process that is waited for has taken too much."""
        process.words.trim()
        if process.memory() > self._memory:
            raise self._too_large(process)

    def _too_large(self, process: Process) -> _TooLarge:
        text = f"killed: it took more than {self._limits.memory:g} GiB of memory"
        return _TooLarge(Loss("crashed", text + process.words.last()))

    def _end_of(self, process: Process) -> _Lost:
        """Why a process has closed its end of the link."""
        code, text = process.cause_of_death()
        if code == -signal.SIGKILL and process.is_too_large():
            return self._too_large(process)
        # who is short of memory kills with this signal, too
        blame = "unknown" if code == -signal.SIGKILL else "solver"
        return _Lost(Loss("crashed", text, blame=blame))


BABBLED = Loss("crashed", "wrote into the pipe to its parent")


class _Lost(Exception):
    def __init__(self, loss: Loss) -> None:
        self.loss = loss


class _TooLarge(_Lost):
    """Whenever it is found, it is the solver's doing."""


class Waited:
    """[s] that this thread and a process have waited for a processor, as far as is told."""

    def __init__(self, pid: int) -> None:
        self._files: list[int] = []
        for which in ("thread-self", pid):
            with contextlib.suppress(OSError):
                self._files.append(os.open(f"/proc/{which}/schedstat", os.O_RDONLY))

    def so_far(self) -> float:
        """Since they began."""
        seconds = 0.0
        for file in self._files:
            with contextlib.suppress(OSError, IndexError):
                seconds += 1e-9 * int(os.pread(file, 100, 0).split()[1])
        return seconds

    def close(self) -> None:
        """No more is asked."""
        while self._files:
            os.close(self._files.pop())
