"""A process that runs one engine; a crash or a hang costs one run.

It is started when first needed, and anew after it was lost.  Parent and child speak in lines of
JSON: a job down; "built" and "passed" as each pass begins and ends, and at last the outcome, up.
"""

from __future__ import annotations

import json
import socket
import time
from dataclasses import asdict
from typing import Any

from harness.peers import engine_class, takes
from harness.peers.observe import observe
from harness.peers.tasks import Task
from harness.processes.process import Process

STARTING = 120.0
"""Longest that importing an engine and building a scene may take [s]."""
ERRORS = (ValueError, RuntimeError, ArithmeticError, MemoryError)
"""What an engine or the stepper may raise of a motion that cannot go on."""
LINE = 200
"""Characters of an error that are kept."""


class Worker:
    """One engine in a process of its own; to be used as a context."""

    def __init__(self, engine: str) -> None:
        self.engine = engine
        self._process: Process | None = None
        self._heard = b""

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def run(
        self, task: Task, options: dict[str, Any], resolution: float, limit: float
    ) -> dict[str, Any]:
        """Outcome of one run: status "done" and what `observe` returns, or status and reason.

        limit : [s] that one pass may take
        """
        process = self._process or self._start()
        patience, told = STARTING, None
        try:
            process.link.sendall(_line([asdict(task), options, resolution]))
            while (told := self._hear(process, patience)) is not None:
                if isinstance(told, dict):
                    return told
                patience = limit if told == "built" else STARTING
        except (EOFError, OSError):
            reason = process.cause_of_death()[1]
            self._end()
            return {"status": "crashed", "reason": reason}
        self._end()
        what, most = ("a pass", limit) if patience == limit else ("building it", STARTING)
        return {"status": "timeout", "reason": f"{what} took more than {most:g} s"}

    def _hear(self, process: Process, patience: float) -> Any:
        """The next line, or None where it does not come within `patience` [s]."""
        ends = time.monotonic() + patience
        while b"\n" not in self._heard:
            if time.monotonic() > ends:
                return None
            try:
                more = process.link.recv(1 << 16)
            except TimeoutError:
                continue
            if not more:
                raise EOFError
            self._heard += more
        line, _, self._heard = self._heard.partition(b"\n")
        return json.loads(line)

    def _start(self) -> Process:
        for in_space in (False, True):
            if takes(self.engine, in_space):
                engine_class(self.engine, in_space).prepare()
        self._heard = b""
        self._process = Process(f"{__name__}:_work", {"engine": self.engine}, (__name__,))
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process = None


def _line(what: Any) -> bytes:
    return json.dumps(what).encode() + b"\n"


def _work(link: socket.socket, engine: str) -> None:
    """What the process does, until the parent is gone."""
    link.setblocking(True)

    def tell(what: Any) -> None:
        link.sendall(_line(what))

    with link.makefile("rb") as jobs:
        for job in jobs:
            task, options, resolution = json.loads(job)
            asked = Task(**task)
            try:
                cls = engine_class(engine, asked.in_space)
                found = observe(cls, options, resolution, asked, tell)
                tell({"status": "done", "reason": "", **found})
            except ERRORS as error:
                reason = " ".join(str(error).split())[:LINE]
                tell({"status": "failed", "reason": f"{type(error).__name__}: {reason}"})
