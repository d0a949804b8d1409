"""A sequence in one call: the same bits as QP by QP."""

from __future__ import annotations

import numpy as np
import pytest

from glambda import PackedQPs, make_solver, simulate, solve_sequence
from problems.qp import ContactQP


@pytest.fixture(scope="module")
def qps() -> list[ContactQP]:
    return [qp for qp in simulate("fig4", until=0.6).qps if qp.k]


@pytest.mark.parametrize("warm", [True, False])
def test_answers_are_those_of_single_calls(qps: list[ContactQP], warm: bool) -> None:
    together, solver, last = solve_sequence(qps, warm=warm), make_solver("glambda"), None
    assert len(together.x) == len(qps) and together.solved.all()
    for i, qp in enumerate(qps):
        last = solver.solve(qp, last if warm else None)
        assert together.x[i].tobytes() == last.x.tobytes()
        assert together.directions[i] == last.iterations


def test_packed_beforehand_is_the_same(qps: list[ContactQP]) -> None:
    packed = PackedQPs.of(qps)
    assert "packed" in repr(packed) and str(len(qps)) in repr(packed)
    again = solve_sequence(packed, accuracy=1e-8)
    assert again.solved.all()
    for qp, x, y in zip(qps, again.x, solve_sequence(qps, accuracy=1e-8).x, strict=True):
        assert x.shape == (qp.k,) and x.tobytes() == y.tobytes()


def test_none_at_all_and_one_without_columns() -> None:
    assert solve_sequence([]).x == []
    empty = ContactQP(np.zeros((3, 0)), np.ones(3), np.zeros(0), np.zeros(0))
    found = solve_sequence([empty, empty])
    assert [x.size for x in found.x] == [0, 0] and found.solved.all()


def test_what_is_too_wide_is_refused_with_a_remedy() -> None:
    k = 97
    wide = ContactQP(np.eye(k), np.ones(k), np.zeros(k), np.ones(k))
    with pytest.raises(ValueError, match=r"97 columns.*make_solver"):
        solve_sequence([wide])
    with pytest.raises(ValueError, match="accuracy"):
        solve_sequence([], accuracy=-1.0)
