"""Does an adapter cost more than the package?  Each against the shortest hand-written call of it.

    python -m benchmarks.floors                          all packages, k = 6 to 450
    python -m benchmarks.floors daqp osqp --sequences tower,bodies=15 --rounds 9

1. The sequences are families of other sizes than those that are published; they are simulated here.
2. Rounds: for every QP the adapter and the hand-written call (`harness.race.by_hand`), one
   right after the other, in an order that is turned round every time, both warm along the sequence.
   Accuracy asked: 1e-9 of the scale.
3. For each QP the least of the rounds counts; printed are medians over the QPs [µs], their ratios,
   and the larger error of the two in A x, relative to the scale.

What is allowed: setup + solve up to `SOLVE` times the hand-written one; build up to `BUILD` times
what NumPy needs for the same arrays, beside the wrapper's floor: what the adapter's build of one
column of these QPs takes beyond NumPy's, when such solves have been between; and 0.2 µs, by which
readings of the same time differ.  Exit code 1 where that is exceeded; times under load are noise:
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

from harness.judging.facts import facts_of
from harness.machine.threads import one_thread
from harness.race.by_hand import HANDS, Called, Hand, posed_for_hands, takes, timed
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
SLOW = 3.0
"""[s] Beyond which there is no other round."""
NOISE = 2e-7
"""[s] By which two readings of one time differ that follow other work."""
WHO = "adapter", "hand"


class Posed(NamedTuple):
    """A QP, A x* and the unit of errors."""

    qp: ContactQP
    Ax: Any
    scale: float


class Line(NamedTuple):
    """Medians over the QPs of a sequence [s], the wrapper's floor [s], and the errors."""

    sequence: str
    k: int
    package: str
    build: float
    solve: float
    hand_build: float
    hand_solve: float
    wrapper: float
    error: float


def sequence(label: str, longest: int = LONGEST) -> list[Posed]:
    """QPs of the steps of a scene that no package can complain of: no fixed rows."""
    name, parameters = parse_label(label)
    run = simulate(calm_scene(name, **parameters), make_solver("glambda"))
    reference = make_solver("velocity")
    posed = []
    for qp in run.qps:
        if qp.kind == "step" and posed_for_hands(qp) and len(posed) < longest:
            facts = facts_of(qp)
            asked = qp.with_accuracy(1e-9 * facts.scale)
            exact = (
                reference if qp.k < 200 else make_solver("glambda", accuracy=1e-12 * facts.scale)
            )
            posed.append(Posed(asked, qp.A @ exact.solve(qp).x, facts.scale))
    return posed


def one_column(posed: Sequence[Posed]) -> list[Posed]:
    """Of each QP the last column alone, of what has two bounds if anything has: what is left is the
    wrapper."""
    made, method = [], make_solver("velocity")
    for qp, _, scale in posed:
        two = np.flatnonzero(qp.upper < np.inf)
        last = [int(two[-1]) if two.size else qp.k - 1]
        rows = {name: getattr(qp, name)[last] for name in ("lower", "upper", "row_id")}
        one = ContactQP(qp.A[:, last], qp.d, **rows, eps0=qp.eps0)
        made.append(Posed(one, one.A @ method.solve(one).x, scale))
    return made


class Sides:
    """The adapter and the hand-written call of a package, each warm along a sequence."""

    def __init__(self, package: str) -> None:
        self.solver, self.by_hand = make_solver(package), Called(HANDS[package])
        self.last: Any = None

    def solve(self, who: str, qp: ContactQP) -> tuple[float, float, Any]:
        """Seconds of build, of setup and solve, and x."""
        if who == "adapter":
            self.last = self.solver.solve(qp, self.last)
            timing = self.last.timing
            return timing.build, timing.setup + timing.solve, self.last.x
        found = timed(self.by_hand.ready_for(qp), qp)
        return found if found[2] is not None else (np.nan, np.nan, None)


def compare(package: str, label: str, posed: Sequence[Posed], rounds: int) -> Line | None:
    """The adapter and the hand-written call, in turns; None where it is not for these QPs."""
    if not takes(HANDS[package], [each.qp for each in posed]):
        return None
    one = one_column(posed)
    times = np.full((rounds, len(posed), 2, 3), np.nan)
    error, began = 0.0, time.perf_counter()
    for turn in range(rounds):
        sides, small = Sides(package), Sides(package)
        gc.collect()
        gc.disable()
        for i, (qp, Ax, scale) in enumerate(posed):
            for who in WHO[:: 1 if turn % 2 else -1]:
                *times[turn, i, WHO.index(who), :2], x = sides.solve(who, qp)
                error = max(error, _error(qp, x, Ax, scale)) if turn == 0 else error
        for i, (qp, *_) in enumerate(posed):  # caches are as cold as before
            for who in WHO[:: 1 if turn % 2 else -1]:
                sides.solve(WHO[1 - WHO.index(who)], qp)
                times[turn, i, WHO.index(who), 2] = small.solve(who, one[i].qp)[0]
        gc.enable()
        if time.perf_counter() - began > SLOW:
            break
    own, hand = np.median(np.nanmin(times[: turn + 1], axis=0), axis=0)
    k, wrapper = posed[0].qp.k, max(own[2] - hand[2], 0.0)
    return Line(label, k, package, *own[:2], *hand[:2], wrapper, error)


def _error(qp: ContactQP, x: Any, Ax: Any, scale: float) -> float:
    return 0.0 if x is None else float(np.linalg.norm(qp.A @ x - Ax)) / scale


def exceeded(line: Line) -> list[str]:
    """What of a line is beyond what is allowed."""
    beyond = []
    if line.solve > SOLVE * line.hand_solve:
        beyond.append("solve")
    if line.build > BUILD * line.hand_build + line.wrapper + NOISE:
        beyond.append("build")
    return beyond


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 where anything is exceeded, 2 for bad input."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("packages", nargs="*", metavar="NAME")
    parser.add_argument("--sequences", nargs="+", default=list(SEQUENCES), metavar="LABEL")
    parser.add_argument("--rounds", type=int, default=60)
    chosen = parser.parse_args(arguments)
    there = [name for name in HANDS if name in available_solvers()]
    unknown = [name for name in chosen.packages if name not in there]
    if unknown or chosen.rounds < 1:
        print(f"{unknown[0] if unknown else '--rounds'}: choose from {', '.join(there)}, "
              "and one round or more", file=sys.stderr)  # fmt: skip
        return 2
    names = chosen.packages or there
    lines: list[Line] = []
    for label in track(chosen.sequences, "floors", console=Console(stderr=True), transient=True):
        posed = sequence(label)
        with one_thread(), quietly():
            lines += [
                line for name in names if (line := compare(name, label, posed, chosen.rounds))
            ]
    told = {line: exceeded(line) for line in lines}
    columns = ["sequence", ">k", "package", ">solve", ">by hand", ">ratio", ">build", ">NumPy",
               ">ratio", ">wrapper", ">error", "exceeded"]  # fmt: skip
    rows = [
        (line.sequence, line.k, line.package, *_pair(line.solve, line.hand_solve),
         *_pair(line.build, line.hand_build), f"{1e6 * line.wrapper:.1f}",
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
