"""How much memory a process may still take."""

from __future__ import annotations

from pathlib import Path

MEMINFO = Path("/proc/meminfo")
GROUP = Path("/sys/fs/cgroup")
"""Where Linux tells of the machine's memory, and a container of its own."""


def available_memory() -> float:
    """Bytes that can be had without swapping, as far as the system tells; else infinity."""
    return min(_of_machine(), _of_container())


def _of_machine() -> float:
    try:
        lines = MEMINFO.read_text().splitlines()
        return 1024.0 * next(int(line.split()[1]) for line in lines if line[:13] == "MemAvailable:")
    except (OSError, ValueError, IndexError, StopIteration):
        return float("inf")


def _of_container() -> float:
    try:
        limit = int((GROUP / "memory.max").read_text())
        stat = dict(line.split() for line in (GROUP / "memory.stat").read_text().splitlines())
        return float(max(0, limit - int(stat["anon"])))  # what else is in use can be given back
    except (OSError, ValueError, KeyError):  # no container, or one without a limit
        return float("inf")
