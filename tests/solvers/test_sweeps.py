"""Sweeps between directions: against their definition, and on a heap they are there for."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.active_set.sparse.loop import take_residual_sparse
from solvers.active_set.sparse.sweeps import SWEEPS, sweep
from solvers.active_set.sparse.workspace import IN_F
from solvers.active_set.workspace import LOWER, RESIDUAL, UPPER, Z
from tests.solvers.test_interior import boxed, columns, laid_out

AIM = 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_sweeps_minimise_one_variable_after_the_other(seed: int) -> None:
    qp = boxed(seed, m=40)
    room, k = laid_out(qp), qp.k
    S, I = room.S, room.I
    low, high, B = S[LOWER, :k], S[UPPER, :k], columns(qp, room)
    z = np.clip(np.random.default_rng(seed).standard_normal(k), low, high)
    S[Z, :k] = z
    I[IN_F, :k] = seed % 2  # none of F, or all, fixed ones never
    I[IN_F, :k][low == high] = 0
    member = I[IN_F, :k].copy()
    take_residual_sparse(room.pattern, room.Bx, S, qp.m)
    before = np.linalg.norm(S[RESIDUAL, : qp.m])

    f = sweep(room.pattern, room.Bx, S, I, AIM)

    r = B @ z + qp.d
    for turn in range(SWEEPS):
        for c in range(k)[:: -1 if turn % 2 else 1]:
            value = np.clip(z[c] - B[:, c] @ r, low[c], high[c])
            r += (value - z[c]) * B[:, c]
            z[c] = value
    slope = B.T @ r
    free = low < high
    between = free & (low < z) & (z < high)
    pulled = free & (((z == low) & (slope < -AIM)) | ((z == high) & (slope > AIM)))
    pushed = free & (((z == low) & (slope > AIM)) | ((z == high) & (slope < -AIM)))
    member = np.where(between | pulled, 1, np.where(pushed, 0, member))
    np.testing.assert_allclose(S[Z, :k], z, atol=1e-12)
    np.testing.assert_allclose(S[RESIDUAL, : qp.m], r, atol=1e-12)
    np.testing.assert_array_equal(I[IN_F, :k], member)
    assert f == member.sum()
    assert np.linalg.norm(r) < before
