"""Answers in exact arithmetic: the same as an enumeration of all active sets, also exact."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

import harness.judging.oracle as oracle
from harness.judging.error_bound import error_bound
from harness.judging.facts import facts_of
from harness.judging.oracle import reference
from harness.judging.proof import prove
from problems.qp import ContactQP
from tests.fakes.random_qps import KINDS, random_qp

INF = np.inf
Rows = list[list[Fraction]]


def exactly(values: object) -> list[Fraction]:
    return [Fraction(float(v)) for v in np.ravel(values)]


def solve(M: Rows, b: list[Fraction]) -> list[Fraction] | None:
    """By Gaussian elimination; None for a singular M."""
    n = len(b)
    M = [[*row, right] for row, right in zip(M, b, strict=True)]
    for i in range(n):
        pivot = next((j for j in range(i, n) if M[j][i] != 0), None)
        if pivot is None:
            return None
        M[i], M[pivot] = M[pivot], M[i]
        for j in range(n):
            if j != i and M[j][i] != 0:
                share = M[j][i] / M[i][i]
                M[j] = [u - share * v for u, v in zip(M[j], M[i], strict=True)]
    return [M[i][n] / M[i][i] for i in range(n)]


def enumerated(qp: ContactQP) -> list[Fraction]:
    """A x* from the first of all 3ᵏ working sets whose KKT conditions hold, in fractions.

    Some working set with independent free columns is optimal, whatever the rank of A.
    """
    A = [exactly(row) for row in qp.dense_A]
    d = exactly(qp.d)
    sides = []
    for lower, upper in zip(qp.lower, qp.upper, strict=True):
        ends = [Fraction(float(bound)) for bound in (lower, upper) if np.isfinite(bound)]
        sides.append([None, *ends] if lower < upper else ends[:1])
    for choice in itertools.product(*sides):
        free = [j for j, end in enumerate(choice) if end is None]
        rest = [
            di + sum(row[j] * end for j, end in enumerate(choice) if end is not None)
            for row, di in zip(A, d, strict=True)
        ]
        gram = [[sum(row[i] * row[j] for row in A) for j in free] for i in free]
        slope = [-sum(row[j] * v for row, v in zip(A, rest, strict=True)) for j in free]
        inner = solve(gram, slope)
        if inner is None:
            continue
        x = list(choice)
        for j, value in zip(free, inner, strict=True):
            x[j] = value
        if optimal(qp, A, d, x):
            return [sum(a * v for a, v in zip(row, x, strict=True)) for row in A]
    raise AssertionError("no working set is optimal")


def optimal(qp: ContactQP, A: Rows, d: list[Fraction], x: list[Fraction]) -> bool:
    r = [sum(a * v for a, v in zip(row, x, strict=True)) + di for row, di in zip(A, d, strict=True)]
    for j, value in enumerate(x):
        slope = sum(row[j] * ri for row, ri in zip(A, r, strict=True))
        if not qp.lower[j] <= value <= qp.upper[j]:
            return False
        if (slope > 0 and value != qp.lower[j]) or (slope < 0 and value != qp.upper[j]):
            return False
    return True


def assert_proved(qp: ContactQP, candidate: object) -> None:
    """The proof's A x is within its radius of the enumerated one, exactly."""
    proof, best = prove(qp, candidate), enumerated(qp)
    assert proof is not None
    gap = sum((a - b) ** 2 for a, b in zip(exactly(proof.Ax), best, strict=True))
    assert gap <= Fraction(proof.error_bound) ** 2
    assert proof.error_bound <= 1e-15 * float(np.linalg.norm(proof.Ax))
    assert ((qp.lower <= proof.x) & (proof.x <= qp.upper)).all()


