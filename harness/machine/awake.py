"""Processors that do not fall asleep while something is timed.

Who is asked one QP at a time waits some tens of microseconds for the next.  A processor that sleeps
meanwhile wakes up slowly and cold: on a virtual machine, solves of 3 to 60 µs take a fifth to a
half longer than one after the other in one process.  Linux keeps processors awake as long as
somebody holds `DEVICE` open with a latency of 0 written to it (PM QoS); who may write there is for
the administrator to say.  Elsewhere nothing is done.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DEVICE = Path("/dev/cpu_dma_latency")
AWAKE = ", kept awake"
"""What the label of a machine ends with where it was: times of the two do not compare."""


@contextmanager
def awake(device: Path = DEVICE) -> Iterator[bool]:
    """Keep all processors awake meanwhile; whether that can be done."""
    try:
        file = device.open("r+b", buffering=0)
    except OSError:
        yield False
        return
    with file:
        try:
            file.write(bytes(4))
        except OSError:
            kept = False
        else:
            kept = True
        yield kept
