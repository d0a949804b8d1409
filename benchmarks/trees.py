"""QPs of trees of bodies: with the multipliers of their pins, or in joint coordinates.

    python -m benchmarks.trees

Per scene and solver the time of all QPs of a run in joint coordinates, as a ratio to that of the
multiplier form.  Forming B(q) and the smaller QP is not compiled here and is left out: it is the
price of the smaller form, and for the multiplier form none.
"""

from __future__ import annotations

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from harness.machine.threads import ask_for_one_thread
from problems import scene, simulate
from problems.joints.tree import allowed_velocities, in_joint_coordinates
from problems.qp import ContactQP
from solvers import make_solver

RUNS = (("double_pendulum", 1.2), ("arm", 1.0), ("human", 1.0))
SOLVERS = ("glambda", "daqp", "proxqp", "clarabel")
PASSES = 5


def forms(name: str, until: float) -> tuple[list[ContactQP], list[ContactQP]]:
    """The QPs of the accepted steps of a run, in both forms."""
    made = scene(name)
    run = simulate(made, make_solver("glambda"), until=until)
    place = {float(t): i for i, t in enumerate(run.t)}
    steps = [qp for qp in run.qps if qp.kind == "step" and qp.accepted and qp.t in place]
    poses = (run.q[place[qp.t]].ravel() for qp in steps)
    small = [
        in_joint_coordinates(qp, allowed_velocities(made, q))[0]
        for qp, q in zip(steps, poses, strict=True)
    ]
    return steps, small


def ratio(solver: str, both: tuple[list[ContactQP], list[ContactQP]]) -> float:
    """CPU time of the second over that of the first, cold starts, in turns; the best of each."""
    one, spent = make_solver(solver), [float("inf")] * 2
    for _ in range(PASSES):
        for form, qps in enumerate(both):
            begin = time.process_time()
            for qp in qps:
                one.solve(qp)
            spent[form] = min(spent[form], time.process_time() - begin)
    return spent[1] / spent[0]


def main() -> None:
    ask_for_one_thread()
    table = Table("scene", "QPs", "k", "k, joint coordinates", *SOLVERS)
    for name, until in RUNS:
        both = forms(name, until)
        sizes = [f"{np.mean([qp.k for qp in qps]):.1f}" for qps in both]
        ratios = [f"{ratio(solver, both):.2f}" for solver in SOLVERS]
        table.add_row(name, str(len(both[0])), *sizes, *ratios)
    Console().print(table)


if __name__ == "__main__":
    main()
