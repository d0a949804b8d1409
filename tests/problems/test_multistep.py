"""Multistep formulas: exact on the polynomials that they should be exact on, and (3.5)."""

from itertools import pairwise

import numpy as np
import pytest

from problems.formulas.multistep import History, first_order_step


def history_of(v, a, times):
    """A history that has stepped through `times` along known functions."""
    history = History(np.array([v(times[0])]))
    for before, now in pairwise(times):
        history.push(now - before, np.array([v(now)]), np.array([a(now)]))
    return history


def test_ab2_is_exact_for_linear_velocity_with_variable_steps():
    history = history_of(lambda t: 1 + 3 * t, lambda t: 3.0, [0.0, 0.1, 0.17])
    path = history.path(np.zeros(1))
    h = 0.05
    assert path(h)[0] == pytest.approx(h * (1 + 3 * 0.17) + 1.5 * h * h)
    assert path.rate(h)[0] == pytest.approx(1 + 3 * (0.17 + h))


def test_bdf2_is_exact_for_quadratic_velocity_with_variable_steps():
    v, a = lambda t: 2 - t + 4 * t * t, lambda t: -1 + 8 * t
    history = history_of(v, a, [0.0, 0.1, 0.17])
    h = 0.05
    alpha0, b = history.bdf(h)
    assert (h * a(0.17 + h) + b[0]) / alpha0 == pytest.approx(v(0.17 + h))


def test_constant_step_gives_the_familiar_coefficients():
    history = history_of(lambda t: t, lambda t: 1.0, [0.0, 0.1, 0.2])
    alpha0, b = history.bdf(0.1)
    assert alpha0 == pytest.approx(1.5)
    assert b[0] == pytest.approx(2 * 0.2 - 0.5 * 0.1)


def test_two_first_order_steps_after_a_restart():
    history = History(np.zeros(1))
    orders = []
    for _ in range(4):
        orders.append(history.order)
        history.push(0.1, np.zeros(1), np.zeros(1))
    assert orders == [1, 1, 2, 2]
    history.restart(np.ones(1))
    assert history.order == 1
    assert history.path(np.zeros(1))(0.5)[0] == 0.5


def test_predictor_uses_what_is_known():
    v, a = lambda t: t * t, lambda t: 2 * t
    assert history_of(v, a, [0.0]).predict(0.1)[0] == 0.0
    assert history_of(v, a, [0.0, 0.1]).predict(0.1)[0] == pytest.approx(0.01 + 0.1 * 0.2)
    assert history_of(v, a, [0.0, 0.1, 0.2]).predict(0.1)[0] == pytest.approx(0.09)


def test_step_length_meets_3_5_with_equality():
    norm = np.linalg.norm
    history = history_of(lambda t: t**3, lambda t: 3 * t * t, [0.0, 0.1, 0.17])
    eps = 1e-4
    h = history.largest_step(eps, norm)
    jerk = norm(history.a[0] - history.a[1]) / history.h
    assert h * h * (h / 6 + history.h / 4) * jerk == pytest.approx(h * eps)
    early = history_of(lambda t: t, lambda t: 2.0, [0.0, 0.1])
    assert 0.5 * early.largest_step(eps, norm) ** 2 * 2.0 == pytest.approx(
        early.largest_step(eps, norm) * eps
    )
    assert first_order_step(0.0, eps) == np.inf


def test_free_fall_has_no_estimate():
    history = history_of(lambda t: -9.81 * t, lambda t: -9.81, [0.0, 0.1, 0.2])
    assert history.largest_step(1e-3, np.linalg.norm) == np.inf
