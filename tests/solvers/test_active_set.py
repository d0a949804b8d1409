"""Algorithm 2: hand cases with exact counts, every kind of QP, warm starts along sequences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from problems.qp import (
    AT_LOWER,
    AT_UPPER,
    FREE,
    PASSIVE,
    ContactQP,
    Solution,
    Status,
    WorkCounts,
)
from solvers import make_solver
from solvers.active_set.glambda import Glambda
from solvers.active_set.lotstedt import Lotstedt
from solvers.active_set.workspace import AGE, COUNTS, N_FLOAT_ROWS, OLD_F, OLD_ORDER
from tests.fakes.assertions import assert_kkt, assert_same_force, force_scale
from tests.fakes.methods import METHODS
from tests.fakes.random_qps import (
    KINDS,
    contact_sequence,
    from_solution,
    random_qp,
    tower_columns,
)

INF = np.inf
WARM_METHODS = [name for name in METHODS if "no_working_set" not in name]


def work_of(solution: Solution) -> WorkCounts:
    assert solution.work is not None
    return solution.work


def qp_of(A: object, d: object, lower: object = None, upper: object = None, **rest) -> ContactQP:
    A = np.array(A, float)
    k = A.shape[1]
    lower = np.zeros(k) if lower is None else lower
    return ContactQP(A, d, lower, np.full(k, INF) if upper is None else upper, **rest)


# Hand cases


def test_one_contact_that_carries() -> None:
    """min ½‖(x − 2, 1)‖²: one factorization, one direction, one iteration with today's R."""
    solution = Lotstedt().solve(qp_of([[1.0], [0.0]], [-2.0, 1.0]))
    assert solution.x == pytest.approx([2.0], abs=1e-15)
    assert solution.working_set.tolist() == [FREE]
    work = work_of(solution)
    assert (work.descent_directions, work.working_set_changes) == (1, 0)
    assert (work.qr_factorizations, work.qr_updates, work.cg_iterations) == (1, 0, 1)
    assert solution.iterations == 1 and solution.found


def test_one_contact_that_separates() -> None:
    """Δ = 2 > 0: the direction points below 0 at once, a zero step moves the row to X."""
    solution = Lotstedt().solve(qp_of([[1.0], [0.0]], [2.0, 1.0]))
    assert solution.x is not None and solution.x.tolist() == [0.0]
    assert solution.working_set.tolist() == [AT_LOWER]
    work = work_of(solution)
    assert (work.descent_directions, work.working_set_changes, work.qr_updates) == (1, 1, 1)


def test_several_variables_reach_a_bound_at_once() -> None:
    qp = qp_of(np.eye(3), [-2.0, -2.0, -2.0], upper=np.ones(3))
    solution = Glambda().solve(qp)
    assert solution.x is not None and solution.x.tolist() == [1.0, 1.0, 1.0]
    assert solution.working_set.tolist() == [AT_UPPER] * 3
    work = work_of(solution)
    assert (work.descent_directions, work.working_set_changes) == (1, 3)


def test_a_step_that_underflows_still_blocks() -> None:
    """x a denormal above its bound: θ p underflows, and the row must reach it all the same."""
    qp = qp_of(np.eye(2), [5.0, -1.0])
    start = Solution(
        x=np.array([1e-323, 0.0]),
        row_id=np.arange(2),
        status=Status.SOLVED,
        working_set=np.array([FREE, FREE], np.int8),
    )
    solution = Glambda().solve(qp, start)
    assert solution.found and solution.x is not None and solution.x.tolist() == [0.0, 1.0]


def test_the_nearest_bound_blocks_first() -> None:
    """p = (2, 4): the second blocks at θ = ¼, the first goes on alone."""
    solution = Glambda().solve(qp_of(np.eye(2), [-2.0, -4.0], upper=[5.0, 1.0]))
    assert solution.x == pytest.approx([2.0, 1.0], abs=1e-15)
    assert solution.working_set.tolist() == [FREE, AT_UPPER]
    work = work_of(solution)
    assert (work.descent_directions, work.working_set_changes) == (2, 1)


