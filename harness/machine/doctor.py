"""Is this machine fit to time anything?  What is wrong is told before a study, with its remedy.

Every check reads the system and gives a `Finding`: good, wrong, or unknown where the system does
not tell.  Nothing is changed.
"""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Literal

import psutil

from harness.machine.awake import DEVICE, awake
from harness.machine.calibration import calibrate, clock_facts
from harness.machine.memory import available_memory
from harness.machine.threads import VARIABLES, threads_asked_for
from harness.machine.unrest import ROOT
from solvers.registry import describe, solver_names

Level = Literal["good", "wrong", "unknown"]

CORES = 2
"""Cores that a study is meant for: one that times and one that judges."""
MEMORY = 4e9
"""Bytes that a study may take."""
LOAD = 0.25
"""Load per core that others may make."""
WAITING = 5.0
"""Percent of the last ten seconds in which some task may have waited for a processor."""
PACE = 0.1
"""By how much the least times of a fixed piece of work may differ from each other."""
TURNS = 7
FINE = 1e-6
"""[s] Coarsest clock that tells QPs of some µs apart."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    remedy : what to do where it is wrong, or how it can be told where it is unknown
    """

    topic: str
    level: Level
    said: str
    remedy: str = ""


def examine(root: Path = ROOT) -> list[Finding]:
    """All checks.  root : where /proc and /sys are"""
    checks: Sequence[Callable[[Path], Finding]] = (
        frequency,
        sleep,
        load,
        pressure,
        cores,
        memory,
        swap,
        heat,
        threads,
        clock,
        pace,
        packages,
    )
    return [check(root) for check in checks]


def frequency(root: Path = ROOT) -> Finding:
    """Whether processors change their frequency as they like."""
    cpus = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = {text for text in map(_text, cpus) if text}
    if not governors:
        return Finding(
            "frequency", "unknown", "unavailable: the system does not tell who governs it",
            "on a virtual machine ask for one with a fixed frequency",
        )  # fmt: skip
    if governors == {"performance"}:
        return Finding("frequency", "good", "governed for performance")
    return Finding(
        "frequency", "wrong", f"scaled by {', '.join(sorted(governors))}",
        "sudo cpupower frequency-set -g performance",
    )  # fmt: skip


def sleep(root: Path = ROOT) -> Finding:
    """Whether processors may be kept from falling asleep between two solves."""
    device = root / DEVICE.relative_to("/")
    if not device.exists():
        return Finding(
            "sleep", "unknown", f"unavailable: there is no {DEVICE}",
            "short solves may be timed on a processor that has just woken up",
        )  # fmt: skip
    with awake(device) as kept:
        if kept:
            return Finding("sleep", "good", "processors are kept awake between solves")
    return Finding(
        "sleep", "wrong", "processors fall asleep between solves, which makes short ones longer",
        f"sudo chmod a+rw {DEVICE}, or run as root",
    )  # fmt: skip


def load(root: Path = ROOT) -> Finding:
    """Whether others use the processors."""
    try:
        one = os.getloadavg()[0]
    except (OSError, AttributeError):
        return Finding("load", "unknown", "unavailable", "look at the system's own monitor")
    share = one / (psutil.cpu_count() or 1)
    said = f"{one:.2f} in the last minute, {share:.2f} per core"
    if share <= LOAD:
        return Finding("load", "good", said)
    return Finding("load", "wrong", said, "end other programs, and wait a minute")


def pressure(root: Path = ROOT) -> Finding:
    """Whether tasks wait for a processor (PSI)."""
    text = _text(root / "proc/pressure/cpu")
    fields = dict(word.partition("=")[::2] for word in text.split()[1:5])
    if not text.startswith("some") or "avg10" not in fields:
        return Finding(
            "pressure", "unknown", "unavailable: no pressure stall information",
            "Linux has it from 4.20 on, with psi=1 on the kernel's command line",
        )  # fmt: skip
    waiting = float(fields["avg10"])
    said = f"a task waited for a processor {waiting:.1f} % of the last ten seconds"
    if waiting <= WAITING:
        return Finding("pressure", "good", said)
    return Finding("pressure", "wrong", said, "end other programs")


