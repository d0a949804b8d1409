"""Plug-ins that do to who imports them what they should not, as their module is looked into.

`load("tests.fakes.hostile_imports:NAME")` does what `NAME` says, and returns an honest solver.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.fakes.crimes import Honest

DENORMALS_ARE_ZERO = "0fae5c24fc" + "814c24fc40800000" + "0fae5424fc" + "c3"
"""Machine code that sets FTZ and DAZ, as a library linked with -ffast-math does."""
DOWNWARD = 0x400


def _flush_to_zero() -> None:
    code = mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    code.write(bytes.fromhex(DENORMALS_ARE_ZERO))
    ctypes.CFUNCTYPE(None)(ctypes.addressof(ctypes.c_char.from_buffer(code)))()


def _everything_is_verified() -> None:
    from dataclasses import replace

    import harness.study.replay

    judge = harness.study.replay.judge
    for module in [m for name, m in sys.modules.items() if name.startswith("harness.")]:
        if hasattr(module, "judge"):
            module.judge = lambda *a, **b: replace(  # type: ignore[attr-defined]
                judge(*a, **b), verdict="verified", glambda_error=0.0
            )


def _deaf() -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD):
        signal.signal(number, signal.SIG_IGN)


FATAL: dict[str, Callable[[], Any]] = {
    "leaves": lambda: os._exit(0),
    "wants_to_leave": lambda: sys.exit(0),
    "segfault": lambda: ctypes.string_at(0),
    "hangs": lambda: time.sleep(1000),
}
"""What no process survives."""
SILENT: dict[str, Callable[[], Any]] = {
    "folder": lambda: os.chdir(tempfile.gettempdir()),
    "umask": lambda: os.umask(0o777),
    "signals": _deaf,
    "timer": lambda: signal.setitimer(signal.ITIMER_REAL, 1000.0),
    "files": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (16, 16)),
    "size": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000)),
    "closes": lambda: os.closerange(0, 3),
    "errors": lambda: np.seterr(all="raise"),
    "rounding": lambda: ctypes.CDLL(None).fesetround(DOWNWARD),
    "denormals": _flush_to_zero,
    "judge": _everything_is_verified,
}
"""What is seen later, and elsewhere."""


def __getattr__(name: str) -> Any:
    if name in FATAL or name in SILENT:
        {**FATAL, **SILENT}[name]()
        return Honest
    if name == "wrong_judge":
        _everything_is_verified()
        return type("Wrong", (Honest,), {"answer": lambda self, qp, x: x + 1.0})
    raise AttributeError(name)


def targets() -> dict[str, str]:
    """Name → "module:Class"."""
    return {name: f"{__name__}:{name}" for name in (*FATAL, *SILENT, "wrong_judge")}
