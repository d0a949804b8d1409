"""How much memory a process may still take."""

from __future__ import annotations

from pathlib import Path

import psutil

from harness.machine.unrest import ROOT

GROUPS = (
    ("memory.max", "memory.stat", "anon"),
    ("memory/memory.limit_in_bytes", "memory/memory.stat", "total_rss"),
)
"""Where Linux tells of a container's limit, and of what is in use there that cannot be given back:
below /sys/fs/cgroup, today and in its first version."""


def available_memory(root: Path = ROOT) -> float:
    """Bytes that can be had without swapping, from the machine and from its container if any.

    root : where /sys is
    """
    free = float(psutil.virtual_memory().available)
    return min(free, *(_of_container(root / "sys/fs/cgroup", *names) for names in GROUPS))


def _of_container(group: Path, limit: str, stat: str, held: str) -> float:
    try:
        lines = (group / stat).read_text().splitlines() if (group / stat).exists() else []
        used = int(dict(line.split() for line in lines).get(held, "0"))
        return float(max(0, int((group / limit).read_text()) - used))
    except (OSError, ValueError):  # no container, or one without a limit
        return float("inf")
