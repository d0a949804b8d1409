"""Algorithm 2 and its variants on random QPs: it ends, it is right, and nothing else matters.

What must not matter: the method, the start, the order of rows and coordinates, how A is stored,
the units of x and of the force.  Tolerances are derived from the data, see `optimality`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.judging.oracle import reference
from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE, ContactQP, Solution, Status, Vector
from solvers import make_solver
from tests.fakes.assertions import force_scale
from tests.fakes.methods import METHODS
from tests.fakes.optimality import assert_same, assert_solved
from tests.fakes.qp_strategies import (
    Posed,
    columns_of,
    dense_qps,
    sparse_qps,
    yesterday,
)
from tests.fakes.random_qps import INF, from_solution

seeds = st.integers(0, 2**32 - 1)
RELATIVE = 1e-9
"""Accuracy asked, in units of ‖A A⁺ d‖; the setting `high` of a replay."""


def examples(number: int) -> settings:
    return settings(max_examples=number)


def accuracy(qp: ContactQP) -> float:
    return RELATIVE * force_scale(qp)


def run(qp: ContactQP, method: str, start: Solution | None = None) -> Solution:
    return make_solver(method, accuracy=accuracy(qp)).solve(qp, start)


def solved(
    qp: ContactQP, method: str, start: Solution | None = None, *, dependent: bool = False
) -> Vector:
    return assert_solved(qp, run(qp, method, start), accuracy(qp), dependent=dependent)


# It ends, and is right


@examples(150)
@given(dense_qps())
def test_dense(case: Posed) -> None:
    """Any rank, degenerate, every kind of bound, columns from 1e-8 to 1e8, k = 0 and m = 1, too."""
    qp, expected = case
    for method in METHODS:
        solution = run(qp, method)
        assert_same(qp, assert_solved(qp, solution, accuracy(qp)), expected, accuracy(qp))
        assert solution.iterations <= 4 * (qp.k + 1), "far more directions than rows"


@examples(150)
@given(dense_qps(scaled_rows=True))
def test_rows_of_any_size(case: Posed) -> None:
    """Rows from 1e-8 to 1e8 leave columns dependent to rounding: A x is lost, the signs are not."""
    for method in METHODS:
        solved(case[0], method, dependent=True)


extreme = st.sampled_from([0.0, 1.0, -1.0, 2.0, 1e-8, -1e-8, 1e8, -1e8, 0.3])
lows = st.sampled_from([-INF, -1e8, -1.0, -1e-8, 0.0])
highs = st.sampled_from([0.0, 1e-8, 1.0, 1e8, INF])


@examples(150)
@given(st.data(), st.integers(1, 3), st.integers(0, 2))
def test_tiny_with_extreme_numbers(data: st.DataObject, m: int, k: int) -> None:
    """k = 0, 1, 2 with every entry chosen, down to nothing at all; against the oracle."""
    entries = data.draw(st.lists(extreme, min_size=m * k, max_size=m * k))
    d = data.draw(st.lists(extreme, min_size=m, max_size=m))
    lower = np.array(data.draw(st.lists(lows, min_size=k, max_size=k)), float)
    upper = np.array(data.draw(st.lists(highs, min_size=k, max_size=k)), float)
    qp = ContactQP(np.array(entries, float).reshape(m, k), np.array(d), lower, upper)
    oracle = reference(qp)
    for method in METHODS:
        x = solved(qp, method)
        if oracle is not None:
            assert_same(qp, x, oracle.x, accuracy(qp))


@examples(40)
@given(sparse_qps())
def test_sparse(case: Posed) -> None:
    """Columns that touch two bodies, k up to 120, stored by columns and in full."""
    qp, expected = case
    for method in METHODS:
        assert_same(qp, solved(qp, method), expected, accuracy(qp))
    assert_same(qp, solved(replace(qp, A=qp.dense_A), "glambda"), expected, accuracy(qp))


@examples(100)
@given(dense_qps())
def test_the_oracle_agrees(case: Posed) -> None:
    """The oracle shares no code with the method, nor has it seen the answer chosen first."""
    qp, _ = case
    oracle = reference(qp)
    if oracle is not None:
        for method in METHODS:
            assert_same(qp, solved(qp, method), oracle.x, accuracy(qp))


def test_nearly_dependent_columns() -> None:
    """A_F with singular values of 1e-7: a small A_Fᵀ r does not make r small, nor other rows."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        A = np.outer(rng.standard_normal(5), rng.standard_normal(12))
        A *= 1 + 1e-6 * rng.standard_normal(A.shape)
        A[:, :2] = rng.standard_normal((5, 2))
        lower = np.where(rng.random(12) < 0.2, -INF, rng.uniform(-1.0, 1.0, 12))
        upper = np.where(rng.random(12) < 0.3, np.maximum(lower, -1.0) + 2.0, INF)
        qp = ContactQP(A, 300.0 * rng.standard_normal(5), lower, upper)
        for method in METHODS:
            solved(qp, method)


