"""Times of solvers against each other in one run, as ratios with their spread and nothing else.

    python benchmarks/times.py                                glambda against itself and others
    python benchmarks/times.py glambda lotstedt               against the paper's method
    python benchmarks/times.py glambda ../before:glambda      against another checkout's

The first contestant is the measure of the others.  Where a solver stands against itself, the ratio
tells what the others' ratios are worth: two processes with the same code differ by up to a sixth,
since their memory lies differently.  FOLDER:NAME is a solver of the code in FOLDER,
such as `git worktree add ../before COMMIT` makes.

1. The sequences are simulated by the code of this checkout, and handed to all as plain arrays.
2. Every contestant lives in a process of its own, with the code of its own folder.  It waits, and
   solves one sequence in order when it is told to (setup + solve of each QP, cold or warm).
3. Rounds: all contestants one after the other, in an order that is turned round every time, so that
   what drifts on the machine drifts for all.  The first round warms up and is not counted.
4. A round gives one ratio for each: its median time per QP over that of the first contestant.
   Printed are the median of the rounds and the range of their middle half.

No time is asserted, and none in seconds is printed: they mean nothing on another machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

ROOT = Path(__file__).resolve().parents[1]
SEQUENCES = (
    *("fig2", "fig3", "fig4", "fig5"),
    *("tower,bodies=20", "wall,bodies=12,mu=0.3", "tower,bodies=100", "wall,bodies=100"),
)
PEERS = ("daqp", "quadprog", "proxqp", "piqp", "highs", "clarabel", "scipy_bvls")
"""Who stands against `glambda`, and against it once more, where nobody is named."""
PARTS = ("data", "indices", "indptr")
FIELDS = ("d", "lower", "upper", "row_id", "kind", "restart", "eps0")


class Contestant:
    """A solver of some checkout, in a process of its own."""

    def __init__(self, text: str, sequences: Path, setting: str) -> None:
        folder, colon, name = text.rpartition(":")
        self.text, root = text, Path(folder).resolve() if colon else ROOT
        if not (root / "solvers").is_dir():
            raise ValueError(f"{root}: is no checkout of glambda, it has no folder 'solvers'")
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--contestant", name, setting, str(sequences)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
        )  # fmt: skip
        try:
            where = self._answer()
            if Path(where) != root:
                raise ValueError(
                    f"{text}: the code of {where} answers; is {root} all of a checkout?"
                )
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> Contestant:
        return self

    def __exit__(self, *error: object) -> None:
        self.process.__exit__(None, None, None)  # closes the pipes, which ends it, and waits

    def median(self, label: str, arm: str) -> float:
        """Median setup + solve [s] of one pass over a sequence."""
        assert self.process.stdin is not None
        print(json.dumps([label, arm]), file=self.process.stdin, flush=True)
        return float(self._answer())

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.text}: ended early; its own words are above")
        return json.loads(line)


def contest(name: str, setting: str, sequences: Path) -> None:
    """The life of a contestant: say whose code this is, then answer [label, arm] with a median."""
    import solvers
    from harness.judging.facts import facts_of
    from harness.machine.threads import one_thread
    from harness.passes.measure import run_pass
    from problems import ContactQP

    answer = sys.stdout
    sys.stdout = sys.stderr  # what a backend prints is no answer
    posed = {}
    for label, stored in read_sequences(sequences).items():
        qps = [ContactQP(**arrays) for arrays in stored]
        if setting == "high":
            qps = [qp.with_accuracy(facts_of(qp).asked("high")) for qp in qps]
        posed[label] = qps
    solver = solvers.make_solver(name)
    print(json.dumps(str(Path(str(solvers.__file__)).parents[1])), file=answer, flush=True)
    with one_thread():
        for line in sys.stdin:
            label, arm = json.loads(line)
            _, times = run_pass(solver, posed[label], arm=arm)
            print(json.dumps(float(np.median(times[:, 1] + times[:, 2]))), file=answer, flush=True)


def write_sequences(labels: Sequence[str], path: Path) -> None:
    """Simulate the scenes and keep their QPs as plain arrays, which every version can read."""
    from problems import simulate
    from problems.scenes.calm import calm_scene
    from problems.scenes.labels import parse_label
    from solvers import make_solver

    kept: dict[str, Any] = {}
    for label in labels:
        name, parameters = parse_label(label)
        run = simulate(calm_scene(name, **parameters), make_solver("velocity"))
        for number, qp in enumerate(run.qps):
            where = f"{label}/{number}"
            A = sp.csc_array(qp.A)
            kept[f"{where}/dense"] = not sp.issparse(qp.A)
            kept[f"{where}/shape"] = np.array(A.shape)
            for name in PARTS:
                kept[f"{where}/{name}"] = getattr(A, name)
            for name in FIELDS:
                kept[f"{where}/{name}"] = getattr(qp, name)
    np.savez(path, **kept)


def read_sequences(path: Path) -> dict[str, list[dict[str, Any]]]:
    """What `write_sequences` wrote: for each label the fields of its QPs."""
    found: dict[str, list[dict[str, Any]]] = {}
    with np.load(path) as arrays:
        for key in arrays.files:
            label, number, name = key.split("/")
            qps = found.setdefault(label, [])
            if int(number) == len(qps):
                qps.append({})
            value = arrays[key]
            qps[int(number)][name] = value if value.ndim else value.item()
    for qps in found.values():
        for fields in qps:
            parts = tuple(fields.pop(name) for name in PARTS)
            A = sp.csc_array(parts, shape=tuple(fields.pop("shape")))
            fields["A"] = A.toarray() if fields.pop("dense") else A
    return found


def ratios(
    contestants: Sequence[Contestant], label: str, arm: str, rounds: int
) -> np.ndarray[Any, Any]:
    """(rounds, n − 1) median times of all but the first contestant over the first one's."""
    table = []
    for turn in range(rounds + 1):
        order = list(range(len(contestants)))
        order = order[::-1] if turn % 2 else order
        times = {i: contestants[i].median(label, arm) for i in order}
        table.append([times[i] / times[0] for i in range(1, len(contestants))])
    return np.array(table[1:])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table of ratios; exit code 0, or 2 for bad input."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("contestants", nargs="*", metavar="[FOLDER:]NAME")
    parser.add_argument("--sequences", nargs="+", default=list(SEQUENCES), metavar="LABEL")
    parser.add_argument("--setting", choices=("paper", "high"), default="high")
    parser.add_argument("--arm", choices=("cold", "warm"), default="warm")
    parser.add_argument("--rounds", type=int, default=9)
    chosen = parser.parse_args(arguments)
    names = chosen.contestants or _installed()
    if len(names) < 2 or chosen.rounds < 1:
        print("name two contestants or more, and one round or more", file=sys.stderr)
        return 2
    rows = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        stored = Path(folder) / "sequences.npz"
        write_sequences(chosen.sequences, stored)
        try:
            playing = [
                stack.enter_context(Contestant(name, stored, chosen.setting)) for name in names
            ]
        except (ValueError, RuntimeError) as error:
            print(error, file=sys.stderr)
            return 2
        for label in chosen.sequences:
            found = ratios(playing, label, chosen.arm, chosen.rounds)
            low, middle, high = np.percentile(found, (25, 50, 75), axis=0)
            for i, name in enumerate(names[1:]):
                rows.append((label, name, f"{middle[i]:.2f}×", f"{low[i]:.2f} to {high[i]:.2f}"))
    import pandas as pd

    print(f"median time per QP over that of {names[0]}, {chosen.setting}, {chosen.arm}")
    columns = ["sequence", "contestant", "ratio", "middle half of the rounds"]
    print(pd.DataFrame(rows, columns=columns).to_markdown(index=False, disable_numparse=True))
    return 0


def _installed() -> list[str]:
    from solvers import available_solvers

    there = available_solvers()
    return ["glambda", "glambda", *(name for name in PEERS if name in there)]


if __name__ == "__main__":
    if sys.argv[1:2] == ["--contestant"]:
        contest(sys.argv[2], sys.argv[3], Path(sys.argv[4]))
    else:
        sys.exit(main())
