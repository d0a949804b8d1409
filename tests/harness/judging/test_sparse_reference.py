"""Facts, bound and reference of QPs of many columns, by sparse factors instead of dense ones."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import harness.judging.facts as facts_module
import harness.judging.oracle as oracle
from harness.judging.error_bound import error_bound
from harness.judging.facts import UNKNOWN, Facts, facts_of
from harness.judging.oracle import reference
from harness.judging.span import DenseSpan, SparseSpan
from harness.study.record import record
from problems import scene
from problems.qp import ContactQP
from tests.fakes.random_qps import KINDS, random_qp
from tests.harness.judging.test_judge import wrong_answers

ANY = sorted(set(KINDS) - {"empty"})


@pytest.fixture
def sparse_facts(monkeypatch: pytest.MonkeyPatch):
    """`facts_of` as if every QP had many columns."""

    def of(qp: ContactQP) -> Facts:
        with monkeypatch.context() as patch:
            patch.setattr(facts_module, "DENSE_COLUMNS", 0)
            return facts_of(qp)

    return of


@pytest.mark.parametrize("kind", ANY)
def test_facts_agree_with_the_dense_ones(kind, sparse_facts):
    for seed in range(10):
        qp, _ = random_qp(kind, seed)
        dense, sparse = facts_of(qp), sparse_facts(qp)
        assert sparse.sparse and not dense.sparse
        assert sparse.rank == dense.rank
        assert sparse.scale == pytest.approx(dense.scale, rel=1e-6)


@pytest.mark.parametrize("kind", ANY)
def test_error_bound_is_never_below_the_error(kind, sparse_facts):
    rng = np.random.default_rng(5)
    for seed in range(5):
        qp, Ax = random_qp(kind, seed)
        exact, facts = reference(qp), sparse_facts(qp)
        known_to = 1e-15 * (1 + np.linalg.norm(qp.d) + np.abs(qp.dense_A).sum())
        for answer in wrong_answers(qp, exact.x, rng):
            error = np.linalg.norm(facts.A @ answer - Ax)
            assert error_bound(qp, answer, facts) >= error * (1 - 1e-9) - known_to


@pytest.mark.parametrize("kind", ANY)
def test_an_answer_that_is_nearly_right_becomes_a_reference(kind, sparse_facts):
    rng = np.random.default_rng(3)
    for seed in range(8):
        qp, _ = random_qp(kind, seed)
        exact, facts = reference(qp), sparse_facts(qp)
        start = exact.x + 1e-9 * rng.standard_normal(qp.k)
        found = reference(qp, facts, start)
        assert found is not None
        gap = np.linalg.norm(found.Ax - exact.Ax)
        assert gap <= found.error_bound + exact.error_bound + 1e-14 * np.linalg.norm(qp.d)
        assert ((found.x >= qp.lower) & (found.x <= qp.upper)).all()


def test_spans_agree():
    rng = np.random.default_rng(0)
    U, _, Vt = np.linalg.svd(rng.normal(size=(40, 30)), full_matrices=False)
    C = U * np.append(np.geomspace(1, 1e-3, 25), np.zeros(5)) @ Vt
    g = C.T @ rng.normal(size=40)
    dense, sparse = DenseSpan(C), SparseSpan(sp.csc_array(C))
    v = np.zeros(40)
    for _ in range(sparse.passes):
        v += sparse.correction(g - C.T @ v)
    np.testing.assert_allclose(v, dense.correction(g), atol=1e-9 * np.linalg.norm(v))
    assert dense.nearby.flatness == pytest.approx(1e-3)
    assert 0.2e-3 <= sparse.nearby.flatness <= 1.001e-3
    assert max(dense.nearby.gap, sparse.nearby.gap) < 1e-14


@pytest.mark.parametrize("kind", ANY)
def test_the_way_downhill_ends_at_the_answer(kind, sparse_facts, monkeypatch):
    """Where sets of free rows do not settle, they are walked through."""
    monkeypatch.setattr(oracle, "MAX_CHANGES", 0)
    for seed in range(5):
        qp, _ = random_qp(kind, seed)
        exact, facts = reference(qp), sparse_facts(qp)
        x = oracle._settle(facts, None)
        assert ((x >= qp.lower) & (x <= qp.upper)).all()
        assert np.linalg.norm(facts.A @ x - exact.Ax) <= 1e-9 * facts.scale


@pytest.mark.parametrize("kind", [DenseSpan, SparseSpan])
@pytest.mark.parametrize("least", [1.0, 1e-2, 1e-4, 3e-6, 1e-9, 0.0])
def test_what_is_certified_of_independent_columns_is_true(kind, least):
    rng = np.random.default_rng(1)
    U, _, Vt = np.linalg.svd(rng.normal(size=(40, 30)), full_matrices=False)
    C = U * np.append(np.ones(29), least) @ Vt
    true = float(np.linalg.svd(C, compute_uv=False)[-1])
    basis = kind(sp.csc_array(C) if kind is SparseSpan else C).basis
    if least >= 3e-6:
        assert basis.columns.all() and 0.1 * least <= basis.flatness <= true
    elif basis is not None:  # never more than the decomposition can tell from 0
        assert basis.flatness <= true * (1 + 1e-6)


@pytest.mark.parametrize("kind", [DenseSpan, SparseSpan])
def test_only_columns_that_are_combinations_exactly_are_spanned(kind):
    C = np.eye(6, 8)
    C[:, 6], C[:, 7] = 0.5 * (C[:, 0] + C[:, 1]), 0.25 * C[:, 2]
    for off, spanned in ((0.0, True), (2.0**-52, False)):
        C[5, 7] = off
        C[5, 5] = 0.0  # so that the last row is reached by the last column alone
        basis = kind(sp.csc_array(C) if kind is SparseSpan else C).basis
        assert (basis is not None) == spanned
        if spanned:
            assert basis.columns.sum() == 5


@pytest.mark.parametrize("family", ["tower", "wall", "pyramid"])
def test_every_qp_of_a_large_recording_has_a_reference(family):
    recording = record(scene(family, bodies=400), until=0.002)
    assert all(sp.issparse(qp.A) for qp in recording.qps)
    for qp, solution, exact in zip(
        recording.qps, recording.solutions, recording.references, strict=True
    ):
        facts = facts_of(qp)
        assert facts.rank == (UNKNOWN if qp.k > facts_module.RANK_COLUMNS else qp.k)
        assert exact is not None and exact.error_bound <= 1e-10 * facts.scale
        assert np.linalg.norm(qp.A @ solution.x - exact.Ax) <= 10 * qp.eps0
        assert "dense_A" not in vars(qp)
