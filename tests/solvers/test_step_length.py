"""How far to go along a direction that is cut off at the bounds: against its definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from problems.qp import ContactQP
from solvers.active_set.sparse.loop import (
    LENGTHS,
    SHORTER,
    ratio_test_sparse,
    step_length,
    take_gradient_sparse,
    take_residual_sparse,
    take_step_sparse,
)
from solvers.active_set.sparse.workspace import IN_F, SparseWorkspace
from solvers.active_set.workspace import LOWER, REMAINDER, RESIDUAL, UPPER, P, Z
from tests.solvers.test_interior import boxed, columns, laid_out


def with_direction(qp: ContactQP, seed: int, size: float) -> tuple[SparseWorkspace, float]:
    """A workspace whose z is within the bounds, a p of that `size` which descends, and θ."""
    rng = np.random.default_rng(seed)
    room, k, m = laid_out(qp), qp.k, qp.m
    S, I, B = room.S, room.I, columns(qp, room)
    low, high = S[LOWER, :k], S[UPPER, :k]
    I[IN_F, :k] = low < high
    inner = np.clip(rng.standard_normal(k), low + 1e-3, high - 1e-3)
    S[Z, :k] = z = np.where(low + 2e-3 < high, inner, low)
    take_residual_sparse(room.pattern, room.Bx, S, m)
    take_gradient_sparse(room.pattern, room.Bx, S, RESIDUAL)
    uphill = np.where(I[IN_F, :k] == 1, B.T @ (B @ z + qp.d), 0.0)
    S[P, :k] = p = -size * uphill / np.linalg.norm(B @ uphill)
    S[REMAINDER, :m] = S[RESIDUAL, :m] + B @ p
    return room, float(ratio_test_sparse(S, I, k))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("size", [1e-2, 1.0, 1e2, 1e7])
def test_the_longest_step_that_is_as_good_as_the_feasible_one(seed: int, size: float) -> None:
    qp = boxed(seed, m=40)
    room, theta = with_direction(qp, seed, size)
    S, I, k, B = room.S, room.I, qp.k, columns(qp, room)
    z, p, low, high = (S[row, :k].copy() for row in (Z, P, LOWER, UPPER))

    def objective(length: float) -> float:
        at = np.clip(z + length * p, low, high)
        return 0.5 * float(np.linalg.norm(B @ at + qp.d) ** 2)

    parts = [part for part in SHORTER ** np.arange(LENGTHS) if part > theta]
    as_good = [part for part in parts if objective(part) <= objective(theta)]
    right = as_good[0] if as_good else theta
    length = step_length(room.pattern, room.Bx, S, I, qp.m, theta)
    assert length == pytest.approx(right, rel=1e-12)

    reached = take_step_sparse(S, I, k, length)
    np.testing.assert_allclose(S[Z, :k], np.clip(z + length * p, low, high), atol=1e-12 * size)
    assert reached == np.count_nonzero((I[IN_F, :k] == 0) & (low < high))


def test_every_length_is_taken_somewhere() -> None:
    """The cases above are not all alike."""
    taken = set()
    for seed in range(6):
        for size in (1e-2, 1.0, 1e2, 1e7):
            qp = boxed(seed, m=40)
            room, theta = with_direction(qp, seed, size)
            length = step_length(room.pattern, room.Bx, room.S, room.I, qp.m, theta)
            taken.add("all" if length == 1.0 else "first bound" if length == theta else "part")
    assert taken == {"all", "first bound", "part"}


def test_what_is_less_than_rounding_in_the_objective_is_still_seen() -> None:
    """A row without contacts adds 5e15 to ½‖B z + d‖², whose last digit is 1; nothing changes."""
    for seed in range(6):
        qp = boxed(seed, m=40)
        A = sp.csc_array(sp.vstack([qp.A, sp.csc_array((1, qp.k))]))
        far = replace(qp, A=A, d=np.append(qp.d, 1e8), D=None)
        lengths = []
        for each in (qp, far):
            room, theta = with_direction(each, seed, 1e-2)
            lengths.append(step_length(room.pattern, room.Bx, room.S, room.I, each.m, theta))
        assert lengths[0] == lengths[1]
