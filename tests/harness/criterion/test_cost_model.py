"""The paper's cost model, §3.2."""

from __future__ import annotations

from functools import cache
from math import inf, sqrt

import numpy as np
import pytest

from harness.criterion.cost_model import cost_per_call, criterion_of, optimal_interval, threshold
from harness.criterion.factor_rules import drive, fixed, sequence
from harness.recordings.recording import Recording
from harness.study.record import recording_of
from problems import scene, simulate
from solvers import make_solver
from solvers.active_set.flops import cg_iteration_flops, qr_flops
from solvers.active_set.sparse.pattern import make_pattern
from solvers.active_set.unit_costs import dense_costs, goes_sparse, sparse_costs
from tests.fakes.fake_recordings import fake_recording


def test_the_paper_has_c_and_r_equal_to_1() -> None:
    assert optimal_interval(50.0, 4.0) == pytest.approx(5.0)
    assert threshold(50.0, 4.0) == pytest.approx(sqrt(2 * 50 / 4))


@pytest.mark.parametrize(("c", "r"), [(1.0, 1.0), (0.4, 0.6), (12.0, 0.92), (3.0, 0.41)])
def test_the_optimum_is_the_least_of_a_sweep(c: float, r: float) -> None:
    best = optimal_interval(700.0, 90.0, c, r)
    sweep = best * np.geomspace(0.1, 10, 2001)
    costs = [cost_per_call(s, 700.0, 90.0, c, r) for s in sweep]
    assert sweep[int(np.argmin(costs))] == pytest.approx(best, rel=2e-3)
    assert threshold(700.0, 90.0, c, r) == pytest.approx(c * best**r)


def test_cost_is_the_sum_of_a_cycle() -> None:
    """One factorization and s steps that need c j^r iterations, for many steps."""
    C_QR, C_IT, c, r, s = 1e6, 7.0, 2.0, 0.5, 4000
    cycle = C_QR + sum(c * C_IT * j**r for j in range(1, s + 1))
    assert cost_per_call(s, C_QR, C_IT, c, r) == pytest.approx(cycle / s, rel=1e-3)
    assert cost_per_call(s, C_QR, C_IT, c, r, C_0=10.0) == pytest.approx(cycle / s + 10, rel=1e-3)


def test_without_growth_it_never_pays_to_factorize() -> None:
    assert optimal_interval(50.0, 4.0, r=0.0) == threshold(50.0, 4.0, r=0.0) == inf
    assert cost_per_call(inf, 50.0, 4.0, c=3.0, r=0.0) == 12.0


@pytest.mark.parametrize("wrong", [(0.0, 1.0, 1.0, 1.0), (1.0, -1.0, 1.0, 1.0), (1, 1, 1, -0.5)])
def test_costs_must_be_positive(wrong: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        optimal_interval(*wrong)
    with pytest.raises(ValueError, match="interval"):
        cost_per_call(0.0, 1.0, 1.0)


def test_counts_of_a_recording() -> None:
    made = fake_recording(length=6)
    found = criterion_of(made)
    sizes = []
    for qp, ref in zip(made.qps, made.references, strict=True):
        if qp.kind == "step" and ref is not None:
            free = (ref.x > qp.lower) & (ref.x < qp.upper)
            sizes.append((qp.m, np.linalg.matrix_rank(qp.dense_A[:, free])))
    assert found.calls == len(sizes) == 5  # QP 4 has no reference
    assert pytest.approx(np.mean([qr_flops(m, int(f)) for m, f in sizes])) == found.C_QR
    assert pytest.approx(np.mean([cg_iteration_flops(m, int(f)) for m, f in sizes])) == found.C_IT
    assert found.threshold == pytest.approx(sqrt(2 * found.C_QR / found.C_IT))


def test_a_recording_without_steps_has_no_criterion() -> None:
    from dataclasses import replace

    made = fake_recording(length=6)
    none = criterion_of(replace(made, qps=(), solutions=(), references=()))
    assert none.calls == 0 and none.threshold == 0.0 and none.cost_per_call == 0.0


@cache
def tower_recording() -> Recording:
    """A tower large enough for the sparse path."""
    run = simulate(scene("tower", bodies=30), make_solver("glambda"), until=0.12)
    return recording_of(run, "glambda")


def test_sparse_costs_are_those_that_the_solver_counts() -> None:
    links = sequence(tower_recording())
    assert len(links) > 5 and all(goes_sparse(link.qp) for link in links)
    always, third = drive(links, fixed(1)), drive(links, fixed(3))
    entries = np.array([make_pattern(link.qp.A).entries for link in links])
    # without changes of F all that differs are factorizations, each with its estimate, and CG
    assert (always["working_set_changes"] == 0).all() and always["sparse"].all()
    more_qr = always["qr_factorizations"] - third["qr_factorizations"]
    more_cg = always["cg_iterations"] - third["cg_iterations"]
    expected = more_qr * (always["C_QR"] + 8 * entries) + more_cg * always["C_IT"]
    assert more_qr.sum() > 0 > more_cg.sum()
    np.testing.assert_array_equal(always["flops"] - third["flops"], expected)


def test_sparse_costs_can_be_counted_without_a_solve() -> None:
    made = tower_recording()
    links = sequence(made)
    steps = drive(links, fixed(1))
    for link, (_, row) in zip(links, steps.iterrows(), strict=True):
        solution = made.solutions[link.place]
        free = (solution.x > link.qp.lower) & (solution.x < link.qp.upper)
        counted = sparse_costs(link.qp, free, make_pattern(link.qp.A))
        assert counted == tuple(row[name] for name in counted._fields)
        dense = dense_costs(counted.m, counted.f)
        assert counted.C_QR < dense.C_QR / 100 and counted.C_IT < dense.C_IT
    found = criterion_of(made)
    assert found.sparse == 1.0 and found.calls == len(links)
    assert (found.rows, found.free) == (90.0, 60.0)
    assert pytest.approx(steps["C_QR"].mean()) == found.C_QR
