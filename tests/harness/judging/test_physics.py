"""The laws of contact as the judge measures them: by hand, and on answers of recorded scenes."""

from __future__ import annotations

import numpy as np
import pytest

from harness import judge, replay
from harness.judging.contact_rows import contact_rows
from harness.judging.facts import facts_of
from harness.judging.physics import MEASURES, physics
from problems import simulate
from problems.qp import NORMAL, TANGENT, ContactQP
from reports.rows.results import Results, prepare
from reports.sections.physics import physics_table
from solvers import make_solver
from tests.fakes.runs import one_box, scene_recording, scene_run

INF = np.inf
MASS, WEIGHT = 2.0, 20.0


def block(h: float = 0.1, push: float = 3.0, bound: float = 4.0) -> ContactQP:
    """A body of mass 2 on the ground, at rest: weight 20, a push, friction of up to `bound`.

    Coordinates x, y, φ (of inertia 1); row 0 is the normal and row 1 the tangent of one contact.
    """
    D = np.sqrt([MASS, MASS, 1.0])
    G = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    force = np.array([push, -WEIGHT, 0.0])
    feature = [[0, 0, -1, 0, NORMAL], [0, 0, -1, 0, TANGENT]]
    return ContactQP(
        G / D[:, None], force / D, [0.0, -bound], [INF, bound], D=D, h=h, feature=feature
    )


MU = np.array([0.0, 0.2])


def measured(x: list[float], **options: float) -> dict[str, float]:
    verdict = judge(block(**options), x, mu=MU)
    return {name: getattr(verdict, name) for name in MEASURES}


def test_an_exact_answer_obeys_every_law() -> None:
    found = measured([20.0, -3.0])
    assert all(value == pytest.approx(0.0, abs=1e-15) for value in found.values())


def test_too_little_force_lets_bodies_approach() -> None:
    found = measured([18.0, -3.0])  # 2 N short for 0.1 s on 2 kg
    assert found["approach"] == pytest.approx(0.1)
    assert found["pull"] == 0.0
    assert found["work_error"] == pytest.approx(18.0 * 0.1 * 0.1)  # λ_N g_Nᵀq̇ h
    assert found["energy_error"] == pytest.approx(0.5 * MASS * 0.1**2)


def test_too_much_force_makes_bodies_part_and_does_work() -> None:
    found = measured([22.0, -3.0])
    assert found["approach"] == 0.0
    assert found["work_error"] == pytest.approx(22.0 * 0.1 * 0.1)
    assert found["energy_error"] > 0


def test_pulling_is_seen() -> None:
    found = measured([-1.0, -3.0])
    assert found["pull"] == pytest.approx(1.0)
    assert found["approach"] == pytest.approx(21.0 / MASS * 0.1)


def test_coulomb_by_the_normal_force_of_the_answer_itself() -> None:
    """The bound of the QP is 4, lagged; μ λ_N of the answer is 0.2 · 10 = 2, and λ_F is −3."""
    assert measured([10.0, -3.0])["coulomb_excess"] == pytest.approx(1.0)
    assert measured([20.0, -3.0])["coulomb_excess"] == 0.0
    assert np.isnan(judge(block(), [20.0, -3.0]).coulomb_excess)


def test_friction_opposes_slip_with_all_its_bound() -> None:
    """Pushed with 10 the block slips at (10 − 4)/2 · 0.1 = 0.3 m/s against a friction of −4."""
    assert measured([20.0, -4.0], push=10.0)["work_error"] == pytest.approx(0.0, abs=1e-15)
    short = measured([20.0, -2.0], push=10.0)  # slips at 0.4 with half of it
    assert short["work_error"] == pytest.approx((4.0 * 0.4 - 2.0 * 0.4) * 0.1)
    along = measured([20.0, 4.0], push=10.0)  # drives the slip, of 0.7
    assert along["work_error"] == pytest.approx(2 * 4.0 * 0.7 * 0.1)
    assert along["energy_error"] == pytest.approx(0.5 * MASS * (0.7**2 - 0.3**2))


def test_the_error_without_units_does_not_depend_on_units() -> None:
    """The same fall told in other units of mass and time."""
    one = block()
    facts = facts_of(one)
    found = physics(facts, np.array([19.0, -3.0]), MU, 0.0).physics_error
    G = one.dense_A * one.D[:, None]
    D, force = np.sqrt(1000.0) * one.D, one.D * one.d * 1000.0 / 3600.0
    other = ContactQP(
        G / D[:, None], force / D, one.lower, one.upper / 3.6, D=D, h=360.0, feature=one.feature
    )
    x = np.array([19.0, -3.0]) / 3.6
    assert physics(facts_of(other), x, MU, 0.0).physics_error == pytest.approx(found)


