"""The same scenes as other types of processor would round them: how far apart are the motions?

    python -m tests.endurance.processors                    the paper's scenes, seven environments
    python -m tests.endurance.processors --scenes fig4      one of them
    python -m tests.endurance.processors --run another -m pytest -m rounding     any module, as one

On one type of processor, with the same versions, the same command gives the same recording bit for
bit.  On another one BLAS, NumPy and the compiled kernels sum in another order.  Each environment
here is a process of its own, told by variables of these libraries to do as on another processor:

    OPENBLAS_CORETYPE            the processor whose BLAS kernels are used
    NPY_DISABLE_CPU_FEATURES     vector instructions that NumPy is to do without
    NUMBA_CPU_NAME, NUMBA_OPT    the processor that kernels are compiled for, and how well

Columns of the table, against the first environment:

    recording   "same" if the content of the recordings is the same, bit for bit
    apart       largest error of a pose [m] (`harness.motions.motion_error`) over the whole motion
    at impact   the same up to the first impact
    events      those that restart the integration: in both, and in one of the two only
    time        largest difference in time of a pair of events [s]
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from harness.machine.threads import ask_for_one_thread
from harness.motions.motion_error import Motion, match_events, pose_error
from harness.recordings.recording import Recording, read_recording, write_recording
from harness.study.record import recording_of
from problems import scene, simulate
from solvers import make_solver

SCENES = ("fig2", "fig3", "fig4", "fig5")
METHOD = "glambda"


def dispatched() -> str:
    """The vector instructions of this processor that NumPy can do without."""
    from numpy._core import _multiarray_umath as umath

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


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=SCENES, metavar="SCENE")
    parser.add_argument(
        "--run",
        nargs=argparse.REMAINDER,
        metavar="ENVIRONMENT ARGUMENTS",
        help=f"run `python ARGUMENTS` in one of {', '.join(ENVIRONMENTS)}",
    )
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.run is not None:
        name, *command = options.run or [""]
        if name not in ENVIRONMENTS:
            parser.error(f"--run {name!r} is unknown; choose from {', '.join(ENVIRONMENTS)}")
        variables = {**os.environ, **ENVIRONMENTS[name]}
        return subprocess.run([sys.executable, *command], env=variables).returncode
    if options.into is not None:
        for name in options.scenes:
            run = simulate(scene(name), make_solver(METHOD))
            write_recording(options.into / f"{name}.h5", recording_of(run, METHOD))
        return 0
    with TemporaryDirectory() as folder:
        Console().print(table(Path(folder), options.scenes))
    return 0


def table(folder: Path, scenes: Sequence[str]) -> Table:
    """One line per environment and scene."""
    out = Table("environment", "scene", "recording", "apart", "at impact", "events", "time")
    watched = track(ENVIRONMENTS.items(), "environments", console=Console(stderr=True))
    for number, (name, variables) in enumerate(watched):
        into = folder / str(number)
        into.mkdir()
        failure = run_in(variables, into, scenes)
        for label in scenes:
            if failure:
                out.add_row(name, label, failure, "", "", "", "")
            elif number:
                out.add_row(name, label, *difference(folder / "0", into, label))
    return out


def run_in(variables: dict[str, str], into: Path, scenes: Sequence[str]) -> str:
    """Record the scenes in a process with these variables; "" or why that failed."""
    own = [sys.executable, __file__, "--into", str(into), "--scenes", *scenes]
    done = subprocess.run(own, env={**os.environ, **variables}, capture_output=True, text=True)
    if done.returncode < 0:
        return signal.Signals(-done.returncode).name
    return (done.stderr.strip() or "failed").splitlines()[-1] if done.returncode else ""


def difference(first: Path, other: Path, label: str) -> list[str]:
    """The columns of one line."""
    ours, theirs = (read_recording(folder / f"{label}.h5") for folder in (other, first))
    motion, reference = motion_in(ours), motion_in(theirs)
    error = pose_error(motion, reference)
    events = match_events(motion.events, reference.events)
    return [
        "same" if ours.digest == theirs.digest else "differs",
        f"{error.largest():.1e}",
        f"{error.largest(reference.first_impact):.1e}",
        f"{events.matched} / {events.missing + events.extra}",
        f"{events.largest:.1e}",
    ]


def motion_in(recording: Recording) -> Motion:
    """The motion that was recorded."""
    radius = np.array(
        [np.linalg.norm(np.vstack(body), axis=1).max() for body in recording.polygons]
    )
    return Motion(recording.t, recording.q, recording.v, radius, recording.events)


if __name__ == "__main__":
    ask_for_one_thread()
    sys.exit(main())
