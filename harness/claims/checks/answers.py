"""What the README says of answers: the same bit for bit, the same Gλ, and caught where wrong."""

from __future__ import annotations

import numpy as np

from harness.claims.checking import check
from harness.claims.checks.motions import evenly, qps_of, run_of
from harness.judging.facts import facts_of
from harness.judging.judge import judge
from harness.judging.oracle import reference
from harness.judging.proof import COLUMNS, prove
from harness.motions.as_elsewhere import apart
from problems import scene, simulate
from solvers import available_solvers, make_solver

CASES = 25


@check
def bits_apart(label: str, density: float = 1.0) -> float:
    """Numbers that differ between two runs, of which the second has another density."""
    one, two = (
        simulate(scene(label, density=rho), make_solver("glambda"), until=0.8)
        for rho in (1.0, density)
    )
    if one.q.shape != two.q.shape:
        return float(one.q.size)
    return float((one.q != two.q).sum() + (one.v != two.v).sum())


@check
def farthest(names: str, accuracy: float) -> float:
    """Largest ‖A(x − x*)‖ over the scale of QPs of fig4, asked for `accuracy` of it.

    names : solvers with commas between; absent ones are left out
    """
    qps, most = qps_of(run_of("fig4", 2.5), "step"), 0.0
    for qp in evenly(qps, CASES):
        facts, known = facts_of(qp), reference(qp)
        assert known is not None
        for name in set(names.split(",")) & set(available_solvers()):
            x = make_solver(name, accuracy=accuracy * facts.scale).solve(qp).x
            error = np.inf if x is None else np.linalg.norm(qp.A @ x - known.Ax)
            most = max(most, float(error / facts.scale))
    return most


@check
def caught(error: float) -> float:
    """Share of answers, off by so much in A x and claimed solved, that the judge calls wrong."""
    qps, rng, wrong = qps_of(run_of("fig4", 2.5), "step"), np.random.default_rng(0), 0
    for qp in evenly(qps, CASES):
        facts, known = facts_of(qp), reference(qp)
        assert known is not None
        push = rng.standard_normal(qp.k)
        x = known.x + error * facts.scale / np.linalg.norm(qp.A @ push) * push
        verdict = judge(qp, x, asked=1e-9 * facts.scale, reference=known).verdict
        wrong += verdict == "claimed_wrong"
    return wrong / CASES


@check
def proved(columns: int = COLUMNS) -> float:
    """Share of QPs of fig4 whose answer, from ours, is had in exact arithmetic.

    columns : most that may be tried
    """
    qps, solver = qps_of(run_of("fig4", 2.5), "step"), make_solver("glambda")
    found = [
        prove(qp, np.asarray(solver.solve(qp).x), columns=columns) for qp in evenly(qps, CASES)
    ]
    return float(np.mean([proof is not None for proof in found]))


@check
def rounded_apart(labels: str, environment: str, size: float = 0.0) -> float:
    """Largest pose error [m] of motions as another processor would round them, against ours.

    labels : scenes, with commas between;  environment : of `harness.motions.as_elsewhere`
    size : by which the first body is moved there at the start [m]
    """
    return max(apart(label, environment, size) for label in labels.split(","))