def test_a_row_enters_from_its_bound() -> None:
    """The previous step had the row at 0; today Δ = −3 there: one entry, one direction."""
    solver = Lotstedt(variant="updated_qr")
    before = solver.solve(qp_of([[1.0], [0.0]], [2.0, 1.0]))
    after = solver.solve(qp_of([[1.0], [0.0]], [-3.0, 1.0]), before)
    assert after.x == pytest.approx([3.0], abs=1e-15)
    work = work_of(after)
    assert (work.descent_directions, work.working_set_changes, work.qr_updates) == (1, 1, 1)
    assert work.qr_factorizations == 0


def test_a_warm_start_at_the_solution_needs_no_direction() -> None:
    qp = qp_of([[1.0], [0.0]], [-2.0, 1.0])
    solver = Lotstedt()
    again = solver.solve(qp, solver.solve(qp))
    work = work_of(again)
    assert (work.descent_directions, work.cg_iterations, work.qr_factorizations) == (0, 0, 0)


def test_of_two_equal_columns_one_carries_and_one_waits_at_its_bound() -> None:
    qp = qp_of([[1.0, 1.0], [0.0, 0.0]], [-2.0, 1.0])
    solution = Glambda().solve(qp)
    assert sorted(solution.working_set.tolist()) == [AT_LOWER, FREE]
    assert solution.x is not None and solution.x.sum() == pytest.approx(2.0, abs=1e-15)
    assert work_of(solution).descent_directions == 1


def test_a_passive_row_takes_over_when_the_free_one_is_blocked() -> None:
    """Equal columns: F = {a}, P = {b} with x_b = 0 inside its bounds.  Then a is capped at 1.

    Zero step, a to X, b becomes independent and |Δ_b| = 1 brings it into F: x = (1, 1).
    """
    A, d, solver = [[1.0, 1.0], [0.0, 0.0]], [-2.0, 1.0], Lotstedt(variant="updated_qr")
    first = solver.solve(qp_of(A, d, lower=[-INF, -INF]))
    assert sorted(first.working_set.tolist()) == [FREE, PASSIVE]
    a = first.working_set.tolist().index(FREE)
    upper = np.full(2, INF)
    upper[a] = 1.0
    second = solver.solve(qp_of(A, d, lower=[-INF, -INF], upper=upper), first)
    assert second.x == pytest.approx([1.0, 1.0], abs=1e-15)
    assert second.working_set[a] == AT_UPPER and second.working_set[1 - a] == FREE
    work = work_of(second)
    assert (work.descent_directions, work.working_set_changes) == (2, 2)


def test_a_passive_row_keeps_its_nonzero_value() -> None:
    """x = (3, 4) shares a load of 7 between equal columns; of a load of 8 the free one takes 1."""
    A, d = [[1.0, 1.0], [0.0, 0.0]], np.array([-7.0, 1.0])
    start = Solution(
        x=np.array([3.0, 4.0]),
        row_id=np.arange(2),
        status=Status.SOLVED,
        working_set=np.array([FREE, PASSIVE], np.int8),
    )
    same = Glambda().solve(qp_of(A, d), start)
    assert same.x is not None and same.x.tolist() == [3.0, 4.0]
    more = Glambda().solve(qp_of(A, d - [1.0, 0.0]), start)
    assert more.x == pytest.approx([4.0, 4.0], abs=1e-14)
    assert more.working_set.tolist() == [FREE, PASSIVE]


def test_members_of_X_follow_a_bound_that_moves() -> None:
    """A slipping row at its friction bound 1 is at today's bound 1.5 without a direction."""
    solver = Glambda()
    qp = qp_of(np.eye(2)[:, :1], [-9.0, 0.0], lower=[-1.0], upper=[1.0])
    moved = replace(qp, lower=np.array([-1.5]), upper=np.array([1.5]))
    solution = solver.solve(moved, solver.solve(qp))
    assert solution.x is not None and solution.x.tolist() == [1.5]
    assert work_of(solution).descent_directions == 0


def test_nothing_to_solve() -> None:
    for solution in (
        Glambda().solve(random_qp("empty", 0)[0]),
        Glambda().solve(random_qp("all_fixed", 0)[0]),
    ):
        assert solution.found and work_of(solution).descent_directions == 0


def test_no_momentum_at_all() -> None:
    solution = Glambda().solve(qp_of(np.eye(3), np.zeros(3)))
    assert solution.found and solution.x is not None and not solution.x.any()


