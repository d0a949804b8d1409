"""Is `glambda compare` right? Studies of the same code, and of code with a change planted in it.

    python -m tests.endurance.compare                     eight studies of two scenes, some minutes
    python -m tests.endurance.compare --studies 3 --until 0.5

1. The scenes are recorded once.  Studies are made of them one after the other, the same solvers
   each time, in processes of their own as ever.
2. Among them is one with DAQP waiting busily, a fifth longer for each QP, and one with the paper's
   method counting 5 % more work (`tests/endurance/planted.py`).
3. All pairs of studies of the same code are compared: nothing should have changed.  Each of them is
   compared with the two others: what was planted should be found, and nobody else blamed.

Exit code 1 if more than one in twenty of the former comparisons (one, where they are fewer) sees a
change, or one in twenty of the latter misses what was planted.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import pandas as pd

from harness.processes.introduction import forget
from harness.results.changes import Changes, compare_results
from harness.study.replay import replay
from harness.study.study import record_into
from solvers import registry

SCENES = ("fig3", "fig4")
SOLVERS = ("glambda", "daqp", "quadprog", "piqp", "proxqp", "scipy_bvls")
PLANTED = {
    "daqp": "tests.endurance.planted:SlowDAQP",
    "glambda": "tests.endurance.planted:BusyGlambda",
}


def study(recordings: Sequence[Path], folder: Path, planted: str = "") -> Path:
    """Replay the recordings into a folder, with a change planted in one of the solvers."""
    if planted:
        registry.register(planted, PLANTED[planted])
    forget()
    try:
        replay(recordings, SOLVERS, ("high",), results=folder)
    finally:
        registry._REGISTERED.pop(planted, None)
        forget()
    return folder


def changed(changes: Changes) -> list[str]:
    """Solvers and runs whose times are said to differ, and work counts that have risen."""
    solvers = [name for name, r in changes.ratios.solvers.items() if r.slower or r.faster]
    times = changes.times[(changes.times["low"] > 1) | (changes.times["high"] < 1)]
    counts = changes.counts[changes.counts["risen"]]
    return [
        *(f"{name} {changes.ratios.solvers[name].ratio:.2f}" for name in solvers),
        *(f"{row.scene} {row.arm} {row.solver} {row.ratio:.2f}" for row in times.itertuples()),
        *(f"{row.scene} {row.arm} {row.solver} {row.work}" for row in counts.itertuples()),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the studies, compare them, and print what was found."""
    parser = argparse.ArgumentParser(description="Studies of the same code, and of changed code.")
    parser.add_argument("--studies", type=int, default=6, help="of the same code")
    parser.add_argument("--until", type=float, default=1.5, help="end of the motions [s]")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = []
        for scene in SCENES:
            made = record_into(folder / "recordings", scene, until=chosen.until)
            recordings.append(folder / "recordings" / f"{made.scene}.h5")
        plan = ["" for _ in range(chosen.studies)]
        for planted in PLANTED:  # in the middle
            plan.insert(len(plan) // 2, planted)
        alike, other = [], {}
        for number, planted in enumerate(plan):
            print(f"study {number + 1} of {len(plan)}", flush=True)
            made_in = study(recordings, folder / f"{number}", planted)
            if planted:
                other[planted] = made_in
            else:
                alike.append(made_in)
        return report(alike, other)


def report(alike: Sequence[Path], other: dict[str, Path]) -> int:
    """Compare and print; the exit code."""
    false, disturbed, spreads, machines = [], [], [], []
    for one, two in combinations(alike, 2):
        changes = compare_results(one, two)
        words = changed(changes)
        false.append(bool(words))
        disturbed.append(changes.disturbed)
        spreads.append(changes.ratios.spread)
        machines.append(abs(changes.ratios.machine - 1))
        if words:
            print(f"same code, studies {one.name} and {two.name}: {', '.join(words)}")
    slow, others, counts, ratios = [], [], [], []
    for one in alike:
        changes = compare_results(one, other["daqp"])
        slow.append("daqp" in changes.ratios.solvers and changes.ratios.solvers["daqp"].slower)
        ratios.append(changes.ratios.solvers["daqp"].ratio if slow[-1] else float("nan"))
        blamed = [words for words in changed(changes) if "daqp" not in words]
        others.append(bool(blamed))
        if blamed:
            print(f"slow daqp, study {one.name}: {', '.join(blamed)}")
        changes = compare_results(one, other["glambda"])
        risen = changes.counts[changes.counts["risen"]]
        counts.append(set(risen["solver"]) == {"glambda"})
    rows = [
        ("comparisons of the same code", len(false)),
        ("that saw a change", sum(false)),
        ("runs not compared, the machine being disturbed, mean", sum(disturbed) / len(disturbed)),
        ("spread of the same code beyond passes, median", f"{pd.Series(spreads).median():.1%}"),
        ("the machine's change, largest", f"{max(machines):.1%}"),
        ("comparisons with DAQP a fifth slower", len(slow)),
        ("that saw it", sum(slow)),
        ("its ratio, median", f"{pd.Series(ratios).median():.3f}"),
        ("that blamed another solver", sum(others)),
        ("comparisons with 5 % more work counted", len(counts)),
        ("that saw it and no other", sum(counts)),
    ]
    print(pd.DataFrame(rows, columns=["what", "number"]).to_markdown(index=False))
    wrong = sum(false) > max(1, len(false) // 20)
    return int(wrong or sum(slow) < 0.95 * len(slow) or not all(counts))


if __name__ == "__main__":
    sys.exit(main())
