"""The oracle of the kernels, against plain linear algebra: QR, rank, ‖R⁻¹‖, updates, iterations.

That the kernels are the same as this oracle is held by `test_kernels`.
"""

from __future__ import annotations

import numpy as np
import pytest

from solvers.active_set.flops import cg_limit, delete_flops, qr_flops
from tests.solvers.numpy_twin.conjugate_gradients import conjugate_gradients, solve_R, solve_RT
from tests.solvers.numpy_twin.factorization import (
    Factorization,
    dependence_tolerance,
    empty_factorization,
    inverse_norm_estimate,
    karasalo_bound,
    karasalo_rank,
    qr_delete,
    qr_factorize,
    qr_insert,
)
from tests.solvers.numpy_twin.tally import delete_many_flops


def unit_columns(rng: np.random.Generator, m: int, k: int) -> np.ndarray:
    A = rng.standard_normal((m, k))
    return np.asfortranarray(A / np.linalg.norm(A, axis=0))


def assert_factorizes(F: Factorization, A: np.ndarray, columns: set[int]) -> None:
    """R (and Q) belong to the columns of A that F names, and those are `columns`."""
    assert set(F.columns.tolist()) == columns
    A_F = A[:, F.columns]
    assert np.array_equal(F.R, np.triu(F.R))
    assert F.R.flags.f_contiguous
    np.testing.assert_allclose(F.R.T @ F.R, A_F.T @ A_F, rtol=0, atol=1e-13)
    if F.Q is not None:
        np.testing.assert_allclose(F.Q @ F.R, A_F, rtol=0, atol=1e-13)
        np.testing.assert_allclose(F.Q.T @ F.Q, np.eye(F.order), rtol=0, atol=1e-13)


def kahan(n: int, theta: float) -> np.ndarray:
    """Kahan's triangular matrix (1966), which pivoting leaves as it is; far from its diagonal."""
    s, c = np.sin(theta), np.cos(theta)
    return np.diag(s ** np.arange(n)) @ (np.eye(n) - np.triu(np.full((n, n), c), 1))


@pytest.mark.parametrize("keep_Q", [True, False])
@pytest.mark.parametrize(("m", "k"), [(7, 1), (12, 8), (5, 5), (60, 40)])
def test_qr_of_independent_columns(m: int, k: int, keep_Q: bool) -> None:
    A = unit_columns(np.random.default_rng(1), m, k)
    F = qr_factorize(A, np.arange(k), keep_Q)
    assert_factorizes(F, A, set(range(k)))
    assert (F.Q is not None) == keep_Q


def test_pivots_fall() -> None:
    """Businger and Golub: |r_kk|² is at least the rest of every later column."""
    A = unit_columns(np.random.default_rng(2), 10, 8)
    R = qr_factorize(A, np.arange(8), False).R
    for k in range(8):
        assert (R[k, k] ** 2 >= (R[k:, k + 1 :] ** 2).sum(axis=0) - 1e-14).all()


@pytest.mark.parametrize(("m", "k", "rank"), [(12, 9, 5), (6, 10, 6), (40, 30, 17)])
def test_dependent_columns_are_left_out(m: int, k: int, rank: int) -> None:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((m, rank)) @ rng.standard_normal((rank, k))
    A = np.asfortranarray(A / np.linalg.norm(A, axis=0))
    F = qr_factorize(A, np.arange(k), True)
    assert F.order == rank
    assert np.linalg.matrix_rank(A[:, F.columns]) == rank
    assert_factorizes(F, A, set(F.columns.tolist()))


def test_zero_columns_have_rank_zero() -> None:
    F = qr_factorize(np.zeros((4, 3), order="F"), np.arange(3), True)
    assert F.order == 0
    assert F.Q is not None and F.Q.shape == (4, 0)


def test_only_the_columns_asked_for() -> None:
    A = unit_columns(np.random.default_rng(4), 9, 6)
    F = qr_factorize(A, np.array([4, 1, 3]), False)
    assert_factorizes(F, A, {1, 3, 4})


