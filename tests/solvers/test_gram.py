"""Normal equations of short and of full columns, compiled, against NumPy."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from problems.qp import AT_LOWER, FREE, PASSIVE
from solvers.active_set import gram
from solvers.active_set.workspace import (
    FIRST,
    LANES,
    MEMBER,
    N_FLOAT_ROWS,
    SORTED,
    F,
    P,
    Workspace,
    make_workspace,
)
from tests.solvers.test_sparse_path import contact_matrix

SIZES = [(3, 5), (8, 16), (12, 30), (20, 40), (24, 60), (40, 33)]
"""Bodies and contacts; those of 24 and 40 have more rows than `BITS`."""


@numba.njit
def whole(A, d, S, I, mp):
    head = gram.take_columns(A, d, S, I, mp)
    gram.take_gram(A, S, I, head, gram.NOTHING)


@numba.njit
def of_free(A, d, S, I, mp):
    head = gram.take_columns(A, d, S, I, mp)
    gram.take_gram_of_free(A, S, I, head, (I[MEMBER, : A.shape[1]] == FREE).sum())
    for j in range(A.shape[1]):
        S[N_FLOAT_ROWS + 2 * S.shape[1] + j, j] = (A[:, j] ** 2).sum()


@numba.njit
def factorize_and_solve(S, I, m, k, right):
    f = gram.factorize_gram(S, I, m, k, 0.0)
    for c in range(f):
        S[P, c] = right[I[F, c]]
    gram.solve_gram(S, I, f)
    return f


def room_of(A: np.ndarray) -> tuple[Workspace, int]:
    m, k = A.shape
    room = make_workspace(m, k)
    room.S[:], room.I[:] = np.nan, 99  # a new room holds anything
    return room, (m + LANES - 1) // LANES * LANES


FORMS = [(False, False), (True, False), (False, True), (True, True)]
"""Whether columns are full, and whether contacts are soft."""


def matrix(seed: int, bodies: int, contacts: int, full: bool, soft: bool) -> np.ndarray:
    A = hard_matrix(seed, bodies, contacts, full)
    if not soft:
        return A
    rng = np.random.default_rng(seed)
    softness = np.diag(rng.uniform(0.1, 1.0, contacts) * (rng.random(contacts) < 0.8))
    return np.vstack((A[:, rng.permutation(contacts)], softness, softness[contacts // 2 :] * 2.0))


def hard_matrix(seed: int, bodies: int, contacts: int, full: bool) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if full:
        return rng.standard_normal((3 * bodies, contacts))
    A = contact_matrix(rng, bodies, contacts, reach=bodies if seed % 2 else 3).toarray()
    if seed % 3 == 0:
        A[:, contacts // 2] = 0.0
    return np.ascontiguousarray(A)


@pytest.mark.parametrize(("bodies", "contacts"), SIZES)
@pytest.mark.parametrize(("full", "soft"), FORMS)
@pytest.mark.parametrize("seed", range(4))
def test_products_of_columns(seed: int, bodies: int, contacts: int, full: bool, soft: bool) -> None:
    A = matrix(seed, bodies, contacts, full, soft)
    m, k = A.shape
    room, mp = room_of(A)
    whole(A, np.zeros(m), room.S, room.I, mp)
    H = room.S[N_FLOAT_ROWS + 2 * room.n :][:k, :k]
    lengths = np.linalg.norm(A, axis=0)
    assert (np.abs(H - A.T @ A) <= 1e-15 * m * np.outer(lengths, lengths)).all()
    assert (H == H.T).all()
    assert sorted(room.I[SORTED, :k]) == list(range(k))


@pytest.mark.parametrize(("bodies", "contacts"), SIZES)
@pytest.mark.parametrize(("full", "soft"), FORMS)
@pytest.mark.parametrize("way", [whole, of_free])
@pytest.mark.parametrize("seed", range(4))
def test_solutions_on_F(seed: int, way, bodies: int, contacts: int, full: bool, soft: bool) -> None:
    """Independent columns of those that are free, all others of them passive: F spans the same."""
    A = matrix(seed, bodies, contacts, full, soft)
    m, k = A.shape
    room, mp = room_of(A)
    rng = np.random.default_rng(seed)
    member = np.where(rng.random(k) < 0.6, FREE, AT_LOWER)
    room.I[MEMBER, :k] = member
    if way is whole:
        whole(A, np.zeros(m), room.S, room.I, mp)
    else:
        of_free(A, np.zeros(m), room.S, room.I, mp)
    right = rng.standard_normal(k)
    f = factorize_and_solve(room.S, room.I, m, k, right)
    free = room.I[F, :f]
    A_F = A[:, free]
    assert f == np.linalg.matrix_rank(A[:, member == FREE])
    assert np.linalg.matrix_rank(A_F) == f
    assert (np.flatnonzero(room.I[MEMBER, :k] == PASSIVE).size + f) == (member == FREE).sum()
    expected = np.linalg.solve(A_F.T @ A_F, right[free])
    tolerance = 1e-14 * np.linalg.cond(A_F) ** 2
    assert np.abs(room.S[P, :f] - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize(("bodies", "contacts"), SIZES)
@pytest.mark.parametrize("seed", range(4))
def test_nothing_hangs_on_what_a_room_held_before(seed: int, bodies: int, contacts: int) -> None:
    A = matrix(seed, bodies, contacts, False, False)
    m, k = A.shape
    member = np.where(np.random.default_rng(seed).random(k) < 0.6, FREE, AT_LOWER)
    found = []
    for before in (0, 10**6):
        room, mp = room_of(A)
        room.I[:] = before
        room.I[MEMBER, :k] = member
        of_free(A, np.zeros(m), room.S, room.I, mp)
        f = factorize_and_solve(room.S, room.I, m, k, np.ones(k))
        found.append((room.I[F, :f].tolist(), room.I[FIRST, :f].tolist(), room.S[P, :f].tobytes()))
    assert found[0] == found[1]


def test_neighbours_are_eliminated_after_each_other() -> None:
    """A tower whose contacts come in any order has an L as narrow as one from the ground up."""
    bodies, k = 20, 40
    A = np.zeros((3 * bodies, k))
    rng = np.random.default_rng(0)
    for j in range(k):
        body = j // 2
        A[max(0, 3 * body - 3) : 3 * body + 3, j] = rng.standard_normal(min(6, 3 * body + 3))
    A = np.ascontiguousarray(A[:, rng.permutation(k)])
    room, mp = room_of(A)
    whole(A, np.zeros(3 * bodies), room.S, room.I, mp)
    room.I[MEMBER, :k] = FREE
    f = factorize_and_solve(room.S, room.I, 3 * bodies, k, np.ones(k))
    assert f == k
    assert (np.arange(f) - room.I[FIRST, :f]).max() <= 3
