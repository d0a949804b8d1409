"""Work counts of our method and the paper's on fixed sequences, against the committed baseline.

    python benchmarks/work_counts.py              compare; exit 1 where a count rose by over 5 %
    python benchmarks/work_counts.py --update     write work_counts.json anew; of what is named
                                                  by --sequences or --solvers, only that

1. The sequences are simulated on the spot.  Another method than those that are counted is in the
   loop, `velocity`, so that a change of theirs leaves the questions as they are.
2. Each sequence is replayed through our method, the paper's and its variants, cold and warm, to
   each QP's own ε₀, and every count of `problems.qp.WorkCounts` is added up.
3. A count has *risen* if it exceeds its baseline by over 5 %, and by more than rounding explains.

The counts are exact: the same code on the same machine gives the same ones.  Between machines they
differ in the last places, because sums are grouped as the processor's vectors are wide: d and A
differ by 1e-16, and where two rows block at once, or Δ_j is 0 but for rounding, that decides which
comes first.  So `--update` simulates each sequence `DISTURBED` more times, with the last bit of
every answer and then of every A and d changed at random (seeded): another machine in small.  The
farthest that a count moved is kept beside it as `rounding`.  It is 0 for half of the counts, and
above 5 % for one in seven, most of them small: there, a rise of 5 % is not told from rounding.
A sequence whose bits are not those of the baseline is named, for then the stepper has changed, or
the machine; a changed stepper calls for `--update`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp

from harness.names import METHOD, PAPER
from harness.passes.measure import run_pass
from harness.passes.starts import ARMS
from problems import ContactQP, Solution, simulate
from problems.qp import Matrix, WorkCounts
from problems.scenes.calm import calm_scene
from problems.scenes.labels import parse_label
from solvers import make_solver
from solvers.active_set.lotstedt import Lotstedt

BASELINE = Path(__file__).with_suffix(".json")
SEQUENCES = (
    *("fig2", "fig3", "fig4", "fig5"),
    *("tower,bodies=20", "tower,bodies=10,mu=0.3"),
    *("wall,bodies=20", "wall,bodies=12,mu=0.3"),
    *("tower,bodies=60", "wall,bodies=60"),
    *("pyramid,bodies=10,mu=0.3", "heap,bodies=8"),
)
SOLVERS = (METHOD, PAPER, *(f"{PAPER}[{variant}]" for variant in Lotstedt.variants))
COUNTS = tuple(WorkCounts.__dataclass_fields__)
DRIVER = "velocity"
ALLOWED = 0.05
"""Relative rise that is let pass."""
DISTURBED = 3
"""Simulations that tell what rounding does to a count."""
LAST_BIT = float(np.finfo(float).eps)

Counts = dict[str, dict[str, int]]
"""{"solver arm": {count: sum over the sequence}}."""


class Disturbed:
    """The driver, with the last bit of its answers changed at random."""

    name = DRIVER

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.driver = rng, make_solver(DRIVER)

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        """The driver's answer, disturbed and still within its bounds."""
        solution = self.driver.solve(qp, start)
        if solution.x is None:
            return solution
        x = np.clip(_disturb(solution.x, self.rng), qp.lower, qp.upper)
        return replace(solution, x=x)


