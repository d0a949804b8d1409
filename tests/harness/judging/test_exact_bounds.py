"""The error bound and the judge against exact truth, on QPs made to be awkward.

Data are small integers times powers of two, so that ties, dependent columns and degenerate
gradients are exact; A x* is known in rational arithmetic (`harness.judging.proof`, itself held to
an enumeration by `tests.harness.judging.test_proof`), and so is the error of any answer.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import harness.judging.oracle as oracle
from harness import judge
from harness.judging.error_bound import error_bound
from harness.judging.facts import Facts, facts_of
from harness.judging.oracle import reference
from harness.judging.proof import Proof, prove
from problems.qp import ContactQP, Vector

INF = np.inf
KINDS = ("plain", "deficient", "parallel", "scaled", "zeros", "degenerate", "tiny")


def bounds(rng: np.random.Generator, k: int) -> tuple[Vector, Vector]:
    """One-sided either way, two-sided, fixed and free."""
    lower, upper = np.zeros(k), np.full(k, INF)
    sort = rng.integers(0, 8, k)
    lower[sort == 1], upper[sort == 1] = -INF, 1.0
    lower[sort == 2], upper[sort == 2] = -1.0, 2.0
    lower[sort == 3] = upper[sort == 3] = 1.0
    lower[sort == 4] = -INF
    return lower, upper


def awkward_qp(rng: np.random.Generator, kind: str, k: int, m: int) -> ContactQP:
    """Of small integers; `kind` says what is wrong with it."""
    A = rng.integers(-3, 4, (m, k)).astype(float)
    if k > 60:
        A *= rng.random((m, k)) < 6 / m
        A[np.arange(k) % m, np.arange(k)] += 4.0
    d = rng.integers(-9, 10, m).astype(float)
    lower, upper = bounds(rng, k)
    some = rng.integers(0, k, (3, 2))
    if kind == "deficient":
        for i, j in some:
            A[:, i] = 0.5 * (A[:, j] + A[:, j - 1])
    elif kind == "parallel":
        for i, j in some:
            A[:, i] = A[:, j] * rng.choice([-1.0, 1.0])
            A[rng.integers(m), i] += 2.0 ** -rng.integers(10, 50)
    elif kind == "scaled":
        A *= 2.0 ** rng.integers(-40, 40, k)
        d *= 2.0 ** rng.integers(-20, 20)
    elif kind == "zeros":
        A[:, some.ravel()] = 0.0
    elif kind == "degenerate":
        d = -A @ np.clip(rng.integers(-1, 3, k), lower, upper)
    elif kind == "tiny":
        A[:, some.ravel()] *= 2.0 ** -rng.integers(500, 560)
    return ContactQP(sp.csc_array(A) if k > 60 else A, d, lower, upper, eps0=1e-6)


def answers(facts: Facts, best: Proof, rng: np.random.Generator) -> list[Vector]:
    """Right, off by every size, at corners, and of huge forces along dependent columns."""
    qp, x = facts.qp, best.x
    off = 10.0 ** rng.uniform(-16, 1) * np.maximum(np.abs(x), 1e-3) * rng.standard_normal(qp.k)
    null = np.zeros(qp.k)
    null[: min(qp.k, 60)] = np.linalg.svd(qp.dense_A[:, :60], full_matrices=True)[2][-1]
    rounded = np.where(np.isfinite(x), np.round(x, 3), 0.0)
    made = [x, x + off, rounded, x + 10.0 ** rng.uniform(-3, 12) * null, np.zeros(qp.k)]
    return [*made, *(np.clip(each, qp.lower, qp.upper) for each in made[1:])]


def exactly(values: object) -> list[Fraction]:
    return [Fraction(float(v)) for v in np.ravel(values)]


def squared_error(qp: ContactQP, x: Vector, Ax: Vector) -> Fraction:
    """‖A x − Ax‖² in fractions."""
    columns = sp.csc_array(qp.A)
    off = [-value for value in exactly(Ax)]
    for j, value in enumerate(exactly(x)):
        for place in range(columns.indptr[j], columns.indptr[j + 1]):
            off[columns.indices[place]] += Fraction(float(columns.data[place])) * value
    return sum((value * value for value in off), Fraction(0))


def root(square: Fraction) -> float:
    """Its square root to 1e-15, of whatever size."""
    if square == 0:
        return 0.0
    shift = (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    scaled = square / Fraction(4) ** shift
    return float(np.ldexp(np.sqrt(float(scaled)), shift))


def assert_never_below(qp: ContactQP, rng: np.random.Generator) -> int:
    """No bound is below the error, no verdict is wrong; returns how many answers were judged."""
    facts = facts_of(qp)
    near = oracle._settle(facts, None) if facts.sparse else np.zeros(qp.k)
    best = prove(qp, near.astype(float), work=1e9, columns=500)
    if best is None:  # numbers beyond float64
        return 0
    known = reference(qp, facts, start=best.x)
    made = answers(facts, best, rng)
    for x in made:
        error = root(squared_error(qp, x, best.Ax)) * (1 - 1e-14) - best.error_bound
        assert error_bound(qp, x, facts) >= error
        given = known if rng.random() < 0.5 else None
        verdict = judge(qp, x, facts=facts, reference=given, seek_reference=False)
        assert verdict.error_bound >= error
        if verdict.verdict == "verified" and (given is None or given.proved):
            assert error <= 10.001 * qp.eps0
        if error <= qp.eps0 and ((qp.lower <= x) & (x <= qp.upper)).all():
            assert verdict.verdict not in ("claimed_wrong", "failed")
    return len(made)


@pytest.mark.parametrize("kind", KINDS)
def test_no_bound_is_below_the_exact_error(kind: str) -> None:
    rng, judged = np.random.default_rng([11, *kind.encode()]), 0
    for _ in range(25):
        k = int(rng.integers(1, 9))
        judged += assert_never_below(awkward_qp(rng, kind, k, int(rng.integers(1, 10))), rng)
    assert judged > 150


@pytest.mark.parametrize("kind", KINDS)
def test_no_bound_by_sparse_factors_is_below_the_exact_error(kind: str) -> None:
    rng = np.random.default_rng([12, *kind.encode()])
    assert assert_never_below(awkward_qp(rng, kind, 61, 65), rng) > 5
