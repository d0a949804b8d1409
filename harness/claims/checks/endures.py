"""What the harness endures: SIGKILL, and solvers that crash, hang, leak or lie about their time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import pandas as pd

from harness.claims.checking import check
from harness.claims.checks.motions import run_of
from harness.claims.culprits import CULPRITS
from harness.machine.kernels import import_path
from harness.recordings.recording import Recording, write_recording
from harness.results.shard_file import BY_CLOCK
from harness.results.store import read_results
from harness.study.record import recording_of
from harness.study.replay import replay
from solvers import registry

LENGTH, SCENE = 12, 7
"""QPs of the recording, and the place of that at which something is done."""
MEMORY = 0.5
"""That a solver may take [GiB]."""
MAY_DIFFER = ("executor", *BY_CLOCK)
KILLED = """
import os, signal, sys
from harness.study.replay import replay

def kill(name, done, total):
    if 2 * done > total:
        os.kill(os.getpid(), signal.SIGKILL)

replay(sys.argv[1], {solvers}, ("high",), results=sys.argv[2], repeats=1, isolate=False,
       progress=kill)
"""
SOLVERS = ("glambda", "quadprog", "daqp")


def _recording() -> Recording:
    """The first steps of fig4 that have columns."""
    run = run_of("fig4", 0.4)
    kept = [i for i, qp in enumerate(run.qps) if qp.kind == "step" and qp.k > 0][:LENGTH]
    part = replace(run, qps=[run.qps[i] for i in kept], solutions=[run.solutions[i] for i in kept])
    return recording_of(part, "glambda")


@check
def differing(resume: bool) -> float:
    """Entries by which a study that SIGKILL has ended in its midst differs from one at a stretch.

    Times aside.  resume : whether it is begun again afterwards; a row that is missing is an entry
    """
    with TemporaryDirectory() as name:
        recording, killed, whole = (Path(name) / part for part in ("fig4.h5", "killed", "whole"))
        write_recording(recording, _recording())
        code = KILLED.format(solvers=SOLVERS)
        command = [sys.executable, "-c", code, str(recording), str(killed)]
        environment = {**os.environ, "PYTHONPATH": import_path()}
        ended = subprocess.run(command, env=environment).returncode
        if ended != -signal.SIGKILL:
            raise RuntimeError(f"the study was not killed, but ended with {ended}")
        for folder in (killed, whole):
            if folder == whole or resume:
                replay(recording, SOLVERS, ("high",), results=folder, repeats=1, isolate=False)
        one, other = (
            read_results(folder).drop(columns=list(MAY_DIFFER)) for folder in (killed, whole)
        )
    if len(one) != len(other):
        return float(abs(len(one) - len(other)))
    written = [rows.astype(object).map(repr).to_numpy() for rows in (one, other)]
    return float((written[0] != written[1]).sum())


def _study(names: Sequence[str], variant: str) -> pd.DataFrame:
    """The rows of a study of culprits and an honest solver, each in a process of its own.

    variant : "at" for the time of the QP at `SCENE`
    """
    recording = _recording()
    told = str(recording.qps[SCENE].t) if variant == "at" else variant
    asked = [f"{name}[{told}]" if told else name for name in names]
    with patch.dict(registry._REGISTERED, CULPRITS):
        return replay(recording, [*asked, "glambda"], ("high",), ("cold",), repeats=1,
                      time_limit=0.2, memory_limit=MEMORY)  # fmt: skip


@check
def lost(names: str, variant: str = "at") -> float:
    """Rows of a study that are not verified, but for those of the QPs at which something was done.

    names : culprits with commas between;  variant : "at" one QP, or "always"
    """
    culprits = names.split(",")
    verdicts = _study(culprits, variant)["verdict"]
    return float((verdicts != "verified").sum() - len(culprits))


@check
def disbelieved(variant: str) -> float:
    """Share of a solver's rows in which its own clock is not believed.

    It spends `culprits.PAD` on each QP.  variant : "always" tells of a nanosecond, "" of the truth
    """
    rows = _study(["lies"], variant)
    return float(1.0 - rows[rows["solver"] != "glambda"]["believed"].mean())
