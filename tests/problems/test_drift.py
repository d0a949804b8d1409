"""Stabilization of drift: gaps close, and the motion stays what it was."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from problems import scene, simulate
from problems.bodies.bodies import polygon_body
from problems.contacts.geometry import HalfPlane
from problems.scenes import Scene
from problems.sequence import SimulationError
from problems.stepping.drift import correction
from solvers import make_solver

SCENES = [("fig2", 0.7), ("fig4", 0.6), ("fig5", 0.8)]


def runs(name, until, **options):
    return {
        rule: simulate(scene(name), make_solver("glambda"), until=until, drift=rule, **options)
        for rule in ("none", "baumgarte", "projection")
    }


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("redundant", [False, True])
def test_correction_is_the_shortest_that_does_it(sparse, redundant):
    rng = np.random.default_rng(3)
    A, D = rng.normal(size=(9, 4)), rng.uniform(0.5, 2.0, 9)
    wanted = rng.normal(size=4)
    if redundant:
        A = np.column_stack([A, A[:, 0] + A[:, 1]])
        wanted = np.append(wanted, wanted[0] + wanted[1])
    u = correction(sp.csc_array(A) if sparse else A, D, wanted)
    np.testing.assert_allclose((D[:, None] * A).T @ u, wanted, atol=1e-10)
    np.testing.assert_allclose(D * u, np.linalg.pinv(A.T) @ wanted, atol=1e-10)


def test_no_gap_needs_no_correction():
    assert not correction(np.ones((3, 1)), np.ones(3), np.zeros(1)).any()
    assert not correction(np.ones((3, 0)), np.ones(3), np.zeros(0)).any()


@pytest.mark.parametrize(("name", "until"), SCENES)
def test_gaps_close(name, until):
    depth = {rule: -run.gaps.min() for rule, run in runs(name, until).items()}
    assert depth["projection"] < 0.01 * depth["none"]
    assert depth["baumgarte"] < depth["none"]


@pytest.mark.parametrize(("name", "until"), SCENES)
def test_the_motion_stays_within_the_error_of_a_step(name, until):
    found = runs(name, until, eps=1e-4)
    exact = simulate(scene(name), make_solver("glambda"), until=until, eps=1e-6, h_max=2e-3)
    for rule, run in found.items():
        assert np.abs(run.q[-1] - exact.q[-1]).max() < 5e-3, rule
        assert np.abs(run.v[-1] - exact.v[-1]).max() < 5e-2, rule


def test_baumgarte_gaps_decay_in_its_time():
    """A box that drift has laid 0.01 mm too high on the ground sinks as exp(−t/τ)."""
    from problems.stepping.stepper import Stepper, StepperOptions

    tau = 0.05
    options = StepperOptions(
        1e-3, 1e-3, rest_speed=1e-9, h_max=5e-4, drift="baumgarte", drift_time=tau
    )
    made = scene("fig2", boxes=1, velocity=0.0, pushed=1)
    stepper = Stepper(made, make_solver("glambda"), options)
    stepper.start()
    stepper.system.q[1] += 1e-5
    stepper.advance(1.0)
    (t0, q0), start = (stepper.system.t, stepper.system.q[1] - 0.5), 1e-5
    assert 0 < q0 < 1.01 * start
    while stepper.system.t < 0.2:
        stepper.advance(1.0)
    assert stepper.system.q[1] - 0.5 == pytest.approx(
        q0 * np.exp(-(stepper.system.t - t0) / tau), rel=0.02
    )


def test_a_gap_that_baumgarte_closes_is_no_wrong_answer():
    """0.3 mm at τ = 0.01 close at 0.03 m/s; it is looked at anew when the contacts change."""
    from problems.stepping.stepper import Stepper, StepperOptions

    options = StepperOptions(1e-3, 1e-3, rest_speed=1e-9, drift="baumgarte", drift_time=0.01)
    made = scene("fig2", boxes=1, velocity=0.0, pushed=1)
    stepper = Stepper(made, make_solver("glambda"), options)
    stepper.start()
    stepper.system.q = stepper.system.q + np.array([0.0, 3e-4, 0.0])
    stepper.system.history.restart(np.array([0.0, -0.03, 0.0]))
    stepper.advance(1.0)
    assert len(stepper.system.graph.normals) == 2
    stepper.system.history.restart(np.array([0.0, -0.3, 0.0]))
    with pytest.raises(SimulationError, match="approaches at"):
        stepper.advance(1.0)


def test_contacts_that_almost_contradict_each_other_are_not_torn_apart():
    """To close 0.7 µm where edge lies on edge and corner on slope, bodies were moved by 0.9 m."""
    triangle = polygon_body([(0.15, 0.41), (-0.38, -0.10), (0.22, -0.31)])
    thick, long = 0.15, 0.98
    foot = [(0, 0), (long, 0), (long, thick), (0, thick)]
    leg = [(0, thick), (thick, thick), (thick, long), (0, long)]
    wedged = Scene(
        bodies=(triangle, polygon_body([np.array(foot), np.array(leg)])),
        q0=[(0.08, 1.24, 0.0), (-0.14, 2.42, -2.36)],
        v0=[(-0.87, 0.0, -0.49), (0.24, 0.0, 0.85)],
        ground=(HalfPlane((0.0, 0.0), (-0.19, 1.0)),),
        mu=0.3,
        end_time=1.5,
    )
    run = simulate(wedged, make_solver("glambda"), drift="projection")
    assert run.t[-1] == pytest.approx(1.5)
    assert run.gaps.min() > -10 * wedged.eps
    assert np.abs(np.diff(run.q, axis=0)).max() < 0.3  # at 10 m/s for the longest step: 0.2


def test_an_unknown_rule_is_refused():
    with pytest.raises(ValueError, match="drift = 'spring'; choose one of none, baumgarte"):
        simulate(scene("fig2"), make_solver("glambda"), drift="spring")
    with pytest.raises(ValueError, match="drift_time"):
        simulate(scene("fig2"), make_solver("glambda"), drift_time=0.0)


def test_rest_is_no_turning_point():
    """A box thrown up is still at the top of its flight, but not at rest."""
    from dataclasses import replace

    made = scene("fig2", boxes=1, velocity=0.0, pushed=1, end_time=2.0)
    thrown = replace(made, v0=np.array([[0.0, 1.0, 0.0]]), stop_at_rest=True)
    run = simulate(thrown, make_solver("glambda"), rest_speed=0.1)
    top = 1.0 / 9.81
    assert run.t[-1] > 2 * top
    assert run.event_log[-1].kind == "rest"
    assert abs(run.q[-1, 0, 1] - 0.5) < 1e-3
