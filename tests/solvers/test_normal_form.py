"""Compiled posing against NumPy's and SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from problems.qp import ContactQP
from solvers.adapters.normal_form import (
    csc,
    dense_product,
    dense_sizes,
    is_definite,
    is_one_sided,
    product,
    sparse_sizes,
    transposed,
)
from tests.fakes.random_qps import KINDS, random_qp


def sparse(m: int, k: int, seed: int) -> sp.csc_matrix:
    """A third of the entries; a column and a row of zeros, where there are two."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m, k)) * (rng.random((m, k)) < 0.3)
    A[:, k // 2] = 0.0
    A[m // 2] = 0.0
    return sp.csc_matrix(A)


@pytest.mark.parametrize(("m", "k"), [(1, 1), (9, 6), (6, 9), (40, 30), (30, 70)])
@pytest.mark.parametrize("seed", range(3))
def test_products_are_scipys(m: int, k: int, seed: int) -> None:
    A = sparse(m, k, seed)
    At, P = transposed(A), (A.T @ A).toarray()
    made = dense_product(A, At)
    np.testing.assert_array_equal(At.toarray(), A.T.toarray())
    np.testing.assert_allclose(made, P, atol=1e-14 * k)
    np.testing.assert_array_equal(made, made.T)
    for part, wanted in ((0, P), (1, np.triu(P)), (-1, np.tril(P))):
        found = product(A, At, part)
        found.check_format()
        assert found.has_sorted_indices
        np.testing.assert_allclose(found.toarray(), wanted, atol=1e-14 * k)
    whole = product(A, At)
    np.testing.assert_array_equal(whole.toarray(), whole.T.toarray())


def test_an_entry_that_cancels_is_stored_so_that_patterns_stay() -> None:
    A = sp.csc_matrix(np.array([[1.0, 1.0], [1.0, -1.0]]))
    assert product(A, transposed(A)).nnz == 4


@pytest.mark.parametrize("kind", KINDS)
def test_sizes_are_numpys(kind: str) -> None:
    for seed in range(3):
        qp, _ = random_qp(kind, seed)
        A, finite = qp.dense_A, [*qp.lower, *-qp.upper, 0.0]
        q, squares = A.T @ qp.d, (A * A).sum(axis=0)
        P = A.T @ A
        wanted = (
            np.abs(q).max(initial=0.0), max(finite),
            squares.min() if qp.k else 1.0, squares.max() if qp.k else 1.0,
            np.count_nonzero(qp.lower == qp.upper),
            not qp.lower.any() and bool((qp.upper == np.inf).all()),
        )  # fmt: skip
        for found in (dense_sizes(qp, A, P), sparse_sizes(qp, sp.csc_array(A))):
            np.testing.assert_allclose(found[0], q, atol=1e-13 * (1.0 + np.abs(q).max(initial=0.0)))
            np.testing.assert_allclose(found[1:], wanted, rtol=1e-12, atol=1e-300)
        assert is_one_sided(qp.lower, qp.upper) == wanted[-1]


def test_a_matrix_is_made_of_arrays_without_a_copy() -> None:
    A = sparse(7, 5, 0)
    made = csc(A.shape, A.data, A.indices, A.indptr)
    assert isinstance(made, sp.csc_matrix) and made.data is A.data
    assert csc(A.shape, A.data, A.indices, A.indptr) is not made
    np.testing.assert_array_equal(made.toarray(), A.toarray())


@pytest.mark.parametrize("n", [1, 2, 7, 30])
def test_definite_is_what_the_cholesky_factor_says(n: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.standard_normal((2 * n, n))
    pivots = np.linalg.cholesky(A.T @ A).diagonal()
    share = pivots.min() / pivots.max()
    assert is_definite(A.T @ A, 0.99 * share)
    assert is_definite(A.T @ A, 1.01 * share) == (n == 1 and 1.01 * share < 1.0)
    A[:, -1] = A[:, 0] if n > 1 else 0.0
    assert not is_definite(A.T @ A, 1e-6)


def test_a_qp_of_no_columns_has_sizes() -> None:
    qp = ContactQP(np.zeros((3, 0)), np.ones(3), np.zeros(0), np.zeros(0))
    found = dense_sizes(qp, qp.dense_A, np.zeros((0, 0)))
    assert found[0].size == 0 and found[1:] == (0.0, 0.0, 1.0, 1.0, 0, True)
