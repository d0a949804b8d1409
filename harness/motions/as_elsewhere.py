"""A motion as another type of processor would round it.

    python -m harness.motions.as_elsewhere FOLDER fig4 fig5     record scenes, in this environment

On one type of processor, with the same versions, the same command gives the same recording bit for
bit.  On another one BLAS, NumPy and the compiled kernels sum in another order.  Each environment
here is a process of its own, told by variables of these libraries to do as on another processor:

    OPENBLAS_CORETYPE            the processor whose BLAS kernels are used
    NPY_DISABLE_CPU_FEATURES     vector instructions that NumPy is to do without
    NUMBA_CPU_NAME, NUMBA_OPT    the processor that kernels are compiled for, and how well
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from harness.machine.kernels import import_path
from harness.machine.threads import ask_for_one_thread
from harness.motions.motion_error import Motion, pose_error
from harness.names import METHOD
from harness.recordings.recording import Recording, read_recording, write_recording
from harness.study.record import recording_of
from problems import scene, simulate
from solvers import make_solver


def dispatched() -> str:
    """The vector instructions of this processor that NumPy can do without."""
    umath: Any = import_module("numpy._core._multiarray_umath")
    return " ".join(name for name in umath.__cpu_dispatch__ if umath.__cpu_features__[name])


GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_OPT": "1"}
"""Optimized less as well, which sums in yet another order and compiles sooner.  Always together:
numba's cache tells processors apart, and not how much was optimized."""
ENVIRONMENTS: dict[str, dict[str, str]] = {
    "this": {},
    "nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "zen": {"OPENBLAS_CORETYPE": "Zen"},
    "plain_numpy": {"NPY_DISABLE_CPU_FEATURES": dispatched()},
    "generic_kernels": GENERIC,
    "another": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": dispatched(),
        **GENERIC,
    },
}
"""By name, the variables of each.  A processor without AVX-512 dies of SkylakeX's instructions."""


def record(into: Path, scenes: Sequence[str], ahead: float = 0.0) -> None:
    """Record scenes in this process; their first body begins by `ahead` further along x [m]."""
    for label in scenes:
        made = scene(label)
        q0 = made.q0.copy()
        q0[0, 0] += ahead
        run = simulate(replace(made, q0=q0), make_solver(METHOD))
        write_recording(into / f"{label}.h5", recording_of(run, METHOD))


def record_in(
    variables: Mapping[str, str], into: Path, scenes: Sequence[str], ahead: float = 0.0
) -> str:
    """The same in a process with these variables; "" or why that failed."""
    own = [sys.executable, "-m", "harness.motions.as_elsewhere", str(into), *scenes, str(ahead)]
    environment = {**os.environ, "PYTHONPATH": import_path(), **variables}
    done = subprocess.run(own, env=environment, capture_output=True, text=True)
    if done.returncode < 0:
        return signal.Signals(-done.returncode).name
    return (done.stderr.strip() or "failed").splitlines()[-1] if done.returncode else ""


def motion_in(recording: Recording) -> Motion:
    """The motion that was recorded."""
    radius = np.array(
        [np.linalg.norm(np.vstack(body), axis=1).max() for body in recording.polygons]
    )
    return Motion(recording.t, recording.q, recording.v, radius, recording.events)


def apart(label: str, environment: str, ahead: float = 0.0) -> float:
    """Largest pose error [m] of a scene in an environment against the same in this one.

    ahead : by which the first body begins further along x there [m]

    Raises RuntimeError where the environment cannot be had.
    """
    with TemporaryDirectory() as name:
        here, there = (Path(name) / part for part in ("here", "there"))
        for folder in (here, there):
            folder.mkdir()
        record(here, [label])
        failed = record_in(ENVIRONMENTS[environment], there, [label], ahead)
        if failed:
            raise RuntimeError(f"{environment}: {failed}")
        ours, theirs = (
            motion_in(read_recording(folder / f"{label}.h5")) for folder in (here, there)
        )
    return pose_error(theirs, ours).largest()


if __name__ == "__main__":
    ask_for_one_thread()
    record(Path(sys.argv[1]), sys.argv[2:-1], float(sys.argv[-1]))
