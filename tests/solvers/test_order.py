"""The order of elimination, against sets of Python and against SuperLU's minimum degree."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.linalg import splu

from problems.qp import Indices
from solvers.active_set.sparse.order import (
    cliques,
    coupled,
    eliminated,
    node_of_columns,
    numbered,
    transposed,
)
from solvers.active_set.sparse.pattern import make_pattern


def patterns() -> st.SearchStrategy[list[set[int]]]:
    """The rows of every column."""
    return st.lists(st.sets(st.integers(0, 14), max_size=5), min_size=1, max_size=25)


def csc(columns: list[set[int]]) -> tuple[int, Indices, Indices]:
    indptr = np.cumsum([0, *map(len, columns)]).astype(np.int32)
    return 15, indptr, np.array([i for rows in columns for i in sorted(rows)], np.int32)


def shared(columns: list[set[int]]) -> list[frozenset[int]]:
    """Of the rows of each column, those that another has too."""
    return [
        frozenset(i for i in rows if sum(i in other for other in columns) > 1) for rows in columns
    ]


@given(st.lists(st.integers(0, 40), max_size=60))
def test_equal_keys_have_the_same_number(keys: list[int]) -> None:
    found, count = numbered(np.array(keys, np.uint64) << np.uint64(8))
    met = list(dict.fromkeys(keys))
    assert found.tolist() == [met.index(key) for key in keys] and count == len(met)


@settings(max_examples=60)
@given(patterns())
def test_nodes_and_their_cliques_are_those_of_the_columns(columns: list[set[int]]) -> None:
    m, indptr, indices = csc(columns)
    node, count = node_of_columns(m, indptr, indices)
    rows = shared(columns)
    for c, own in enumerate(rows):
        for other in range(c):
            assert (node[c] == node[other]) == (own == rows[other] and bool(own))
    Ep, Ei = cliques(m, indptr, indices, node, count)
    found = [tuple(Ei[a:b].tolist()) for a, b in pairwise(Ep)]
    assert len(set(found)) == len(found)
    having = {tuple(sorted({int(node[c]) for c in range(len(columns)) if i in columns[c]}))
              for i in range(m)}  # fmt: skip
    assert {each for each in found if len(each) > 1} == {each for each in having if len(each) > 1}


@settings(max_examples=60)
@given(patterns())
def test_who_is_coupled_shares_a_row(columns: list[set[int]]) -> None:
    m, indptr, indices = csc(columns)
    node, count = node_of_columns(m, indptr, indices)
    weight = np.bincount(node, minlength=count)
    Ep, Ei = cliques(m, indptr, indices, node, count)
    having = transposed(count, Ep, Ei)
    order = eliminated(Ep, Ei, *having, weight)
    assert sorted(order.tolist()) == list(range(count))
    assert weight.tolist() == np.bincount(node, minlength=count).tolist()
    begin, before = coupled(Ep, Ei, *having, order)
    member = [columns[node.tolist().index(v)] for v in order]
    for v in range(count):
        expected = [u for u in range(v) if member[u] & member[v]]
        assert sorted(before[begin[v] : begin[v + 1]].tolist()) == expected
    Tp, Ti = transposed(count, begin, before)
    for v in range(count):
        later = [u for u in range(v + 1, count) if member[u] & member[v]]
        assert Ti[Tp[v] : Tp[v + 1]].tolist() == later


def contacts(pairs: list[tuple[int, int]], each: int, ridge: bool) -> sp.csc_array:
    """`each` columns for each pair of bodies of three coordinates, body −1 being the ground."""
    rng, entries = np.random.default_rng(0), []
    for c, pair in enumerate(pair for pair in pairs for _ in range(each)):
        for body in pair:
            entries += [(3 * body + i, c) for i in range(3) if body >= 0]
    bodies, k = 1 + max(map(max, pairs)), each * len(pairs)
    if ridge:
        entries += [(3 * bodies + c, c) for c in range(k)]
    rows, columns = np.array(entries).T
    shape = (3 * bodies + (k if ridge else 0), k)
    return sp.csc_array((1.0 + rng.random(rows.size), (rows, columns)), shape=shape)


def coupling(A: sp.csc_array) -> sp.csc_array:
    return sp.csc_array(abs(A.T) @ abs(A))


@pytest.mark.parametrize("ridge", [False, True])
@pytest.mark.parametrize("each", [1, 2, 12])
def test_a_tree_has_no_fill(each: int, ridge: bool) -> None:
    """Its bodies can be eliminated from the leaves on."""
    rng = np.random.default_rng(1)
    pairs = [(int(rng.integers(-1, max(1, body))), body) for body in range(1, 40)]
    A = contacts([pairs[i] for i in rng.permutation(len(pairs))], each, ridge)
    k = A.shape[1]
    pattern = make_pattern(A)
    assert sorted(pattern.order) == list(range(k))
    stored = (coupling(A).nnz + k) // 2
    assert stored <= pattern.entries <= 1.2 * stored  # fronts hold a few zeros


@pytest.mark.parametrize("wide", [6, 15, 30])
def test_a_grid_is_filled_no_more_than_by_superlu(wide: int) -> None:
    cells = [(i, j) for i in range(wide) for j in range(wide)]
    number = {cell: n for n, cell in enumerate(cells)}
    pairs = [(number[i, j], number[i + a, j + b]) for i, j in cells for a, b in ((0, 1), (1, 0))
             if (i + a, j + b) in number]  # fmt: skip
    A = contacts(pairs, 2, ridge=False)
    k = A.shape[1]
    graph = coupling(A)
    graph.data[:] = 1.0
    graph = sp.csc_array(graph + 2.0 * k * sp.eye_array(k))  # dominant: no pivot is moved
    theirs = splu(
        graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    assert make_pattern(A).entries <= 1.2 * theirs.L.nnz


def test_columns_that_share_no_row_are_not_coupled() -> None:
    A = sp.csc_array(sp.eye_array(70))
    assert make_pattern(A).entries == 70