def cores(root: Path = ROOT) -> Finding:
    """Cores that this process may use, and what its control group gives it of them."""
    usable = float(len(psutil.Process().cpu_affinity() or [])) if _has_affinity() else inf
    usable = min(usable, float(psutil.cpu_count() or 1))
    quota = cpu_quota(root)
    said = f"{usable:g}" + ("" if quota == inf else f", limited to {quota:g} by the control group")
    if quota < usable:
        return Finding(
            "cores", "wrong", f"{said}: a process that has used its share is stopped",
            "raise the limit of the container (--cpus), or pin it to whole cores (--cpuset-cpus)",
        )  # fmt: skip
    if usable < CORES:
        return Finding("cores", "wrong", said, f"a study wants {CORES}: one times, one judges")
    return Finding("cores", "good", said)


def cpu_quota(root: Path = ROOT) -> float:
    """Processors that the control group may use; inf without a limit."""
    group = root / "sys/fs/cgroup"
    pair = _text(group / "cpu.max").split()
    if len(pair) != 2:
        pair = [_text(group / "cpu" / f"cpu.cfs_{name}_us") for name in ("quota", "period")]
    try:
        quota, period = float(pair[0]), float(pair[1])
    except (ValueError, IndexError):
        return inf
    return quota / period if quota > 0 and period > 0 else inf


def memory(root: Path = ROOT) -> Finding:
    """Memory that can be had, from the machine and its control group."""
    free = available_memory(root)
    said = f"{free / 1e9:.1f} GB"
    if free >= MEMORY:
        return Finding("memory", "good", said)
    return Finding("memory", "wrong", said, f"a study may take {MEMORY / 1e9:.0f} GB")


def swap(root: Path = ROOT) -> Finding:
    """Whether anything was swapped out."""
    try:
        used = psutil.swap_memory().used
    except (psutil.Error, RuntimeError, OSError):
        return Finding("swap", "unknown", "unavailable", "look at the system's own monitor")
    if not used:
        return Finding("swap", "good", "not in use")
    return Finding(
        "swap", "wrong", f"{used / 1e6:.0f} MB in use", "end other programs; sudo swapoff -a"
    )


def heat(root: Path = ROOT) -> Finding:
    """Whether processors were slowed down because they were hot."""
    counts = (root / "sys/devices/system/cpu").glob(
        "cpu[0-9]*/thermal_throttle/core_throttle_count"
    )
    known = [int(text) for text in map(_text, counts) if text.isdigit()]
    if not known:
        return Finding(
            "heat", "unknown", "unavailable: the system does not count it", "watch `pace` below"
        )
    if not any(known):
        return Finding("heat", "good", "no processor was slowed down since the start")
    return Finding(
        "heat", "wrong", f"processors were slowed down {sum(known):,} times since the start",
        "cool the machine, or lower its frequency until it keeps it",
    )  # fmt: skip


def threads(root: Path = ROOT) -> Finding:
    """Whether numerical libraries are held to one thread."""
    asked = threads_asked_for()
    if asked == "1":
        return Finding("threads", "good", "one for every numerical library")
    variables = " ".join(f"{name}=1" for name in VARIABLES)
    return Finding("threads", "wrong", f"{asked}: a fair time is that of one", f"set {variables}")


def clock(root: Path = ROOT) -> Finding:
    """Whether the clock tells QPs of some µs apart."""
    facts = clock_facts()
    said = f"steps of {1e9 * facts.resolution:.0f} ns, {1e9 * facts.reading:.0f} ns a reading"
    if facts.resolution <= FINE:
        return Finding("clock", "good", said)
    return Finding("clock", "wrong", said, "choose another clock source, such as tsc")


def pace(root: Path = ROOT) -> Finding:
    """Whether a fixed piece of work takes the same time again and again."""
    times = [calibrate() for _ in range(TURNS)]
    off = max(times) / statistics.median(times) - 1.0
    said = f"a fixed piece of work takes up to {off:.0%} longer than its median"
    if off <= PACE:
        return Finding("pace", "good", said)
    return Finding("pace", "wrong", said, "find what else runs; see load, frequency and heat")


def packages(root: Path = ROOT) -> Finding:
    """Whether all backends can be imported."""
    absent = [info.name for info in map(describe, solver_names()) if not info.available]
    if not absent:
        return Finding("packages", "good", "every backend can be imported")
    return Finding(
        "packages", "wrong", f"not installed: {', '.join(absent)}",
        "install them, or name the others with --solvers",
    )  # fmt: skip


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def _has_affinity() -> bool:
    return hasattr(psutil.Process, "cpu_affinity")