@pytest.mark.parametrize("sigma", [1e-3, 1e-9, 1e-12])
def test_karasalo_finds_the_rank_of_a_gap(sigma: float) -> None:
    """Two singular values of size `sigma` under four of size 1: tolerance above, then below."""
    rng = np.random.default_rng(5)
    U, _ = np.linalg.qr(rng.standard_normal((10, 6)))
    V, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    A = U @ np.diag([1, 0.9, 0.8, 0.7, sigma, 0.9 * sigma]) @ V.T
    everything = qr_factorize(np.asfortranarray(A), np.arange(6), False)
    assert karasalo_rank(everything.R, 0.01 * sigma) == 6
    assert karasalo_rank(everything.R, min(10 * sigma, 0.05)) == 4


@pytest.mark.parametrize("n", [2, 5, 12])
def test_karasalo_bound_is_the_norm_of_the_inverse_of_w(n: int) -> None:
    R = np.linalg.qr(np.random.default_rng(n).standard_normal((n + 2, n)), mode="r")
    W = np.diag(np.abs(np.diagonal(R)))
    for i in range(n - 1):
        W[i, i + 1 :] = -np.abs(R[i, i + 1 :]).max()
    bound = karasalo_bound(R)
    assert bound == pytest.approx(1 / np.linalg.norm(np.linalg.inv(W)), rel=1e-10)
    assert bound <= np.linalg.svd(R, compute_uv=False)[-1] * (1 + 1e-12)


def test_the_estimate_saves_columns_that_the_bound_would_cut() -> None:
    """300 well-conditioned columns, whose bound is below rounding while σ_min is above 0.1."""
    A = unit_columns(np.random.default_rng(6), 400, 300)
    F = qr_factorize(A, np.arange(300), False)
    assert karasalo_bound(F.R) < dependence_tolerance(400)
    assert F.order == 300
    assert np.linalg.svd(A, compute_uv=False)[-1] > 0.1


def test_kahan_is_cut_although_its_diagonal_is_not_small() -> None:
    """Order 60, θ = 1.2: the last pivot is 0.016 and σ_min below 1e-9, where pivots say nothing."""
    R = kahan(60, 1.2)
    assert R[-1, -1] > 0.01
    assert np.linalg.svd(R, compute_uv=False)[-1] < 1e-9
    assert karasalo_rank(R, 1e-8) < 60


@pytest.mark.parametrize("n", [1, 2, 8, 40])
def test_inverse_norm_estimate_is_within_a_factor(n: int) -> None:
    """From below; never by more than the factor of 10 that its authors name, mostly by little."""
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng([seed, n])
        scales = 10.0 ** rng.uniform(-3, 0, n)
        R = np.asfortranarray(np.linalg.qr(rng.standard_normal((n + 2, n)) * scales, mode="r"))
        true = 1 / np.linalg.svd(R, compute_uv=False)[-1]
        ratios.append(true / inverse_norm_estimate(R))
    assert min(ratios) >= 1 - 1e-12
    assert np.median(ratios) <= 1.3
    assert max(ratios) <= 10


def test_inverse_norm_estimate_of_kahan() -> None:
    R = np.asfortranarray(kahan(30, 1.2))
    true = 1 / np.linalg.svd(R, compute_uv=False)[-1]
    assert true / 3 <= inverse_norm_estimate(R) <= true * (1 + 1e-12)


def test_inverse_norm_estimate_of_a_nearly_singular_R_is_finite() -> None:
    R = np.asfortranarray(np.triu(np.ones((4, 4))))
    R[3, 3] = 1e-200
    assert inverse_norm_estimate(R) == pytest.approx(2e200, rel=0.5)


@pytest.mark.parametrize("keep_Q", [True, False])
@pytest.mark.parametrize("gone", [[0], [5], [11], [0, 11], [2, 3, 7], list(range(1, 12))])
def test_deleting_equals_factorizing_the_rest(gone: list[int], keep_Q: bool) -> None:
    A = unit_columns(np.random.default_rng(7), 20, 12)
    F = qr_factorize(A, np.arange(12), keep_Q)
    before = F.R.copy()
    smaller, flops = qr_delete(F, np.array(gone))
    left = set(np.delete(F.columns, gone).tolist())
    assert_factorizes(smaller, A, left)
    assert np.array_equal(F.R, before)
    assert flops >= 0
    again = qr_factorize(A, smaller.columns, False)
    assert smaller.inverse_norm >= inverse_norm_estimate(again.R) / 3


