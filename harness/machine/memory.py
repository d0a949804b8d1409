"""How much memory a process may still take."""

from __future__ import annotations

from pathlib import Path

import psutil

GROUP = Path("/sys/fs/cgroup")
"""Where Linux tells of a container's memory."""


def available_memory() -> float:
    """Bytes that can be had without swapping, from the machine and from its container if any."""
    return min(float(psutil.virtual_memory().available), _of_container())


def _of_container() -> float:
    try:
        limit = int((GROUP / "memory.max").read_text())
        stat = dict(line.split() for line in (GROUP / "memory.stat").read_text().splitlines())
        return float(max(0, limit - int(stat["anon"])))  # what else is in use can be given back
    except (OSError, ValueError, KeyError):  # no container, or one without a limit
        return float("inf")
