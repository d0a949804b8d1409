"""Projected Newton steps, compiled, against NumPy; and what happens where they do not end a QP."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from problems.qp import FREE, ContactQP
from solvers.active_set import newton
from solvers.active_set.glambda import Glambda
from solvers.active_set.method import COLD_CROSSOVER, FULL_CROSSOVER, THIN_CROSSOVER
from solvers.active_set.sparse.workspace import SparseWorkspace
from solvers.active_set.workspace import (
    CHANGES,
    COUNTS,
    DIRECTIONS,
    FLOPS,
    LANES,
    MEMBER,
    OLD_MEMBER,
    OLD_ORDER,
    PREVIOUS,
    Workspace,
    X,
    make_workspace,
)
from tests.fakes.assertions import assert_kkt, assert_same_force, force_scale
from tests.fakes.random_qps import KINDS, from_solution, random_qp
from tests.solvers.numpy_twin.newton import projected_newton
from tests.solvers.test_sparse_path import contact_matrix

U = 2.0**-51


def compiled(qp: ContactQP, x: np.ndarray | None = None):
    """What the kernel finds by itself: x, free rows, steps, and whether it came to an end."""
    room = make_workspace(qp.m, qp.k)
    S, I = room.S, room.I
    S[:], I[:] = np.nan, 99  # a new room holds anything
    I[COUNTS, DIRECTIONS : FLOPS + 1] = 0
    if x is not None:
        S[X, : qp.k] = x
        I[PREVIOUS, : qp.k] = np.arange(qp.k)
        I[OLD_MEMBER, : qp.k] = FREE
    mp = (qp.m + LANES - 1) // LANES * LANES
    done, _ = newton.solve_by_newton(
        *(qp.dense_A, qp.d, qp.lower, qp.upper, qp.row_id, S, I, mp, U, x is not None, 0, mp)
    )
    return S[X, : qp.k].copy(), I[MEMBER, : qp.k] == FREE, int(I[COUNTS, DIRECTIONS]), done, room


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("warm", [False, True])
def test_kernel_and_numpy_go_the_same_way(kind: str, seed: int, warm: bool) -> None:
    qp, Ax = random_qp(kind, seed)
    x = np.random.default_rng(seed).standard_normal(qp.k) if warm else None
    twin = projected_newton(qp, x)
    assert (np.diff(twin.objectives) <= 1e-12 * (1 + abs(twin.objectives[-1]))).all()
    found, free, _, done, _ = compiled(qp, x)
    if done:
        assert_same_force(qp, found, Ax, 1e-9)
    # columns that nearly depend may be left out by one and not by the other
    if done and twin.ended and (free == twin.free).all():
        assert np.linalg.norm(qp.A @ (found - twin.x)) <= 1e-7 * force_scale(qp)


def test_most_random_qps_are_ended_by_it() -> None:
    """Contact problems of up to 40 columns: nine of ten, cold."""
    rng = np.random.default_rng(3)
    ended = 0
    for _ in range(100):
        bodies = int(rng.integers(4, 20))
        k = int(rng.integers(2, 2 * bodies))
        A = contact_matrix(rng, bodies, k).toarray()
        qp = ContactQP(A, rng.standard_normal(3 * bodies), np.zeros(k), np.full(k, np.inf))
        ended += compiled(qp)[3]
    assert ended >= 90


def test_many_rows_change_sides_at_once() -> None:
    """Thirty boxes in free fall, of which every second is caught: one step, one look."""
    d = np.where(np.arange(30) % 2, -1.0, 1.0)
    found, free, steps, done, room = compiled(
        ContactQP(np.eye(30), d, np.zeros(30), np.full(30, np.inf))
    )
    assert done and found.tolist() == np.maximum(-d, 0.0).tolist()
    assert free.tolist() == (d < 0).tolist()
    assert steps == 2 and room.I[COUNTS, CHANGES] == 15


@pytest.mark.parametrize("seed", range(4))
def test_cold_a_load_that_contacts_share_is_on_all_of_them(seed: int) -> None:
    """Ten columns that all press, each twice: either bears half, and no bound is met on the way."""
    rng = np.random.default_rng(seed)
    one = contact_matrix(rng, 12, 10).toarray()
    load = rng.uniform(1.0, 2.0, 10)
    qp = ContactQP(np.tile(one, 2), -one @ load, np.zeros(20), np.full(20, np.inf))
    found, free, steps, done, room = compiled(qp)
    assert done and steps == 2 and room.I[COUNTS, CHANGES] == 0
    assert free.sum() == 10  # the others are passive
    np.testing.assert_allclose(found, np.tile(load / 2, 2), rtol=1e-4)


def test_cold_what_least_norm_puts_beyond_a_bound_is_put_on_it() -> None:
    """Twice the same column, of which one may bear little: the other bears the rest."""
    rng = np.random.default_rng(5)
    one = contact_matrix(rng, 12, 10).toarray()
    load = rng.uniform(1.0, 2.0, 10)
    upper = np.full(20, np.inf)
    upper[:10] = 0.1
    qp = ContactQP(np.tile(one, 2), -one @ load, np.zeros(20), upper)
    solution = Glambda(accuracy=1e-10).solve(qp)
    assert solution.found
    assert_same_force(qp, solution.x, one @ load, 1e-9)
    assert (solution.x <= upper).all() and (solution.x >= 0.0).all()


def test_what_it_does_not_end_goes_on_from_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns 1e-7 apart are one by normal equations, and two by QR."""
    e = 1e-7
    A = np.array([[1.0, 1.0, 0.0], [0.0, e, 0.0], [0.0, 0.0, 1.0]])
    d = np.array([-2.0, -e, 1.0])
    qp = ContactQP(A, d, np.zeros(3), np.full(3, np.inf))
    reached, _, _, done, _ = compiled(qp)
    assert not done
    np.testing.assert_allclose(reached, [2.0, 0.0, 0.0], atol=1e-12)
    solution = Glambda(accuracy=1e-12).solve(qp)
    assert solution.found
    np.testing.assert_allclose(solution.x, [1.0, 1.0, 0.0], atol=1e-6)
    assert_kkt(qp, solution.x, 1e-12)


