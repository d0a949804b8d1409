"""What else the machine was doing while something was timed.

Two readings, one before a pass and one after it, and what happened in between:

    seconds    from one to the other
    pressure   share of them in which some task waited for a processor (PSI, Linux 4.20 on)
    memory     the same for memory
    steal      share of all processor time that the hypervisor gave to others
    switches   involuntary context switches of the process that is timed, per second
    swapped    bytes moved from and to swap
    frequency  of the processor at the end over that at the beginning

What a system does not tell is NaN, "unavailable" in words, and never 0: no reading is not a quiet
machine.  `reasons` says in words what a pass was disturbed by; what is not known is no reason, nor
is what the counters are too coarse to tell.
"""

from __future__ import annotations

import math
import time
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple

import psutil

ROOT = Path("/")
PRESSURE = 0.05
"""Share of the time with a task waiting from which on a pass is disturbed; who asks and who answers
take turns, and on a quiet machine wait for 0.6 % of it, in one pass of a hundred for 3 %."""
STEAL = 0.01
SWITCHES = 50.0
"""Per second; a process that has its core to itself has a few."""
SLOWED = 0.9
"""Part of its frequency that a processor must keep."""
TICKS = 0.03
"""[s] that counters of processor time must have gone on: they go in steps of 10 ms."""
FEW = 10
"""Context switches that anybody may have."""
MICROSECOND = 1e-6


class Reading(NamedTuple):
    """Counters at one moment; NaN where the system has none.

    time : [s];  pressure, memory : [s] in which some task waited so far
    steal, busy : [s] of all processors, given to others and in all
    switches : of the process;  swapped : [bytes];  frequency : [MHz], mean of the cores
    """

    time: float
    pressure: float
    memory: float
    steal: float
    busy: float
    switches: float
    swapped: float
    frequency: float


class Unrest(NamedTuple):
    """What happened between two readings, see the module's list; NaN where it is not known."""

    seconds: float = nan
    pressure: float = nan
    memory: float = nan
    steal: float = nan
    switches: float = nan
    swapped: float = nan
    frequency: float = nan

    @property
    def is_quiet(self) -> bool:
        """Whether there is nothing that is known to have disturbed the pass."""
        return not self.reasons()

    def reasons(self) -> dict[str, str]:
        """Entry → in words, what was beyond what a quiet machine does."""
        said = {}
        if self.pressure > PRESSURE:
            said["pressure"] = f"a task waited for a processor {self.pressure:.0%} of the time"
        if self.memory > PRESSURE:
            said["memory"] = f"a task waited for memory {self.memory:.0%} of the time"
        if self.steal > max(STEAL, TICKS / self.seconds if self.seconds > 0 else 0.0):
            said["steal"] = f"the hypervisor took {self.steal:.0%} of the processors"
        if self.switches > SWITCHES and not self.switches * self.seconds <= FEW:
            said["switches"] = f"the process was put aside {self.switches:.0f} times a second"
        if self.swapped > 0:
            said["swapped"] = f"{self.swapped / 1e6:.1f} MB were swapped"
        if self.frequency < SLOWED:
            said["frequency"] = f"the processor fell to {self.frequency:.0%} of its frequency"
        return said

    def as_json(self) -> list[float | None]:
        """The entries in order, None where they are not known."""
        return [None if isnan(value) else value for value in self]

    def told(self) -> dict[str, str]:
        """Every entry in words, "unavailable" where it is not known."""
        words = {
            "seconds": f"{self.seconds:.3g} s",
            "pressure": f"{self.pressure:.1%}",
            "memory": f"{self.memory:.1%}",
            "steal": f"{self.steal:.1%}",
            "switches": f"{self.switches:.1f} /s",
            "swapped": f"{self.swapped:.0f} bytes",
            "frequency": f"{self.frequency:.1%}",
        }
        return {
            name: "unavailable" if isnan(value) else words[name]
            for name, value in self._asdict().items()
        }


def read(pid: int | None = None, root: Path = ROOT) -> Reading:
    """What the system tells now; takes half a millisecond.

    pid : of the process whose switches are counted; None: ours;  root : where /proc is
    """
    cpu = psutil.cpu_times()
    steal = getattr(cpu, "steal", nan)
    return Reading(
        time=time.perf_counter(),
        pressure=stalled(root, "cpu"),
        memory=stalled(root, "memory"),
        steal=steal,
        busy=math.fsum(cpu[:8]) if not isnan(steal) else nan,
        switches=_switches(pid),
        swapped=_swapped(),
        frequency=_frequency(),
    )


def between(before: Reading, after: Reading) -> Unrest:
    """What happened between two readings of one process."""
    wall = after.time - before.time
    busy = after.busy - before.busy

    def share(name: str, whole: float) -> float:
        change = float(getattr(after, name) - getattr(before, name))
        return change / whole if whole > 0 else nan

    return Unrest(
        seconds=wall,
        pressure=share("pressure", wall),
        memory=share("memory", wall),
        steal=share("steal", busy),
        switches=share("switches", wall),
        swapped=after.swapped - before.swapped,
        frequency=after.frequency / before.frequency if before.frequency > 0 else nan,
    )


def stalled(root: Path, what: str) -> float:
    """[s] in which some task waited for `what`, so far; NaN without PSI."""
    try:
        lines = (root / "proc/pressure" / what).read_text().splitlines()
    except OSError:
        return nan
    for line in lines:
        if line.startswith("some "):
            return MICROSECOND * float(line.rpartition("total=")[2])
    return nan


def _switches(pid: int | None) -> float:
    try:
        return float(psutil.Process(pid).num_ctx_switches().involuntary)
    except (psutil.Error, NotImplementedError, OSError):
        return nan


def _swapped() -> float:
    try:
        swap = psutil.swap_memory()
    except (psutil.Error, RuntimeError, OSError):
        return nan
    return float(swap.sin + swap.sout)


def _frequency() -> float:
    """NaN where the frequency cannot change as far as the system tells."""
    try:
        known = psutil.cpu_freq() if hasattr(psutil, "cpu_freq") else None
    except (NotImplementedError, OSError):
        return nan
    return nan if known is None or not known.current else float(known.current)
