"""Minimum-norm multipliers (4.8) and the least-distance form of Lawson and Hanson."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import minimize

from problems import scene, simulate
from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.least_norm.independence import (
    IndependenceProof,
    far_from_dependent,
    surely_independent,
)
from problems.least_norm.least_distance import (
    least_distance_point,
    least_norm,
    non_negative_form,
    null_space,
)
from problems.least_norm.minimum_norm import minimum_norm
from problems.least_norm.sparse_minimum_norm import ridge
from problems.qp import ContactQP
from problems.sequence import QPSequence
from solvers import make_solver
from solvers.active_set.sparse.pattern import is_narrow


def sequence():
    return QPSequence(make_solver("glambda", accuracy=1e-13))


@pytest.mark.parametrize("shape", [(5, 3, 8), (8, 3, 5), (4, 4, 4), (3, 0, 2)])
def test_null_space_is_orthonormal_and_complete(shape):
    m, rank, k = shape
    rng = np.random.default_rng(0)
    A = rng.normal(size=(m, rank)) @ rng.normal(size=(rank, k))
    basis = null_space(A.copy())
    assert basis.shape == (k - rank, k)
    np.testing.assert_allclose(basis @ A.T, 0, atol=1e-13)
    np.testing.assert_allclose(basis @ basis.T, np.eye(k - rank), atol=1e-14)


@pytest.mark.parametrize("seed", range(20))
def test_least_distance_equals_a_general_optimizer(seed):
    rng = np.random.default_rng(seed)
    E = rng.normal(size=(6, 3))
    e = E @ rng.normal(size=3) - rng.uniform(0, 0.5, 6)  # feasible by construction
    A, d, acts = non_negative_form(E, e)
    qp = ContactQP(A, d, np.zeros(acts.size), np.full(acts.size, np.inf))
    solution = make_solver("glambda", accuracy=1e-13).solve(qp)
    z, found = least_distance_point(A, solution.x)
    assert found
    best = minimize(
        lambda z: z @ z,
        np.zeros(3),
        jac=lambda z: 2 * z,
        constraints={"type": "ineq", "fun": lambda z: E @ z - e, "jac": lambda z: E},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    np.testing.assert_allclose(z, best.x, atol=1e-6)
    assert (E @ z - e).min() >= -1e-10


def test_infeasible_rows_are_seen():
    E, e = np.array([[1.0], [-1.0]]), np.array([1.0, 1.0])  # z ≥ 1 and z ≤ −1
    A, d, _ = non_negative_form(E, e)
    qp = ContactQP(A, d, np.zeros(2), np.full(2, np.inf))
    solution = make_solver("glambda", accuracy=1e-13).solve(qp)
    assert not least_distance_point(A, solution.x)[1]


def table_on_four_legs(lower=0.0):
    """A load on four legs in a row: two equations, four unknowns."""
    A = np.array([[1.0, 1, 1, 1], [0.0, 1, 2, 3]])
    qp = ContactQP(A, -A @ np.array([3.0, 0, 0, 1]), np.full(4, lower), np.full(4, np.inf))
    return qp, np.array([3.0, 0, 0, 1])


def test_load_on_four_legs_is_shared():
    """Textbook: the least-norm forces are linear along the table, 4/4 plus a tilt."""
    qp, x = table_on_four_legs()
    shared = minimum_norm(sequence(), qp, x, None)
    np.testing.assert_allclose(qp.A @ shared, qp.A @ x, atol=1e-12)
    np.testing.assert_allclose(shared, [1.9, 1.3, 0.7, 0.1], atol=1e-12)


def test_bounds_hold_where_they_bind():
    A = np.array([[1.0, 1, 1, 1], [0.0, 1, 2, 3]])
    x = np.array([4.5, 0.0, 0.5, 0])  # unbounded least norm would pull on the last leg
    qp = ContactQP(A, -A @ x, np.zeros(4), np.full(4, np.inf))
    free = np.linalg.lstsq(A, A @ x, rcond=None)[0]
    assert free.min() < 0
    found = minimum_norm(sequence(), qp, x, None)
    assert found.min() >= 0
    np.testing.assert_allclose(A @ found, A @ x, atol=1e-11)
    assert found @ found < x @ x
    # optimality: the least norm is at a KKT point λ = Aᵀy + w, w ≥ 0 where λ = 0
    positive = found > 1e-12
    y = np.linalg.lstsq(A[:, positive].T, found[positive], rcond=None)[0]
    np.testing.assert_allclose(A[:, positive].T @ y, found[positive], atol=1e-10)
    assert (A[:, ~positive].T @ y <= 1e-10).all()


def test_coulomb_rows_are_kept_where_feasible():
    """Least norm alone would leave |λ_F| > μ λ_N; the rows forbid it."""
    A = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])  # N1 + N2 = 4, F1 + F2 = 1.6
    x = np.array([3.0, 1.0, 1.2, 0.4])
    qp = ContactQP(A, -A @ x, np.array([0, 0, -5, -5.0]), np.array([np.inf, np.inf, 5, 5]))
    mu = np.array([0.3, 0.6])
    C = sp.csr_array(
        np.array([[mu[0], 0, -1, 0], [0, mu[1], 0, -1], [mu[0], 0, 1, 0], [0, mu[1], 0, 1]])
    )
    free = minimum_norm(sequence(), qp, x, None)
    assert (C @ free).min() < -0.1
    kept = minimum_norm(sequence(), qp, x, C)
    assert (C @ kept).min() >= -1e-10
    np.testing.assert_allclose(A @ kept, A @ x, atol=1e-11)
    nothing = sp.csr_array(-np.ones((1, 4)) @ np.diag([1, 1, 0, 0]))  # N1 + N2 ≤ 0: impossible
    np.testing.assert_allclose(minimum_norm(sequence(), qp, x, nothing), free, atol=1e-9)


@pytest.mark.parametrize("form", [np.array, sp.csc_array])
@pytest.mark.parametrize("least", [1.0, 1e-3, 1e-5, 1e-7, 1e-9, 0.0])
def test_independence_is_claimed_only_where_qr_confirms_it(form, least):
    """Singular values from 1 down to `least`: near dependence is left to the QR decomposition."""
    rng = np.random.default_rng(7)
    U, _, Vt = np.linalg.svd(rng.normal(size=(60, 50)), full_matrices=False)
    A = U * np.linspace(1, least, 50) @ Vt
    assert surely_independent(form(A)) == (least >= 1e-5)
    assert null_space(A.copy()).shape[0] == (least == 0)


@pytest.mark.parametrize("seed", range(40))
def test_dense_independence_equals_that_of_lapack(seed):
    """AᵀA − τ²I has Cholesky factors, and no column has been touched."""
    rng = np.random.default_rng(seed)
    m, k = rng.integers(1, 30), rng.integers(1, 30)
    A = rng.normal(size=(m, k)) * (rng.random((m, k)) < 0.6)
    A[:, -1] = A[:, 0] + 10.0 ** rng.integers(-12, 1) * A[:, -1]
    before, fraction = A.copy(), 1e-5
    normal = A.T @ A - fraction**2 * np.trace(A.T @ A) * np.eye(k)
    try:
        twin = k <= m and np.linalg.cholesky(normal).size > 0
    except np.linalg.LinAlgError:
        twin = False
    assert far_from_dependent(A, fraction) == twin
    np.testing.assert_array_equal(A, before)


def test_more_columns_than_rows_or_a_column_of_zeros_are_not_independent():
    assert not surely_independent(np.ones((2, 3)))
    assert not surely_independent(np.diag([1.0, 0.0]))
    assert not surely_independent(sp.csc_array(np.diag([1.0, 0.0])))
    assert surely_independent(np.zeros((3, 0)))


def test_full_rank_needs_no_qp():
    qps = sequence()
    qp = ContactQP(np.eye(3), -np.ones(3), np.zeros(3), np.full(3, np.inf))
    np.testing.assert_array_equal(minimum_norm(qps, qp, np.ones(3), None), np.ones(3))
    assert not qps.qps


@pytest.mark.parametrize("seed", range(5))
def test_fixed_rows_stay_and_the_others_share_the_load(seed):
    """Each column stands twice; of the last pair one is fixed, so that its twin keeps its part."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(9, 4))
    lower, upper = np.zeros(8), np.full(8, np.inf)
    lower[7] = upper[7] = 0.3
    x = rng.uniform(1, 2, 8)
    x[7] = 0.3
    qp = ContactQP(np.hstack([half, half]), rng.normal(size=9), lower, upper)
    least = minimum_norm(sequence(), qp, x, None)
    shared = (x[:3] + x[4:7]) / 2
    np.testing.assert_allclose(least, [*shared, x[3], *shared, 0.3], rtol=1e-10)


