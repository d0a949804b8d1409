"""The sparse path of the method: pattern and factor against dense algebra, answers against QR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from harness.judging.error_bound import error_bound
from problems.qp import ContactQP, Indices, Vector
from solvers import make_solver
from solvers.active_set.glambda import Glambda
from solvers.active_set.lotstedt import Lotstedt
from solvers.active_set.method import CROSSOVER
from solvers.active_set.sparse.cholesky import (
    cholesky,
    delete_column,
    insert_column,
    inverse_norm,
    solve_L,
    solve_LT,
)
from solvers.active_set.sparse.direction import conjugate_gradients_sparse
from solvers.active_set.sparse.loop import LEAP_AFTER
from solvers.active_set.sparse.pattern import (
    FEW_ZEROS,
    WIDEST,
    Pattern,
    make_pattern,
)
from solvers.active_set.sparse.workspace import (
    CHANGED,
    IN_F,
    IN_L,
    SPREAD,
    SparseWorkspace,
    make_sparse_workspace,
)
from solvers.active_set.tolerances import NOISE
from solvers.active_set.workspace import GRADIENT, LOWER, RESIDUAL, UPPER, P
from tests.fakes.assertions import assert_kkt, force_scale
from tests.fakes.grid import grid_qp
from tests.fakes.random_qps import from_solution


def contact_matrix(
    rng: np.random.Generator, bodies: int, contacts: int, reach: int = 3
) -> sp.csc_array:
    """Each column has three entries for each of two bodies, or for one and the ground."""
    columns = []
    for _ in range(contacts):
        body = int(rng.integers(bodies))
        column = np.zeros(3 * bodies)
        column[3 * body : 3 * body + 3] = rng.standard_normal(3)
        other = body + int(rng.integers(0, reach))
        if other != body and other < bodies:
            column[3 * other : 3 * other + 3] = rng.standard_normal(3)
        columns.append(column)
    return sp.csc_array(np.array(columns).T)


def contact_qp(rng: np.random.Generator, bodies: int, contacts: int) -> ContactQP:
    """Two thirds are one-sided, the others have bounds on both sides; doubles make it redundant."""
    A = contact_matrix(rng, bodies, contacts)
    double = rng.random(contacts) < 0.2
    A = sp.csc_array(sp.hstack([A, A[:, double]]))
    k = A.shape[1]
    two_sided = rng.random(k) < 1 / 3
    size = rng.uniform(0.0, 2.0, k)
    return ContactQP(
        A,
        3 * rng.standard_normal(A.shape[0]),
        np.where(two_sided, -size, 0.0),
        np.where(two_sided, size, np.inf),
        row_id=rng.permutation(k),
    )


def sparse_sizes() -> st.SearchStrategy[tuple[int, int, int]]:
    return st.tuples(st.integers(0, 2**32 - 1), st.integers(3, 60), st.integers(CROSSOVER + 1, 150))


def laid_out(A: sp.csc_array, inside: Vector) -> tuple[SparseWorkspace, Vector]:
    """A workspace with A itself as B and `inside` (k,) bool as F; B_F in its order, dense."""
    pattern = make_pattern(A)
    room = make_sparse_workspace(A.shape[0], pattern)
    dense = A.toarray()[:, pattern.order]
    padded = np.vstack([dense, np.zeros(pattern.order.size)])
    room.Bx[: pattern.order.size] = padded[pattern.Bi, np.arange(pattern.order.size)[:, None]]
    room.I[IN_L, : inside.size] = inside
    return room, dense


def columns_of_L(pattern: Pattern) -> list[tuple[int, slice, Indices]]:
    """For each column: the place of its diagonal, its places and its rows."""
    columns = []
    for s, (begin, end) in enumerate(zip(pattern.first[:-1], pattern.first[1:], strict=True)):
        rows = pattern.Ri[pattern.Rp[s] : pattern.Rp[s + 1]]
        for q in range(end - begin):
            diagonal = pattern.Lp[s] + q * (rows.size + 1)
            columns.append((diagonal, slice(diagonal, diagonal + rows.size - q), rows[q:]))
    return columns


def dense_L(room: SparseWorkspace) -> NDArray[np.float64]:
    """L (k, k); its diagonal is stored as reciprocals."""
    k = room.pattern.order.size
    L = np.zeros((k, k))
    for c, (diagonal, places, rows) in enumerate(columns_of_L(room.pattern)):
        L[rows, c] = room.Lx[places]
        L[c, c] = 1.0 / room.Lx[diagonal]
    return L


def gram_of(B: NDArray[np.float64], inside: NDArray[np.bool_], shift: float) -> NDArray[np.float64]:
    """B_FᵀB_F + shift, the unit matrix elsewhere."""
    gram = B.T @ B + shift * np.eye(inside.size)
    gram[~inside], gram[:, ~inside] = 0.0, 0.0
    gram[~inside, ~inside] = 1.0
    return gram


@settings(max_examples=25)
@given(sparse_sizes())
def test_the_pattern_is_that_of_elimination(sizes: tuple[int, int, int]) -> None:
    seed, bodies, contacts = sizes
    A = contact_matrix(np.random.default_rng(seed), bodies, contacts)
    pattern = make_pattern(A)
    assert sorted(pattern.order) == list(range(contacts))
    B = (A[:, pattern.order] != 0).toarray().astype(float)
    filled = np.tril(B.T @ B > 0)
    for c in range(contacts):
        below = np.flatnonzero(filled[c + 1 :, c]) + c + 1
        if below.size:
            filled[np.ix_(below, [below[0]])] |= (below >= below[0])[:, None]
    zeros = 0
    for c, (_, _, rows) in enumerate(columns_of_L(pattern)):
        assert (np.diff(rows) > 0).all() and rows[0] == c
        assert set(np.flatnonzero(filled[:, c])) <= set(rows.tolist())
        zeros += rows.size - int(filled[:, c].sum())
    assert pattern.entries == filled.sum() + zeros
    assert zeros <= FEW_ZEROS * pattern.entries


@settings(max_examples=25)
@given(sparse_sizes(), st.sampled_from([0.0, 1e-6, 1.0]))
def test_L_is_the_cholesky_factor(sizes: tuple[int, int, int], shift: float) -> None:
    """L Lᵀ = B_FᵀB_F + shift, the unit matrix elsewhere; solves and the estimate follow from it."""
    seed, bodies, contacts = sizes
    rng = np.random.default_rng(seed)
    A = contact_matrix(rng, bodies, contacts)
    inside = rng.random(contacts) < 0.7
    room, B = laid_out(A, inside)
    pattern = room.pattern
    flops = cholesky(pattern, room.Bx, room.S, room.I, room.Lx, shift)
    gram = gram_of(B, inside, shift)
    if flops < 0:
        assert shift < 1.0 and np.linalg.eigvalsh(gram)[0] < 1e-9
        return
    L = dense_L(room)
    assert np.abs(L @ L.T - gram).max() <= 1e-13 * np.abs(gram).max() * contacts
    right = rng.standard_normal(contacts)
    x = right.copy()
    solve_L(pattern, room.Lx, x)
    assert np.abs(L @ x - right).max() <= 1e-10 * max(1.0, np.abs(x).max())
    x = right.copy()
    solve_LT(pattern, room.Lx, x)
    assert np.abs(L.T @ x - right).max() <= 1e-10 * max(1.0, np.abs(x).max())
    true = 1 / np.linalg.svd(L, compute_uv=False)[-1]
    assert 0.1 * true <= inverse_norm(pattern, room.S, room.I, room.Lx) <= true * (1 + 1e-6)


@settings(max_examples=25)
@given(sparse_sizes())
def test_a_changed_L_is_that_of_the_changed_columns(sizes: tuple[int, int, int]) -> None:
    """Ten columns in turn leave L or enter it; the scratch rows are left at 0."""
    seed, bodies, contacts = sizes
    rng = np.random.default_rng(seed)
    shift = 1e-3
    inside = rng.random(contacts) < 0.7
    room, B = laid_out(contact_matrix(rng, bodies, contacts), inside)
    assert cholesky(room.pattern, room.Bx, room.S, room.I, room.Lx, shift) > 0
    for c in rng.integers(contacts, size=10):
        if inside[c]:
            sound = delete_column(room.pattern, room.Lx, room.S, room.I, c)
        else:
            sound = insert_column(room.pattern, room.Bx, room.Lx, room.S, room.I, c, shift)
        inside[c] = not inside[c]
        assert sound
        assert (room.I[IN_L, :contacts] == inside).all()
        assert not room.S[[SPREAD, CHANGED]].any()
        gram = gram_of(B, inside, shift)
        L = dense_L(room)
        assert np.abs(L @ L.T - gram).max() <= 1e-11 * np.abs(gram).max()


def test_a_column_that_depends_on_others_is_refused() -> None:
    """Without a shift there is no L with both of two equal columns."""
    A = contact_matrix(np.random.default_rng(1), 90, 30)
    A = sp.csc_array(sp.hstack([A, A[:, [7]]]))
    inside = np.ones(31, dtype=bool)
    room, _ = laid_out(A, inside)
    assert cholesky(room.pattern, room.Bx, room.S, room.I, room.Lx, 0.0) < 0
    twin = int(np.flatnonzero(room.pattern.order == 30)[0])
    room.I[IN_L, twin] = 0
    assert cholesky(room.pattern, room.Bx, room.S, room.I, room.Lx, 0.0) > 0
    assert not insert_column(room.pattern, room.Bx, room.Lx, room.S, room.I, twin, 0.0)


def old_direction(noise: float, bound: float) -> tuple[int, float, float]:
    """Conjugate gradients on 100 columns of rank 40, with L of A as it was, 1e-3 earlier.

    The residual stays large in the other 20 of 60 dimensions, and with it the rounding.  Bounds
    are −bound ≤ z ≤ bound.  Returns the iterations, ‖p‖ in units of the least possible, and the
    relative error of B p.
    """
    rng = np.random.default_rng(4)
    room, B = laid_out(contact_matrix(rng, 20, 100), np.ones(100, dtype=bool))
    m, k = B.shape
    for moved in (0.0, 1e-3):
        B *= 1.0 + moved * rng.standard_normal(B.shape)
        B[2::3] = B[::3] + B[1::3]
        padded = np.vstack([B, np.zeros(k)])
        room.Bx[:k] = padded[room.pattern.Bi, np.arange(k)[:, None]]
        if moved == 0.0:
            assert cholesky(room.pattern, room.Bx, room.S, room.I, room.Lx, 1e-4) > 0
    r = 1e4 * rng.standard_normal(m)
    S, I = room.S, room.I
    S[RESIDUAL, :m], S[GRADIENT, :k], I[IN_F, :k] = r, B.T @ r, 1
    S[LOWER, :k], S[UPPER, :k] = -bound, bound
    made = conjugate_gradients_sparse(
        room.pattern, room.Bx, room.Lx, S, I, m, 1e-12, noise, 60, False
    )
    least = -np.linalg.pinv(B, rcond=1e-10) @ r
    error = float(np.linalg.norm(B @ (S[P, :k] - least)) / np.linalg.norm(B @ least))
    return made, float(np.linalg.norm(S[P, :k]) / np.linalg.norm(least)), error


def test_rounding_along_dependent_columns_is_not_followed() -> None:
    """‖p‖ is 1e16 times the least otherwise."""
    rounding = 4 * float(np.finfo(float).eps) * 1e5
    made, size, error = old_direction(NOISE * rounding**2 / 1e-4, np.inf)
    assert 0 < made < 20
    assert size < 100 and error < 1e-8


def test_a_direction_that_is_blocked_is_only_roughly_right() -> None:
    rounding = 4 * float(np.finfo(float).eps) * 1e5
    wide, _, fine = old_direction(NOISE * rounding**2 / 1e-4, np.inf)
    blocked, _, rough = old_direction(NOISE * rounding**2 / 1e-4, 1e-3)
    assert 0 < blocked < wide / 2
    assert fine < 1e-8 < rough < 1e-2


def test_a_column_of_many_bodies_is_solved_by_the_dense_path() -> None:
    rng = np.random.default_rng(2)
    A = contact_matrix(rng, 60, 110).toarray()
    A[: WIDEST + 1, 0] = rng.standard_normal(WIDEST + 1)
    qp = ContactQP(sp.csc_array(A), rng.standard_normal(180), np.zeros(110), np.full(110, np.inf))
    solution = Glambda(accuracy=1e-10).solve(qp)
    assert solution.found and not isinstance(solution.memory, SparseWorkspace)
    assert_kkt(qp, solution.x, 1e-8)


def test_columns_and_rows_of_zeros() -> None:
    """A column that does nothing keeps its 0; bodies that touch nothing join and leave."""
    rng = np.random.default_rng(8)
    A = contact_matrix(rng, 70, 170).toarray()
    A[:, [0, 7, 169]] = 0.0
    qp = ContactQP(sp.csc_array(A), rng.standard_normal(210), np.zeros(170), np.full(170, np.inf))
    solver = Glambda(accuracy=1e-10)
    last = None
    for m in (210, 270, 210):
        taller = sp.csc_array(np.vstack([A, np.zeros((m - 210, 170))]))
        d = np.concatenate([qp.d, np.ones(m - 210)])
        last = solver.solve(replace(qp, A=taller, d=d, D=np.ones(m)), last)
        assert last.found and isinstance(last.memory, SparseWorkspace)
        assert_kkt(qp, last.x, 1e-8)
        assert not last.x[[0, 7, 169]].any()


def test_a_chain_has_little_fill() -> None:
    """A tower: contacts between bodies i and i + 1, two each, in any order."""
    n = 50
    columns = np.zeros((3 * n, 2 * n))
    rng = np.random.default_rng(0)
    for c in range(2 * n):
        body = c // 2
        columns[3 * body : 3 * body + 3, c] = 1 + rng.random(3)
        if body + 1 < n:
            columns[3 * body + 3 : 3 * body + 6, c] = 1 + rng.random(3)
    A = sp.csc_array(columns[:, rng.permutation(2 * n)])
    pattern = make_pattern(A)
    gram = abs(A.T) @ abs(A)
    assert pattern.entries <= 1.2 * (gram.nnz + 2 * n) // 2
    assert sorted(pattern.order) == list(range(2 * n))


SPARSE_METHODS = (
    *("glambda", "lotstedt", "lotstedt[deferred]", "lotstedt[online]", "lotstedt[exact_qr]"),
    "lotstedt[no_working_set]",
)


@settings(max_examples=20)
@given(sparse_sizes(), st.sampled_from(SPARSE_METHODS))
def test_sparse_and_dense_give_the_same_force(sizes: tuple[int, int, int], method: str) -> None:
    """Cold, warm from a QP nearby, and warm when contacts have gone and others have come."""
    seed, bodies, contacts = sizes
    rng = np.random.default_rng(seed)
    qp = contact_qp(rng, bodies, contacts)
    dense = make_solver("lotstedt[exact_qr]", accuracy=1e-10)
    solver = make_solver(method, accuracy=1e-10 * force_scale(qp))
    moved = sp.csc_array(qp.A)
    moved.data = moved.data * (1 + 1e-3 * rng.standard_normal(moved.data.size))
    kept = np.sort(rng.permutation(qp.k)[: qp.k - 1 - int(rng.integers(3))])
    fewer = replace(
        qp,
        A=moved[:, kept],
        lower=qp.lower[kept],
        upper=qp.upper[kept],
        row_id=qp.row_id[kept],
        feature=None,
    )
    last = None
    for now in (qp, replace(qp, A=moved), fewer, qp):
        last = solver.solve(now, last)
        assert last.found, last.status_text
        right = dense.solve(replace(now, A=now.dense_A)).x
        assert last.x is not None and right is not None
        error = np.linalg.norm(now.A @ (last.x - right))
        assert error <= 1e-8 * force_scale(now)
        assert_kkt(now, last.x, 1e-8)


def test_an_unchanged_matrix_needs_no_new_factor() -> None:
    """As in a pass of the functional iteration; no row is at a bound, and L has much fill."""
    rng = np.random.default_rng(3)
    A = contact_matrix(rng, 80, 200, reach=80)
    qp = ContactQP(A, rng.standard_normal(240), np.full(200, -1e3), np.full(200, np.inf))
    solver = Glambda(accuracy=1e-9)
    first = last = solver.solve(qp)
    for step in range(1, 4):  # the first solve may ask for a lower shift
        last = solver.solve(replace(qp, d=(1 + 0.01 * step) * qp.d), last)
    assert last.work is not None and last.work.qr_factorizations == 0
    assert last.memory is first.memory


@pytest.mark.parametrize("order", [(60, 20), (20, 60)])
def test_memory_passes_between_the_paths(order: tuple[int, int]) -> None:
    """The working set goes on where a sequence grows or shrinks across the border."""
    qp = contact_qp(np.random.default_rng(5), 30, 60)
    solver = Glambda(accuracy=1e-10)
    last = None
    for k in order:
        part = replace(
            qp,
            A=sp.csc_array(qp.A)[:, :k],
            lower=qp.lower[:k],
            upper=qp.upper[:k],
            row_id=qp.row_id[:k],
            feature=None,
        )
        last = solver.solve(part, last)
        cold = Lotstedt(accuracy=1e-10, variant="exact_qr").solve(replace(part, A=part.dense_A))
        assert last.found
        assert np.linalg.norm(part.A @ (last.x - cold.x)) <= 1e-8 * force_scale(part)


def ridge_qp(seed: int, bodies: int, contacts: int, delta: float) -> ContactQP:
    """Redundant contacts with a ridge, all of them one-sided: a search of many sets."""
    rng = np.random.default_rng(seed)
    A = contact_matrix(rng, bodies, contacts)
    stacked = sp.vstack([A, delta * sp.eye_array(contacts)], format="csc")
    d = np.concatenate([rng.standard_normal(3 * bodies), np.zeros(contacts)])
    zero, inf = np.zeros(contacts), np.full(contacts, np.inf)
    return ContactQP(stacked, d, zero, inf, kind="minimum_norm", eps0=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_a_leap_ends_at_the_same_force(seed: int) -> None:
    """Most contacts are loose and a ridge tells which: many sets to search.

    An option about iterations makes the method walk all the way.
    """
    qp = grid_qp(24, seed, loose=0.9)
    leapt = Glambda().solve(qp)
    walked = Glambda(iteration_limit=10**6).solve(qp)
    assert leapt.found and walked.found and leapt.work and walked.work
    assert leapt.work.descent_directions > LEAP_AFTER
    assert leapt.work != walked.work
    assert_kkt(qp, leapt.x, 1e-7)
    error = np.linalg.norm(qp.A @ (leapt.x - walked.x))
    assert error <= 2 * qp.eps0


@pytest.mark.parametrize("seed", range(3))
def test_what_is_solved_is_as_accurate_as_was_asked(seed: int) -> None:
    """A gradient of 1e-14 moves A x by 1e-9 along a ridge, and rounding is far smaller than that.

    It is that of the few rows of one column: the norm over all rows is fifty times as large.
    """
    qp = grid_qp(40, seed, loose=0.3)
    solution = Glambda().solve(qp)
    assert solution.found
    assert error_bound(qp, solution.x) <= qp.eps0


def test_a_matrix_that_moves_is_factorized_for_a_minimum_norm() -> None:
    """And one that does not is not."""
    qp = ridge_qp(7, 70, 200, 1e-4)
    solver = Glambda()
    last = solver.solve(qp)
    last = solver.solve(replace(qp, d=1.001 * qp.d), last)
    assert last.work is not None and last.work.qr_factorizations == 0
    moved = sp.csc_array(qp.A)
    moved.data = moved.data * (1 + 1e-7)
    last = solver.solve(replace(qp, A=moved), last)
    assert last.work is not None and last.work.qr_factorizations == 1


def twice(seed: int, near: float) -> ContactQP:
    """A sparse QP whose columns are there twice, but for a share `near` of their entries."""
    rng, m, half = np.random.default_rng(seed), 480, 81
    rows = np.concatenate([rng.choice(m, 3, replace=False) for _ in range(half)])
    indices = rows, np.repeat(np.arange(half), 3)
    once = sp.csc_array((rng.standard_normal(3 * half), indices), shape=(m, half))
    again = once.copy()
    again.data *= 1 + near * rng.standard_normal(again.nnz)
    k = 2 * half
    lower = np.where(rng.random(k) < 0.8, 0.0, -np.inf)
    upper = np.where(rng.random(k) < 0.5, 1.0, np.inf)
    A = sp.csc_array(sp.hstack([once, again]))
    return ContactQP(A, 1e3 * rng.standard_normal(m), lower, upper)


def test_columns_that_hardly_differ_are_told_apart_by_qr(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which L of A_FᵀA_F, in whose pivots such a difference is squared, does not do for all."""
    qps = [twice(seed, near) for seed in range(4) for near in (1e-4, 1e-5)]
    for qp in qps:
        solution = make_solver("glambda", accuracy=1e-9 * force_scale(qp)).solve(qp)
        dense = make_solver("glambda", accuracy="default").solve(replace(qp, A=qp.dense_A))
        assert solution.found, solution.status_text
        error = np.linalg.norm(qp.A @ (solution.x - dense.x))
        assert error <= 1e-8 * force_scale(qp)  # both to 1e-9, and then some
    monkeypatch.setattr("solvers.active_set.method.BY_QR", 0)
    solver = make_solver("glambda", accuracy="default")
    assert not all(solver.solve(qp).found for qp in qps)


