"""The paper's cost model, §3.2."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
import pytest

from harness.cost_model import cost_per_call, criterion_of, optimal_interval, threshold
from solvers.active_set.flops import cg_iteration_flops, qr_flops
from tests.fake_recordings import fake_recording


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
