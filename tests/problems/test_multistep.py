"""Multistep formulas: exact on the polynomials that they should be exact on, and (3.5)."""

import numpy as np
import pytest

from problems.formulas.multistep import first_order_step
from problems.formulas.step_kernels import bdf, longest_step, path_curvature, predicted

TIMES = np.array([0.0, 0.1, 0.17])
"""Three time points, of which the last is the newest; the next step goes on from there."""
H_BEFORE, H = 0.07, 0.05


def newest(function):
    """Values (1,) at the last two time points, newest first."""
    return np.array([function(TIMES[2])]), np.array([function(TIMES[1])])


def test_ab2_is_exact_for_linear_velocity_with_variable_steps():
    (v, before), bend = newest(lambda t: 1 + 3 * t), np.empty(1)
    path_curvature(2, v, before, H_BEFORE, bend)
    assert H * (v + H * bend)[0] == pytest.approx(H * (1 + 3 * 0.17) + 1.5 * H * H)
    path_curvature(1, v, before, H_BEFORE, bend)
    assert bend[0] == 0.0


def test_bdf2_is_exact_for_quadratic_velocity_with_variable_steps():
    def v(t):
        return 2 - t + 4 * t * t

    def a(t):
        return -1 + 8 * t

    b = np.empty(1)
    alpha0 = bdf(2, H / H_BEFORE, *newest(v), b)
    assert (H * a(0.17 + H) + b[0]) / alpha0 == pytest.approx(v(0.17 + H))


def test_constant_step_gives_the_familiar_coefficients():
    b = np.empty(1)
    assert bdf(2, 1.0, np.array([0.2]), np.array([0.1]), b) == pytest.approx(1.5)
    assert b[0] == pytest.approx(2 * 0.2 - 0.5 * 0.1)
    assert bdf(1, 1.0, np.array([0.2]), np.array([0.1]), b) == 1.0
    assert b[0] == 0.2


def test_predictor_uses_what_is_known():
    (v, _), guess = newest(lambda t: t * t), np.empty(1)
    a = newest(lambda t: 2 * t)
    for steps, expected in ((0, 0.17**2), (1, 0.17**2 + H * 0.34), (2, (0.17 + H) ** 2)):
        predicted(steps, H, H / H_BEFORE, v, *a, guess)
        assert guess[0] == pytest.approx(expected)


def test_step_length_meets_3_5_with_equality():
    D, eps = np.array([2.0]), 1e-4
    a = newest(lambda t: 3 * t * t)
    h = longest_step(D, 2, *a, H_BEFORE, eps)
    jerk = 2 * abs(a[0][0] - a[1][0]) / H_BEFORE
    assert h * h * (h / 6 + H_BEFORE / 4) * jerk == pytest.approx(h * eps)
    early = longest_step(D, 1, *a, H_BEFORE, eps)
    assert 0.5 * early**2 * 2 * a[0][0] == pytest.approx(early * eps)
    assert first_order_step(0.0, eps) == np.inf


def test_free_fall_has_no_estimate():
    assert longest_step(np.ones(1), 2, np.ones(1), np.ones(1), H_BEFORE, 1e-3) == np.inf
