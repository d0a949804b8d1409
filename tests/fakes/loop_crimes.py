"""What a process of a closed loop can do wrong; light, because the process imports it."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

CRIMES = ("dies", "leaves", "hangs")


def commit(loop: Any, folder: Path, told: Callable[[float], None]) -> None:
    """Come to t = 0.25 s, then do what the solver's name says."""
    told(0.25)
    if loop.solver == "dies":
        print("last words", file=sys.stderr, flush=True)
        os.kill(os.getpid(), signal.SIGSEGV)
    elif loop.solver == "leaves":
        os._exit(3)
    elif loop.solver == "hangs":
        time.sleep(600)
