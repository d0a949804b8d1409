"""Machine code does not depend on what else has been loaded, or on who compiled it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

KERNELS = """
import os, sys
from pathlib import Path
import numpy as np
from problems.kernels.compiled import kernel_decorator

kernel = kernel_decorator([Path(__file__)])

@kernel
def near_root(x, times):
    for _ in range(times):
        for i in range(x.size):
            if x[i] > 1.0:
                x[i] = np.sqrt(x[i]) + 1e-3 * np.sin(x[i])
            elif x[i] < -1.0:
                x[i] = -np.cbrt(x[i]) + 1e-3 * np.cos(x[i])
            else:
                x[i] += 2.0 * np.exp(x[i]) - np.log(2.0 + x[i])
    return x

@kernel
def twice(x):
    return near_root(x, 3).sum() + near_root(x, 5).sum() + near_root(x, x.size).sum()
"""
LOOK = """
from llvmlite.binding import Linkage

x = np.linspace(-3.0, 5.0, 37)
print(twice(x.copy()).hex())
library = twice.overloads[twice.signatures[0]].library
if len(sys.argv) > 1:
    print(sum(twice.stats.cache_hits.values()))
else:
    own = [f for f in library._final_module.functions if not f.is_declaration]
    copies = [f for f in own if "near_root" in f.name]
    print(len(copies), sum(f.linkage is Linkage.internal for f in copies))
"""


def test_a_kernel_calls_its_own_copies_of_other_kernels(tmp_path: Path) -> None:
    script = tmp_path / "kernels.py"
    script.write_text(KERNELS + LOOK)

    apart = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}

    def lines(*argument: str) -> list[str]:
        run = [sys.executable, str(script), *argument]
        done = subprocess.run(run, capture_output=True, text=True, check=True, env=apart)
        return done.stdout.split()

    compiled, copies, own = lines()
    again, hits = lines("cached")
    assert int(copies) == int(own) > 0
    assert again == compiled and hits == "1"
