"""A process that runs one engine; a crash or a hang costs one run.

It is started when first needed, and anew after it was lost.  Parent and child speak by a pipe: a
job down; "built" and "passed" as each pass begins and ends, and at last the outcome, up.
"""

from __future__ import annotations

import multiprocessing as mp
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from harness.peers import engine_class
from harness.peers.observe import observe
from harness.peers.tasks import Task
from harness.processes.own_process import OwnProcess

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
        self._process: OwnProcess
        self._link: Connection | None = None

    def __enter__(self) -> Worker:
        self._folder = tempfile.TemporaryDirectory()
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._folder.cleanup()

    def run(
        self, task: Task, options: dict[str, Any], resolution: float, limit: float
    ) -> dict[str, Any]:
        """Outcome of one run: status "done" and what `observe` returns, or status and reason.

        limit : [s] that one pass may take
        """
        link = self._link or self._start()
        try:
            link.send((task, options, resolution))
            patience = STARTING
            while link.poll(patience):
                told: str | dict[str, Any] = link.recv()
                if isinstance(told, dict):
                    return told
                patience = limit if told == "built" else STARTING
        except (EOFError, OSError):
            reason = self._process.cause_of_death()
            self._end()
            return {"status": "crashed", "reason": reason}
        self._end()
        what, most = ("a pass", limit) if patience == limit else ("building it", STARTING)
        return {"status": "timeout", "reason": f"{what} took more than {most:g} s"}

    def _start(self) -> Connection:
        engine_class(self.engine).prepare()
        self._link, theirs = mp.Pipe()
        words = Path(self._folder.name) / "words.txt"
        self._process = OwnProcess(words, _work, theirs, self.engine)
        theirs.close()
        return self._link

    def _end(self) -> None:
        if self._link is not None:
            self._process.kill()
            self._link.close()
            self._link = None


def _work(link: Connection, engine: str) -> None:
    """What the process does."""
    cls = engine_class(engine)
    while True:
        try:
            task, options, resolution = link.recv()
        except EOFError:
            return  # the parent is gone
        try:
            found = observe(cls, options, resolution, task, link.send)
            link.send({"status": "done", "reason": "", **found})
        except ERRORS as error:
            reason = " ".join(str(error).split())[:LINE]
            link.send({"status": "failed", "reason": f"{type(error).__name__}: {reason}"})
