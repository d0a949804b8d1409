"""Does an adapter cost more than the package?  Each against the shortest hand-written call of it.

    python -m benchmarks.floors                          all packages, k = 6 to 450
    python -m benchmarks.floors daqp osqp --sequences tower,bodies=15 --rounds 9

1. The sequences are families of other sizes than those that are published; they are simulated here.
2. Rounds: for every QP the adapter and the hand-written call (`benchmarks/hand_written.py`), one
   right after the other, in an order that is turned round every time, both warm along the sequence.
   Accuracy asked: 1e-9 of the scale.
3. For each QP the least of the rounds counts; printed are medians over the QPs [µs], their ratios,
   and the larger error of the two in A x, relative to the scale.

What is allowed: setup + solve up to `SOLVE` times the hand-written one; build up to `BUILD` times
what NumPy needs for the same arrays, beside the wrapper's floor: what the adapter's build of a QP
of one column takes beyond NumPy's.  Exit code 1 where that is exceeded; times under load are noise:
run again alone what fails once.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.hand_written import HANDS, Hand
from harness.judging.facts import facts_of
from harness.machine.threads import one_thread
from problems import ContactQP, simulate
from problems.scenes.calm import calm_scene
from problems.scenes.labels import parse_label
from reports.parts.terminal_table import terminal_table
from solvers import available_solvers, make_solver
from solvers.adapters.quietly import quietly

SOLVE, BUILD = 1.15, 1.5
SEQUENCES = (
    *("tower,bodies=3", "tower,bodies=15", "wall,bodies=11,mu=0.3"),
    *("tower,bodies=40", "wall,bodies=30", "tower,bodies=225"),
)
LONGEST = 20
"""QPs of a sequence."""
SLOW = 2.0
"""[s] Of a round, beyond which there is no other."""


class Posed(NamedTuple):
    """A QP, A x* and the unit of errors."""

    qp: ContactQP
    Ax: Any
    scale: float


class Line(NamedTuple):
    """Medians over the QPs of a sequence [s], and the errors."""

    sequence: str
    k: int
    package: str
    build: float
    hand_build: float
    solve: float
    hand_solve: float
    error: float


def sequence(label: str, longest: int = LONGEST) -> list[Posed]:
    """QPs of the steps of a scene that no package can complain of: no fixed rows."""
    name, parameters = parse_label(label)
    run = simulate(calm_scene(name, **parameters), make_solver("glambda"))
    reference = make_solver("velocity")
    posed = []
    for qp in run.qps:
        if qp.kind == "step" and qp.k and (qp.lower < qp.upper).all() and len(posed) < longest:
            facts = facts_of(qp)
            asked = qp.with_accuracy(1e-9 * facts.scale)
            exact = (
                reference if qp.k < 200 else make_solver("glambda", accuracy=1e-12 * facts.scale)
            )
            posed.append(Posed(asked, qp.A @ exact.solve(qp).x, facts.scale))
    return posed


def one_column() -> list[Posed]:
    """A body on the ground, k = 1: what is left is the wrapper."""
    A, d, ends = (
        np.array([[1.0], [0.0], [0.5]]),
        np.array([-1.0, 0.2, 0.1]),
        (np.zeros(1), [np.inf]),
    )
    qp = ContactQP(A, d, *ends, eps0=1e-9)
    return [Posed(qp, A @ make_solver("velocity").solve(qp).x, 1.0)] * LONGEST


def compare(package: str, label: str, posed: Sequence[Posed], rounds: int) -> Line | None:
    """The adapter and the hand-written call, in turns; None where it is not for these QPs."""
    kind, k = HANDS[package], posed[0].qp.k
    bounded = any(each.qp.lower.any() or (each.qp.upper < np.inf).any() for each in posed)
    if k > kind.most or (kind.one_sided and bounded):
        return None
    solver = make_solver(package)
    times = np.full((rounds, len(posed), 4), np.nan)
    error, clock = 0.0, time.perf_counter
    for turn in range(rounds):
        hand, last, began = None, None, clock()
        gc.collect()
        gc.disable()
        for i, (qp, Ax, scale) in enumerate(posed):
            if i == 0 or qp.row_id.tobytes() != posed[i - 1].qp.row_id.tobytes():
                hand = kind(qp, 0.1 * qp.eps0 / qp.k**0.5, max(0.5 * qp.eps0**2, 1e-13))
            answers = []
            for who in ("adapter", "hand") if turn % 2 else ("hand", "adapter"):
                if who == "adapter":
                    last = solver.solve(qp, last)
                    times[turn, i, 0] = last.timing.build
                    times[turn, i, 1] = last.timing.setup + last.timing.solve
                    answers.append(last.x)
                else:
                    times[turn, i, 2:], x = _by_hand(hand, qp)
                    answers.append(x)
            if turn == 0:
                error = max(error, *(_error(qp, x, Ax, scale) for x in answers))
        gc.enable()
        if clock() - began > SLOW:
            break
    build, solve, hand_build, hand_solve = np.median(np.nanmin(times[: turn + 1], axis=0), axis=0)
    return Line(label, k, package, build, hand_build, solve, hand_solve, error)


def _by_hand(hand: Any, qp: ContactQP) -> tuple[tuple[float, float], Any]:
    """Seconds of build, and of setup and solve, and x."""
    clock = time.perf_counter
    t0 = clock()
    arrays = hand.arrays(qp)
    t1 = clock()
    try:
        x = hand.answer(arrays)
    except ValueError:  # quadprog, where P is singular
        return (np.nan, np.nan), None
    t2 = clock()
    if hasattr(hand, "after"):
        hand.after()
    return (t1 - t0, t2 - t1), x


def _error(qp: ContactQP, x: Any, Ax: Any, scale: float) -> float:
    return 0.0 if x is None else float(np.linalg.norm(qp.A @ x - Ax)) / scale


def exceeded(line: Line, floor: float) -> list[str]:
    """What of a line is beyond what is allowed, with the wrapper's `floor` [s]."""
    beyond = []
    if line.solve > SOLVE * line.hand_solve:
        beyond.append("solve")
    if line.build > BUILD * line.hand_build + floor:
        beyond.append("build")
    return beyond


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 where anything is exceeded, 2 for bad input."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("packages", nargs="*", metavar="NAME")
    parser.add_argument("--sequences", nargs="+", default=list(SEQUENCES), metavar="LABEL")
    parser.add_argument("--rounds", type=int, default=9)
    chosen = parser.parse_args(arguments)
    there = [name for name in HANDS if name in available_solvers()]
    unknown = [name for name in chosen.packages if name not in there]
    if unknown or chosen.rounds < 1:
        print(f"{unknown[0] if unknown else '--rounds'}: choose from {', '.join(there)}, "
              "and one round or more", file=sys.stderr)  # fmt: skip
        return 2
    names = chosen.packages or there
    with one_thread(), quietly():
        floors = {name: compare(name, "k = 1", one_column(), chosen.rounds) for name in names}
    lines: list[Line] = []
    for label in track(chosen.sequences, "floors", console=Console(stderr=True), transient=True):
        posed = sequence(label)
        with one_thread(), quietly():
            lines += [
                line for name in names if (line := compare(name, label, posed, chosen.rounds))
            ]
    wrapper = {name: max(f.build - f.hand_build, 0.0) if f else 0.0 for name, f in floors.items()}
    told = {line: exceeded(line, wrapper[line.package]) for line in lines}
    columns = ["sequence", ">k", "package", ">solve", ">by hand", ">ratio", ">build", ">NumPy",
               ">ratio", ">wrapper", ">error", "exceeded"]  # fmt: skip
    rows = [
        (line.sequence, line.k, line.package, *_pair(line.solve, line.hand_solve),
         *_pair(line.build, line.hand_build), f"{1e6 * wrapper[line.package]:.1f}",
         f"{line.error:.0e}", ", ".join(told[line]))
        for line in lines
    ]  # fmt: skip
    title = f"[µs] allowed: solve {SOLVE}×, build {BUILD}× and the wrapper's floor"
    Console(width=132).print(terminal_table(title, columns, rows))
    return int(any(told.values()))


def _pair(own: float, hand: float) -> tuple[str, str, str]:
    return f"{1e6 * own:.1f}", f"{1e6 * hand:.1f}", f"{own / hand:.2f}"


__all__ = ["Hand", "compare", "exceeded", "main"]

if __name__ == "__main__":
    sys.exit(main())