# Every kind of QP


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_solved_cold_and_warm(kind: str, method: str) -> None:
    """KKT to 1e-10 of the force and A x to 1e-9 where 1e-9 is asked."""
    for seed in range(8):
        qp, Ax = random_qp(kind, seed)
        solver = make_solver(method, accuracy=1e-9 * force_scale(qp))
        cold = solver.solve(qp)
        warm = solver.solve(qp, cold)
        for solution in (cold, warm):
            assert solution.status is Status.SOLVED
            assert_kkt(qp, solution.x, 1e-10)
            assert_same_force(qp, solution.x, Ax, 1e-9)
        if "no_working_set" not in method:
            assert work_of(warm).descent_directions <= 1
            assert work_of(warm).working_set_changes == 0


@pytest.mark.parametrize("kind", ["rank_deficient", "contact_redundant", "wide"])
def test_impulses_work_with_exact_q_and_r(kind: str) -> None:
    qp, Ax = random_qp(kind, 1)
    solution = Glambda(accuracy=1e-9 * force_scale(qp)).solve(replace(qp, kind="impulse"))
    assert work_of(solution).cg_iterations == 0
    assert_same_force(qp, solution.x, Ax, 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_order_of_rows_does_not_matter(kind: str) -> None:
    for seed in range(4):
        qp, Ax = random_qp(kind, seed)
        order = np.random.default_rng(seed).permutation(qp.k)
        shuffled = ContactQP(qp.dense_A[:, order], qp.d, qp.lower[order], qp.upper[order])
        solver = Glambda(accuracy=1e-9 * force_scale(qp))
        assert_same_force(shuffled, solver.solve(shuffled).x, Ax, 1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rank", [3, 6, 9])
def test_rank_deficient_joints_equal_the_svd(rank: int, method: str) -> None:
    """Rows without bounds: A x = −A A⁺ d, with d up to 10,000 times the force."""
    for seed in range(6):
        rng = np.random.default_rng([seed, rank])
        A = rng.standard_normal((15, rank)) @ rng.standard_normal((rank, 12))
        U = np.linalg.svd(A)[0][:, :rank]
        away = rng.standard_normal(15)
        away -= U @ (U.T @ away)
        d = U @ rng.standard_normal(rank) + 10.0 ** rng.uniform(0, 4) * away
        qp = qp_of(A, d, lower=np.full(12, -INF))
        solution = make_solver(method, accuracy=1e-12).solve(qp)
        assert np.linalg.norm(A @ solution.x + U @ (U.T @ d)) <= 1e-10 * force_scale(qp)
        assert np.count_nonzero(solution.working_set == FREE) == rank


@pytest.mark.parametrize("accuracy", [1e-1, 1e-2, 1e-4])
@pytest.mark.parametrize("method", METHODS)
def test_loose_accuracy_is_kept(method: str, accuracy: float) -> None:
    """(3.13): ‖A δx‖ ≤ ε₀ for what was asked, cold and from a neighbouring QP."""
    for kind in KINDS:
        for seed in range(4):
            qp, Ax = random_qp(kind, seed)
            rng = np.random.default_rng(seed)
            A = qp.dense_A * (1 + 0.01 * rng.standard_normal(qp.dense_A.shape))
            solver = make_solver(method, accuracy=accuracy * force_scale(qp))
            for start in (None, solver.solve(replace(qp, A=A))):
                assert_same_force(qp, solver.solve(qp, start).x, Ax, accuracy)


@pytest.mark.parametrize("method", METHODS)
def test_loose_accuracy_is_kept_by_nearly_dependent_columns(method: str) -> None:
    """Columns 1e-4 … 0.1 from the span of others: a small wrong Δ is a large error in A x.

    With ε₁ = ε₀/‖R⁻¹‖ alone, of the R that lacks them, the error is up to 5 ε₀ here.
    """
    for seed in range(40):
        rng = np.random.default_rng([seed, 110])
        A = rng.standard_normal((12, 8))
        for j in (5, 6, 7):
            off = 10.0 ** rng.uniform(-4, -1) * rng.standard_normal(12)
            A[:, j] = A[:, :3] @ rng.standard_normal(3) + off
        x = np.where(rng.random(8) < 0.6, rng.uniform(0.1, 2, 8), 0.0)
        qp, Ax = from_solution(A, x, np.zeros(8), np.full(8, INF), rng, degenerate=x == 0)
        near = replace(qp, d=qp.d + 0.003 * force_scale(qp) * rng.standard_normal(12))
        for accuracy in (1e-1, 1e-2, 1e-3):
            solver = make_solver(method, accuracy=accuracy * force_scale(qp))
            for start in (None, solver.solve(near)):
                assert_same_force(qp, solver.solve(qp, start).x, Ax, accuracy)


def test_less_accuracy_is_less_work() -> None:
    """(3.20) is used: the looser ε₀ the fewer conjugate gradient iterations."""
    counts = []
    for accuracy in (1e-1, 1e-4, 1e-10):
        total = 0
        for (first, _), (second, _) in pairwise(contact_sequence(3)):
            scale = force_scale(first)
            solver = Lotstedt(accuracy=accuracy * scale, cg_limit=50)
            total += work_of(solver.solve(second, solver.solve(first))).cg_iterations
        counts.append(total)
    assert counts[0] < counts[1] < counts[2]


def test_the_default_accuracy_is_fine() -> None:
    for kind in KINDS:
        qp, Ax = random_qp(kind, 2)
        assert_same_force(qp, Glambda(accuracy="default").solve(qp).x, Ax, 1e-8)


def nearly_dependent(rng: np.random.Generator, distance: float) -> ContactQP:
    """Four of ten columns at `distance` from sums of the others, every bound degenerate."""
    m, k = 14, 10
    A = rng.standard_normal((m, k))
    for j in range(6, k):
        A[:, j] = A[:, :6] @ rng.integers(-1, 2, 6) + distance * rng.standard_normal(m)
    lower = np.where(rng.random(k) < 0.8, 0.0, -1.0)
    upper = np.where(rng.random(k) < 0.5, INF, 1.0)
    held = np.where(rng.random(k) < 0.5, lower, np.minimum(upper, 0.0))
    x = np.clip(np.where(rng.random(k) < 0.6, rng.uniform(0.1, 0.9, k), held), lower, upper)
    edge, momentum = (x == lower) | (x == upper), 10.0 ** rng.uniform(0, 4)
    return from_solution(A, x, lower, upper, rng, degenerate=edge, momentum=momentum)[0]


@pytest.mark.parametrize("method", WARM_METHODS)
@pytest.mark.parametrize("distance", [1e-4, 1e-6, 1e-8, 1e-10, 1e-11, 1e-13, 3e-14, 1e-15])
def test_columns_on_the_verge_of_dependence(distance: float, method: str) -> None:
    """Where directions are half rounding: no cycling, no exception, and what is claimed is KKT.

    The seeds named are those on which the method cycles if a variable that was thrown back is not
    barred, claims too much if it is not given a second chance with exact Q and R, or meets columns
    that conjugate gradients cannot insert.  A x is not compared: it is known only to u ‖d‖ ‖R⁻¹‖.
    """
    named = (37, 66, 79, 100, 117, 141, 143, 151, 165, 193, 203, 242, 250, 262, 272, 280)
    for seed in (*range(10), *named):
        rng = np.random.default_rng([seed, int(-np.log10(distance))])
        qp = nearly_dependent(rng, distance)
        d = qp.d * (1 + 1e-3 * rng.standard_normal(qp.m))
        near = replace(qp, d=d, A=qp.dense_A * (1 + 1e-6 * rng.standard_normal(qp.dense_A.shape)))
        solver = make_solver(method, accuracy=1e-9 * force_scale(qp))
        for start in (None, solver.solve(near)):
            solution = solver.solve(qp, start)
            if solution.found:
                # signs are promised to ε₀/10 for columns of length 1
                assert_kkt(qp, solution.x, 1e-10 * np.linalg.norm(qp.dense_A, axis=0).max())
            elif solution.status is Status.ITERATION_LIMIT:
                assert distance <= 1e-11 and "plain_cg" in method
            else:
                # free columns that nearly cancel grow without bound
                assert solution.status is Status.INACCURATE
                assert distance <= 1e-11 and np.abs(solution.x).max() > 1e8


small = st.integers(-2, 2)


@settings(max_examples=150)
@given(data=st.data(), m=st.integers(1, 6), k=st.integers(1, 10))
def test_small_integers(data: st.DataObject, m: int, k: int) -> None:
    """Equal, opposite, zero and dependent columns, ties and degenerate vertices everywhere."""
    A = np.array(data.draw(st.lists(small, min_size=m * k, max_size=m * k)), float).reshape(m, k)
    d = np.array(data.draw(st.lists(small, min_size=m, max_size=m)), float)
    lower = np.array(
        data.draw(st.lists(st.sampled_from([-INF, -1.0, 0.0]), min_size=k, max_size=k))
    )
    upper = np.array(data.draw(st.lists(st.sampled_from([0.0, 1.0, INF]), min_size=k, max_size=k)))
    qp = ContactQP(A, d, lower, upper)
    for method in METHODS:
        solver = make_solver(method, accuracy=1e-10)
        solution = solver.solve(qp)
        assert solution.found
        assert_kkt(qp, solution.x, 1e-10)
        # from a start that has nothing to do with this QP but its rows
        other = solver.solve(replace(qp, A=-A[::-1].copy(), d=d[::-1].copy() + 1))
        warm = solver.solve(qp, other)
        assert warm.found
        assert_kkt(qp, warm.x, 1e-10)
        assert np.linalg.norm(qp.A @ (solution.x - warm.x)) <= 1e-9


# Sequences


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("accuracy", [1e-4, 1e-9])
def test_warm_equals_cold_along_a_sequence(method: str, accuracy: float) -> None:
    """Rows are lost, gained and reordered on the way; the start is mapped by row_id."""
    for seed in range(6):
        last = None
        for qp, Ax in contact_sequence(seed):
            solver = make_solver(method, accuracy=accuracy * force_scale(qp))
            last = solver.solve(qp, last)
            assert last.found
            assert_same_force(qp, last.x, Ax, accuracy)
            assert_same_force(qp, solver.solve(qp).x, Ax, accuracy)
            if accuracy <= 1e-9:
                assert_kkt(qp, last.x, 1e-10)


def smooth_sequence(boxes: int, redundant: bool, length: int = 25) -> list[ContactQP]:
    """A tower whose A, friction bounds and load change smoothly with time."""
    rng = np.random.default_rng([boxes, redundant])
    base = tower_columns(boxes, True, rng)
    turn = base * rng.standard_normal(base.shape)
    x = rng.uniform(50.0, 100.0, base.shape[1])
    tangent = (np.arange(base.shape[1]) % 3 == 1) & (np.arange(base.shape[1]) > 1)
    x[tangent] = rng.uniform(-40.0, 40.0, tangent.sum())
    fall = rng.standard_normal(base.shape[0])
    qps = []
    for step in range(length):
        t = 0.01 * step
        A = base + 0.01 * np.sin(t) * turn
        bound = np.where(tangent, 30.0 + 5.0 * t, INF)
        d = -A @ x * (1 + 0.1 * np.sin(3 * t)) + fall * (1 + t)
        lower = np.where(tangent, -bound, 0.0)
        if redundant:
            A = np.hstack([A, 0.5 * (A[:, [0]] + A[:, [1]]), A[:, [1]]])
            lower, bound = np.append(lower, [0.0, 0.0]), np.append(bound, [INF, INF])
        qps.append(ContactQP(A, d, lower, bound, t=t, eps0=1e-5))
    return qps


@pytest.mark.parametrize("redundant", [False, True])
@pytest.mark.parametrize("boxes", [1, 3, 10, 20])
def test_one_direction_does_when_A_varies_slowly(boxes: int, redundant: bool) -> None:
    """k from 2 to 61: nine steps of ten need one direction, and half of them no factorization.

    With few columns a factorization costs less than three iterations, and the rule asks for it.
    """
    solver, last, directions, factorizations = Lotstedt(), None, [], 0
    for qp in smooth_sequence(boxes, redundant):
        solution = solver.solve(qp, last)
        if last is not None:
            directions.append(work_of(solution).descent_directions)
            factorizations += work_of(solution).qr_factorizations
        assert solution.found
        exact = Lotstedt(accuracy=1e-12 * force_scale(qp), variant="exact_qr").solve(qp)
        assert np.linalg.norm(qp.A @ (solution.x - exact.x)) <= qp.eps0
        last = solution
    # which of redundant rows are passive is a matter of pivoting, and with it which reach a bound
    assert np.mean(np.array(directions) <= 1) >= (0.85 if redundant else 0.9)
    assert boxes <= 3 or factorizations <= 0.5 * len(directions)


def test_hundreds_of_columns() -> None:
    """k = 269: a cold solve and a warm one, which keeps the old R."""
    first, second = smooth_sequence(90, False, length=2)
    solver = Glambda(accuracy=1e-9 * force_scale(first))
    cold = solver.solve(first)
    warm = solver.solve(second, cold)
    assert_kkt(first, cold.x, 1e-10)
    assert_kkt(second, warm.x, 1e-10)
    assert work_of(warm).qr_factorizations == 0
    assert work_of(warm).flops < 0.1 * work_of(cold).flops


def test_rows_that_are_gone_leave_R_and_new_ones_enter_it() -> None:
    """One row lost and one gained: two updates of the old R and no factorization."""
    qp = smooth_sequence(3, False)[0]
    solver = Lotstedt(cg_limit=50)
    first = solver.solve(qp)
    free = np.flatnonzero(first.working_set == FREE)
    keep = np.delete(np.arange(qp.k), free[0])
    A = np.column_stack([qp.dense_A[:, keep], np.eye(qp.m)[:, 1] - np.eye(qp.m)[:, 3]])
    row_id = np.append(qp.row_id[keep], 99)
    smaller = ContactQP(
        A, qp.d, np.append(qp.lower[keep], -INF), np.append(qp.upper[keep], INF), row_id=row_id
    )
    second = solver.solve(smaller, first)
    work = work_of(second)
    assert work.qr_factorizations == 0
    assert work.qr_updates == 2 + work.working_set_changes
    assert second.memory.I[COUNTS, AGE] == 1
    assert second.working_set[-1] == FREE
    assert_same_force(smaller, second.x, smaller.A @ solver.solve(smaller).x, 1e-8)


def test_the_memory_is_R_of_the_free_columns() -> None:
    qp = random_qp("full_rank", 3)[0]
    solution = Lotstedt().solve(qp)
    S, I, n = solution.memory.S, solution.memory.I, solution.memory.n
    f = I[COUNTS, OLD_ORDER]
    columns = I[OLD_F, :f]
    assert sorted(columns.tolist()) == np.flatnonzero(solution.working_set == FREE).tolist()
    R = np.triu(S[N_FLOAT_ROWS + 2 * n : N_FLOAT_ROWS + 2 * n + f, :f].T)
    A_F = (qp.dense_A / np.linalg.norm(qp.dense_A, axis=0))[:, columns]
    np.testing.assert_allclose(R.T @ R, A_F.T @ A_F, atol=1e-13)


def test_an_interval_factorizes_on_schedule() -> None:
    solver, last, made = Lotstedt(interval=3), None, []
    for qp in smooth_sequence(3, False, length=10):
        last = solver.solve(qp, last)
        made.append(work_of(last).qr_factorizations)
    assert made == [1, 0, 0, 1, 0, 0, 1, 0, 0, 1]


def iterations_and_factorizations(solver: Lotstedt) -> list[tuple[int, int]]:
    """Of each QP of a smooth sequence of one direction per QP."""
    last, made = None, []
    for qp in smooth_sequence(10, False, length=12):
        last = solver.solve(qp, last)
        work = work_of(last)
        made.append((work.cg_iterations, work.qr_factorizations))
    return made[1:]


@pytest.mark.parametrize("limit", [2.09, 2.0])
def test_the_third_iteration_exceeds_a_limit_of_two_and_a_bit(limit: float) -> None:
    """Printed: "when the number of iterations … exceeds": 3 does, 2 does not, whatever is between.

    At once, no direction has a third iteration on an old R; deferred, it has, and then the next QP
    factorizes.
    """
    at_once = iterations_and_factorizations(Lotstedt(cg_limit=limit))
    assert any(made for _, made in at_once)
    assert all(iterations <= 2 for iterations, made in at_once if not made)
    deferred = iterations_and_factorizations(Lotstedt(variant="deferred", cg_limit=limit))
    assert any(iterations > 2 for iterations, _ in deferred)
    for (iterations, _), (_, made) in pairwise(deferred):
        assert made == (iterations > 2)


def test_a_limit_below_one_factorizes_whenever_a_direction_is_needed() -> None:
    """After 0.79, fig3's, the first iteration exceeds; rounded up the rule would never fire."""
    for variant in ("", "deferred"):
        made = iterations_and_factorizations(Lotstedt(variant=variant, cg_limit=0.79))
        assert all(factorized == 1 for _, factorized in made)


def test_a_limit_of_no_iterations_factorizes_whenever_a_direction_is_needed() -> None:
    last = None
    for qp in smooth_sequence(3, False, length=5):
        last = Lotstedt(cg_limit=0).solve(qp, last)
        assert work_of(last).descent_directions == (1 if qp.t > 0 else last.iterations)
        assert work_of(last).qr_factorizations == 1


def test_the_preconditioner_pays() -> None:
    """Iterations of the old R against none, on QPs 2 to 25 of a sequence with k = 29."""
    totals = {}
    for variant in ("", "plain_cg"):
        solver, last, totals[variant] = Lotstedt(variant=variant, cg_limit=50), None, 0
        for qp in smooth_sequence(10, False):
            last, first = solver.solve(qp, last), last is None
            totals[variant] += 0 if first else work_of(last).cg_iterations
    assert totals[""] < 0.3 * totals["plain_cg"]


@pytest.mark.parametrize("method", WARM_METHODS)
def test_the_previous_working_set_pays(method: str) -> None:
    def directions(name: str) -> int:
        solver, last, total = make_solver(name), None, 0
        for qp in smooth_sequence(10, True):
            last = solver.solve(qp, last)
            total += last.iterations
        return total

    assert directions(method) < directions("lotstedt[no_working_set]")


# Contract


@pytest.mark.parametrize("method", METHODS)
def test_nothing_given_is_modified(method: str) -> None:
    cases = contact_sequence(1)
    solver = make_solver(method)
    start = solver.solve(cases[3][0])
    qp = cases[4][0]
    arrays = [qp.A, qp.d, qp.lower, qp.upper, qp.row_id, start.x, start.working_set]
    before = [np.array(a, copy=True) for a in arrays]
    solver.solve(qp, start)
    for a, b in zip(arrays, before, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("method", METHODS)
def test_the_same_sequence_gives_the_same_bits(method: str) -> None:
    """Work counts and x are exact functions of the sequence, whatever a new workspace held."""
    runs = []
    for _ in range(2):
        solver, last, answers = make_solver(method), None, []
        for qp, _ in contact_sequence(1)[:20]:
            last = solver.solve(qp, last)
            answers.append((last.x.tobytes(), last.working_set.tobytes(), last.work))
        runs.append(answers)
    assert runs[0] == runs[1]


def test_a_solution_of_another_solver_can_be_the_start() -> None:
    qp = smooth_sequence(3, False)[0]
    theirs = make_solver("scipy_bvls").solve(qp)
    ours = Glambda(accuracy=1e-9 * force_scale(qp)).solve(qp, theirs)
    assert ours.found and work_of(ours).descent_directions <= 1
    assert_same_force(qp, ours.x, qp.A @ theirs.x, 1e-8)


@pytest.mark.parametrize("limit", [0, 1, 2])
def test_the_iteration_cap_is_reported(limit: int) -> None:
    """An x within its bounds and a status that says what to do."""
    qp = random_qp("two_sided", 1)[0]
    assert Glambda(iteration_limit=100).solve(qp).iterations > 2
    solution = Glambda(iteration_limit=limit).solve(qp)
    assert solution.status is Status.ITERATION_LIMIT
    assert solution.x is not None
    assert ((qp.lower <= solution.x) & (solution.x <= qp.upper)).all()


def test_a_foreign_memory_is_passed_over() -> None:
    qp, Ax = random_qp("contact_small", 0)
    solver = Glambda(accuracy=1e-9 * force_scale(qp))
    foreign = replace(solver.solve(qp), memory={"from": "another solver"})
    assert_same_force(qp, solver.solve(qp, foreign).x, Ax, 1e-9)


def test_the_registry_makes_the_variants() -> None:
    assert make_solver("glambda") == Glambda()
    assert make_solver("lotstedt[exact_qr]", accuracy=1e-9) == Lotstedt(1e-9, variant="exact_qr")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"variant": "fast"}, "no variant 'fast'"),
        ({"interval": -1}, "interval = -1"),
        ({"cg_limit": -0.5}, "cg_limit = -0.5"),
        ({"iteration_limit": -3}, "iteration_limit = -3"),
        ({"accuracy": 0.0}, "accuracy"),
    ],
)
def test_wrong_options_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Lotstedt(**options)
