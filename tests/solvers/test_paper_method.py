"""The paper's claims for algorithm 2, on every QP of the four scenes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from harness.judging.facts import facts_of
from problems.sequence import WARM_KINDS
from solvers import make_solver
from tests.fakes.runs import scene_recording

SCENES = ("fig2", "fig3", "fig4", "fig5")
TIGHT = 1e-10
"""Accuracy asked and KKT residual allowed, in units of the scale ‖A A⁺ d‖."""


@cache
def solved(name: str, warm: bool):
    """(facts, reference, solution, whether warm) of every QP of a scene, solved tightly."""
    solver, last, out = make_solver("glambda"), None, []
    recording = scene_recording(name)
    for qp, reference in zip(recording.qps, recording.references, strict=True):
        facts = facts_of(qp)
        follows = warm and qp.kind in WARM_KINDS and not qp.restart and last is not None
        asked = qp.with_accuracy(TIGHT * facts.scale)
        solution = solver.solve(asked, last if follows else None)
        if qp.kind in WARM_KINDS:
            last = solution
        out.append((facts, reference, solution, follows))
    return out


def kkt_residual(facts, x):
    """Largest wrong sign of Δ over columns of length 1."""
    qp = facts.qp
    gradient = qp.gradient(x) / facts.norms
    up = np.where(x < qp.upper, -gradient, 0.0)
    down = np.where(x > qp.lower, gradient, 0.0)
    return float(np.maximum(up, down).max(initial=0.0))


@pytest.mark.parametrize("warm", [False, True], ids=["cold", "warm"])
@pytest.mark.parametrize("name", SCENES)
def test_kkt_residual_on_every_recorded_qp(name, warm):
    for facts, _, solution, _ in solved(name, warm):
        assert solution.found, solution.status_text
        assert kkt_residual(facts, solution.x) <= TIGHT * facts.scale


@pytest.mark.parametrize("warm", [False, True], ids=["cold", "warm"])
@pytest.mark.parametrize("name", SCENES)
def test_equal_to_the_oracle_in_A_x_and_often_rank_deficient(name, warm):
    deficient = 0
    for facts, reference, solution, _ in solved(name, warm):
        error = np.linalg.norm(facts.qp.A @ solution.x - reference.Ax)
        assert error <= 10 * TIGHT * facts.scale
        deficient += facts.rank < facts.qp.k
    assert (deficient > 0) == (name in ("fig4", "fig5"))


@pytest.mark.parametrize(
    ("name", "share"), [("fig2", 0.9), ("fig3", 0.9), ("fig4", 0.9), ("fig5", 0.8)]
)
def test_most_warm_qps_need_one_descent_direction(name, share):
    """§3.2: "at most time points the optimum is found after one descent direction"."""
    directions = np.array(
        [s.work.descent_directions for f, _, s, follows in solved(name, True) if follows and f.qp.k]
    )
    assert np.median(directions) == 1
    assert np.mean(directions == 1) >= share


def test_minimum_norm_multipliers_equal_the_oracle_s():
    """The least-norm λ is unique; it is read off the residual of the least-distance QP."""
    compared = 0
    for name in ("fig4", "fig5"):
        for facts, reference, solution, _ in solved(name, False):
            qp = facts.qp
            if qp.kind != "minimum_norm":
                continue
            ours, theirs = (r[:-1] / r[-1] for r in (qp.residual(solution.x), reference.Ax + qp.d))
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
            compared += 1
    assert compared > 10
