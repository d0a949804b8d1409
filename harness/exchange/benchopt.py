"""A benchmark for benchopt: the recorded QPs as its dataset, with an objective and a first solver.

    LABEL/objective.py                 ½‖A x + d‖² within bounds: what every answer is judged by
    LABEL/datasets/recorded.py         the QPs of LABEL/datasets/recorded.npz, one by its number
    LABEL/solvers/scipy_bvls.py        to have one at all

and then `benchopt run LABEL`.  Writing only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from harness.exchange import npz
from harness.files.whole_files import write_whole
from harness.recordings.recording import Recording

OBJECTIVE = '''"""min 1/2 |A x + d|^2 within bounds; x is moved into its bounds first."""

import numpy as np
from benchopt import BaseObjective


class Objective(BaseObjective):
    name = "least squares within bounds"
    min_benchopt_version = "1.6"

    def set_data(self, A, d, lower, upper):
        self.A, self.d, self.lower, self.upper = A, d, lower, upper

    def get_objective(self):
        return dict(A=self.A, d=self.d, lower=self.lower, upper=self.upper)

    def get_one_result(self):
        return dict(x=np.clip(np.zeros(self.A.shape[1]), self.lower, self.upper))

    def evaluate_result(self, x):
        inside = np.clip(x, self.lower, self.upper)
        r = self.A @ inside + self.d
        return dict(value=0.5 * float(r @ r), violation=float(np.abs(x - inside).max(initial=0.0)))
'''
DATASET = '''"""The QPs of {label!r}, by number."""

from pathlib import Path

import numpy as np
from benchopt import BaseDataset


class Dataset(BaseDataset):
    name = "recorded"
    parameters = {{"number": {numbers}}}

    def get_data(self):
        i = self.number
        with np.load(Path(__file__).with_suffix(".npz")) as file:
            A, b, lower, upper = (file[f"{{name}}_{{i}}"] for name in ("A", "b", "lb", "ub"))
        return dict(A=A, d=-b, lower=lower, upper=upper)
'''
SOLVER = '''"""SciPy's bounded-variable least squares, run once."""

import numpy as np
from benchopt import BaseSolver
from scipy.optimize import lsq_linear


class Solver(BaseSolver):
    name = "scipy_bvls"
    sampling_strategy = "run_once"

    def set_objective(self, A, d, lower, upper):
        self.A, self.d = A, d
        room = np.where(upper > lower, upper, np.nextafter(lower, np.inf))  # a fixed row needs some
        self.bounds = lower, room

    def run(self, _):
        self.x = lsq_linear(self.A, -self.d, self.bounds, method="bvls", tol=1e-14).x

    def get_result(self):
        return dict(x=self.x)
'''
SHOWN = 5
"""QPs that a run takes if it is not told which: evenly spaced."""


def write(folder: Path, recording: Recording) -> list[Path]:
    """Write the benchmark LABEL into a folder.  Returns what is written.

    Raises ValueError where no QP has columns.
    """
    there = [i for i, qp in enumerate(recording.qps) if qp.k]
    if not there:
        raise ValueError(f"{recording.scene}: no QP has columns, so there is nothing to solve")
    chosen = sorted({there[i] for i in np.linspace(0, len(there) - 1, SHOWN).astype(int).tolist()})
    home = folder / recording.scene
    (data,) = npz.write(home / "datasets", recording)
    data = data.rename(data.with_name("recorded.npz"))
    sources = {
        home / "objective.py": OBJECTIVE,
        home / "datasets" / "recorded.py": DATASET.format(label=recording.scene, numbers=chosen),
        home / "solvers" / "scipy_bvls.py": SOLVER,
    }
    for path, text in sources.items():
        write_whole(path, text.encode())
    return [*sources, data]
