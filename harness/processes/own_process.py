"""A process of its own: how it begins, what it has printed, and how it ends with its family.

A crash or a hang then costs what the process did, and no more.  All of ours share this:

1. `begin`.  It leads a session of its own, so that no interrupt of the terminal reaches it; reads
   nothing; prints into a file; asks libraries for one thread; dumps no core; is the first that a
   Linux without memory kills; and dies with its parent (on Linux).  Orphans of what it has forked
   become its own children (on Linux), so that they are found.
2. `Words`.  The last lines in that file explain a death.
3. `kill_family`.  Whatever it has forked ends with it.

Closed loops and peers use `OwnProcess`: multiprocessing's fork server, which has imported once what
they need, starts a guard, which forks the process itself and ends with it.  A replay's processes
share a recording besides, which their own server has read (`harness.processes.forkserver`).
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing as mp
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

import psutil

from harness.machine.threads import ask_for_one_thread

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
KEPT = 1 << 20
"""Bytes of what a process prints that are kept."""
LINES, LENGTH = 3, 100
"""Last words: so many lines of so many characters at most."""
TAIL = 4096
"""Bytes that last words are looked for in."""


class OwnProcess:
    """A process that calls `work(*arguments)`, a function of a module.

    words : file for what it prints

    Where the system cannot fork, it is started from nothing.
    """

    def __init__(self, words: Path, work: Callable[..., None], *arguments: Any) -> None:
        self._words = Words(words)
        context: Any = mp.get_context(start_method())
        if start_method() == "forkserver":
            context.set_forkserver_preload([work.__module__])
        self._process = context.Process(target=_run, args=(words, work, arguments), daemon=True)
        self._process.start()

    @property
    def sentinel(self) -> int:
        """What `multiprocessing.connection.wait` takes; ready when the process is dead."""
        return int(self._process.sentinel)

    @property
    def is_alive(self) -> bool:
        """Whether it is still there."""
        return bool(self._process.is_alive())

    def kill(self) -> None:
        """Kill it with its family, and wait until it is dead."""
        if self.is_alive:
            kill_family(self._process.pid)
        self._process.join()

    def cause_of_death(self) -> str:
        """Why it has ended, with its last words; it waits for that."""
        self._process.join()
        return cause_of_death(self._process.exitcode) + self._words.last()


def start_method() -> str:
    """The way of multiprocessing in which processes start here."""
    return "forkserver" if "forkserver" in mp.get_all_start_methods() else "spawn"


def _run(words: Path, work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """What a process does: it begins, and works under a guard, where the system can fork."""
    begin(words)
    if hasattr(os, "fork") and (worker := os.fork()):
        _guard(worker)
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    work(*arguments)


def _guard(worker: int) -> NoReturn:
    """Wait until the worker is dead, kill what it has left behind, and end as it did.

    When who has started us is gone the worker is killed, whatever it does: the fork server lives on
    as long as its children, so that nobody else would.
    """
    starter = mp.parent_process()
    assert starter is not None

    def watch() -> None:
        starter.join()
        kill_family(worker)

    threading.Thread(target=watch, daemon=True).start()
    code = os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1])
    while left := family(os.getpid()):
        kill(left)
    if code < 0:
        with contextlib.suppress(OSError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


def begin(words: Path) -> None:
    """Become a process of our own, as the module says; first of all in a fresh one.

    words : file for what it prints
    """
    if hasattr(os, "setsid"):
        os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    _redirect(words)
    ask_for_one_thread()
    with contextlib.suppress(ImportError):  # Windows
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text("1000")


def _redirect(words: Path) -> None:
    """Nothing comes in, and whatever is printed goes to the file `words`."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    out = os.open(words, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600)
    os.dup2(nothing, 0)
    os.dup2(out, 1)
    os.dup2(out, 2)
    os.close(nothing)
    os.close(out)


def prctl(option: int, value: int) -> None:
    """Set a property of this process that Linux alone knows."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


class Words:
    """What a process prints, in a file of which the end is kept."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._trimmed = b""

    def last(self) -> str:
        """The last lines, behind a colon, or nothing."""
        text = (self._trimmed + self._tail()).decode(errors="replace")
        lines = [" ".join(line.split())[:LENGTH] for line in text.splitlines() if line.strip()]
        said = " | ".join(lines[-LINES:])
        return f": {said}" if said else ""

    def trim(self) -> None:
        """Empty the file if it is long, but for its end."""
        with contextlib.suppress(OSError):
            if self.path.stat().st_size > KEPT:
                self._trimmed = self._tail()
                os.truncate(self.path, 0)

    def _tail(self) -> bytes:
        try:
            with open(self.path, "rb") as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - TAIL))
                return file.read()
        except OSError:
            return b""


def cause_of_death(code: int) -> str:
    """What an exit code says; negative: the signal."""
    if code >= 0:
        return f"left with exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def family(pid: int, recursive: bool = True) -> set[psutil.Process]:
    """What a process has forked, and what that has forked and so on, as far as it lives."""
    with contextlib.suppress(psutil.Error):
        return set(filter(_lives, psutil.Process(pid).children(recursive)))
    return set()


def _lives(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    return False


def kill_family(pid: int) -> None:
    """Kill a process that lives, with its family and its session."""
    members = family(pid)
    with contextlib.suppress(psutil.Error):
        psutil.Process(pid).kill()
    kill(members)
    kill_session(pid)


def kill(processes: Iterable[psutil.Process]) -> None:
    """Kill processes, as far as they are still there."""
    for process in processes:
        with contextlib.suppress(psutil.Error):
            process.kill()


def kill_session(leader: int) -> None:
    """Kill what is left of the session that a process led, dead or alive."""
    with contextlib.suppress(ProcessLookupError, PermissionError, AttributeError):
        os.killpg(leader, signal.SIGKILL)
