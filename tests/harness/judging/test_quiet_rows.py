"""Rows at a bound whose gradients are of all sizes from rounding up: the bound is not their sum."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from harness.judging import error_bound as module
from harness.judging.error_bound import error_bound
from harness.judging.facts import facts_of
from problems import ContactQP
from problems.qp import Vector

CONTACTS = 400


def column(least: float, seed: int) -> tuple[ContactQP, Vector]:
    """Bodies on each other, a sixth of the contacts pressed, and x*, right to rounding.

    A third have Δ = 0 but for rounding, the others from `least` to 0.1, evenly by magnitude.
    """
    rng = np.random.default_rng(seed)
    here, there = rng.uniform(0.9, 1.1, (2, CONTACTS))
    shape = CONTACTS + 1, CONTACTS
    A = np.eye(*shape) * here - np.eye(*shape, -1) * there
    x, gradient = np.zeros(CONTACTS), np.zeros(CONTACTS)
    x[::6] = rng.uniform(0.5, 1.0, x[::6].size)
    pushed = rng.permutation(np.flatnonzero(x == 0))[: CONTACTS // 2]
    gradient[pushed] = np.logspace(np.log10(least), -1, pushed.size)
    Q, R = np.linalg.qr(A)
    r = Q @ np.linalg.solve(R.T, gradient)
    along = rng.standard_normal(shape[0])
    along -= Q @ (Q.T @ along)
    r += along / np.linalg.norm(along)
    unbounded = np.full(CONTACTS, np.inf)
    return ContactQP(sp.csc_array(A), r - A @ x, np.zeros(CONTACTS), unbounded), x


@pytest.mark.parametrize("least", [1e-15, 1e-14, 1e-12])
@pytest.mark.parametrize("seed", range(3))
def test_a_right_answer_is_proved(least: float, seed: int) -> None:
    qp, x = column(least, seed)
    facts = facts_of(qp)
    assert error_bound(qp, x, facts) <= 1e-12 * facts.scale
    off = x + 1e-6 * (x > 0)
    assert error_bound(qp, off, facts) >= np.linalg.norm(qp.A @ (off - x)) - 1e-12 * facts.scale


def test_without_quiet_rows_one_moves_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of some at least; so that the test above says something."""
    monkeypatch.setattr(module, "QUIET", ())
    bounds = []
    for seed in range(3):
        qp, x = column(1e-14, seed)
        facts = facts_of(qp)
        bounds.append(error_bound(qp, x, facts) / facts.scale)
    assert max(bounds) > 1e-3
