"""Whether an adapter costs more than its package: against a hand-written call, in turns."""

from __future__ import annotations

import time

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import qps_of, run_of
from harness.machine.threads import one_thread
from harness.race.by_hand import HANDS, Called, timed
from solvers import make_solver

ROUNDS, LONGEST = 60, 12


@check
def over_hand(label: str, bodies: int, slower: float = 1.0) -> float:
    """Set-up and solve of the adapter of quadprog over those of the shortest call of the package.

    QPs of a frictionless family; the least of `ROUNDS` turns counts for each.
    slower : factor by which the adapter's part is stretched, by waiting
    """
    qps = qps_of(run_of(label, 0.3, bodies=bodies), "step")[:LONGEST]
    solver, by_hand = make_solver("quadprog"), Called(HANDS["quadprog"])
    times = np.full((2, ROUNDS, len(qps)), np.inf)
    with one_thread():
        for turn in range(ROUNDS):
            for i, qp in enumerate(qps):
                found = solver.solve(qp).timing
                spent = found.setup + found.solve
                began = time.perf_counter()
                while time.perf_counter() - began < (slower - 1.0) * spent:
                    pass
                waited = time.perf_counter() - began if slower > 1.0 else 0.0
                times[:, turn, i] = spent + waited, timed(by_hand.ready_for(qp), qp)[1]
    own, hand = np.median(times.min(axis=1), axis=1)
    return float(own / hand)
