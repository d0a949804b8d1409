"""The compiled arithmetic of friction passes equals its NumPy twins."""

from __future__ import annotations

import numpy as np
import pytest

from problems.contacts.active_kernels import JOINT
from problems.contacts.geometry_kernels import column_product, columns_product, dense_columns
from problems.friction.kernels import (
    RIDGE,
    loaded,
    newton_move,
    next_multipliers,
    small_newton_multipliers,
    solve_in_place,
)
from problems.friction.rules import extrapolated_multipliers, spring_loads

EXACT = {"rtol": 1e-10, "atol": 1e-10}


def random_columns(rng, bodies: int, count: int):
    """Entries (count, 6) and bodies (count, 2) of columns between different bodies, some ground."""
    pairs = np.array([rng.permutation(bodies + 1)[:2] - 1 for _ in range(count)], dtype=np.int64)
    entries = rng.normal(size=(count, 6))
    entries[np.repeat(pairs < 0, 3, axis=1)] = 0.0
    return entries, pairs


def friction_problem(seed: int):
    """Normals, their frictions with one or two each, and a state of the passes."""
    rng = np.random.default_rng(seed)
    bodies, F = 6, 5
    friction_of = np.array([0, 0, 1, 2, 3, 3, 4, -1], dtype=np.int64)
    normals = random_columns(rng, bodies, friction_of.size)
    tangents = random_columns(rng, bodies, F)
    signs = rng.choice([-1.0, 0.0, 1.0], F)
    sigma = np.where(signs != 0, signs, rng.choice([-1.0, 0.0, 1.0], F))
    lam_star, lam_N = rng.uniform(0, 2, (2, friction_of.size))
    lam_N[rng.integers(friction_of.size)] = 0.0
    mass = np.repeat(rng.uniform(0.5, 2.0, bodies), 3)
    mu = rng.uniform(0.0, 0.5, F)
    return normals, tangents, mass, friction_of, mu, signs, sigma, lam_star, lam_N


def matrices(normals, tangents, mass):
    D = np.sqrt(mass)
    return dense_columns(*normals, D), dense_columns(*tangents, D)


def numpy_move(normals, tangents, mass, friction_of, mu, sigma, inside, free, gamma):
    """y by the formula of `problems.friction.passes`, for the free normals."""
    A_N, A_F = matrices(normals, tangents, mass)
    E = np.eye(free.size)[:, free]
    members = (friction_of[None, :] == np.arange(mu.size)[:, None]).astype(float)
    T = np.diag(sigma * mu) @ members
    S = np.hstack([A_N[:, free], A_F[:, inside]])
    forced = np.hstack([A_F @ T @ E, np.zeros((S.shape[0], inside.sum()))])
    K, right = S.T @ (S + forced), -S.T @ (A_F @ (T @ gamma))
    y = np.zeros(free.size)
    y[free] = np.linalg.solve(K, right)[: free.sum()]
    return y


@pytest.mark.parametrize("n", [1, 2, 7, 20])
def test_elimination_is_that_of_lapack(n):
    rng = np.random.default_rng(n)
    K, y = rng.normal(size=(n, n)), rng.normal(size=n)
    expected = np.linalg.solve(K, y)
    assert solve_in_place(K.copy(), y, 0.0)
    np.testing.assert_allclose(y, expected, **EXACT)


def test_elimination_says_where_a_pivot_is_too_small():
    K = np.array([[1.0, 2.0], [2.0, 4.0 + 1e-13]])
    assert not solve_in_place(K.copy(), np.ones(2), 1e-10)
    assert solve_in_place(K.copy(), np.ones(2), 0.0)
    assert not solve_in_place(np.zeros((1, 1)), np.ones(1), 0.0)


@pytest.mark.parametrize("seed", range(5))
def test_products_of_columns(seed):
    normals, tangents, mass, *_ = friction_problem(seed)
    A_N, A_F = matrices(normals, tangents, mass)
    products = [
        [columns_product(*normals, i, *tangents, j, 1 / mass) for j in range(A_F.shape[1])]
        for i in range(A_N.shape[1])
    ]
    np.testing.assert_allclose(products, A_N.T @ A_F, **EXACT)
    force = np.random.default_rng(seed).normal(size=mass.size)
    found = [column_product(*normals, i, force, 1 / mass) for i in range(A_N.shape[1])]
    np.testing.assert_allclose(found, A_N.T @ (force / np.sqrt(mass)), **EXACT)


