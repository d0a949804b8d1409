"""The server that live processes are forked from, and what goes on in one of them.

`serve` runs in a process of its own, which has imported everything and read the recording, so that
a fork is ready to solve within some 10 ms and shares all of that with the others.  It computes
nothing.  By order of the parent (`harness.processes.isolate`) it starts processes, passes on what
they are to do, tells what they say and what they die of, and kills.

1. A process begins, speaks and ends as every one of ours does (`harness.processes.own_process`).
   What a dead one has left behind is found as well, on Linux: the server adopts its orphans.
2. Every process is killed when the parent is gone: then the server reads the end of its pipe.  If
   the server itself is killed, its processes die with it (on Linux).
3. A process has limits: of memory (`RLIMIT_AS`, which macOS does not heed), and of new processes
   and threads (`RLIMIT_NPROC`, which root is not held to).
4. After a pass a process says `DONE` or `LOST` behind the token that came with the order, and at
   no other time anything.  Its answers stand in the sheet (`harness.processes.sheet`).
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import resource
import shutil
import signal
import socket
import sys
import traceback
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NoReturn

import psutil

from harness.machine.threads import one_thread
from harness.passes.measure import pose, run_pass
from harness.processes.own_process import (
    PR_SET_CHILD_SUBREAPER,
    begin,
    family,
    kill,
    kill_family,
    kill_session,
    prctl,
)
from harness.processes.sheet import Layout, Lost, Pen
from harness.recordings.recording import Recording, read_recording
from problems.qp import ContactQP
from solvers import make_solver
from solvers.active_set import method  # noqa: F401  its kernels are loaded once for all processes
from solvers.registry import BUILT_IN, register

DONE, LOST = b"done", b"lost"
"""What a process says after a pass; `LOST`: it ended early and wants to be replaced."""
NEW_TASKS = 256
"""Processes and threads that may be added to the user's while a process lives."""


