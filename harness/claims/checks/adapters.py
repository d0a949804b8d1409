"""Whether an adapter costs more than its package: against a hand-written call, in turns."""

from __future__ import annotations

import time

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import qps_of, run_of
from harness.machine.threads import one_thread
from problems import ContactQP
from solvers import make_solver

ROUNDS, LONGEST = 60, 12


@check
def over_hand(label: str, bodies: int, slower: float = 1.0) -> float:
    """Set-up and solve of the adapter of quadprog over those of the shortest call of the package.

    QPs of a frictionless family; the least of `ROUNDS` turns counts for each.
    slower : factor by which the adapter's part is stretched, by waiting
    """
    qps = qps_of(run_of(label, 0.3, bodies=bodies), "step")[:LONGEST]
    solver, times = make_solver("quadprog"), np.full((2, ROUNDS, len(qps)), np.inf)
    with one_thread():
        for turn in range(ROUNDS):
            for i, qp in enumerate(qps):
                found = solver.solve(qp).timing
                spent = found.setup + found.solve
                began = time.perf_counter()
                while time.perf_counter() - began < (slower - 1.0) * spent:
                    pass
                waited = time.perf_counter() - began if slower > 1.0 else 0.0
                times[:, turn, i] = spent + waited, _by_hand(qp)
    own, hand = np.median(times.min(axis=1), axis=1)
    return float(own / hand)


def _by_hand(qp: ContactQP) -> float:
    """Seconds of the shortest call, arrays ready."""
    import quadprog

    A = qp.dense_A
    P, a, C, b = A.T @ A, -(A.T @ qp.d), np.identity(qp.k), np.zeros(qp.k)
    began = time.perf_counter()
    quadprog.solve_qp(P, a, C, b)
    return time.perf_counter() - began
