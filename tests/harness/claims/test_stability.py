"""Figure 1: the regions by their roots, and the stepper on both sides of their border."""

from __future__ import annotations

import numpy as np
import pytest

from harness.claims.stability import (
    CORNERS,
    amplification,
    border,
    characteristic,
    measured_run,
    region,
    roots,
)
from solvers import make_solver


@pytest.mark.parametrize("order", [1, 2])
def test_the_region_ends_at_the_border(order: int) -> None:
    D, K = np.linspace(0.0, 20.0, 101), np.linspace(0.0, 60.0, 301)
    # off the axes and the border, where rounding would decide
    found = region(order, D[1:], K[1:] + 1e-3)
    below = (K[1:, None] + 1e-3) <= border(order, D[None, 1:])
    np.testing.assert_array_equal(found.growth <= 1.0, below)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("D", "K"), CORNERS)
def test_corners_have_a_double_root_of_size_one(order: int, D: float, K: float) -> None:
    first, second = roots(order, D, K)[:2]
    assert abs(first - second) < 1e-6
    assert abs(abs(first) - 1) < 1e-6


def test_roots_are_those_of_the_multistep_formulas() -> None:
    """u_n = ζⁿ and h u̇_n = w ζⁿ satisfy AB-r and BDF-r as they are printed."""
    rng = np.random.default_rng(1)
    ab = {1: [0.0, 1.0], 2: [0.0, 1.5, -0.5]}
    bdf = {1: [1.0, -1.0], 2: [1.5, -2.0, 0.5]}
    for order in (1, 2):
        for D, K in rng.uniform(0.1, 3.0, (20, 2)):
            for root in roots(order, D, K):
                back = root ** -np.arange(order + 1.0)
                w = (1 - 1 / root) / (np.array(ab[order]) @ back)
                assert w * (np.array(bdf[order]) @ back) == pytest.approx(-D * w - K, abs=1e-8)


def test_without_a_damper_both_orders_are_the_leapfrog() -> None:
    K = np.linspace(0.1, 6.0, 40)
    np.testing.assert_allclose(amplification(2, 0.0, K), amplification(1, 0.0, K), rtol=1e-7)


def test_other_orders_are_refused() -> None:
    with pytest.raises(ValueError, match="order 1 or 2"):
        characteristic(3, 0.0, 1.0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("D", [0.0, 0.1])
def test_the_stepper_does_what_the_roots_say(order: int, D: float) -> None:
    assert {1: 1.0, 2: 1.5}[order] > D  # α₀ of BDF-r: (3.9) converges
    inside = measured_run(make_solver("glambda"), order, D, 0.97 * float(border(order, D)))
    outside = measured_run(make_solver("glambda"), order, D, 1.03 * float(border(order, D)))
    for run in (inside, outside):
        assert run.residual < 1e-8
        assert run.growth == pytest.approx(float(amplification(order, run.D, run.K)), rel=0.01)
    assert inside.growth < 1.001 < 1.1 < outside.growth


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("D", "K"), CORNERS)
def test_runs_at_the_corners_grow_linearly(order: int, D: float, K: float) -> None:
    size = measured_run(make_solver("glambda"), order, D, K).size
    assert size[200] / size[100] == pytest.approx(2.0, rel=0.02)
    assert size[100] / size[50] == pytest.approx(2.0, rel=0.04)
