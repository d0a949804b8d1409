"""Overlap, Signorini, energy and accuracy of a finished run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from harness.motions.in_loop import InLoop
from harness.motions.run_physics import (
    accuracy_of_answers,
    energy,
    last_answers,
    overlap,
    physics_of,
    reach,
    signorini,
)
from problems import Run, scene, simulate
from problems.bodies.bodies import box
from problems.bodies.forces import Load
from problems.contacts.geometry import HalfPlane
from problems.scenes import Scene
from solvers import make_solver
from tests.fakes.runs import one_box, scene_run


def pair(x: float, y: float, angle: float = 0.0) -> float:
    """Overlap of a unit box at the origin, the ground far below, with another one."""
    scene = Scene(
        bodies=(box(1.0, 1.0), box(1.0, 1.0)),
        q0=np.zeros((2, 3)),
        v0=np.zeros((2, 3)),
        ground=(HalfPlane((0.0, -10.0)),),
    )
    return float(overlap(scene, np.array([[[0.0, 0.0, 0.0], [x, y, angle]]]))[0])


def test_overlap_of_two_boxes_is_the_least_way_out() -> None:
    assert pair(0.9, 0.2) == pytest.approx(0.1)
    assert pair(0.3, -0.95) == pytest.approx(0.05)
    assert pair(1.25, 0.0) == pytest.approx(-0.25)
    corner = 0.5 + np.sqrt(0.5)  # a corner that points at a side
    assert pair(corner - 0.1, 0.0, np.pi / 4) == pytest.approx(0.1)
    # near two corners, where boxes of their shadows would overlap
    assert pair(0.95, 0.95, np.pi / 4) < 0


def test_overlap_with_the_ground_is_the_deepest_corner() -> None:
    q = np.array([[[0.0, 0.4, 0.0]], [[0.0, 0.6, 0.0]], [[0.0, np.sqrt(0.5) - 0.2, np.pi / 4]]])
    assert overlap(one_box(), q) == pytest.approx([0.1, -0.1, 0.2])


def test_overlap_agrees_with_the_active_gaps_of_a_run() -> None:
    measured = physics_of(scene_run("fig4"))
    assert measured["overlap"] == pytest.approx(-measured["active_gap"], rel=1e-6)
    assert 0 < measured["overlap"] < 1e-3


@pytest.fixture(scope="module")
def dropped() -> Run:
    """A unit box that falls 0.1 m onto the ground."""
    return simulate(one_box(y=0.6, end_time=0.3), make_solver("glambda"))


def test_what_falls_loses_its_energy_at_the_impact(dropped: Run) -> None:
    found = energy(dropped)
    assert found["lost_at_impulses"] == pytest.approx(0.1 * 9.81, rel=1e-3)
    assert found["gained_at_impulses"] == 0.0
    assert found["gained_at_steps"] < 2e-3  # the first two steps are of first order
    assert found["final_energy"] == pytest.approx(0.5 * 9.81, rel=1e-6)
    assert found["peak_kinetic"] == pytest.approx(0.1 * 9.81, rel=1e-3)


def test_the_work_of_a_load_is_no_gain() -> None:
    pushed = one_box(forces=(Load(0, (5.0, 0.0, 0.0), 0.1, 0.3),), end_time=0.4)
    run = simulate(pushed, make_solver("glambda"))
    found = energy(run)
    assert run.kinetic_energy()[-1] == pytest.approx(0.5 * (5.0 * 0.2) ** 2, rel=1e-3)
    assert found["gained_at_steps"] < 1e-2 * run.kinetic_energy()[-1]
    bare = energy(simulate(one_box(v=(1.0, 0.0, 0.0), end_time=0.4), make_solver("glambda")))
    assert bare["gained_at_steps"] < 1e-12


def test_an_external_impulse_is_no_gain() -> None:
    run = scene_run("fig4")  # it begins with one
    assert run.kinetic_energy()[:2] == pytest.approx([0.0, run.kinetic_energy()[1]])
    assert run.kinetic_energy()[1] > 10.0
    assert energy(run)["gained_at_impulses"] < 1e-12


def test_each_step_and_impulse_has_one_last_answer() -> None:
    for name in ("fig4", "fig5"):
        run = scene_run(name)
        answers = list(last_answers(run))
        assert len(answers) == run.counts["steps"] + run.counts["impulses"]
        assert {qp.t for qp, _ in answers} <= set(run.t.tolist())


def test_exact_answers_meet_signorini(dropped: Run) -> None:
    found = signorini(dropped)
    assert found["approach"] < 1e-12
    assert found["pull"] == 0.0
    assert found["pumped"] < 1e-12


def sloppy_run(noise: str, setting: str) -> Run:
    return simulate(one_box(end_time=0.2), InLoop(f"sloppy[{noise}]", setting))


def test_forces_too_small_approach_and_forces_too_large_pump() -> None:
    """A standing box: ‖A δλ‖ = tol changes g_Nᵀq̇ by (h/α₀) tol, the work by λ times that."""
    less, more = (signorini(sloppy_run(noise, "300x")) for noise in ("less", "more"))
    assert less["approach"] > 1e-4
    assert less["pumped"] == 0.0
    assert more["approach"] == 0.0
    assert more["pumped"] > 1e-4
    lifted = energy(sloppy_run("more", "300x"))
    # all that the box has gained was pumped in
    assert lifted["gained_at_steps"] == pytest.approx(more["pumped"], rel=0.5)
    assert sloppy_run("less", "300x").gaps.min() < -1e-5


def test_a_contact_that_is_never_without_force_is_dropped_all_the_same() -> None:
    """Boxes of fig2 part at 0.39 s, whether or not a multiplier is ever exactly 0."""
    exact, inside = (
        reach(simulate(scene("fig2"), InLoop(*solver), until=0.8))
        for solver in (("glambda", "paper"), ("sloppy[inside]", "1e-4x"))
    )
    assert 0 < exact < 1e-3
    assert inside == pytest.approx(exact, abs=1e-9)


def test_reach_is_the_distance_of_the_corner_from_its_edge() -> None:
    run = simulate(one_box(y=0.5, end_time=0.1), make_solver("glambda"))
    assert reach(run) == pytest.approx(0.0, abs=1e-15)
    lifted = replace(run, q=run.q + np.array([0.3, 0.2, 0.0]))
    assert reach(lifted) == pytest.approx(0.2)
    stack = replace(scene_run("fig5"), q=scene_run("fig5").q * 1.0)
    stack.q[:, 2, 1] += 0.1  # the box that lies on the two others
    assert reach(stack) > 0.09


def test_the_accuracy_of_the_answers_is_measured() -> None:
    exact = accuracy_of_answers(sloppy_run("any", "1e-4x"))
    assert exact["eps0_ratio"] == pytest.approx(1e-4, rel=1e-3)
    assert exact["missed"] == 0
    run = sloppy_run("any", "100x")
    found = accuracy_of_answers(run)
    assert found["eps0_ratio"] == pytest.approx(100, rel=1e-6)
    assert found["eps0_ratio_median"] == pytest.approx(100, rel=1e-6)
    assert found["missed"] == sum(qp.kind != "minimum_norm" and qp.k > 0 for qp in run.qps)
    assert found["rank_deficient"] == 0.0
    assert accuracy_of_answers(scene_run("fig5"))["rank_deficient"] > 0.3