@pytest.mark.parametrize("entry", [1e-200, 1e140])
def test_columns_out_of_range_are_left_to_algorithm_2(entry: float) -> None:
    A = np.diag([1.0, entry, 1.0])
    qp = ContactQP(A, np.array([-1.0, -1.0, 1.0]), np.zeros(3), np.full(3, np.inf))
    x = Glambda().solve(qp).x
    assert x[0] == 1.0 and x[2] == 0.0


def test_a_start_beyond_all_bounds_is_no_start() -> None:
    qp, Ax = random_qp("two_sided", 2)
    found, _, _, done, _ = compiled(qp, np.full(qp.k, 1e12))
    assert done
    assert_same_force(qp, found, Ax, 1e-9)


@pytest.mark.parametrize("k", [THIN_CROSSOVER + 1, COLD_CROSSOVER])
def test_a_cold_start_of_some_columns_more_needs_no_pattern(k: int) -> None:
    """The next one, warm, makes it; both find the same A x as a dense matrix gives."""
    rng = np.random.default_rng(k)
    A = contact_matrix(rng, 60, k)
    qp = ContactQP(A, rng.standard_normal(180), np.zeros(k), np.full(k, np.inf))
    solver = Glambda(accuracy=1e-11)
    cold = solver.solve(qp)
    warm = solver.solve(qp, cold)
    dense = solver.solve(ContactQP(A.toarray(), qp.d, qp.lower, qp.upper))
    assert not isinstance(cold.memory, SparseWorkspace)
    assert isinstance(warm.memory, SparseWorkspace) and sp.issparse(qp.A)
    for solution in (cold, warm, dense):
        assert solution.found
        assert_same_force(qp, solution.x, A @ dense.x, 1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_contacts_that_are_soft(seed: int) -> None:
    """A ends with a diagonal, entries of which are 0, and with a row of zeros."""
    rng = np.random.default_rng(seed)
    k = 30
    softness = np.diag(rng.uniform(0.05, 0.5, k) * (rng.random(k) < 0.9))
    A = np.vstack((rng.standard_normal((9, k)), softness, np.zeros(k)))
    x = np.where(rng.random(k) < 0.7, rng.uniform(0.1, 2.0, k), 0.0)
    qp, Ax = from_solution(A, x, np.zeros(k), np.full(k, np.inf), rng, momentum=10.0)
    found, _, _, done, _ = compiled(qp)
    assert done  # else algorithm 2 would mend it
    assert_same_force(qp, found, Ax, 1e-9)
    solver, last = Glambda(accuracy=1e-11), None
    for _ in range(4):
        qp = replace(qp, d=qp.d + 0.05 * rng.standard_normal(qp.m))
        last, cold = solver.solve(qp, last), solver.solve(qp)
        assert last.found and cold.found
        assert_kkt(qp, last.x, 1e-9)
        assert_same_force(qp, last.x, qp.A @ cold.x, 1e-9)


@pytest.mark.parametrize("full", [False, True])
def test_large_dense_arrays_are_factorized_anew_unless_full_and_warm(full: bool) -> None:
    """An old R is of use where columns are full; both ways lead to the same A x."""
    rng = np.random.default_rng(7)
    m, k = 210, FULL_CROSSOVER + 20
    A = rng.standard_normal((m, k)) if full else contact_matrix(rng, m // 3, k).toarray()
    ends, d, last, twin = (np.zeros(k), np.full(k, np.inf)), rng.standard_normal(m), None, None
    for step in range(4):
        qp = ContactQP(A, d + 1e-3 * step * rng.standard_normal(m), *ends)
        last = Glambda(accuracy=1e-11).solve(qp, last)
        arrays = Glambda(accuracy=1e-11).solve_arrays(A, qp.d, *ends, start=twin)
        twin = arrays
        cold = Glambda(accuracy=1e-11).solve(qp)
        assert last.found and cold.found
        assert (arrays.x == last.x).all()
        assert_same_force(qp, last.x, A @ cold.x, 1e-9)
        keeps_R = isinstance(last.memory, Workspace) and last.memory.I[COUNTS, OLD_ORDER] >= 0
        assert keeps_R == (full and step > 0)