@pytest.mark.parametrize("seed", range(20))
def test_a_newton_step_solves_the_equations_of_the_fixed_point(seed):
    normals, tangents, mass, friction_of, mu, signs, sigma, lam_star, lam_N = friction_problem(seed)
    free, inside = lam_N > 0, (signs == 0) & (sigma == 0)
    arguments = (friction_of, mu, sigma, inside, free, lam_N - lam_star)
    y, found = newton_move(normals, tangents, 1 / mass, *arguments)
    assert found
    expected = numpy_move(normals, tangents, mass, *arguments)
    np.testing.assert_allclose(y, expected, rtol=1e-8, atol=1e-8)


def test_redundant_contacts_share_a_newton_step():
    """Twice the same normal: the equations have many solutions, the ridge takes a short one."""
    normals, tangents, mass, friction_of, mu, _, _, lam_star, lam_N = friction_problem(0)
    normals[0][1], normals[1][1] = normals[0][0], normals[1][0]
    lam_N, sigma = lam_N + 0.1, np.array([1.0, 0, 0, 0, 0])
    inside, free = np.zeros(5, bool), np.ones(8, bool)
    arguments = (friction_of, mu, sigma, inside, free, lam_N - lam_star)
    y, found = newton_move(normals, tangents, 1 / mass, *arguments)
    assert found and abs(y[0] - y[1]) <= 1e-6 * (1 + abs(y).max()) and RIDGE < 1e-6
    A_N, A_F = matrices(normals, tangents, mass)
    moved = A_F[:, 0] * mu[0] * (y[0] + y[1] + (lam_N - lam_star)[:2].sum())
    np.testing.assert_allclose(A_N.T @ (A_N @ y + moved), 0.0, atol=1e-6)


def test_the_next_multipliers_are_the_fixed_point_where_it_is_one():
    of, star, lam = np.array([0, 0, 1]), np.array([1.0, 1.0, 1.0]), np.array([2.0, 0.5, 3.0])
    y = np.array([0.5, -0.7, -4.0])
    # falls towards −0.2: no load; rises, and −1 is asked: not believed
    np.testing.assert_allclose(next_multipliers(of, star, lam, y, False), [2.5, 0.0, 3.0])
    np.testing.assert_array_equal(next_multipliers(of, star, lam, y, True), lam)
    np.testing.assert_allclose(next_multipliers(of, star, lam, 0.1 * y, True), lam + 0.1 * y)


def test_rows_of_joints_bound_nothing():
    of, star, lam = np.array([0, JOINT]), np.array([1.0, 0.0]), np.array([2.0, -9.0])
    np.testing.assert_allclose(
        next_multipliers(of, star, lam, np.array([0.5, -50.0]), True), [2.5, 0.0]
    )
    np.testing.assert_array_equal(loaded(np.array([0.0, -9.0]), of), [False, True])


def test_nothing_is_solved_where_everything_sticks_or_nothing_bears_a_load():
    normals, tangents, mass, friction_of, mu, signs, sigma, star, lam = friction_problem(3)
    columns = (normals, tangents, 1 / mass, friction_of, mu, signs)
    for case in (
        (0 * sigma, star, lam),
        (sigma, star, 0 * lam),
        (sigma, np.full(star.size, np.inf), lam),
    ):
        found = small_newton_multipliers(*columns, *case, False)
        np.testing.assert_array_equal(found, case[2])
        assert found is not case[2]


def test_predictions_of_multipliers():
    lam, before = np.array([2.0, 1.0]), np.array([1.0, 3.0])
    np.testing.assert_allclose(extrapolated_multipliers(lam, before, 1, 0.5), lam)
    np.testing.assert_allclose(extrapolated_multipliers(lam, before, 2, 0.5), [2.5, 0.0])
    now, then = np.array([0.0, 0.1]), np.array([-0.02, 0.2])
    # k = 2 m_eff/h² on what the gap would close by, nothing where it opens
    np.testing.assert_allclose(spring_loads(now, then, np.array([4.0, 4.0]), 0.1), [1.0, 0.0])
