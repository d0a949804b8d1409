"""Examples on which pivoting methods go round for ever, or nearly so, posed as contact QPs.

A vertex of bounds alone is never degenerate, so that no example of the literature is a contact QP
as it stands.  Linear programs come in by their dual side, where their degenerate vertices are rows
with Δ = 0 and dependent columns:

1. the optimality conditions of the program as one least-squares problem with residual 0;
2. the steepest feasible descent from the vertex where the simplex method cycles, a QP with free,
   one-sided and fixed rows;
3. the constraints as heavy rows beside an objective that asks too much.

Each is started at every basis of the cycle.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import isotonic_regression, linprog

from harness.judging.oracle import reference
from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE, ContactQP, Solution, Status, Vector
from solvers import make_solver
from tests.fakes.assertions import force_scale
from tests.fakes.cycling_programs import PROGRAMS, cycle
from tests.fakes.methods import METHODS
from tests.fakes.optimality import assert_same, assert_solved

INF = np.inf


def optimality_conditions(name: str) -> ContactQP:
    """min ‖E x − b‖² + ‖Eᵀy + s − c‖² + (cᵀx − bᵀy)² with x, s ≥ 0; columns x, y, s."""
    E, b, c, _ = PROGRAMS[name]
    m, n = E.shape
    A = np.block(
        [
            [E, np.zeros((m, m)), np.zeros((m, n))],
            [np.zeros((n, n)), E.T, np.eye(n)],
            [c, -b, np.zeros(n)],
        ]
    )
    lower = np.concatenate([np.zeros(n), np.full(m, -INF), np.zeros(n)])
    return ContactQP(A, -np.concatenate([b, c, [0.0]]), lower, np.full(2 * n + m, INF))


def steepest_descent(name: str) -> ContactQP:
    """min ½‖p + c‖² with E p = 0 and p_j ≥ 0 where x_j = 0, as its dual: p = Eᵀy + s − c.

    Columns y, free, and s ≥ 0; s_j is fixed at 0 where x_j > 0 at the vertex.
    """
    E, b, c, basis = PROGRAMS[name]
    m, n = E.shape
    x = np.zeros(n)
    x[list(basis)] = np.linalg.solve(E[:, basis], b)
    lower = np.concatenate([np.full(m, -INF), np.zeros(n)])
    upper = np.concatenate([np.full(m, INF), np.where(x > 1e-9, 0.0, INF)])
    return ContactQP(np.hstack([E.T, np.eye(n)]), -c, lower, upper)


def goal(name: str, weight: float) -> ContactQP:
    """min ½ weight² ‖E x − b‖² + ½(cᵀx − target)², x ≥ 0, with a target below the optimum."""
    E, b, c, _ = PROGRAMS[name]
    target = linprog(c, A_eq=E, b_eq=b).fun - 1.0
    A, d = np.vstack([weight * E, c]), -np.append(weight * b, target)
    return ContactQP(A, d, np.zeros(E.shape[1]), np.full(E.shape[1], INF))


def from_basis(qp: ContactQP, free: list[int], x: Vector) -> Solution:
    """A start in which the columns `free` are in F and all others in X."""
    members = np.full(qp.k, AT_LOWER, np.int8)
    members[free] = FREE
    return Solution(x=x, row_id=qp.row_id, status=Status.SOLVED, working_set=members)


def starts(name: str, qp: ContactQP, form: str) -> list[Solution | None]:
    """Cold, and every basis of the cycle with its x and its multipliers y."""
    E, b, c, _ = PROGRAMS[name]
    m, n = E.shape
    out: list[Solution | None] = [None]
    for basis in cycle(name):
        columns, rest = list(basis), [j for j in range(n) if j not in basis]
        x = np.zeros(n)
        x[columns] = np.linalg.solve(E[:, columns], b)
        y = np.linalg.solve(E[:, columns].T, c[columns])
        s = np.maximum(c - E.T @ y, 0.0)
        ys = [*range(m)]
        if form == "goal":
            out.append(from_basis(qp, columns, x))
        elif form == "descent":
            out.append(from_basis(qp, ys + [m + j for j in rest], np.concatenate([y, s])))
        else:
            free = columns + [n + i for i in ys] + [n + m + j for j in rest]
            out.append(from_basis(qp, free, np.concatenate([x, y, s])))
    return out


def accuracy(qp: ContactQP) -> float:
    return 1e-9 * force_scale(qp)


def run(qp: ContactQP, method: str, start: Solution | None) -> Solution:
    return make_solver(method, accuracy=accuracy(qp)).solve(qp, start)


def solved(qp: ContactQP, method: str, start: Solution | None) -> Vector:
    return assert_solved(qp, run(qp, method, start), accuracy(qp))


@pytest.mark.parametrize("name", PROGRAMS)
def test_the_programs_do_have_a_cycle(name: str) -> None:
    """The simplex method may go round for ever, at a vertex that is not the optimum."""
    E, b, c, basis = PROGRAMS[name]
    assert len(cycle(name)) == (10 if name == "Hoffman 1953" else 6)
    value = c[list(basis)] @ np.linalg.solve(E[:, basis], b)
    for other in cycle(name):
        assert c[list(other)] @ np.linalg.solve(E[:, other], b) == pytest.approx(value, abs=1e-9)
    optimum = linprog(c, A_eq=E, b_eq=b).fun
    assert optimum <= value and (optimum < value or name in ("Hoffman 1953", "Solow 1984"))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_optimality_conditions_are_met_from_every_basis_of_the_cycle(
    name: str, method: str
) -> None:
    """By duality the residual is 0; many x and s do it."""
    qp = optimality_conditions(name)
    for start in starts(name, qp, "conditions"):
        x = solved(qp, method, start)
        assert np.linalg.norm(qp.residual(x)) <= 1e-8 * np.linalg.norm(qp.d)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_steepest_descent_from_the_vertex_of_the_cycle(name: str, method: str) -> None:
    """p = r is feasible, and downhill unless the vertex is the optimum."""
    E, _, c, _ = PROGRAMS[name]
    qp = steepest_descent(name)
    oracle = reference(qp)
    assert oracle is not None
    for start in starts(name, qp, "descent"):
        x = solved(qp, method, start)
        assert_same(qp, x, oracle.x, accuracy(qp))
        p = qp.residual(x)
        assert c @ p == pytest.approx(-(p @ p), abs=1e-7)
        assert np.linalg.norm(E @ p) <= 1e-7 * np.linalg.norm(E)


@pytest.mark.parametrize("weight", [1.0, 1e3])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_goal_out_of_reach(name: str, method: str, weight: float) -> None:
    qp = goal(name, weight)
    oracle = reference(qp)
    assert oracle is not None
    for start in starts(name, qp, "goal"):
        x = solved(qp, method, start)
        assert_same(qp, x, oracle.x, accuracy(qp))


# Least-squares examples


def exchange_all(qp: ContactQP) -> bool:
    """Whether the method that exchanges every row of the wrong sign at once meets a set twice."""
    A, free, seen = qp.dense_A, np.zeros(qp.k, bool), set()
    while free.tobytes() not in seen:
        seen.add(free.tobytes())
        x = np.zeros(qp.k)
        x[free] = np.linalg.lstsq(A[:, free], -qp.d, rcond=None)[0] if free.any() else 0.0
        wrong = np.where(free, x < -1e-9, qp.gradient(x) < -1e-9)
        if not wrong.any():
            return False
        free ^= wrong
    return True


BLOCK_PIVOTING = {
    3: ([[1, 2, -2], [1, 1, 1], [-1, -2, 1]], [1, -2, -2]),
    4: ([[0, 1, -2, -2], [2, -2, -1, -2], [1, -1, -2, -2], [1, -1, 0, -1]], [-2, -2, -1, -2]),
    5: (
        [[1, 0, 2, 1, 2], [-1, -2, 0, 1, 1], [-2, -2, 2, -1, -1], [-2, -1, 1, 1, 0],
         [0, -2, -1, 0, 1]],
        [-1, 1, 1, 1, 2],
    ),
}  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("k", BLOCK_PIVOTING)
def test_where_block_pivoting_cycles(k: int, method: str) -> None:
    """Portugal, Júdice and Vicente 1994, Mathematics of Computation 63: exchanging all wrong rows
    of a non-negative least-squares problem at once may cycle, for independent columns, too."""
    A, d = BLOCK_PIVOTING[k]
    qp = ContactQP(np.array(A, float), np.array(d, float), np.zeros(k), np.full(k, INF))
    assert exchange_all(qp)
    oracle = reference(qp)
    assert oracle is not None
    for members in product([AT_LOWER, FREE], repeat=k):
        free = [j for j in range(k) if members[j] == FREE]
        x = solved(qp, method, from_basis(qp, free, np.zeros(k)))
        assert_same(qp, x, oracle.x, accuracy(qp))


def least_index_pivots(qp: ContactQP) -> int:
    """Pivots of Murty's method: the first row of the wrong sign changes sides, one at a time."""
    A, free, pivots = qp.dense_A, np.zeros(qp.k, bool), 0
    while True:
        x = np.zeros(qp.k)
        x[free] = np.linalg.lstsq(A[:, free], -qp.d, rcond=None)[0] if free.any() else 0.0
        wrong = np.flatnonzero(np.where(free, x < -1e-9, qp.gradient(x) < -1e-9))
        if wrong.size == 0:
            return pivots
        free[wrong[0]] ^= True
        pivots += 1