def _disturb(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return values * (1.0 + LAST_BIT * rng.integers(-1, 2, values.shape))


def _disturb_matrix(A: Matrix, rng: np.random.Generator) -> Matrix:
    if isinstance(A, np.ndarray):
        return _disturb(A, rng)
    return sp.csc_array((_disturb(np.array(A.data), rng), A.indices, A.indptr), shape=A.shape)


def sequence(label: str, seed: int | None = None) -> list[ContactQP]:
    """The QPs of a scene; with a seed, those of another machine in small."""
    name, parameters = parse_label(label)
    if seed is None:
        return simulate(calm_scene(name, **parameters), make_solver(DRIVER)).qps
    rng = np.random.default_rng(seed)
    run = simulate(calm_scene(name, **parameters), Disturbed(rng))
    return [replace(qp, A=_disturb_matrix(qp.A, rng), d=_disturb(qp.d, rng)) for qp in run.qps]


def digest(qps: Iterable[ContactQP]) -> str:
    """First 16 hexadecimal digits of the sha256 of A, d and the bounds."""
    total = hashlib.sha256()
    for qp in qps:
        for array in (qp.dense_A, qp.d, qp.lower, qp.upper):
            total.update(array.tobytes())
    return total.hexdigest()[:16]


def counts_of(qps: Sequence[ContactQP], solvers: Sequence[str] = SOLVERS) -> Counts:
    """Work counts, added up over the sequence, of each solver in each arm.

    Raises RuntimeError where a solver gives no counts: then it has failed.
    """
    counts = {}
    for solver in solvers:
        for arm in ARMS:
            outcomes, _ = run_pass(make_solver(solver), qps, arm=arm)
            total = dict.fromkeys(COUNTS, 0)
            for outcome in outcomes:
                if outcome.work is None:
                    raise RuntimeError(f"{solver}, {arm}: {outcome.status_text}")
                for name, value in asdict(outcome.work).items():
                    total[name] += value
            counts[f"{solver} {arm}"] = total
    return counts


def measure(labels: Sequence[str], solvers: Sequence[str] = SOLVERS) -> dict[str, Any]:
    """{label: {"qps", "digest", "counts"}} of today's code."""
    measured = {}
    for label in labels:
        qps = sequence(label)
        counts = counts_of(qps, solvers)
        measured[label] = {"qps": len(qps), "digest": digest(qps), "counts": counts}
    return measured


def rounding_of(label: str, counts: Counts, solvers: Sequence[str] = SOLVERS) -> Counts:
    """How far each count moves when only the last bits of a sequence change."""
    moved = {who: dict.fromkeys(COUNTS, 0) for who in counts}
    for seed in range(DISTURBED):
        others = counts_of(sequence(label, seed), solvers)
        for who, other in others.items():
            for name in COUNTS:
                moved[who][name] = max(moved[who][name], abs(other[name] - counts[who][name]))
    return moved


def baseline_of(labels: Sequence[str], solvers: Sequence[str] = SOLVERS) -> dict[str, Any]:
    """What `measure` gives, with "rounding" beside each sequence's counts."""
    measured = measure(labels, solvers)
    for label, found in measured.items():
        found["rounding"] = rounding_of(label, found["counts"], solvers)
    return measured


def updated(kept: Mapping[str, Any], made: Mapping[str, Any]) -> dict[str, Any]:
    """The baseline `kept` with what was made in the place of the same of its own.

    Raises ValueError where some solvers of a sequence would be left with counts of other QPs.
    """
    whole = dict(kept)
    for label, new in made.items():
        old = kept.get(label, new)
        others = old["counts"].keys() - new["counts"].keys()
        if others and old["digest"] != new["digest"]:
            raise ValueError(
                f"{label}: its QPs have changed, and so have the counts of all solvers; leave "
                "--solvers out"
            )
        both = {part: {**old[part], **new[part]} for part in ("counts", "rounding")}
        whole[label] = {**new, **both} if others else new
    return whole


def compare(baseline: Mapping[str, Any], today: Mapping[str, Any]) -> pd.DataFrame:
    """One row per count that both have: sequence, solver, count, was, rounding, now, change, risen.

    change : relative;  risen : by more than `ALLOWED`, and by more than rounding explains
    """
    rows = []
    for label in baseline.keys() & today.keys():
        before, after = baseline[label]["counts"], today[label]["counts"]
        for who in before.keys() & after.keys():
            for name in COUNTS:
                was, now = before[who][name], after[who][name]
                rounding = baseline[label]["rounding"][who][name]
                change = (now - was) / was if was else (float("inf") if now else 0.0)
                risen = change > ALLOWED and now - was > rounding
                rows.append((label, who, name, was, rounding, now, change, risen))
    columns = ["sequence", "solver", "count", "was", "rounding", "now", "change", "risen"]
    table = pd.DataFrame(rows, columns=columns)
    return table.sort_values(["sequence", "solver", "count"], ignore_index=True)


def remarks(baseline: Mapping[str, Any], today: Mapping[str, Any]) -> list[str]:
    """What the comparison of the counts does not say."""
    said = []
    for label, found in today.items():
        kept = baseline.get(label)
        if kept is None:
            said.append(f"{label}: not in the baseline")
            continue
        if kept["qps"] != found["qps"]:
            said.append(f"{label}: {found['qps']} QPs instead of {kept['qps']}; see --update")
        elif kept["digest"] != found["digest"]:
            said.append(f"{label}: the QPs differ from the baseline's, if only in the last bits")
        before, after = ({who.split()[0] for who in of["counts"]} for of in (kept, found))
        said += [f"{label}: {solver} is not in the baseline" for solver in sorted(after - before)]
        gone = before - after - set(SOLVERS)  # of those, others were not asked for
        said += [f"{label}: {solver} is not in the code" for solver in sorted(gone)]
    return said


def report(table: pd.DataFrame, said: Sequence[str]) -> int:
    """Print what changed; return the exit code."""
    for line in said:
        print(f"note: {line}")
    changed = table[table["now"] != table["was"]]
    shown = changed[changed["risen"] | (changed["change"] < -ALLOWED)]
    if len(shown):
        shown = shown.assign(
            change=[f"{100 * change:+.1f} %" for change in shown["change"]],
            risen=["RISEN" if risen else "" for risen in shown["risen"]],
        )
        print(shown.to_markdown(index=False))
    risen = int(table["risen"].sum())
    print(f"{len(table)} counts compared: {len(changed)} differ, {risen} rose by over 5 %")
    return 1 if risen else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare with the baseline or write it; exit code 0, 1 (a rise) or 2 (bad input)."""
    parser = argparse.ArgumentParser(description="Work counts against the committed baseline.")
    parser.add_argument("--update", action="store_true", help="write the baseline anew")
    parser.add_argument("--baseline", type=Path, default=BASELINE, metavar="F.json")
    parser.add_argument("--sequences", nargs="+", metavar="LABEL", help="default: all")
    parser.add_argument("--solvers", nargs="+", metavar="NAME", help="default: all")
    chosen = parser.parse_args(arguments)
    labels, solvers = chosen.sequences or SEQUENCES, chosen.solvers or SOLVERS
    if chosen.update:
        part = chosen.sequences or chosen.solvers
        kept = json.loads(chosen.baseline.read_text()) if part and chosen.baseline.exists() else {}
        try:
            made = updated(kept, baseline_of(labels, solvers))
        except ValueError as error:
            print(error, file=sys.stderr)
            return 2
        chosen.baseline.write_text(json.dumps(made, indent=1, sort_keys=True) + "\n")
        print(f"{chosen.baseline}: written")
        return 0
    if not chosen.baseline.exists():
        print(f"{chosen.baseline}: there is none; make it with --update", file=sys.stderr)
        return 2
    baseline = json.loads(chosen.baseline.read_text())
    today = measure(labels, solvers)
    table = compare(baseline, today)
    if not len(table):
        print(f"{chosen.baseline}: holds none of what was asked for", file=sys.stderr)
        return 2
    return report(table, remarks(baseline, today))


if __name__ == "__main__":
    sys.exit(main())
