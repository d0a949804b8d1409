"""The compiled kernels of algorithm 2 against NumPy and against their plain twins."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from solvers import make_solver
from solvers.active_set import factorization as kernels
from solvers.active_set import loop
from solvers.active_set.conjugate_gradients import conjugate_gradients
from solvers.active_set.workspace import (
    INVERSE_NORM,
    LANES,
    N_FLOAT_ROWS,
    NORM2,
    REALS,
    REMAINDER,
    RESIDUAL,
    F,
    P,
    make_workspace,
)
from tests.fakes.assertions import force_error, force_scale
from tests.fakes.methods import METHODS
from tests.fakes.random_qps import KINDS, contact_sequence, random_qp
from tests.solvers.numpy_twin import factorization as twin
from tests.solvers.numpy_twin.method import Lotstedt as Twin


def loaded(B: np.ndarray):
    """A workspace with the unit columns of B (m, k), all of them in F; and mp."""
    m, k = B.shape
    room = make_workspace(m, k)
    room.S[:], room.I[:] = 0.0, 0
    room.S[N_FLOAT_ROWS : N_FLOAT_ROWS + k, :m] = B.T
    room.I[F, :k] = np.arange(k)
    return room, (m + LANES - 1) // LANES * LANES


def unit_columns(seed: int, m: int, k: int) -> np.ndarray:
    B = np.random.default_rng(seed).standard_normal((m, k))
    return B / np.linalg.norm(B, axis=0)


def R_of(room, f: int) -> np.ndarray:
    first = N_FLOAT_ROWS + 2 * room.n
    return np.triu(room.S[first : first + f, :f].T)


@pytest.mark.parametrize(("m", "k"), [(3, 2), (9, 9), (15, 8), (17, 12), (40, 33)])
def test_qr_factorize_is_a_pivoted_qr(m, k):
    B = unit_columns(m, m, k)
    room, mp = loaded(B)
    f = kernels.qr_factorize(room.S, room.I, m, mp, k, 0)
    assert f == k
    order = room.I[F, :k]
    assert sorted(order) == list(range(k))
    R = R_of(room, k)
    np.testing.assert_allclose(R.T @ R, B[:, order].T @ B[:, order], atol=1e-13)
    for i in range(k):
        assert R[i, i] ** 2 >= (R[i:, i + 1 :] ** 2).sum(axis=0).max(initial=0) - 1e-12


@pytest.mark.parametrize("rank", [1, 3, 7])
def test_dependent_columns_are_left_out(rank):
    rng = np.random.default_rng(rank)
    B = rng.standard_normal((12, rank)) @ rng.standard_normal((rank, 10))
    B /= np.linalg.norm(B, axis=0)
    room, mp = loaded(B)
    assert kernels.qr_factorize(room.S, room.I, 12, mp, 10, 0) == rank


def test_factorizing_from_a_column_on_equals_factorizing_anew():
    B = unit_columns(5, 14, 9)
    room, mp = loaded(B)
    kernels.qr_factorize(room.S, room.I, 14, mp, 9, 0)
    order = np.delete(room.I[F, :9], 4)  # one column less
    room.I[F, :8] = order
    assert kernels.qr_factorize(room.S, room.I, 14, mp, 8, 4) == 8
    A_F = B[:, room.I[F, :8]]
    R = R_of(room, 8)
    np.testing.assert_allclose(R.T @ R, A_F.T @ A_F, atol=1e-13)
    room.S[RESIDUAL, :14] = r = np.random.default_rng(6).standard_normal(14)
    loop.direction_by_Q(room.S, mp, 8)
    best = -np.linalg.lstsq(A_F, r, rcond=None)[0]
    np.testing.assert_allclose(room.S[P, :8], best, atol=1e-12)


def test_append_and_delete_equal_factorizing_anew():
    B = unit_columns(7, 20, 11)
    room, mp = loaded(B)
    f = kernels.qr_factorize(room.S, room.I, 20, mp, 7, 0)
    for j in (7, 8):
        assert kernels.qr_append(room.S, room.I, 20, mp, f, j)
        f += 1
    room.S[REALS, INVERSE_NORM] = kernels.inverse_norm_estimate(room.S, f)
    for j in (9, 10):  # without Q
        assert loop.r_insert(room.S, room.I, 20, mp, f, j, 100) == 1
        f += 1
    for position in (10, 3, 0):
        kernels.r_delete(room.S, room.I, f, position)
        f -= 1
    A_F, R = B[:, room.I[F, :f]], R_of(room, f)
    np.testing.assert_allclose(R.T @ R, A_F.T @ A_F, atol=1e-12)


def test_a_dependent_column_is_not_appended():
    B = unit_columns(8, 10, 4)
    mixed = B @ np.array([1.0, -2.0, 0.5, 1.0])
    B = np.column_stack([B, mixed / np.linalg.norm(mixed)])
    room, mp = loaded(B)
    f = kernels.qr_factorize(room.S, room.I, 10, mp, 4, 0)
    assert not kernels.qr_append(room.S, room.I, 10, mp, f, 4)
    room.S[REALS, INVERSE_NORM] = kernels.inverse_norm_estimate(room.S, f)
    assert loop.r_insert(room.S, room.I, 10, mp, f, 4, 100) == 0
    np.testing.assert_allclose(B[:, room.I[F, :4]] @ room.S[NORM2, :4], B[:, 4], atol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 8, 30])
def test_karasalo_and_cline_equal_their_twins(n):
    rng = np.random.default_rng(n)
    R = np.triu(rng.standard_normal((n, n))) + 2 * np.eye(n)
    room = make_workspace(n, n)
    first = N_FLOAT_ROWS + 2 * room.n
    room.S[first : first + n, :n] = R.T
    bound, estimate = kernels.karasalo_bound(room.S, n), kernels.inverse_norm_estimate(room.S, n)
    assert bound == pytest.approx(twin.karasalo_bound(R), rel=1e-12)
    assert estimate == pytest.approx(twin.inverse_norm_estimate(np.asfortranarray(R)), rel=1e-9)
    sigma = np.linalg.svd(R, compute_uv=False)[-1]
    assert bound <= sigma * (1 + 1e-12)
    assert estimate <= (1 + 1e-12) / sigma <= 10 * estimate


@pytest.mark.parametrize("preconditioned", [True, False])
def test_conjugate_gradients_minimise(preconditioned):
    B = unit_columns(9, 25, 12)
    room, mp = loaded(B)
    kernels.qr_factorize(room.S, room.I, 25, mp, 12, 0)
    near = B + 1e-3 * np.random.default_rng(1).standard_normal(B.shape)
    room.S[N_FLOAT_ROWS : N_FLOAT_ROWS + 12, :25] = near.T  # today's columns, yesterday's R
    room.S[RESIDUAL, :25] = r = np.random.default_rng(2).standard_normal(25)
    made = conjugate_gradients(room.S, room.I, mp, 12, RESIDUAL, 1e-12, 200, preconditioned)
    assert 0 < made <= (6 if preconditioned else 40)
    A_F = near[:, room.I[F, :12]]
    np.testing.assert_allclose(room.S[P, :12], -np.linalg.lstsq(A_F, r, rcond=None)[0], atol=1e-10)
    np.testing.assert_allclose(room.S[REMAINDER, :25], A_F @ room.S[P, :12] + r, atol=1e-12)
    assert conjugate_gradients(room.S, room.I, mp, 12, RESIDUAL, 0.0, 3, preconditioned) == -4


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_compiled_equals_plain(kind, method):
    for seed in range(4):
        qp, _ = random_qp(kind, seed)
        asked = 1e-10 * force_scale(qp)
        plain = Twin(accuracy=asked).solve(qp)
        ours = make_solver(method, accuracy=asked).solve(qp)
        assert ours.found == plain.found
        assert force_error(qp, ours.x, qp.A @ plain.x) <= 1e-9


def test_compiled_equals_plain_along_a_sequence():
    ours, plain = make_solver("lotstedt"), Twin()
    last = before = None
    for qp, _ in contact_sequence(3):
        last, before = ours.solve(qp, last), plain.solve(qp, before)
        assert np.linalg.norm(qp.A @ (last.x - before.x)) <= 2 * qp.eps0


def test_a_smaller_workspace_hands_its_memory_on():
    small, large = random_qp("full_rank", 1)[0], random_qp("full_rank", 1)[0]
    solver = make_solver("lotstedt", accuracy=1e-10)
    first = solver.solve(small)
    first.memory.S[...] = first.memory.S  # stays as it is
    grown = make_workspace(10 * first.memory.n, 1, first.memory)
    again = solver.solve(large, replace(first, memory=grown))
    assert again.found and again.work.qr_factorizations == 0
    assert force_error(large, again.x, large.A @ first.x) <= 1e-9


def test_the_loop_allocates_nothing():
    """numba's own count of allocations: those of handing over the arguments, and no more."""
    code = (
        "import numba\n"
        "from numba.core.runtime import rtsys\n"
        "from solvers import make_solver\n"
        "from tests.fakes.random_qps import contact_sequence\n"
        "from solvers.active_set.loop import algorithm_2\n"
        "from solvers.base import Start\n"
        "solver = make_solver('glambda')\n"
        "qps = [qp for qp, _ in contact_sequence(1)]\n"
        "last = solver.solve(qps[0])\n"
        "start = Start(None, None, None, last.memory)\n"
        "native = solver.setup(qps[0], 1e-9, start)[0]\n"
        "nothing = numba.njit(lambda A, d, l, u, ids, S, I, eps0, mode: None)\n"
        "nothing(*native)\n"
        "made = []\n"
        "for kernel in (nothing, algorithm_2):\n"
        "    before = rtsys.get_allocation_stats().alloc\n"
        "    for _ in range(100): kernel(*native)\n"
        "    made.append(rtsys.get_allocation_stats().alloc - before)\n"
        "print(made[1] - made[0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "NUMBA_NRT_STATS": "1", "PYTHONPATH": "."},
        check=True,
    )
    assert done.stdout.strip() == "0", done.stdout


