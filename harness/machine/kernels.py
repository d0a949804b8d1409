"""Kernels compiled ahead, on all cores, where a command would otherwise compile them one by one.

    python -m harness.machine.kernels              all of them, if any is missing
    python -m harness.machine.kernels steps        some parts, in this process

Each part is compiled by doing a little of everything with it.  A part that is there is not looked
at again (`_mark`).
"""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from rich.console import Console

from harness.machine.threads import VARIABLES
from harness.progress import Progress, shown


def steps() -> None:
    """Algorithm 1 with friction and impulses, for any solver."""
    from problems import scene, simulate
    from solvers import make_solver

    for name, until in (("fig2", 0.05), ("fig4", 0.3), ("fig5", 0.3)):
        simulate(scene(name), make_solver("velocity"), until=until)


def within_steps() -> None:
    """Some of what `steps` come to last, for the lane that has less to do."""
    import numpy as np
    from numba import typeof

    from problems.contacts.dips import first_dip
    from problems.friction.kernels import small_newton_multipliers
    from problems.least_norm.least_distance import least_distance

    matrix, whole = np.zeros((1, 1)), np.zeros((1, 1), np.int64)
    columns, rows, vector = (matrix, whole), whole[0], matrix[0]
    edges, scratch = (matrix, vector), (matrix, vector, vector)
    fixed = np.zeros((1, 1))
    fixed.flags.writeable = False
    handed = {
        first_dip: ((vector, vector, vector), 0.0, (0, 0), vector, edges, 0.0, scratch),
        small_newton_multipliers: (columns, columns, vector, rows, *(5 * [vector]), True),
        least_distance: (fixed, fixed[0], fixed[0], fixed[0], matrix),
    }
    for kernel, arguments in handed.items():
        kernel.compile(tuple(typeof(argument) for argument in arguments))


def dense() -> None:
    """Algorithm 2."""
    from solvers.active_set.method import compile_dense

    compile_dense()


def sparse() -> None:
    """Algorithm 2 for QPs of many columns; it comes with `dense`."""
    import numpy as np

    from problems.qp import ContactQP
    from solvers import make_solver

    A = _band()
    k = A.shape[1]
    qps = [ContactQP(A, np.full(k, d), np.zeros(k), np.full(k, np.inf)) for d in (1.0, -1.0)]
    for name in ("glambda", "lotstedt"):
        last = None
        for qp in qps:
            last = make_solver(name).solve(qp, last)


def within_sparse() -> None:
    """Some of what `sparse` comes to, the order of elimination among it, for the other lane."""
    from solvers.active_set.sparse.interior import approach
    from solvers.active_set.sparse.pattern import make_pattern
    from solvers.active_set.sparse.workspace import make_sparse_workspace

    A = _band()
    room = make_sparse_workspace(A.shape[0], make_pattern(A))
    approach(room.pattern, room.Bx, room.Lx, room.S, room.I, A.shape[0], 0)


def _band() -> Any:
    """A sparse A of so many columns that it is solved as one."""
    import scipy.sparse as sp

    return sp.csc_array(sp.diags_array([1.0, -1.0], offsets=[0, 1], shape=(60, 60)))


def posing() -> None:
    """What brings QPs into the form of packages."""
    import numpy as np
    import scipy.sparse as sp

    from problems.kernels.spread import compile_spread
    from problems.qp import ContactQP
    from solvers.adapters.normal_form import is_definite, is_one_sided
    from solvers.adapters.posed import pose

    compile_spread()
    A, ends = np.array([[1.0], [0.5]]), (np.zeros(1), np.full(1, np.inf))
    for each in (A, sp.csc_array(A)):
        posed = pose(ContactQP(each, np.ones(2), *ends))
        is_one_sided(posed.lower, posed.upper)
        is_definite(posed.P, 0.5)
        assert posed.P_upper.nnz == posed.P_lower.nnz


PARTS: dict[str, Callable[[], None]] = {
    "steps": steps,
    "within steps": within_steps,
    "posing": posing,
    "dense": dense,
    "sparse": sparse,
    "within sparse": within_sparse,
}
LANES = ("within sparse", "steps", "posing"), ("within steps", "dense", "sparse")
"""Parts that need each other, in the order in which one process compiles them; a lane a core.  What
is within a part is there before the other lane comes to it, which would compile it, too."""
PART_OF = {"within steps": "steps", "within sparse": "sparse"}
"""Parts that are compiled with another one, which need not be named."""


def compile_ahead(
    parts: Sequence[str] = ("steps", "posing", "dense"), tell: Progress | None = None
) -> None:
    """See to it that these parts are compiled, each lane in a process of its own.

    tell : called with what is compiled and how many parts are done, of all

    A part whose process fails is compiled where it is needed, and says there what is wrong.
    """
    lanes = [
        [p for p in lane if PART_OF.get(p, p) in parts and not _mark(p).exists()] for lane in LANES
    ]
    if not any(lanes):
        return
    running = [
        subprocess.Popen(
            [sys.executable, "-m", "harness.machine.kernels", *lane],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **dict.fromkeys(VARIABLES, "1"), "PYTHONPATH": import_path()},
        )
        for lane in lanes
        if lane
    ]
    began = time.monotonic()
    try:
        while left := sum(process.poll() is None for process in running):
            if tell is not None:
                what = f"compile kernels, once ({time.monotonic() - began:.0f} s)"
                tell(what, len(running) - left, len(running))
            time.sleep(0.1)
    finally:
        for process in running:
            if process.poll() is None:
                process.kill()
            process.wait()


def import_path() -> str:
    """What a process of ours finds modules by."""
    return os.pathsep.join(path or os.getcwd() for path in sys.path)


def _mark(part: str) -> Path:
    """A file that is there when this part has been compiled, by these sources, for this machine."""
    import numba

    from problems.kernels.compiled import SOURCES, cache_folder
    from solvers.active_set import compiled

    place = Path(__file__).resolve()
    names = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_NRT_STATS")
    said = [numba.__version__, sys.version, str(place), *(os.environ.get(n, "") for n in names)]
    if part == "posing":
        said.append((place.parents[2] / "solvers/adapters/normal_form.py").read_text("utf-8"))
    key = hashlib.sha256("\n".join(said).encode()).hexdigest()[:16]
    sources = compiled.SOURCES if PART_OF.get(part, part) in ("dense", "sparse") else SOURCES
    return cache_folder(sources) / f"{part}-{key}"


def main(arguments: Sequence[str]) -> None:
    """Compile the parts that are named, here, or all."""
    if not arguments:
        with shown("kernels", Console(stderr=True)) as tell:
            compile_ahead(tuple(PARTS), tell)
        return
    gc.disable()  # compilers keep objects by the million: to search these takes a fifth of the time
    for part in arguments:
        PARTS[part]()
        gc.collect()
        with suppress(OSError):
            _mark(part).touch()


if __name__ == "__main__":
    main(sys.argv[1:])