def banded(rng: np.random.Generator, m: int, k: int) -> Vector:
    """(m, k), each column of six entries below each other."""
    A = np.zeros((m, k))
    for j in range(k):
        first = rng.integers(0, m - 6)
        A[first : first + 6, j] = rng.standard_normal(6)
    return A


def test_an_answer_that_rounding_has_made_is_not_called_solved() -> None:
    """Half of the columns are there twice but for 1e-9 to 1e-7 of them, and little holds x: from
    where it has gone off to 1e5, A_Fᵀ r is as small as rounding leaves it and A x is not right."""
    found = 0
    for seed in (101, 102, 108, 113, 119):
        rng, k, half = np.random.default_rng(seed), 400, 200
        A = banded(rng, 600, k)
        near = 10.0 ** rng.uniform(-12.5, -6)
        A[:, half:] = A[:, :half] * (1 + near * rng.standard_normal((600, half)))
        lower = np.where(rng.random(k) < 0.5, 0.0, -np.inf)
        x = np.where(rng.random(k) < 0.6, rng.uniform(0.1, 0.4, k), lower)
        x[np.isinf(x)] = 0.1
        upper = np.full(k, np.inf)
        qp, expected = from_solution(A, x, lower, upper, rng, momentum=1.0, sparse=True)
        for method in SPARSE_METHODS:
            solution = make_solver(method).solve(qp)
            error = np.linalg.norm(qp.A @ solution.x - expected)
            assert not solution.found or error <= 1e-7 * np.linalg.norm(qp.d)
            found += solution.found
    assert found > 0


def test_a_slope_within_rounding_is_refined_where_its_error_is_not() -> None:
    """One column is there twice but for 1e-4 of it.  What rounding leaves of the gradient may be
    1e-12 in A x, and full steps by L lessen that; hundreds of conjugate gradients have ended in
    NaN."""
    m, k, found, n = 1200, 400, 0, 20
    free = np.full(k, -np.inf), np.full(k, np.inf)
    for seed in range(n):
        rng = np.random.default_rng(seed)
        A = banded(rng, m, k)
        A[:, -1] = A[:, 0] * (1 + 1e-4 * rng.standard_normal(m))
        d = rng.standard_normal(m)
        qp = ContactQP(sp.csc_array(A), d / np.linalg.norm(d), *free, eps0=3e-12)
        expected = A @ np.linalg.lstsq(A, -qp.d, rcond=None)[0]
        for method in SPARSE_METHODS:
            solution = make_solver(method).solve(qp)
            found += solution.found
            assert np.linalg.norm(A @ solution.x - expected) <= 1e-11
    assert found >= 0.9 * n * len(SPARSE_METHODS)  # 0.7 without; some are rounded badly