def tiny_qp(rng: np.random.Generator, kind: str) -> ContactQP:
    """2 to 4 columns with small integers in them, so that all sorts of ties are frequent."""
    m, k = int(rng.integers(2, 5)), int(rng.integers(2, 5))
    A = rng.integers(-2, 3, (m, k)).astype(float)
    d = rng.integers(-3, 4, m).astype(float)
    lower, upper = np.zeros(k), np.full(k, INF)
    if kind == "rank deficient":
        A[:, -1] = A[:, 0] if rng.random() < 0.5 else 0.5 * (A[:, 0] + A[:, 1])
    elif kind == "nearly dependent":
        A[:, -1] = -A[:, 0] * (1 + 1e-16 * rng.integers(-4, 5))
        lower[-1], upper[-1] = -1.0, 2.0
    elif kind == "duplicates":
        A = np.repeat(A[:, : (k + 1) // 2], 2, axis=1)[:, :k]
    elif kind == "fixed":
        lower[0] = upper[0] = rng.integers(-1, 2)
    elif kind == "two-sided":
        lower, upper = -rng.integers(0, 3, k).astype(float), rng.integers(0, 3, k).astype(float)
    elif kind == "one-sided above":
        lower, upper = np.full(k, -INF), np.ones(k)
    elif kind == "bilateral":
        lower[::2] = -INF
    elif kind == "badly scaled":
        A = rng.standard_normal((m, k)) * 10.0 ** rng.uniform(-8, 8, k)
        d = rng.standard_normal(m) * 10.0 ** rng.uniform(-8, 8, m)
    elif kind == "dense":
        A, d = rng.standard_normal((m, k)), rng.standard_normal(m)
    elif kind == "degenerate":
        x = np.maximum(rng.integers(-1, 2, k), 0.0)
        d = -A @ x  # r = 0: every gradient is
    return ContactQP(A, d, lower, upper)


TINY = (
    *("rank deficient", "nearly dependent", "duplicates", "fixed", "two-sided"),
    *("one-sided above", "bilateral", "badly scaled", "dense", "degenerate"),
)


@pytest.mark.parametrize("kind", TINY)
def test_the_proof_agrees_with_exact_enumeration(kind: str) -> None:
    rng = np.random.default_rng([4, *kind.encode()])
    for _ in range(25):
        qp = tiny_qp(rng, kind)
        for candidate in (np.zeros(qp.k), rng.integers(-2, 3, qp.k), 1e9 * rng.random(qp.k)):
            assert_proved(qp, candidate)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_reference_is_a_proof(kind: str) -> None:
    """Small QPs are proved, and the proof is within the bound that trusts nobody."""
    for seed in range(6):
        qp, _ = random_qp(kind, seed)
        facts = facts_of(qp)
        found = reference(qp, facts)
        assert found is not None and found.proof == "exact"
        assert found.error_bound <= 1e-15 * np.linalg.norm(found.Ax)
        bound = error_bound(qp, found.x, facts)
        assert bound <= 1e-12 * facts.scale


def test_a_wrong_candidate_is_led_to_the_answer() -> None:
    rng = np.random.default_rng(2)
    for kind in ("two_sided", "rank_deficient", "degenerate", "badly_scaled"):
        qp, _ = random_qp(kind, 1)
        right = prove(qp, reference(qp).x)
        assert right.exchanges == 0
        wrong = prove(qp, 5 * rng.standard_normal(qp.k))
        assert wrong.exchanges > 0
        assert np.array_equal(wrong.Ax, right.Ax)  # the nearest float64 of the only A x*


def test_x_from_a_candidate_that_is_right_is_kept_where_it_is_not_unique() -> None:
    qp = ContactQP([[1.0, 1.0]], [-2.0], [0.0, 0.0], [INF, INF])
    assert prove(qp, [0.5, 1.5]).x.tolist() == [0.5, 1.5]


def test_what_takes_too_much_work_is_not_proved() -> None:
    qp, _ = random_qp("tower", 0)
    assert prove(qp, np.zeros(qp.k), work=100) is None
    assert prove(qp, np.zeros(qp.k)) is not None


def test_data_of_hundreds_of_decades_cost_more_work() -> None:
    rng = np.random.default_rng(0)
    A, d = rng.standard_normal((50, 40)), rng.standard_normal(50)
    lower, upper = np.full(40, -INF), np.full(40, INF)
    wide = A * 10.0 ** rng.uniform(-100, 100, A.shape)
    assert prove(ContactQP(A, d, lower, upper), np.zeros(40), work=40**3) is not None
    assert prove(ContactQP(wide, d, lower, upper), np.zeros(40), work=40**3) is None


def test_many_columns_go_by_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("harness.judging.proof.COLUMNS", 5)
    qp, Ax = random_qp("tower", 0)
    found = reference(qp)
    assert found.proof == "bound"
    assert np.linalg.norm(found.Ax - Ax) <= found.error_bound + 1e-14 * np.linalg.norm(qp.d)


def squeezed(gap: float) -> ContactQP:
    """A body between two walls that push against each other, opposite but for `gap`."""
    A = np.array([[1.0, -1.0], [gap, 0.0]])
    return ContactQP(A, [-1.0, -1.0], [0.0, 0.0], [INF, INF])


def test_columns_that_are_opposite_but_for_rounding_are_ill_posed() -> None:
    """x* is 1/gap, and A x* = (1, 1) jumps to (1, 0) when the last bit of A goes."""
    qp = squeezed(2.0**-53)
    proof = prove(qp, [1.0, 0.0])
    assert proof.Ax.tolist() == [1.0, 1.0]
    assert proof.x.max() > 1e15
    found = reference(qp)
    assert found.proof == "ill-posed"
    assert found.Ax.tolist() == [1.0, pytest.approx(0.0, abs=1e-15)]
    assert reference(squeezed(2.0**-10)).proof == "exact"
    assert reference(squeezed(0.0)).proof == "exact"


def test_the_oracle_drops_a_row_that_blocks_at_less_than_float64_can_hold() -> None:
    """Its step was rounded to 0 and the row stayed free, for ever."""
    facts = facts_of(ContactQP([[1.0]], [1.0], [0.0], [INF]))
    x, free = np.array([np.longdouble("1e-4000")]), np.array([True])
    oracle._descend(facts, x, free)
    assert x == 0.0 and not free.any()


def test_huge_numbers_are_declined_not_wrong() -> None:
    qp = ContactQP([[1e150]], [1e150], [-1e200], [-1e200])
    assert prove(qp, [-1e200]) is None
