"""A process of its own: how it begins, what it has printed, and how it ends with its family.

A crash or a hang then costs what the process did, and no more.  All of ours share this:

1. `begin`.  It leads a session of its own, so that no interrupt of the terminal reaches it; reads
   nothing; prints into a file; asks libraries for one thread; dumps no core; is the first that a
   Linux without memory kills; and dies with its parent (on Linux).  Orphans of what it has forked
   become its own children (on Linux), so that they are found.
2. `Words`.  The last lines in that file explain a death.
3. `kill_family`.  Whatever it has forked ends with it.

`harness.processes.forkserver` forks them, for replays, closed loops, engines and plug-ins.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import psutil

from harness.machine.threads import ask_for_one_thread

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
WORDS = "words"
"""File in its folder that a process prints into."""
KEPT = 1 << 20
"""Bytes of what a process prints that are kept."""
NEW_TASKS = 256
"""Processes and threads that may be added to the user's."""
LINES, LENGTH = 3, 100
"""Last words: so many lines of so many characters at most."""
TAIL = 4096
"""Bytes that last words are looked for in."""


def begin(folder: Path) -> None:
    """Become a process of our own, as the module says; first of all in a fresh one.

    folder : for what it prints (`WORDS`), its temporary files and its caches
    """
    if hasattr(os, "setsid"):
        os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    _redirect(folder / WORDS)
    os.environ |= dict.fromkeys(("TMPDIR", "HOME", "XDG_CACHE_HOME"), str(folder))
    tempfile.tempdir = None
    ask_for_one_thread()
    with contextlib.suppress(ImportError):  # Windows
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text("1000")


def limit(memory: int) -> None:
    """Limit what this process may take: `memory` [bytes] beyond what it has (`RLIMIT_AS`, which
    macOS does not heed), and new processes and threads (`RLIMIT_NPROC`, which root need not)."""
    if sys.platform == "linux":
        _lower("RLIMIT_AS", psutil.Process().memory_info().vms + memory)
    if hasattr(os, "getuid") and os.getuid() != 0:
        _lower("RLIMIT_NPROC", tasks_of_user() + NEW_TASKS)


def _lower(name: str, value: int) -> None:
    """Set a limit, unless a lower one is there."""
    import resource

    which = getattr(resource, name)
    _, most = resource.getrlimit(which)
    if most == resource.RLIM_INFINITY or value < most:
        resource.setrlimit(which, (value, value))


@cache
def tasks_of_user() -> int:
    """Processes and threads of the user, as they were when first asked for."""
    count = 0
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.uids().real == os.getuid():
                count += process.num_threads()
    return count


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
    found: set[psutil.Process] = set()
    with contextlib.suppress(psutil.Error):
        if not _may_have_forked(pid):
            return found
        found.update(filter(_lives, psutil.Process(pid).children(recursive)))
    return found


def _may_have_forked(pid: int) -> bool:
    """False where Linux says that it has no child; psutil looks at all processes there are."""
    try:
        return any(path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children"))
    except OSError:
        return True


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