def test_many_deletions_go_by_householder_and_few_by_givens() -> None:
    """The cheaper of the two in counted operations."""
    one_by_one = sum(delete_flops(0, 40 - i, 20, False) for i in range(15))
    assert delete_many_flops(0, 40, 20, 15, False) < one_by_one
    A = unit_columns(np.random.default_rng(8), 60, 40)
    F = qr_factorize(A, np.arange(40), False)
    smaller, flops = qr_delete(F, np.arange(20, 35))
    assert flops == delete_many_flops(0, 40, 20, 15, False)
    assert_factorizes(smaller, A, set(np.delete(F.columns, np.arange(20, 35)).tolist()))
    single, flops = qr_delete(F, np.array([20]))
    assert flops == delete_flops(0, 40, 20, False)
    assert_factorizes(single, A, set(np.delete(F.columns, 20).tolist()))


def test_deleting_everything_leaves_nothing() -> None:
    A = unit_columns(np.random.default_rng(9), 6, 3)
    smaller, _ = qr_delete(qr_factorize(A, np.arange(3), True), np.arange(3))
    assert smaller.order == 0 and smaller.R.shape == (0, 0)
    assert smaller.Q is not None and smaller.Q.shape == (6, 0)
    grown, _, _ = qr_insert(smaller, A, 1, 10)
    assert grown is not None
    assert_factorizes(grown, A, {1})


@pytest.mark.parametrize("keep_Q", [True, False])
def test_inserting_equals_factorizing_all(keep_Q: bool) -> None:
    A = unit_columns(np.random.default_rng(10), 14, 9)
    F: Factorization | None = empty_factorization(14, keep_Q)
    for j in (3, 0, 8, 5):
        assert F is not None
        F, _, flops = qr_insert(F, A, j, 100)
        assert flops >= 0
    assert F is not None
    # without Q the new column of R is accurate to the tolerance of a preconditioner only
    if keep_Q:
        assert_factorizes(F, A, {0, 3, 5, 8})
    preconditioned = A[:, F.columns] @ np.linalg.inv(F.R)
    np.testing.assert_allclose(np.linalg.svd(preconditioned)[1], 1, atol=1e-13 if keep_Q else 0.3)
    true = np.linalg.norm(np.linalg.inv(F.R), 2)
    assert true * (1 - 1e-12) <= F.inverse_norm <= 3 * true


def test_a_fresh_column_beside_an_old_R_is_as_good_as_today() -> None:
    """R of yesterday's A, column of today: A_F R⁻¹ gains a unit column orthogonal to A_F."""
    rng = np.random.default_rng(11)
    old = unit_columns(rng, 15, 8)
    today = old + 0.02 * rng.standard_normal(old.shape)
    today = np.asfortranarray(today / np.linalg.norm(today, axis=0))
    F = qr_factorize(old, np.arange(7), False)
    grown, iterations, _ = qr_insert(F, today, 7, 100)
    assert grown is not None and iterations >= 1
    was = np.linalg.svd(today[:, F.columns] @ np.linalg.inv(F.R))[1]
    now = np.linalg.svd(today[:, grown.columns] @ np.linalg.inv(grown.R))[1]
    assert now[0] <= was[0] + 0.05 and now[-1] >= was[-1] - 0.05


@pytest.mark.parametrize("keep_Q", [True, False])
def test_a_dependent_column_is_refused(keep_Q: bool) -> None:
    rng = np.random.default_rng(12)
    A = unit_columns(rng, 12, 6)
    A[:, 5] = A[:, :4] @ rng.standard_normal(4)
    A[:, 5] /= np.linalg.norm(A[:, 5])
    F = qr_factorize(A, np.arange(4), keep_Q)
    assert qr_insert(F, A, 5, 100)[0] is None
    assert qr_insert(F, A, 4, 100)[0] is not None


