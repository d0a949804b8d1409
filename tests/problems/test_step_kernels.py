"""The compiled arithmetic of a time step equals its NumPy twins."""

import numpy as np
import pytest

from problems.bodies.bodies import GROUND
from problems.contacts.active_kernels import friction_bounds
from problems.contacts.geometry_kernels import dense_columns, gather_columns
from problems.contacts.path_kernels import (
    beyond_edge,
    ends_inside,
    largest_motion,
    miss,
    path_end,
    ways,
)
from problems.formulas.step_kernels import fastest_body, momentum, outcome, weighted_norm
from problems.friction.kernels import driven_forces, forced_signs

EXACT = {"rtol": 1e-12, "atol": 1e-12}


@pytest.fixture(params=range(3))
def rng(request):
    return np.random.default_rng(request.param)


def test_norms_and_motion(rng):
    D, v, w = rng.uniform(1, 2, 12), rng.normal(size=12), rng.normal(size=12)
    radius = rng.uniform(1, 2, 4)
    assert weighted_norm(D, v) == pytest.approx(np.linalg.norm(D * v))
    assert fastest_body(D, v) == pytest.approx(np.linalg.norm((D * v).reshape(4, 3), axis=1).max())
    step = np.abs(w - v).reshape(4, 3)
    far = np.hypot(step[:, 0], step[:, 1]) + radius * step[:, 2]
    assert largest_motion(v, w, radius) == pytest.approx(far.max())


def test_momentum_and_outcome_of_a_step(rng):
    """(3.1b) with (3.2): q̇ = (h/α₀) D⁻¹ (A x + d), h q̈ = α₀ q̇ − b."""
    D, b, f = rng.uniform(1, 2, 9), rng.normal(size=9), rng.normal(size=9)
    h, alpha0 = 0.01, 1.5
    bodies = np.array([[0, 1], [2, -1], [1, 2]])
    entries, x = rng.normal(size=(3, 6)), np.array([0.5, 0.0, -2.0])
    d, within = momentum(b, f, D, h, 1e9)
    np.testing.assert_allclose(d, D * (b + h * f / D**2) / h, **EXACT)
    assert within and not momentum(b, f, D, h, 0.5 * np.abs(d).max())[1]
    v, a = outcome(entries, bodies, x, b, d, D, h, alpha0)
    twin = h / alpha0 * (dense_columns(entries, bodies, D) @ x + d) / D
    np.testing.assert_allclose(v, twin, **EXACT)
    np.testing.assert_allclose(a, (alpha0 * twin - b) / h, rtol=1e-10)


def test_a_nan_among_the_forces_is_told():
    force = np.array([1.0, np.nan, 2.0])
    assert not momentum(np.ones(3), force, np.ones(3), 0.1, np.inf)[1]


def test_columns_are_gathered_by_row_and_direction(rng):
    normal, tangent = rng.normal(size=(4, 6)), rng.normal(size=(4, 6))
    bodies = rng.integers(-1, 5, (4, 2))
    row, tangential = np.array([0, 2, 2, 3]), np.array([False, False, True, True])
    entries, where = np.empty((4, 6)), np.empty((4, 2), np.int64)
    gather_columns(normal, tangent, bodies, row, tangential, entries, where)
    np.testing.assert_array_equal(entries, np.where(tangential[:, None], tangent[row], normal[row]))
    np.testing.assert_array_equal(where, bodies[row])


def test_friction_bounds_and_signs():
    mu, friction_of = np.array([0.5, 0.2, 0.3]), np.array([0, 0, -1, 1, 2])
    bound = friction_bounds(friction_of, mu, np.array([1.0, 2.0, 9.0, 5.0, np.inf]))
    np.testing.assert_allclose(bound, [1.5, 1.0, np.inf])
    signs = np.array([0.0, -1.0, 0.0])
    np.testing.assert_array_equal(driven_forces(signs, bound), [0.0, -1.0, 0.0])
    at = np.array([-1.5, 0.0, 7.0]), bound, np.array([1.0, 1.0, 1.0])
    np.testing.assert_array_equal(forced_signs(signs, *at), [-1.0, -1.0, 0.0])
    unloaded = np.zeros(3), np.zeros(3), np.array([2.0, 0.0, -2.0])
    np.testing.assert_array_equal(forced_signs(np.zeros(3), *unloaded), [-1.0, 0.0, 1.0])
    rounding = np.array([1e-17, 1e-17, 5.0]), np.array([1e-17, 1e-17, 5.0])
    slip = np.array([2.0, -1e-16, 1.0])
    np.testing.assert_array_equal(forced_signs(np.zeros(3), *rounding, slip), [-1.0, 0.0, 1.0])


def test_a_gap_that_is_negative_from_the_start_must_close_further():
    before, after = np.array([1.0, 1.0, -1e-3, -1e-3, 0.0]), np.array([0.0, -1e-9, -1e-3, -2e-3, 0])
    found = ends_inside(before, after)
    np.testing.assert_array_equal(found, [False, True, False, True, False])
    assert [ends_inside(*gaps) for gaps in zip(before, after, strict=True)] == found.tolist()


def test_a_corner_is_beyond_an_edge_of_finite_length_only():
    along, length = np.array([-1e-9, -1e-5, 2.0, 2.1, -9.0]), np.array([2.0, 2, 2, 2, np.inf])
    np.testing.assert_array_equal(beyond_edge(along, length), [False, True, False, True, False])


def test_points_that_met_are_within_reach():
    """Two bodies that part at 3 m/s each, from one place, while one also turns."""
    velocity, radius, h = np.array([3.0, 0, 0, -3, 0, 0]), np.array([0.5, 1.0]), 0.1
    at_rest = np.zeros(6)

    def reach(velocity, curvature):
        way = ways(velocity, curvature, h, radius)
        assert way[GROUND] == 0.0
        return way[0] + way[1]

    apart = 2 * 3.0 * h
    assert reach(velocity, at_rest) == pytest.approx(apart)
    turning = velocity + np.array([0.0, 0, 2, 0, 0, 0])
    assert reach(turning, at_rest) == pytest.approx(apart + 0.5 * 2 * h)
    # the same from rest, at twice the speed in the end
    assert path_end(at_rest, at_rest, velocity / h, h) @ [1, 0, 0, -1, 0, 0] == pytest.approx(apart)
    assert reach(at_rest, velocity / h) == pytest.approx(2 * apart)


def test_what_comes_near_enough_is_no_miss():
    """There and back, there alone, from within, and farther away than it moves."""
    before, after = np.array([1.0, 2.0, -0.5, 1.1]), np.array([1.0, -1e-3, 1.9, 1.0])
    found = miss(before, after, 2.0)
    np.testing.assert_array_equal(found, [False, False, False, True])
    assert [miss(*gaps, 2.0) for gaps in zip(before, after, strict=True)] == found.tolist()