def test_an_answer_that_rounding_has_made_is_not_called_solved() -> None:
    """Half of the columns are there twice, but for 1e-11 of them, and nothing holds half of x: it
    becomes 1e10, and A x anything, while A_Fᵀ r is as small as rounding leaves it."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        m, k, half = 60, 40, 20
        A = rng.standard_normal((m, k))
        A[:, half:] = A[:, :half] + 1e-11 * rng.standard_normal((m, half))
        lower = np.where(rng.random(k) < 0.5, 0.0, -INF)
        held = (rng.random(k) < 0.4) & (lower == 0.0)
        x = np.where(held, 0.0, rng.uniform(0.1, 0.4, k))
        qp, expected = from_solution(A, x, lower, np.full(k, INF), rng, momentum=1.0)
        for method in METHODS:
            solution = None
            for _ in range(2):  # cold, and from what there was
                solution = run(qp, method, solution)
                error = np.linalg.norm(qp.A @ solution.x - expected)
                assert solution.status is not Status.SOLVED or error <= 1e-6 * np.linalg.norm(qp.d)


# Where it starts does not matter


@examples(200)
@given(dense_qps(), seeds, st.sampled_from([0.0, 1e-6, 1e-2, 1.0]))
def test_warm_equals_cold(case: Posed, seed: int, change: float) -> None:
    """From a QP of yesterday, and of the day before, whose rows come and go."""
    qp, expected = case
    days = [yesterday(qp, seed, change), yesterday(qp, seed + 1, change)]
    for method in METHODS:
        last = None
        for day in days:
            last = run(day, method, last)
            assert_solved(day, last, accuracy(day), dependent=True)
        x = solved(qp, method, last, dependent=True)
        assert_same(qp, x, expected, accuracy(qp))


@examples(30)
@given(sparse_qps(), seeds, st.sampled_from([0.0, 1e-6, 1e-2]))
def test_warm_equals_cold_sparse(case: Posed, seed: int, change: float) -> None:
    qp, expected = case
    day = yesterday(qp, seed, change)
    for method in METHODS:
        last = run(day, method)
        assert_solved(day, last, accuracy(day))
        assert_same(qp, solved(qp, method, last), expected, accuracy(qp))


@examples(200)
@given(dense_qps(), st.data())
def test_any_start_will_do(case: Posed, data: st.DataObject) -> None:
    """x out of its bounds, by far; members of X where there is no bound; nothing but passive."""
    qp, expected = case
    numbers = st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e8, -1e8])
    x = data.draw(st.lists(numbers, min_size=qp.k, max_size=qp.k))
    sets = st.sampled_from([AT_LOWER, FREE, AT_UPPER, PASSIVE])
    members = data.draw(st.lists(sets, min_size=qp.k, max_size=qp.k))
    z = np.array(x, float) / np.maximum(np.linalg.norm(qp.dense_A, axis=0), 1e-8)
    start = Solution(z, qp.row_id, Status.SOLVED, np.array(members, np.int8))
    for method in METHODS:
        assert_same(qp, solved(qp, method, start), expected, 20 * accuracy(qp))


@examples(100)
@given(dense_qps(), seeds)
def test_the_same_again(case: Posed, seed: int) -> None:
    """x and work counts are functions of the QP and its start, to the last bit."""
    qp, _ = case
    for method in METHODS:
        first, second = (run(qp, method, run(yesterday(qp, seed, 1e-2), method)) for _ in "ab")
        assert first.x is not None and second.x is not None
        assert first.x.tobytes() == second.x.tobytes()
        assert first.work == second.work


# An updated factorization equals a fresh one


@examples(100)
@given(st.integers(8, 30), seeds)
def test_updated_equals_fresh(k: int, seed: int) -> None:
    """Rows come and go under an R that is never made anew, while the columns stay as they are.

    Each R is then of today's A_F, but for columns that were orthogonal to 0.1 and entered as they
    were.  So every iteration of conjugate gradients gains a digit, and from a d that is 1e-6 off
    three of them are enough; without R they take up to k.
    """
    rng = np.random.default_rng(seed)
    columns, loads = rng.standard_normal((k + 5, k)), rng.standard_normal((8, k + 5))
    solver = make_solver("lotstedt", interval=1000, accuracy=1e-9)
    last = None
    for day, d in enumerate(loads):
        rows = rng.permutation(k)[: rng.integers(k // 2, k + 1)]
        lower = np.where(rows % 2 == 0, -INF, 0.0)
        qp = ContactQP(columns[:, rows], d, lower, np.full(rows.size, INF), row_id=rows)
        last = solver.solve(qp, last)
        x = assert_solved(qp, last, 1e-9)
        assert_same(qp, x, solved(qp, "lotstedt[exact_qr]"), 1e-9)
        assert last.work is not None and last.work.qr_factorizations == (day == 0)
    again = replace(qp, d=qp.d * (1 + 1e-6 * rng.standard_normal(qp.m)))
    after = solver.solve(again, last)
    assert after.work is not None and after.work.qr_factorizations == 0
    assert after.work.cg_iterations <= 3 * after.work.descent_directions


# The order, the frame and the units do not matter


@examples(120)
@given(dense_qps(), seeds)
def test_order_of_rows_and_coordinates(case: Posed, seed: int) -> None:
    qp, expected = case
    rng = np.random.default_rng(seed)
    columns, coordinates = rng.permutation(qp.k), rng.permutation(qp.m)
    turned = columns_of(qp, columns)
    turned = replace(turned, A=turned.dense_A[coordinates], d=turned.d[coordinates])
    for method in METHODS:
        x = solved(turned, method)
        assert_same(turned, x, expected[columns], accuracy(qp))


@examples(40)
@given(sparse_qps(most_bodies=20), seeds)
def test_order_of_rows_and_coordinates_sparse(case: Posed, seed: int) -> None:
    qp, expected = case
    rng = np.random.default_rng(seed)
    columns, coordinates = rng.permutation(qp.k), rng.permutation(qp.m)
    turned = columns_of(qp, columns)
    A = sp.csr_array(turned.A)[coordinates]
    turned = replace(turned, A=sp.csc_array(A), d=turned.d[coordinates])
    for method in METHODS:
        x = solved(turned, method)
        assert_same(turned, x, expected[columns], accuracy(qp))


@examples(120)
@given(dense_qps(), seeds)
def test_signs_of_columns(case: Posed, seed: int) -> None:
    """a_j → −a_j with −u ≤ x ≤ −l: x → −x, so that upper bounds are lower ones."""
    qp, expected = case
    s = np.random.default_rng(seed).choice([-1.0, 1.0], qp.k)
    lower = np.where(s > 0, qp.lower, -qp.upper)
    upper = np.where(s > 0, qp.upper, -qp.lower)
    mirrored = replace(qp, A=qp.dense_A * s, lower=lower, upper=upper)
    for method in METHODS:
        assert_same(qp, s * solved(mirrored, method), expected, accuracy(qp))


def rescaled(qp: ContactQP, columns: Vector, force: float) -> ContactQP:
    """A with its columns and d with all forces in other units."""
    A = qp.A @ sp.diags_array(columns) if sp.issparse(qp.A) else qp.dense_A * columns
    lower, upper = force * qp.lower / columns, force * qp.upper / columns
    return replace(qp, A=A, d=force * qp.d, lower=lower, upper=upper)


@examples(120)
@given(st.one_of(dense_qps(), sparse_qps(most_bodies=8)), seeds, st.integers(-20, 20))
def test_powers_of_two_change_nothing(case: Posed, seed: int, power: int) -> None:
    """Units of x (each its own, 2⁻²⁷ … 2²⁷) and of force: the same bits, the same work, warm, too.

    Powers of two are exact in float64, and the method works in ‖a‖ x.
    """
    qp, _ = case
    columns = np.ldexp(1.0, np.random.default_rng(seed).integers(-27, 28, qp.k))
    force = 2.0**power
    other = rescaled(qp, columns, force)
    for method in METHODS:
        for kind in ("step", "impulse"):
            a, b = replace(qp, kind=kind), replace(other, kind=kind)
            solver = make_solver(method, accuracy=accuracy(qp))
            in_force = make_solver(method, accuracy=force * accuracy(qp))
            first, second = solver.solve(a), in_force.solve(b)
            for _ in "cold", "warm":
                assert first.x is not None and second.x is not None
                assert np.array_equal(force * first.x, columns * second.x)
                assert np.array_equal(first.working_set, second.working_set)
                assert first.work == second.work
                first, second = solver.solve(a, first), in_force.solve(b, second)