@pytest.mark.parametrize("keep_Q", [True, False])
@pytest.mark.parametrize("distance", [1e-4, 1e-8, 1e-11])
def test_a_nearly_dependent_column_is_taken(distance: float, keep_Q: bool) -> None:
    rng = np.random.default_rng(13)
    A = unit_columns(rng, 12, 5)
    A[:, 4] = A[:, 0] + distance * A[:, 4]
    F = qr_factorize(A, np.arange(4), keep_Q)
    grown, _, _ = qr_insert(F, A, 4, 100)
    assert grown is not None
    off = np.linalg.qr(A[:, :4])[0]
    rho = np.linalg.norm(A[:, 4] - off @ (off.T @ A[:, 4]))
    assert abs(grown.R[4, 4]) == pytest.approx(rho, rel=max(0.02, 1e-15 / distance))


def test_an_R_that_is_too_old_says_so() -> None:
    rng = np.random.default_rng(14)
    F = qr_factorize(unit_columns(rng, 12, 6), np.arange(6), False)
    with pytest.raises(ArithmeticError, match="too old"):
        qr_insert(F, unit_columns(rng, 12, 7), 6, 1)


def test_triangular_solves() -> None:
    R = np.asfortranarray(
        np.triu(np.random.default_rng(15).standard_normal((6, 6))) + 3 * np.eye(6)
    )
    b = np.arange(6.0)
    np.testing.assert_allclose(R @ solve_R(R, b), b, atol=1e-13)
    np.testing.assert_allclose(R.T @ solve_RT(R, b), b, atol=1e-13)
    assert np.array_equal(b, np.arange(6.0))


@pytest.mark.parametrize("preconditioned", [True, False])
def test_conjugate_gradients_solve_least_squares(preconditioned: bool) -> None:
    rng = np.random.default_rng(16)
    A, b = unit_columns(rng, 20, 8), rng.standard_normal(20)
    R = qr_factorize(A, np.arange(8), False)
    old = A[:, R.columns] + 0.01 * rng.standard_normal((20, 8))
    found = conjugate_gradients(old, R.R if preconditioned else None, b, 1e-13, 50)
    assert found.converged
    np.testing.assert_allclose(found.p, np.linalg.lstsq(old, -b, rcond=None)[0], atol=1e-11)
    np.testing.assert_allclose(found.s, old @ found.p + b, atol=1e-13)


def test_todays_R_needs_one_iteration() -> None:
    rng = np.random.default_rng(17)
    A, b = unit_columns(rng, 20, 8), rng.standard_normal(20)
    F = qr_factorize(A, np.arange(8), False)
    assert conjugate_gradients(A[:, F.columns], F.R, b, 1e-12, 50).iterations == 1


def test_an_older_R_needs_more_iterations() -> None:
    """The rate is set by how far A_F R⁻¹ is from orthogonal."""
    rng = np.random.default_rng(18)
    A, b, drift = unit_columns(rng, 30, 12), rng.standard_normal(30), rng.standard_normal((30, 12))
    F = qr_factorize(A, np.arange(12), False)
    counts = [
        conjugate_gradients((A + size * drift)[:, F.columns], F.R, b, 1e-10, 50).iterations
        for size in (1e-8, 1e-4, 1e-2, 1e-1)
    ]
    assert counts == sorted(counts) and counts[0] <= 2 and counts[-1] >= 8


def test_conjugate_gradients_give_up_at_the_limit() -> None:
    rng = np.random.default_rng(19)
    A, b = unit_columns(rng, 30, 12), rng.standard_normal(30)
    found = conjugate_gradients(A, None, b, 1e-12, 3)
    assert not found.converged and found.iterations == 3
    assert np.linalg.norm(found.s) < np.linalg.norm(b)


def test_a_solved_system_needs_no_iteration() -> None:
    A = np.asfortranarray(np.eye(4)[:, :2])
    found = conjugate_gradients(A, None, np.array([0.0, 0.0, 1.0, 2.0]), 1e-12, 5)
    assert found.converged and found.iterations == 0 and not found.p.any()


def test_flop_formulas() -> None:
    """2 f²(m − f/3), and the paper's limit for a scene of fig. 4's size, 9 rows and 8 columns."""
    assert qr_flops(30, 3) == 2 * 9 * 30 - 18
    assert qr_flops(3, 30) == qr_flops(30, 3)
    assert qr_flops(30, 3, keep_Q=True) == 2 * qr_flops(30, 3)
    assert 1.5 < cg_limit(9, 8) < 2.5
    assert cg_limit(9, 0) == 0.0