def test_what_is_lent_is_the_same_and_is_let_go():
    import weakref
    from typing import NamedTuple

    import numba

    from problems.kernels.numba_internals import lent

    class Pair(NamedTuple):
        one: np.ndarray
        other: tuple

    def total(pair, weight):
        pair = lent(pair)
        return weight * (pair.one.sum() + pair.other[0][1:].sum())

    compiled, one, other = numba.njit(total), np.arange(4.0), np.arange(3.0)
    other.setflags(write=False)
    watched = weakref.ref(one)
    assert compiled(Pair(one, (other,)), 2.0) == 2 * (6 + 3)
    assert sys.getrefcount(one) == 2
    del one
    assert watched() is None and other.tolist() == [0.0, 1.0, 2.0]


def test_memory_seen_otherwise_is_the_same_memory():
    import numba

    from problems.kernels.numba_internals import in_rows, read_only

    @numba.njit
    def seen(vector):
        rows = in_rows(vector, 2, 3)
        rows[1, 0] = 7.0
        return rows, read_only(rows)

    vector = np.arange(6.0)
    rows, posed = seen(vector)
    assert np.shares_memory(rows, vector) and np.shares_memory(posed, vector)
    assert rows.tolist() == posed.tolist() == [[0.0, 1.0, 2.0], [7.0, 4.0, 5.0]]
    assert rows.flags.writeable and not posed.flags.writeable
    del rows, posed
    assert sys.getrefcount(vector) == 2


@pytest.mark.parametrize("n", [9, 60])
def test_a_room_that_nobody_holds_is_used_again_and_no_other(n):
    held = make_workspace(n, n)
    let_go = make_workspace(n, n).S.ctypes.data
    view = make_workspace(n, n)
    assert view.S.ctypes.data == let_go
    view = view.S[3]  # holds all of it
    other = make_workspace(n, n)
    places = {held.S.ctypes.data, view.base.ctypes.data, other.S.ctypes.data}
    assert len(places) == 3


@pytest.mark.parametrize("part", ["x", "S", "I"])
def test_what_is_held_of_a_room_is_not_used_again(part):
    kept = getattr(make_workspace(9, 9), part)
    again = [make_workspace(9, 9) for _ in range(3)]
    assert not any(np.shares_memory(kept, getattr(one, part)) for one in again)
