"""The parent's end of the server of processes (`forkserver`), and of a live process."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import weakref
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from harness.machine.threads import VARIABLES
from harness.passes.limits import Task
from harness.processes.own_process import Words, cause_of_death
from solvers.registry import target_of

PATIENCE = 60.0
"""Longest that the server may take to do what it is told [s]."""


class IsolationError(RuntimeError):
    """The server of processes cannot be started, or does not do what it is told."""


class ServerLost(Exception):
    """The server is gone, and every process with it."""


class Loss(NamedTuple):
    """A process that was lost.

    verdict : of the QP that it worked on;  text : why, or empty if its own outcome says it
    seconds : how long that was waited for
    blame : whose doing it is: "solver", "outside", or "unknown"
    """

    verdict: str
    text: str
    seconds: float = float("nan")
    blame: str = "solver"


class Server:
    """The server, with all that it has been told to run; it ends when this is closed or forgotten.

    Raises OSError where it cannot be started.
    """

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="glambda-"))
        self.serial = itertools.count()
        self._codes: dict[int, int] = {}
        self.imports_from = list(sys.path)
        self._link, theirs = Pipe()
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
        self.close = weakref.finalize(self, _end, self._link, self._process, self.folder)

    @property
    def is_alive(self) -> bool:
        """Whether it can still be told something."""
        return self.close.alive and self._process.poll() is None

    def order(self, do: str, **what: Any) -> None:
        """Tell it to do something; if it is gone, `event` says so."""
        with contextlib.suppress(OSError):
            self._link.send_bytes(json.dumps({"do": do, **what}).encode())

    def event(self, timeout: float) -> dict[str, Any] | None:
        """What it tells next, or None if that is nothing within `timeout` [s].

        Raises ServerLost, and IsolationError where it could not do what it was told.
        """
        try:
            if not self._link.poll(timeout):
                return None
            event: dict[str, Any] = json.loads(self._link.recv_bytes())
        except (OSError, EOFError):
            self.close()
            raise ServerLost from None
        if event["is"] == "dead":
            self._codes[event["pid"]] = event["code"]
        elif event["is"] == "wrong":
            raise IsolationError(event["text"])
        return event

    def await_event(self, kind: str, pid: int | None = None) -> dict[str, Any]:
        """The next event of a kind, of any process or of one.

        Raises IsolationError if it does not come.
        """
        try:
            while event := self.event(PATIENCE):
                if event["is"] == kind and pid in (None, event["pid"]):
                    return event
        except ServerLost:
            raise IsolationError("the server of processes ended; stderr may say why") from None
        raise IsolationError(f"the server of processes has not answered for {PATIENCE:g} s")

    def is_dead(self, pid: int) -> bool:
        """Whether a process has died, as far as the server has told."""
        return pid in self._codes


def _end(link: Connection, process: subprocess.Popen[bytes], folder: Path) -> None:
    """The server kills its processes and ends when its pipe is closed."""
    link.close()
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    shutil.rmtree(folder, ignore_errors=True)


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
    """A live process; it solves the block that the server holds as it starts.

    memory_limit : [bytes] beyond what it starts with

    Raises IsolationError where it cannot be started.
    """

    def __init__(self, server: Server, task: Task, memory_limit: int) -> None:
        self._server = server
        self.words = Words(server.folder / f"words-{next(server.serial)}")
        self.fresh = True
        server.order(
            "start",
            solver=task.solver,
            target=target_of(task.solver),
            options=dict(task.options),
            arm=task.arm,
            memory_limit=memory_limit,
            words=str(self.words.path),
        )
        self.pid: int = server.await_event("started")["pid"]
        self._begins_with = self._resident()

    @property
    def is_alive(self) -> bool:
        """Whether it can still be told something."""
        return self._server.is_alive and not self._server.is_dead(self.pid)

    def kill(self) -> None:
        """Have it killed, with all that it has forked."""
        self._server.order("kill", pid=self.pid)

    def wait(self) -> None:
        """Wait until it is dead, after `kill`.  Raises IsolationError if that takes too long."""
        if self.is_alive:
            self._server.await_event("dead", self.pid)
        self.words.path.unlink(missing_ok=True)

    def memory(self) -> int:
        """Bytes that it holds beyond what it started with; 0 where the system does not tell."""
        return self._resident() - self._begins_with

    def _resident(self) -> int:
        try:
            return int(psutil.Process(self.pid).memory_info().rss)
        except psutil.Error:
            return 0

    def loss_of(self, event: dict[str, Any]) -> Loss | None:
        """What an event after a pass means: None if the pass is done and all is well."""
        if event["is"] == "dead":
            text = cause_of_death(event["code"]) + self.words.last()
            # who is short of memory kills with this signal, too
            blame = "unknown" if event["code"] == -signal.SIGKILL else "solver"
            return Loss("crashed", text, blame=blame)
        if event["is"] == "babbled":
            return Loss("crashed", "wrote into the pipe to its parent")
        if event["is"] == "lost":
            return Loss("crashed", "")
        if event["left"]:
            return Loss("crashed", f"left processes of its own behind: {event['left']}")
        return None