def test_a_step_with_the_second_order_formula_has_its_own_speeds() -> None:
    """q̇ = (h/α₀) D⁻¹ r."""
    from dataclasses import replace

    qp = replace(block(), alpha0=1.5)
    assert judge(qp, [18.0, -3.0], mu=MU).approach == pytest.approx(0.1 / 1.5)


def test_members_are_those_of_the_constraint_graph() -> None:
    """A box on the ground: one tangent, bounded by both of its normals."""
    run = simulate(one_box(mu=0.5, v=(0.0, 0.0, 0.0)), make_solver("glambda"), until=0.01)
    qp = next(qp for qp in run.qps if qp.kind != "minimum_norm" and qp.k == 3)
    rows = contact_rows(qp)
    assert rows.normal.size == 2 and rows.tangent.size == 1
    assert rows.members.toarray().tolist() == [[1.0, 1.0]]


@pytest.mark.parametrize("name", ["fig4", "fig5"])
def test_every_tangent_of_a_scene_has_its_normals(name: str) -> None:
    """And μ times their forces is about its bound once the passes of friction have begun."""
    recording = scene_recording(name)
    near, tangents = 0, 0
    for qp, solution, mu in zip(recording.qps, recording.solutions, recording.mu, strict=True):
        rows = contact_rows(qp)
        assert (np.asarray(rows.members.sum(axis=1)).ravel() >= 1).all()
        assert (mu[rows.tangent] == 0.5).all() and not mu[rows.normal].any()
        assert rows.members.sum() <= rows.normal.size
        if qp.kind == "corrector" and facts_of(qp).rank == qp.k:  # λ is unique
            pushed = mu[rows.tangent] * (rows.members @ solution.x[rows.normal])
            near += int(np.isclose(qp.upper[rows.tangent], pushed, rtol=0.05).sum())
            tangents += rows.tangent.size
    assert near >= 0.9 * tangents


@pytest.mark.parametrize("name", ["fig2", "fig4", "fig5"])
def test_exact_answers_of_a_scene_obey_the_laws(name: str) -> None:
    recording = scene_recording(name)
    for qp, known in list(zip(recording.qps, recording.references, strict=True))[::4]:
        found = judge(qp, known.x, reference=known)
        if qp.kind == "minimum_norm":
            assert np.isnan(found.physics_error)
            continue
        facts = facts_of(qp)
        # x is rounded, and r is a difference of numbers of the size of d
        rounding = 1e-15 * max(1.0, float(np.linalg.norm(qp.d)) / facts.scale)
        assert found.physics_error <= 100 * rounding
        assert found.approach <= 1e-13 and found.pull == 0.0


def test_an_impulse_loses_energy_and_its_cone_is_looked_at() -> None:
    """½‖r‖² − ½‖d‖² = −½‖A x‖², and a negative generator is a Λ outside the cone."""
    run = scene_run("fig5")
    impulses = [qp for qp in run.qps if qp.kind == "impulse"]
    assert impulses
    for qp in impulses:
        facts = facts_of(qp)
        assert facts.contact_rows.normal.size == 0 and qp.generators is not None
        found = judge(qp, np.zeros(qp.k))
        known = judge(qp, -np.ones(qp.k))
        assert found.approach > 0 and found.energy_error > 0
        assert known.pull == 1.0 and np.isnan(known.coulomb_excess)


def test_the_table_of_physics_tells_the_worst_of_each_backend() -> None:
    recording = scene_recording("fig5")
    rows = prepare(replay(recording, ["daqp", "pgs"], ["default"], ["cold"], repeats=1))
    data = physics_table(Results(rows), "default").data.set_index("solver")
    for solver in ("daqp", "pgs"):
        part = rows[(rows["solver"] == solver) & (rows["k"] > 0)]
        assert data.loc[solver, "approach [m/s]"] == part["approach"].max()
        assert data.loc[solver, "answers"] == part["physics_error"].notna().sum() > 100
    assert data.loc["daqp", "max"] < data.loc["pgs", "max"]
    assert physics_table(Results(rows), "high").data.empty
