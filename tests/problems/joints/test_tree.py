"""Joint coordinates give the answer of the multiplier form, in fewer rows and columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from problems import scene, simulate
from problems.joints.joints import Pin, all_rows
from problems.joints.row_kernels import rows_at
from problems.joints.tree import allowed_velocities, in_joint_coordinates
from solvers import make_solver


@pytest.mark.parametrize(("name", "freedoms"), [("double_pendulum", 2), ("arm", 3), ("human", 9)])
def test_joints_allow_what_they_allow(name: str, freedoms: int) -> None:
    made = scene(name)
    rng = np.random.default_rng(1)
    q = made.q0.ravel() + 0.3 * rng.normal(size=3 * len(made.bodies))
    B = allowed_velocities(made, made.q0.ravel())
    rows = all_rows([joint for joint in made.joints if isinstance(joint, Pin)], made.q0.ravel())
    _, entries, bodies = rows_at(rows, made.q0.ravel())
    G = np.zeros((q.size, rows.kind.size))
    for i, pair in enumerate(bodies):
        for side, body in enumerate(pair):
            if body >= 0:
                G[3 * body : 3 * body + 3, i] += entries[i, 3 * side : 3 * side + 3]
    assert B.shape == (q.size, freedoms) and np.linalg.matrix_rank(B) == freedoms
    np.testing.assert_allclose(G.T @ B, 0.0, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "until"), [("double_pendulum", 0.35), ("arm", 0.45), ("human", 0.3)]
)
def test_both_forms_have_one_answer(name: str, until: float) -> None:
    made, solver = scene(name), make_solver("glambda")
    run = simulate(made, solver, until=until)
    place = {float(t): i for i, t in enumerate(run.t)}
    pressed = 0
    for qp in run.qps:
        if qp.kind != "step" or qp.t not in place or not qp.accepted:
            continue
        B = allowed_velocities(made, run.q[place[qp.t]].ravel())
        qp = replace(qp, eps0=1e-13)
        small, inverse = in_joint_coordinates(qp, B)
        x = solver.solve(small).x
        share = qp.h / qp.alpha0
        v, w = share * qp.residual(solver.solve(qp).x) / qp.D, share * inverse @ small.residual(x)
        np.testing.assert_allclose(B @ w, v, atol=1e-10 * max(1.0, np.abs(v).max()))
        assert small.k < qp.k and small.m == B.shape[1] < qp.m
        pressed += bool(small.k and np.abs(x).max() > 0)
    assert pressed > 3 or name == "double_pendulum"


def test_what_is_no_tree_is_refused() -> None:
    made = scene("slider_crank")
    with pytest.raises(ValueError, match="no tree of pins"):
        allowed_velocities(made, made.q0.ravel())