def test_a_least_norm_that_changes_the_force_is_not_taken():
    """Two opposite rows that leave no room but rounding: whatever comes of it, A λ stays."""
    A = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0 + 1e-9], [0.0, 0.0, 0.0]])
    lower = np.array([0.0, 0.0, 0.1 - 1e-16])
    upper = np.array([np.inf, np.inf, 0.1 + 1e-16])
    qp = ContactQP(A, np.ones(3), lower, upper)
    x = np.array([1.0, 2.0, 0.1])
    least = minimum_norm(sequence(), qp, x, None)
    np.testing.assert_allclose(qp.A @ least, qp.A @ x, rtol=1e-9)


# --- sparse: by a ridge and the method of multipliers --------------------------------------------


@pytest.fixture
def always_sparse(monkeypatch):
    monkeypatch.setattr("problems.least_norm.minimum_norm.MANY_COLUMNS", 0)


def two_tables(rng, mu):
    """Loads on two rows of legs with friction between them: redundant, and its Coulomb rows."""
    legs = 6
    A = np.zeros((6, 3 * legs))
    where = np.linspace(-1, 1, legs)
    A[0, :legs], A[1, :legs] = 1.0, where + 0.1 * rng.uniform(size=legs)
    A[2, legs : 2 * legs], A[3, legs : 2 * legs] = 1.0, where
    A[4, 2 * legs :], A[5, 2 * legs :] = 1.0, rng.uniform(-1, 1, legs)
    C = sp.csr_array(
        np.vstack(
            [
                np.hstack([mu * np.eye(legs), mu * np.eye(legs), -np.eye(legs)]),
                np.hstack([mu * np.eye(legs), mu * np.eye(legs), np.eye(legs)]),
            ]
        )
    )
    lam = np.concatenate([rng.uniform(0, 2, 2 * legs), np.zeros(legs)])
    lam[2 * legs :] = mu * (lam[:legs] + lam[legs : 2 * legs]) * rng.uniform(0.5, 1.0, legs)
    lower = np.concatenate([np.zeros(2 * legs), np.full(legs, -50.0)])
    upper = np.concatenate([np.full(2 * legs, np.inf), np.full(legs, 50.0)])
    return A, lam, lower, upper, C


