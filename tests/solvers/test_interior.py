"""Interior points that choose F: a step against its dense equations, and QPs that need them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from problems.qp import ContactQP
from solvers import make_solver
from solvers.active_set.glambda import Glambda
from solvers.active_set.sparse import interior
from solvers.active_set.sparse.interior import (
    choose_F,
    complementarity,
    gradient_at,
    start_inside,
    step_along_path,
)
from solvers.active_set.sparse.loop import LEAP_AFTER, lay_out_sparse
from solvers.active_set.sparse.pattern import make_pattern
from solvers.active_set.sparse.workspace import (
    DUAL_HIGH,
    DUAL_LOW,
    IN_F,
    SparseWorkspace,
    make_sparse_workspace,
)
from solvers.active_set.workspace import GRADIENT, LOWER, UPPER, Z
from tests.fakes.grid import grid_qp


def convex_fit(n: int, noise: float, seed: int = 0) -> ContactQP:
    """The dual of fitting a convex sequence to noisy data: min ½‖Dᵀλ + y‖², λ ≥ 0.

    D takes second differences, so that D Dᵀ has the condition n⁴ and λ grows with n².
    """
    rng = np.random.default_rng(seed)
    t = np.linspace(-1.0, 1.0, n)
    y = np.sin(5.0 * t) + noise * rng.standard_normal(n)
    D = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n))
    k = n - 2
    qp = ContactQP(sp.csc_array(D.T), y, np.zeros(k), np.full(k, np.inf))
    return qp.with_accuracy(1e-9 * float(np.linalg.norm(y)))


def boxed(seed: int, m: int = 24, k: int = 30) -> ContactQP:
    """Sparse columns with bounds of every kind: one-sided, two-sided, none, fixed."""
    rng = np.random.default_rng(seed)
    A = np.zeros((m, k))
    for j in range(k):
        A[rng.choice(m, size=rng.integers(2, 13), replace=False), j] = 1.0
    A *= rng.standard_normal((m, k))
    lower = np.where(rng.random(k) < 0.3, -np.inf, -rng.random(k))
    upper = np.where(rng.random(k) < 0.5, np.inf, rng.random(k))
    lower[:3] = upper[:3] = 0.25
    return ContactQP(sp.csc_array(A), rng.standard_normal(m), lower, upper)


def laid_out(qp: ContactQP) -> SparseWorkspace:
    """A room with the columns, bounds and d of `qp`, z within the bounds."""
    pattern = make_pattern(qp.A)
    room = make_sparse_workspace(qp.m, pattern)
    lay_out_sparse(pattern, qp.A.data, qp.d, qp.lower, qp.upper, room.Bx, room.S, qp.m)
    k = qp.k
    room.S[Z, :k] = np.clip(0.0, room.S[LOWER, :k], room.S[UPPER, :k])
    gradient_at(pattern, room.Bx, room.S, qp.m)
    return room


def columns(qp: ContactQP, room: SparseWorkspace) -> np.ndarray:
    """B, dense, in the order of the pattern."""
    B = qp.dense_A[:, room.pattern.order]
    return B / np.linalg.norm(B, axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_solves_its_linear_equations(seed: int) -> None:
    """Predictor and corrector (Mehrotra 1992), written down anew with a dense matrix."""
    qp = boxed(seed)
    room, k = laid_out(qp), qp.k
    S = room.S
    assert start_inside(room.pattern, room.Bx, room.Lx, S, room.I, qp.m)
    z, low, high = S[Z, :k].copy(), S[LOWER, :k], S[UPPER, :k]
    a, b, g = S[DUAL_LOW, :k].copy(), S[DUAL_HIGH, :k].copy(), S[GRADIENT, :k].copy()
    moves, B = low < high, columns(qp, room)
    assert (z[moves] > low[moves]).all() and (z[moves] < high[moves]).all()
    assert (a[np.isfinite(low) & moves] > 0).all() and (b[np.isfinite(high) & moves] > 0).all()

    has_a, has_b = a > 0, b > 0
    s, t = np.where(has_a, z - low, 1.0), np.where(has_b, high - z, 1.0)
    H = (B.T @ B + np.diag(a / s + b / t))[np.ix_(moves, moves)]

    def move(goal_a: np.ndarray, goal_b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        goal_a, goal_b = np.where(has_a, goal_a, 0.0), np.where(has_b, goal_b, 0.0)
        dz = np.zeros(k)
        dz[moves] = np.linalg.solve(H, (-g + goal_a / s - goal_b / t)[moves])
        return dz, goal_a / s - a - a / s * dz, goal_b / t - b + b / t * dz

    def longest(dz: np.ndarray, da: np.ndarray, db: np.ndarray) -> float:
        pairs = (s[has_a], dz[has_a]), (t[has_b], -dz[has_b]), (a[has_a], da[has_a])
        limits = [1.0]
        for value, change in (*pairs, (b[has_b], db[has_b])):
            limits += list(-0.995 * value[change < 0] / change[change < 0])
        return min(limits)

    def gap(theta: float, dz: np.ndarray, da: np.ndarray, db: np.ndarray) -> float:
        low_side = ((s + theta * dz) * (a + theta * da))[has_a].sum()
        high_side = ((t - theta * dz) * (b + theta * db))[has_b].sum()
        return float(low_side + high_side) / (has_a.sum() + has_b.sum())

    zero = np.zeros(k)
    predictor = move(zero, zero)
    mu = gap(0.0, *predictor)
    target = mu * (gap(longest(*predictor), *predictor) / mu) ** 3
    dz, da, db = move(target - predictor[0] * predictor[1], target + predictor[0] * predictor[2])
    theta = longest(dz, da, db)

    taken = step_along_path(room.pattern, room.Bx, room.Lx, S, room.I, 0.0)
    assert taken == pytest.approx(theta, rel=1e-9)
    size = np.abs(z).max()
    np.testing.assert_allclose(S[Z, :k], z + theta * dz, rtol=1e-9, atol=1e-9 * size)
    np.testing.assert_allclose(S[DUAL_LOW, :k], a + theta * da, rtol=1e-8, atol=1e-10 * a.max())
    np.testing.assert_allclose(S[DUAL_HIGH, :k], b + theta * db, rtol=1e-8, atol=1e-10 * b.max())
    to_low = has_a & (dz / s < da / np.where(has_a, a, 1.0))
    to_high = has_b & (-dz / t < db / np.where(has_b, b, 1.0))
    assert (room.I[IN_F, :k].astype(bool) == moves & ~to_low & ~to_high).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_path_ends_at_the_right_F(seed: int) -> None:
    qp = boxed(seed, m=40)  # more rows than columns: x is unique
    room, k = laid_out(qp), qp.k
    order = room.pattern.order
    assert start_inside(room.pattern, room.Bx, room.Lx, room.S, room.I, qp.m)
    while complementarity(room.S, room.I, k, 0.0)[0] > 1e-12:
        assert step_along_path(room.pattern, room.Bx, room.Lx, room.S, room.I, 0.0) > 0
        gradient_at(room.pattern, room.Bx, room.S, qp.m)
    choose_F(room.S, room.I, k)
    right = make_solver("lotstedt", variant="exact_qr").solve(replace(qp, A=qp.dense_A))
    free = (right.x > qp.lower) & (right.x < qp.upper)
    assert (room.I[IN_F, :k].astype(bool) == free[order]).all()


def test_thousands_of_rows_change_sides_in_tens_of_directions() -> None:
    """λ is of another size than the data, and most rows first are on the wrong side."""
    qp = convex_fit(4000, 0.01)
    found = Glambda().solve(qp)
    assert found.found and found.work is not None
    assert LEAP_AFTER < found.work.descent_directions < 400
    slope = qp.gradient(found.x)
    at_zero = found.x == 0.0
    assert 0 < np.count_nonzero(~at_zero) < qp.k
    # convex to rounding where λ is 0; straight where it is not
    assert slope[at_zero].min() >= -1e-7 and np.abs(slope[~at_zero]).max() <= 1e-7


def test_along_a_ridge_the_path_tells_loads_from_loose_contacts() -> None:
    """Gradients there are 1e-10 of z, so that sizes alone tell nothing."""
    qp = grid_qp(40, 1, loose=0.6)
    found = Glambda().solve(qp)
    assert found.found and found.work is not None
    # 86 measured; 1,373 where z itself was compared with the multiplier of its bound
    assert LEAP_AFTER < found.work.descent_directions < 400
    assert 0 < np.count_nonzero(found.x == 0.0) < qp.k


def test_what_does_not_lower_the_objective_is_taken_back() -> None:
    """From the answer itself no path leads further down."""
    qp = boxed(1, m=40)
    room, k = laid_out(qp), qp.k
    right = Glambda().solve(replace(qp, A=qp.dense_A))
    order = room.pattern.order
    length = np.linalg.norm(qp.dense_A[:, order], axis=0)
    room.S[Z, :k] = right.x[order] * length
    room.I[IN_F, :k] = (right.working_set == 0)[order]
    f = int(room.I[IN_F, :k].sum())
    before, members = room.S[Z, :k].copy(), room.I[IN_F, :k].copy()
    assert interior.approach(room.pattern, room.Bx, room.Lx, room.S, room.I, qp.m, f) >= 0
    if (room.I[IN_F, :k] == members).all():
        np.testing.assert_allclose(room.S[Z, :k], before, atol=1e-7)


@pytest.mark.parametrize("width", [9, 12, 40])
def test_columns_of_contacts_in_space_stay_sparse(width: int) -> None:
    """Twelve entries a column: A x is what the dense method finds."""
    rng = np.random.default_rng(width)
    m, k = 240, 180
    A = np.zeros((m, k))
    for j in range(k):
        A[rng.choice(m, size=width if j % 3 else 3, replace=False), j] = 1.0
    A *= rng.standard_normal((m, k))
    qp = ContactQP(sp.csc_array(A), rng.standard_normal(m), np.zeros(k), np.full(k, np.inf))
    solver = Glambda(accuracy=1e-10)
    sparse, dense = solver.solve(qp), solver.solve(replace(qp, A=A))
    assert sparse.found and dense.found
    assert type(sparse.memory) is SparseWorkspace
    assert np.linalg.norm(A @ (sparse.x - dense.x)) <= 2e-10
    again = solver.solve(replace(qp, d=1.01 * qp.d), sparse)
    assert again.found and type(again.memory) is SparseWorkspace