def serve(link: int, folder: str) -> None:
    """Do what the parent says through the file descriptor `link`, until it is gone.

    folder : deleted in the end
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    server = Server(Connection(link))
    try:
        while server.turn():
            pass
    finally:
        server.kill_all()
        shutil.rmtree(folder, ignore_errors=True)


class Server:
    """The processes, and the block that they are to solve: a recording at an accuracy."""

    def __init__(self, parent: Connection) -> None:
        self.parent = parent
        self.processes: dict[int, socket.socket] = {}
        self.tokens: dict[int, bytes] = {}
        self.babbled: set[int] = set()
        self.recording: Recording | None = None
        self.posed: list[ContactQP] = []
        self.block: dict[str, Any] = {}
        self.deaths, self.wake = socket.socketpair()
        for end in (self.deaths, self.wake):
            end.setblocking(False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self.wake.fileno())

    def turn(self) -> bool:
        """Wait for something and deal with it; False when the parent is gone."""
        talking = {end: pid for pid, end in self.processes.items() if end.fileno() >= 0}
        ready = wait([self.parent, self.deaths, *talking])
        for end in talking.keys() & set(ready):
            self.hear(talking[end])
        if self.deaths in ready:
            self.deaths.recv(1024)
            self.bury()
        if self.parent in ready:
            try:
                self.obey(json.loads(self.parent.recv_bytes()))
            except (EOFError, OSError):
                return False
        return True

    def tell(self, pid: int, said: str, **more: Any) -> None:
        """Tell the parent; if it is gone, the next turn finds out."""
        with contextlib.suppress(OSError):
            self.parent.send_bytes(json.dumps({"pid": pid, "is": said, **more}).encode())

    def obey(self, order: dict[str, Any]) -> None:
        """One order of the parent."""
        do = order.pop("do")
        if do == "load":
            self.load(**order)
        elif do == "start":
            self.tell(self.start(order), "started")
        elif do == "pass":
            pid = order.pop("pid")
            self.tokens[pid] = order["token"].encode()
            with contextlib.suppress(OSError, KeyError):  # its death is told anyway
                self.processes[pid].sendall(json.dumps(order).encode() + b"\n")
        elif do == "kill":
            self.kill(order["pid"])

    def load(self, recording: str, digest: str, asked: list[float], **block: Any) -> None:
        """Read a recording, unless it is the last one, and pose its QPs.

        asked : accuracy of each QP;  block : what `_live` needs
        """
        try:
            if self.recording is None or self.recording.digest != digest:
                self.recording = read_recording(recording)
            if self.recording.digest != digest:
                raise ValueError(f"{recording}: was replaced by another recording in the meantime")
        except ValueError as error:
            self.recording = None
            self.tell(0, "wrong", text=str(error))
            return
        self.posed = pose(self.recording.qps, asked)
        self.block = block
        self.tell(0, "loaded")

    def start(self, task: dict[str, Any]) -> int:
        """Fork a process for a solver in an arm; returns its number."""
        if task["target"] in BUILT_IN.values():
            with contextlib.suppress(ImportError):  # the process says it
                importlib.import_module(task["target"].partition(":")[0])
        ours, theirs = socket.socketpair()
        pid = os.fork()
        if pid == 0:
            self._become(theirs, task)
        theirs.close()
        ours.setblocking(False)
        self.processes[pid] = ours
        return pid

    def hear(self, pid: int) -> None:
        """What a process says; whatever is not what it is to say is remembered."""
        end = self.processes[pid]
        try:
            said = end.recv(1 << 16)
        except OSError:
            said = b""
        if not said:
            end.close()  # it has closed its files; what that is worth is seen when it dies
            return
        before, token, kind = said.rpartition(self.tokens.get(pid, b"\0"))
        if before or not token:
            self.babbled.add(pid)
        if token:
            honest = pid not in self.babbled and kind in (DONE, LOST)
            self.tell(pid, kind.decode() if honest else "babbled", left=self.end_forks(pid))

    def bury(self) -> None:
        """Tell of the processes that have died, when what they have left behind is dead as well."""
        with contextlib.suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                pid, status = found
                if pid not in self.processes:
                    continue
                self.hear(pid)  # its last word
                self.processes.pop(pid).close()
                kill_session(pid)
                self.end_orphans()
                self.tell(pid, "dead", code=os.waitstatus_to_exitcode(status))

    def kill(self, pid: int) -> None:
        """Kill a process and its session; `bury` tells when it is dead."""
        if pid in self.processes:
            kill_family(pid)

    def kill_all(self) -> None:
        """Kill everything and wait for it."""
        for pid in self.processes:
            self.kill(pid)
        for pid in self.processes:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)
        self.processes.clear()
        self.end_orphans()

    def end_forks(self, pid: int) -> int:
        """Kill what process `pid` has forked, and all orphans; returns how many there were."""
        forks = family(pid)
        kill(forks)
        return len(forks | self.end_orphans())

    def end_orphans(self) -> set[psutil.Process]:
        """Kill orphans of processes, and theirs, until there are none; returns which they were."""
        killed = set()
        while orphans := {
            one for one in family(os.getpid(), recursive=False) if one.pid not in self.processes
        }:
            kill(orphans)
            for orphan in orphans:
                os.waitpid(orphan.pid, 0)
            killed.update(orphans)
        return killed

    def _become(self, link: socket.socket, task: dict[str, Any]) -> NoReturn:
        """Turn the fork into a live process; it never returns."""
        code = 1
        try:
            server = os.getppid()
            begin(Path(task["words"]))
            if os.getppid() != server:
                os._exit(1)
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            self.parent.close()
            for other in (self.deaths, self.wake, *self.processes.values()):
                other.close()
            assert self.recording is not None
            _live(link, self.recording, self.posed, task, **self.block)
            code = 0
        except BaseException as error:
            print(*traceback.format_exception_only(error), file=sys.stderr, flush=True)
        finally:
            os._exit(code)


def _live(
    link: socket.socket,
    recording: Recording,
    posed: list[ContactQP],
    task: dict[str, Any],
    *,
    sheet: str,
    time_limit: float,
) -> None:
    """Make the solver, and do a pass whenever told to, until the server is gone."""
    register(task["solver"].partition("[")[0], task["target"])
    solver = make_solver(task["solver"], **task["options"])
    _limit(task["memory_limit"])
    gc.freeze()  # whatever is there is no litter of a pass
    pen = Pen(sheet, Layout([qp.k for qp in posed]))
    with one_thread(), link.makefile("rb") as orders:
        for line in orders:
            order = json.loads(line)
            budget = float("inf") if order["budget"] is None else order["budget"]
            said = DONE
            try:
                run_pass(
                    solver,
                    posed,
                    arm=task["arm"],
                    references=recording.references,
                    time_limit=time_limit,
                    budget=budget,
                    first=order["first"],
                    watch=pen,
                )
            except Lost:
                said = LOST
            link.sendall(order["token"].encode() + said)


def _limit(memory: int) -> None:
    """Limit what the process may take: `memory` [bytes] beyond what it has."""
    if sys.platform == "linux":
        _lower(resource.RLIMIT_AS, psutil.Process().memory_info().vms + memory)
    if os.getuid() != 0:
        _lower(resource.RLIMIT_NPROC, _tasks_of(os.getuid()) + NEW_TASKS)


def _lower(which: int, value: int) -> None:
    """Set a limit, unless a lower one is there."""
    _, most = resource.getrlimit(which)
    if most == resource.RLIM_INFINITY or value < most:
        resource.setrlimit(which, (value, value))


def _tasks_of(user: int) -> int:
    """Processes and threads of a user."""
    count = 0
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.uids().real == user:
                count += process.num_threads()
    return count
