"""The server that processes are forked from, so that one is there within some 10 ms.

`serve` runs in a process of its own, which has imported what all need and knows nothing of any
study.  By order of the parent (`harness.processes.process`) it forks processes, each with a link to
the parent and not to the server, tells what they die of, and kills.

1. A process begins and ends as `harness.processes.own_process` says.  What a dead one has left
   behind is found as well, on Linux: the server adopts its orphans.
2. Every process is killed when the parent is gone: then the server reads the end of its link.  If
   the server itself is killed, its processes die with it (on Linux).
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import shutil
import signal
import socket
import sys
import traceback
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, NoReturn

from harness.processes.cgroup import join
from harness.processes.own_process import (
    PR_SET_CHILD_SUBREAPER,
    begin,
    family,
    kill,
    kill_family,
    kill_session,
    prctl,
    tasks_of_user,
)
from problems.registry import load

LONGEST = 1 << 17
"""Bytes of an order at most."""


def serve(link: int, folder: str) -> None:
    """Do what the parent says through the file descriptor `link`, until it is gone.

    folder : deleted in the end
    """
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    tasks_of_user()  # it takes a while, and forks inherit it
    gc.freeze()
    server = Server(socket.socket(fileno=link))
    try:
        while server.turn():
            pass
    finally:
        server.kill_all()
        shutil.rmtree(folder, ignore_errors=True)


class Server:
    """The processes."""

    def __init__(self, parent: socket.socket) -> None:
        self.parent = parent
        self.processes: set[int] = set()
        self.deaths, self.wake = socket.socketpair()
        for end in (self.deaths, self.wake):
            end.setblocking(False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self.wake.fileno())

    def turn(self) -> bool:
        """Wait for something and deal with it; False when the parent is gone."""
        ready = wait([self.parent, self.deaths])
        if self.deaths in ready:
            self.deaths.recv(1024)
            self.bury()
        if self.parent in ready:
            try:
                said, links, *_ = socket.recv_fds(self.parent, LONGEST, 1)
            except ConnectionError:  # it was killed with something unread
                return False
            if not said:
                return False
            self.obey(json.loads(said), links)
        return True

    def tell(self, pid: int, said: str, **more: Any) -> None:
        """Tell the parent; if it is gone, the next turn finds out."""
        with contextlib.suppress(OSError):
            self.parent.send(json.dumps({"pid": pid, "is": said, **more}).encode())

    def obey(self, order: dict[str, Any], links: list[int]) -> None:
        """One order of the parent: to kill a process, or to start one with this link."""
        if "kill" in order:
            if order["kill"] in self.processes:
                kill_family(order["kill"])
            return
        for module in order["ahead"]:
            with contextlib.suppress(ImportError):  # the process says it
                importlib.import_module(module)
        pid = os.fork()
        if pid == 0:
            self._become(socket.socket(fileno=links[0]), order)
        os.close(links[0])
        self.processes.add(pid)
        self.tell(pid, "started")

    def bury(self) -> None:
        """Tell of the processes that have died, when what they have left behind is dead as well."""
        with contextlib.suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                pid, status = found
                if pid in self.processes:
                    self.processes.remove(pid)
                    kill_session(pid)
                    self.end_orphans()
                    self.tell(pid, "dead", code=os.waitstatus_to_exitcode(status))

    def kill_all(self) -> None:
        """Kill everything and wait for it."""
        for pid in self.processes:
            kill_family(pid)
        for pid in self.processes:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)
        self.processes.clear()
        self.end_orphans()

    def end_orphans(self) -> None:
        """Kill orphans of processes, and theirs, until there are none."""
        while orphans := [
            one for one in family(os.getpid(), recursive=False) if one.pid not in self.processes
        ]:
            kill(orphans)
            for orphan in orphans:
                with contextlib.suppress(ChildProcessError):
                    os.waitpid(orphan.pid, 0)

    def _become(self, link: socket.socket, order: dict[str, Any]) -> NoReturn:
        """Turn the fork into a process that works; it never returns."""
        code = 1
        try:
            server = os.getppid()
            join(order["joins"])
            begin(Path(order["folder"]))
            if os.getppid() != server:
                os._exit(1)
            signal.set_wakeup_fd(-1)
            for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_DFL)
            for other in (self.parent, self.deaths, self.wake):
                other.close()
            load(order["work"])(link, **order["arguments"])
            code = 0
        except BaseException as error:
            print(*traceback.format_exception_only(error), file=sys.stderr, flush=True)
        finally:
            os._exit(code)
