"""Time per step of towers in space against the number of bodies, and the exponent of its growth.

    python benchmarks/space.py
    python benchmarks/space.py --bodies 2 10 40 --steps 20

CPU time of this process, one thread, of steps at rest with h = 0.01, friction and minimum norm; the
first two steps, which compile and find λ, are not counted.  Beside it, the share that finding
points of contact takes.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from problems import scene
from problems.space.contacts import Near
from problems.space.stepper import SpaceStepper
from problems.stepping.options import StepperOptions
from solvers import make_solver

STEP = 0.01
UNCOUNTED = 2


class Timed(NamedTuple):
    """columns of the QP;  seconds per step;  share of it that points of contact take."""

    columns: int
    seconds: float
    share: float


def timed(bodies: int, steps: int) -> Timed:
    """CPU time of a tower's steps."""
    options = StepperOptions.of(1e-3, fixed_step=STEP)
    stepper = SpaceStepper(scene("space_tower", bodies=bodies), make_solver("glambda"), options)
    stepper.start()
    find, spent = Near.points, [0.0]

    def points(*given: Any) -> Any:
        begin = time.process_time()
        found = find(*given)
        spent[0] += time.process_time() - begin
        return found

    Near.points = points  # type: ignore[method-assign]
    try:
        for _ in range(UNCOUNTED):
            stepper.advance(np.inf)
        spent[0], begin = 0.0, time.process_time()
        for _ in range(steps):
            stepper.advance(np.inf)
        total = time.process_time() - begin
    finally:
        Near.points = find  # type: ignore[method-assign]
    columns = max(qp.k for qp in stepper.qps.qps if qp.kind == "step")
    return Timed(columns, total / steps, spent[0] / total)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, nargs="+", default=[2, 5, 10, 20, 40])
    parser.add_argument("--steps", type=int, default=10)
    chosen = parser.parse_args()
    table = Table(title="Towers in space at rest", title_justify="left")
    for name in ("bodies", "columns", "ms per step", "µs per body", "contacts"):
        table.add_column(name, justify="right")
    found = {bodies: timed(bodies, chosen.steps) for bodies in chosen.bodies}
    for bodies, each in found.items():
        apiece = f"{1e6 * each.seconds / bodies:.0f}"
        row = f"{each.columns}", f"{1e3 * each.seconds:.2f}", apiece, f"{each.share:.0%}"
        table.add_row(f"{bodies}", *row)
    Console().print(table)
    if len(found) > 1:
        seconds = [each.seconds for each in found.values()]
        exponent = np.polyfit(np.log(list(found)), np.log(seconds), 1)[0]
        print(f"grows as bodies^{exponent:.2f}")


if __name__ == "__main__":
    main()