@pytest.mark.usefixtures("always_sparse")
@pytest.mark.parametrize("with_rows", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_the_sparse_way_finds_the_same_multipliers(seed, with_rows):
    A, lam, lower, upper, C = two_tables(np.random.default_rng(seed), mu=0.4)
    rows = C if with_rows else None
    dense = minimum_norm(sequence(), ContactQP(A, -A @ lam, lower, upper), lam, rows)
    sparse_qp = ContactQP(sp.csc_array(A), -A @ lam, lower, upper)
    sparse = minimum_norm(sequence(), sparse_qp, lam, rows)
    np.testing.assert_allclose(sparse, dense, atol=1e-8)
    np.testing.assert_allclose(A @ sparse, A @ lam, rtol=1e-8)
    if with_rows:
        assert (C @ sparse).min() >= -1e-8


run_least_norm = Direct(least_norm)


def by_kernels(A, lam, lower, upper, C):
    return run_least_norm(
        *(A, lower, upper, lam, C, Arena.of(lam.size)),
        *make_solver("glambda").compiled(A.shape[1]),
    )


@pytest.mark.parametrize("with_rows", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_the_compiled_way_finds_the_same_multipliers(seed, with_rows):
    A, lam, lower, upper, C = two_tables(np.random.default_rng(seed), mu=0.4)
    if seed == 1:
        lower[[0, 13]] = upper[[0, 13]] = lam[[0, 13]]
    if seed == 2:
        lam[12:] *= 3  # far outside the cone, which is left out
    qps = sequence()
    expected = minimum_norm(
        qps, ContactQP(A, -A @ lam, lower, upper), lam, C if with_rows else None
    )
    rows = C.toarray() if with_rows else np.zeros((0, lam.size))
    found, solves = by_kernels(A, lam, lower, upper, rows)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert solves == qps.count


@pytest.mark.usefixtures("always_sparse")
def test_the_cone_matters_in_some_of_those_cases():
    broken = 0
    for seed in range(8):
        A, lam, lower, upper, C = two_tables(np.random.default_rng(seed), mu=0.4)
        qp = ContactQP(sp.csc_array(A), -A @ lam, lower, upper)
        broken += bool((C @ minimum_norm(sequence(), qp, lam, None)).min() < -1e-6)
    assert broken >= 2


@pytest.mark.usefixtures("always_sparse")
def test_the_sparse_way_leaves_out_a_cone_without_that_force():
    A, lam, lower, upper, C = two_tables(np.random.default_rng(0), mu=0.4)
    lam[12:] *= 3  # far outside the cone
    qp = ContactQP(sp.csc_array(A), -A @ lam, lower, upper)
    kept, free = (minimum_norm(sequence(), qp, lam, rows) for rows in (C, None))
    np.testing.assert_array_equal(kept, free)


@pytest.mark.usefixtures("always_sparse")
def test_the_sparse_way_leaves_fixed_rows_and_unique_answers_alone():
    A, lam, lower, upper, C = two_tables(np.random.default_rng(1), mu=0.4)
    lower[[0, 13]] = upper[[0, 13]] = lam[[0, 13]]
    found = minimum_norm(sequence(), ContactQP(sp.csc_array(A), -A @ lam, lower, upper), lam, C)
    np.testing.assert_array_equal(found[[0, 13]], lam[[0, 13]])
    np.testing.assert_allclose(A @ found, A @ lam, rtol=1e-8)
    qps = sequence()
    qp = ContactQP(sp.eye_array(3, format="csc"), -np.ones(3), np.zeros(3), np.full(3, np.inf))
    np.testing.assert_array_equal(minimum_norm(qps, qp, np.ones(3), None), np.ones(3))
    assert not qps.qps


def test_a_large_wall_at_rest_is_one_pass_and_sparse_for_the_solver():
    """Dense, the minimum-norm QPs of 1,000 bodies would take minutes."""
    wall = scene("wall", bodies=150, mu=0.3, speed=0.0)
    run = simulate(wall, make_solver("glambda"), fixed_step=1 / 240, until=3 / 240)
    least = [qp for qp in run.qps if qp.kind == "minimum_norm"]
    assert least
    assert all(is_narrow(qp.A) for qp in least)
    assert sum(qp.kind == "step" for qp in run.qps) == 3
    assert not any(qp.kind == "corrector" for qp in run.qps)
    np.testing.assert_allclose(run.q[-1], wall.q0, atol=1e-12)


def test_a_proof_of_independence_lasts_while_little_moves(monkeypatch):
    rng = np.random.default_rng(0)
    A = sp.csc_array(np.linalg.qr(rng.normal(size=(8, 5)))[0])
    asked = []
    monkeypatch.setattr(
        "problems.least_norm.independence.surely_independent",
        lambda A, multiple=1.0: asked.append(multiple) or surely_independent(A, multiple),
    )
    proof = IndependenceProof()
    near, far = A.copy(), A.copy()
    near.data = near.data + 1e-10
    far.data = far.data + 1e-3
    assert proof.holds(A) and proof.holds(near) and asked == [2.0]
    assert proof.holds(far) and asked == [2.0, 2.0]
    twice = A.copy()
    twice.data[8:16] = twice.data[:8]  # columns 0 and 1 are equal now
    assert not proof.holds(twice)
    assert asked[2:] == [2.0, 1.0]
    assert proof.holds(A) and not proof.holds(twice)


@pytest.mark.parametrize("least", [2.5e-7, 4e-7, 7e-7])
def test_a_proof_knows_what_is_beyond_doubt(least):
    A = sp.csc_array(np.diag([1.0, least]) + 0.0)
    moved = sp.csc_array(np.diag([1.0, 0.5 * least]))
    proof = IndependenceProof()
    for matrix in (A, A, moved, A):
        assert proof.holds(matrix) == surely_independent(matrix)


def test_the_ridge_keeps_its_pattern_where_entries_cancel() -> None:
    """Or a wall whose bricks turn a little would have another pattern at every step."""
    A = sp.csc_array(np.array([[1.0, 1.0], [0.5, -0.5], [2.0, 0.0]]))
    V = sp.csc_array(np.array([[1.0, 1.0], [1.0, -1.0]]))
    posed, moved = ridge(A, V, 0.1), ridge(A * 1.1 + 0 * A, V, 0.1)
    np.testing.assert_allclose(posed.toarray(), np.vstack([(A @ V).toarray(), 0.1 * V.toarray()]))
    turned = ridge(sp.csc_array(A.toarray() + np.array([[0.1, 0], [0, 0.2], [0, 0]])), V, 0.1)
    assert posed.nnz == turned.nnz == moved.nnz == 10
    np.testing.assert_array_equal(posed.indices, turned.indices)


def test_a_chain_goes_on_from_its_like() -> None:
    """The second ridge QP of a minimum norm, and those of the next one, start from the last."""
    made = scene("wall", bodies=160, mu=0.4)
    cold, starts = make_solver("glambda"), []

    class Watching:
        name = "watching"

        def solve(self, qp, start=None):
            if qp.kind == "minimum_norm":
                starts.append(start is not None)
            return cold.solve(qp, start)

    run = simulate(made, Watching(), until=5e-6)
    assert not starts[0] and all(starts[2:]) and len(starts) >= 4
    again = make_solver("glambda", accuracy=None)
    for qp, found in zip(run.qps, run.solutions, strict=True):
        if qp.kind == "minimum_norm":
            apart = again.solve(qp).x
            assert np.linalg.norm(qp.A @ (apart - found.x)) <= 1e-9 * np.linalg.norm(qp.d)
