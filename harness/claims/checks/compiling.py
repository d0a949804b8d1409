"""How long kernels take to compile."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from tempfile import TemporaryDirectory

from harness.claims.checking import check
from harness.machine.kernels import import_path

COMMAND = [sys.executable, "-m", "harness.machine.kernels"]


@check
def minutes(kept: bool) -> float:
    """Minutes of `harness.machine.kernels` without kernels, or where they are `kept`."""
    with TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": import_path(), "XDG_CACHE_HOME": folder}
        if kept:
            subprocess.run(COMMAND, env=environment, check=True, capture_output=True)
        began = time.perf_counter()
        subprocess.run(COMMAND, env=environment, check=True, capture_output=True)
        return (time.perf_counter() - began) / 60.0
