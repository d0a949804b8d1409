"""One thread: a fair time is that of one core.

The numerical libraries read `VARIABLES` as they load, so the command line sets them before it
imports any.  Where a program has loaded them already, `one_thread` limits what can still be
limited, if threadpoolctl is installed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "RAYON_NUM_THREADS",
)


def ask_for_one_thread() -> None:
    """Set `VARIABLES` to 1, but for those that the user has set."""
    for name in VARIABLES:
        os.environ.setdefault(name, "1")


def threads_asked_for() -> str:
    """What the environment says: a number, "unset", or "mixed"."""
    limits = {os.environ.get(name, "unset") for name in VARIABLES}
    return limits.pop() if len(limits) == 1 else "mixed"


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit libraries that are loaded already to one thread, where threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        yield
        return
    with threadpool_limits(limits=1):
        yield
