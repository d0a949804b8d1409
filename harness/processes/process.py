"""The parent's end of a process, and of the server that all are forked from (`forkserver`)."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil

from harness.machine.threads import VARIABLES
from harness.processes.cgroup import Group
from harness.processes.own_process import WORDS, Words, cause_of_death, family, kill

PATIENCE = 60.0
"""Longest that the server may take to do what it is told [s]."""
GRACE = 2.0
"""What a process that has closed its link is given to end by itself [s]."""
WATCH = 0.1
"""Seconds between two looks at a process that is waited for."""


class IsolationError(RuntimeError):
    """The server of processes cannot be started, or does not do what it is told."""


class ServerLost(Exception):
    """The server is gone, and every process with it."""


class Server:
    """The server, with all that it has forked; it ends when this is closed or forgotten.

    Raises OSError where it cannot be started.
    """

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="glambda-"))
        self._codes: dict[int, int] = {}
        self._has_answered = False
        self.imports_from = list(sys.path)
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        code = (
            "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
            "from harness.processes.forkserver import serve; serve(int(sys.argv[2]), sys.argv[3])"
        )
        arguments = [json.dumps(self.imports_from), str(theirs.fileno()), str(self.folder)]
        self._process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            env={**dict.fromkeys(VARIABLES, "1"), **os.environ},
            start_new_session=True,
        )
        theirs.close()
        self._let_go = weakref.finalize(self, _let_go, self._link, self._process)
        _alive.add(self)

    def close(self) -> None:
        """End it with all that it has forked, and wait for that."""
        self._let_go()
        _wait_for_the_ending()

    @property
    def is_alive(self) -> bool:
        """Whether it can still be told something."""
        return self._let_go.alive and self._process.poll() is None

    def order(self, link: socket.socket | None = None, **what: Any) -> None:
        """Tell it to do something; if it is gone, `await_event` says so."""
        links = [] if link is None else [link.fileno()]
        with contextlib.suppress(OSError):
            socket.send_fds(self._link, [json.dumps(what).encode()], links)

    def await_event(
        self, kind: str, pid: int | None = None, patience: float = PATIENCE
    ) -> dict[str, Any]:
        """The next event of a kind, of any process or of one.

        Raises ServerLost, and IsolationError if it does not come or the server has never begun.
        """
        while True:
            try:
                self._link.settimeout(patience)
                said = self._link.recv(1 << 16)
            except TimeoutError:
                text = f"the server of processes has not answered for {patience:g} s"
                raise IsolationError(text) from None
            except OSError:
                said = b""
            if not said:
                self.close()
                if not self._has_answered:
                    code = self._process.returncode
                    raise IsolationError(f"the server of processes ended with exit code {code}")
                raise ServerLost
            self._has_answered = True
            event: dict[str, Any] = json.loads(said)
            if event["is"] == "dead":
                self._codes[event["pid"]] = event["code"]
            if event["is"] == kind and pid in (None, event["pid"]):
                return event

    def code(self, pid: int, patience: float = PATIENCE) -> int:
        """Exit code of a process that ends (negative: the signal); it waits for that.

        Raises as `await_event` does.
        """
        if pid not in self._codes:
            self.await_event("dead", pid, patience)
        return self._codes[pid]


_alive: weakref.WeakSet[Server] = weakref.WeakSet()
"""Closed as the interpreter ends: `weakref.finalize` may come after whoever waits for them."""
_ending: list[subprocess.Popen[bytes]] = []
"""Servers that kill their processes, delete their folder and end, as their link is closed."""


def _let_go(link: socket.socket, process: subprocess.Popen[bytes]) -> None:
    """Called by the garbage collector as well, where an interrupt would be lost: it waits not."""
    link.close()
    _ending.append(process)


@atexit.register
def _close_all() -> None:
    for each in list(_alive):
        each.close()
    _wait_for_the_ending()


def _wait_for_the_ending() -> None:
    while _ending:
        process = _ending[-1]
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        _ending.pop()


_servers = threading.local()


def server() -> Server:
    """The server of this thread.

    It is started when first asked for, and anew if it is gone or imports from elsewhere than we do.
    """
    mine: Server | None = getattr(_servers, "server", None)
    ours = mine is not None and _servers.owner == os.getpid() and mine.is_alive
    if mine is None or not ours or mine.imports_from != sys.path:
        mine = Server()
        _servers.server, _servers.owner = mine, os.getpid()
    return mine


class Process:
    """A process that calls `work(link, **arguments)`, and the link to it.

    work : "module:function";  arguments : what JSON can say
    ahead : modules of ours that the server imports before, once for all
    memory : [bytes] that its control group may hold, where it has one; 0: no limit

    The link is a socket that waits for `WATCH` at most.  Raises ServerLost, and IsolationError
    where the process cannot be started.
    """

    def __init__(
        self, work: str, arguments: dict[str, Any], ahead: Sequence[str] = (), memory: int = 0
    ) -> None:
        self._server = server()
        self._group, self._limit = Group.fresh(), memory
        if self._group is not None and memory:
            self._group.limit(memory)
        self.folder = Path(tempfile.mkdtemp(dir=self._server.folder))
        self.words = Words(self.folder / WORDS)
        self.link, theirs = socket.socketpair()
        self.link.settimeout(WATCH)
        joins = [] if self._group is None else self._group.joins
        self._server.order(
            theirs,
            work=work,
            arguments=arguments,
            ahead=ahead,
            folder=str(self.folder),
            joins=joins,
        )
        theirs.close()
        try:
            self.pid: int = self._server.await_event("started")["pid"]
        except (IsolationError, ServerLost):
            self.link.close()
            self._end_group()
            raise
        self._begins_with = 0
        self._begins_with = self.memory()

    def end_forks(self) -> int:
        """Kill what it has forked; returns how many there were."""
        forks = family(self.pid)
        kill(forks)
        return len(forks)

    def kill(self) -> None:
        """Kill it with all that it has forked, and remove what it has left in its folder."""
        self.link.close()
        self._server.order(kill=self.pid)
        with contextlib.suppress(ServerLost):
            self._server.code(self.pid)
        self._end_group()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _end_group(self) -> None:
        if self._group is not None:
            self._group.close()
            self._group = None

    def is_too_large(self) -> bool:
        """Whether its control group has come to the limit of its memory."""
        return self._group is not None and 0 < self._limit <= self._group.peak()

    def cause_of_death(self) -> tuple[int, str]:
        """Exit code of a process that ends, and what it says, with its last words.

        One that only seems to, and has closed its link, is killed.
        """
        try:
            code = self._server.code(self.pid, GRACE)
        except IsolationError:
            self._server.order(kill=self.pid)
            self._server.code(self.pid)
            return 1, "closed the link to its parent" + self.words.last()
        return code, cause_of_death(code) + self.words.last()

    def memory(self) -> int:
        """Bytes that it and what it has forked hold beyond what it started with.

        What they share counts in parts.  0 where the system does not tell.
        """
        total = -self._begins_with
        with contextlib.suppress(psutil.Error):
            total += int(psutil.Process(self.pid).memory_info().rss)
            for one in family(self.pid):
                info = one.memory_full_info()
                total += int(getattr(info, "pss", info.uss))
        return total

    def cpu_of_forks(self) -> float:
        """Seconds of CPU of what it has forked, whether that has ended or not; 0 if not known."""
        if self._group is not None:
            return max(0.0, self._group.cpu() - self.cpu())
        total = 0.0
        with contextlib.suppress(psutil.Error):
            own = psutil.Process(self.pid).cpu_times()
            total += getattr(own, "children_user", 0.0) + getattr(own, "children_system", 0.0)
            total += sum(sum(one.cpu_times()[:2]) for one in family(self.pid))
        return total

    def cpu(self) -> float:
        """Seconds of CPU that all its threads have used; NaN where the system does not tell."""
        try:
            return time.clock_gettime(~self.pid << 3 | 2)  # what clock_getcpuclockid returns
        except OSError:
            return float("nan")
