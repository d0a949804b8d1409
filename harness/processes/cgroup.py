"""Control groups: the system itself counts and limits what a process and all that it forks take.

They are made by BenchExec (Beyer, Löwe and Wendler 2019), the extra `cgroups`, where the system
lets its user make them (its documentation says what that takes).  A process joins its group before
it does anything else.  Then

1. memory is limited for the whole family together, by the system and at once, and
2. the CPU of all that it has forked counts, whether that has ended or not, and wherever it went.

Elsewhere both are looked at from outside (`harness.processes.process`).
"""

from __future__ import annotations

import contextlib
import logging
import os
from functools import cache
from pathlib import Path
from typing import Any

GROUPS, LOOKS = "control group", "process"
"""What a row says of who has counted and limited: a control group, or looks at the process."""


@cache
def _parent(owner: int) -> Any:
    """The group that those of process `owner` are made in; None where there can be none."""
    try:
        from benchexec.cgroups import Cgroups
    except ImportError:
        return None
    try:
        group = Cgroups.initialize()
        needed = (group.CPU, group.MEMORY)
        return group if all(group.require_subsystem(one, logging.debug) for one in needed) else None
    except (OSError, AttributeError, KeyError, SystemExit):
        return None  # a system without them, or one that does not let us


def executor() -> str:
    """Who counts and limits here: `GROUPS` or `LOOKS`."""
    return GROUPS if _parent(os.getpid()) is not None else LOOKS


class Group:
    """A group for one process and all that it forks.

    joins : files that a process writes 0 into to be in it
    """

    def __init__(self, made: Any) -> None:
        self._made = made
        self.joins = [str(Path(path) / "cgroup.procs") for path in made.paths]

    @classmethod
    def fresh(cls) -> Group | None:
        """A new one; None where there can be none."""
        parent = _parent(os.getpid())
        if parent is None:
            return None
        return cls(parent.create_fresh_child_cgroup([parent.CPU, parent.MEMORY]))

    def limit(self, memory: int) -> None:
        """Let it take no more than that [bytes]; beyond it the system kills."""
        self._made.write_memory_limit(memory)

    def cpu(self) -> float:
        """CPU that all have used since they joined [s]."""
        return float(self._made.read_cputime())

    def peak(self) -> int:
        """Most memory that they have held together [bytes]; 0 where the system does not tell."""
        return int(self._made.read_max_mem_usage() or 0)

    def close(self) -> None:
        """Kill what is left in it, and remove it."""
        with contextlib.suppress(OSError):
            self._made.kill_all_tasks()
            self._made.remove()


def join(files: list[str]) -> None:
    """Be in the group that `Group.joins` names, for good."""
    for file in files:
        Path(file).write_text("0")
