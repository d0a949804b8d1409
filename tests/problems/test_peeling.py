"""A contact graph that comes apart body by body has independent columns."""

from __future__ import annotations

import numpy as np
import pytest

from problems import scene, simulate
from problems.contacts.assembly import scaled_matrix
from problems.least_norm.peeling import peels
from problems.qp import Indices, Vector
from solvers import make_solver


def random_graph(rng: np.random.Generator, n: int, k: int) -> tuple[Vector, Indices, Vector]:
    """k columns between neighbours of n bodies in a row, the first of which are on the ground."""
    first = rng.integers(0, n, k)
    bodies = np.column_stack([first, np.where(first > 0, first - 1, -1)])
    return rng.standard_normal((k, 6)), bodies, 0.5 + rng.random(3 * n)


def test_what_peels_has_full_rank() -> None:
    """And both answers occur, also on graphs that have full rank."""
    rng = np.random.default_rng(0)
    answers = []
    for _ in range(200):
        n = int(rng.integers(1, 8))
        entries, bodies, D = random_graph(rng, n, int(rng.integers(1, 3 * n + 1)))
        found = peels(entries, bodies, D)
        answers.append(found)
        if found:
            A = np.asarray(scaled_matrix(entries, bodies, D))
            assert np.linalg.matrix_rank(A) == A.shape[1]
    assert 20 < sum(answers) < 180


def test_dependent_columns_never_peel() -> None:
    """A column twice, and, with one of them turned by less than can be told, almost twice."""
    rng = np.random.default_rng(1)
    for turned in (0.0, 1e-6):
        entries, bodies, D = random_graph(rng, 5, 1)
        twin = entries + turned * rng.standard_normal(entries.shape)
        assert peels(entries, bodies, D)
        assert not peels(np.vstack([entries, twin]), np.vstack([bodies, bodies]), D)


@pytest.mark.parametrize(("name", "independent"), [("tower", True), ("wall", False)])
def test_bricks_that_stick(name: str, independent: bool) -> None:
    """A tower with all its friction is determinate; a wall is not."""
    made = scene(name, bodies=40, mu=0.5, speed=0.0)
    run = simulate(made, make_solver("glambda"), until=1e-3)
    qp = next(qp for qp in run.qps if qp.kind == "step")
    assert (np.linalg.matrix_rank(qp.dense_A) == qp.k) == independent
    graph_entries = np.zeros((qp.k, 6))
    graph_bodies = np.full((qp.k, 2), -1)
    for c in range(qp.k):
        rows = np.flatnonzero(qp.dense_A[:, c])
        for side, body in enumerate(np.unique(rows // 3)):
            graph_bodies[c, side] = body
            graph_entries[c, 3 * side : 3 * side + 3] = qp.dense_A[3 * body : 3 * body + 3, c]
    assert peels(graph_entries, graph_bodies, np.ones(qp.m)) == independent