def fathi(k: int) -> ContactQP:
    """Fathi 1979, Mathematical Programming 17: A = L with ones on and twos below the diagonal.

    Aᵀd = −1, so that Aᵀ(A x + d) is the linear complementarity problem (LᵀL, −1).
    """
    A = np.eye(k) + 2.0 * np.tri(k, k, -1)
    d = np.array(np.linalg.solve(A.T, -np.ones(k)), float)
    return ContactQP(A, d, np.zeros(k), np.full(k, INF))


@pytest.mark.parametrize("k", [3, 5, 8])
def test_least_index_pivoting_visits_every_set(k: int) -> None:
    assert least_index_pivots(fathi(k)) == 2**k - 1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("k", [5, 12, 40])
def test_where_least_index_pivoting_is_exponential(k: int, method: str) -> None:
    """x = (0, …, 0, 1), in no more directions than two per row, whatever set is the start."""
    qp, expected = fathi(k), np.eye(k)[-1]
    for free in ([], [*range(k)], [*range(0, k, 2)], [*range(k - 1)]):
        solution = run(qp, method, from_basis(qp, free, np.zeros(k)))
        assert_same(qp, assert_solved(qp, solution, accuracy(qp)), expected, accuracy(qp))
        assert solution.work is not None and solution.work.descent_directions <= 2 * k


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(4))
def test_monotone_regression_of_counts(seed: int, method: str) -> None:
    """The kind of problem on which SciPy's `nnls` went round for ever (scipy pull request 20168).

    x are the increments of a rate that never falls, fitted to small counts out of n trials: many
    equal and empty counts, and k = 60 columns of which neighbours differ in one entry.  The
    oracle pools adjacent violators, which needs no linear algebra.
    """
    rng = np.random.default_rng([seed, 20168])
    k = 60
    trials = np.maximum(1.0, np.round(200 * np.exp(-(((np.arange(k) - 35) / 14) ** 2))))
    rate = (
        np.round(rng.binomial(trials.astype(int), 0.5 * np.linspace(0.0, 1.5, k) ** 2 / 2.25))
        / trials
    )
    rate[: k // 4] = 0.0
    root = np.sqrt(trials)
    A = root[:, None] * np.tri(k)
    lower = np.where(np.arange(k) == 0, -INF, 0.0)
    qp = ContactQP(A, -root * rate, lower, np.full(k, INF))
    expected = np.diff(isotonic_regression(rate, weights=trials).x, prepend=0.0)
    for start in (None, from_basis(qp, [0], np.zeros(k)), from_basis(qp, [*range(k)], np.zeros(k))):
        assert_same(qp, solved(qp, method, start), expected, accuracy(qp))


VERTICES = {
    "equal columns": [[1.0, 1.0, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0]],
    "opposite columns": [[1.0, -1.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0]],
    "a rectangle of contacts": [
        [1.0, 1.0, 1.0, 1.0],
        [1.0, -1.0, 1.0, -1.0],
        [1.0, 1.0, -1.0, -1.0],
    ],
    "columns in a plane": [[1.0, 0.0, 1.0, 2.0], [0.0, 1.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0]],
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", VERTICES)
def test_every_working_set_of_a_degenerate_vertex(name: str, method: str) -> None:
    """x on a corner of the box 0 ≤ x ≤ 1 with Δ = 0 there: each of the 4⁴ working sets is a start.

    Wherever it starts, the method ends, and where the corner itself is the start it stays.
    """
    A = np.array(VERTICES[name])
    for corner in ((0, 0, 0, 0), (1, 0, 0, 1), (1, 1, 1, 1)):
        vertex = np.array(corner, float)
        qp = ContactQP(A, -A @ vertex, np.zeros(4), np.ones(4))
        for members in product([AT_LOWER, FREE, AT_UPPER, PASSIVE], repeat=4):
            start = Solution(vertex, qp.row_id, Status.SOLVED, np.array(members, np.int8))
            x = solved(qp, method, start)
            assert np.linalg.norm(A @ (x - vertex)) <= 1e-14 * np.linalg.norm(A)
