"""Steps are the same whoever solves their QPs: a compiled method, or a solver that is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.bodies.bodies import box, polygon_body
from problems.bodies.forces import Load
from problems.bodies.shapes import box_corners
from problems.contacts.geometry import HalfPlane
from problems.friction import newton_coulomb
from problems.sequence import WARM_KINDS
from problems.stepping import driver, records
from problems.stepping.stepper import Stepper, StepperOptions
from solvers import make_solver

SAME = 1e-10
"""Rounding, as far as the motions of these scenes magnify it [m]."""


def both(name: str, parameters: dict, **options):
    runs = [
        simulate(scene(name, **parameters), make_solver("glambda"), keep_qps=keep, **options)
        for keep in (True, False)
    ]
    return runs


@pytest.mark.parametrize(
    ("name", "parameters", "until"),
    [
        ("fig2", {}, 1.5),
        ("fig3", {}, 1.0),
        ("fig4", {}, 1.5),
        ("fig5", {}, 1.0),
        ("tower", {"bodies": 10}, 0.5),
        ("tower", {"bodies": 6, "mu": 0.5}, 0.5),
        ("wall", {"bodies": 12}, 0.3),
        ("wall", {"bodies": 7, "mu": 0.3}, 0.2),
        ("heap", {"bodies": 6}, 0.25),
    ],
)
def test_steps_of_a_compiled_method_are_those_of_a_solver_that_is_asked(name, parameters, until):
    kept, left = both(name, parameters, until=until)
    # rounding may decide whether (4.8) is posed once more, without its Coulomb rows
    assert left.counts == kept.counts | {"qps": pytest.approx(kept.counts["qps"], abs=1)}
    assert [event.kind for event in left.event_log] == [event.kind for event in kept.event_log]
    np.testing.assert_allclose(left.t, kept.t, rtol=0, atol=SAME)
    np.testing.assert_allclose(left.q, kept.q, rtol=0, atol=SAME)
    np.testing.assert_allclose(left.v, kept.v, rtol=0, atol=100 * SAME)
    np.testing.assert_allclose(left.gaps, kept.gaps, rtol=0, atol=SAME)
    # where contacts share a load without friction λ is not unique, and A λ is
    shared = name == "wall" and "mu" not in parameters
    posed = {qp.t: qp for qp in kept.qps if qp.accepted and qp.kind in WARM_KINDS}
    for t, one, other in zip(kept.t, left.multipliers, kept.multipliers, strict=True):
        assert list(one) == list(other)
        values = [np.array(list(each.values())) for each in (one, other)]
        if shared and other:
            assert posed[t].row_id.tolist() == list(other)
            values = [posed[t].A @ each for each in values]
        np.testing.assert_allclose(*values, rtol=1e-6, atol=1e-6)
    assert (left.qps, left.solutions) == ([], [])


@pytest.mark.parametrize(
    ("name", "parameters", "until", "options"),
    [
        ("fig2", {}, 0.5, {"fixed_step": 1e-3}),
        ("fig2", {}, 0.5, {"order": 1}),
        ("fig2", {}, 0.5, {"eps": 1e-5}),
        ("fig4", {}, 0.12, {"friction": "paper", "eps": 3e-4}),
        ("fig4", {"mu_I": 0.5}, 1.0, {"impulses": "newton_coulomb"}),
        ("fig5", {"mu_I": 0.4}, 0.4, {"impulses": "newton_coulomb"}),
        ("fig4", {}, 0.5, {"stops": "held"}),
    ],
)
def test_they_are_with_other_options(name, parameters, until, options):
    kept, left = both(name, parameters, until=until, **options)
    # a collision with redundant contacts takes a few passes more or less, as rounding has it
    passes = 2 if options.get("impulses") == "newton_coulomb" else 0
    posed = pytest.approx(kept.counts["qps"], abs=passes * kept.counts["impulses"])
    assert left.counts == kept.counts | {"qps": posed}
    # passes of a collision end where q̇₊ changes by less than this: each run somewhere within it
    settled = newton_coulomb.SETTLED_BY * max(1.0, np.abs(kept.v).max()) if passes else 0.0
    np.testing.assert_allclose(left.q, kept.q, rtol=0, atol=SAME + settled)


@pytest.mark.parametrize("name", ["fig3", "fig4", "fig5"])
def test_steps_of_another_solver_are_the_same(name):
    ours, theirs = (
        simulate(scene(name), make_solver(solver), until=0.8) for solver in ("glambda", "daqp")
    )
    assert theirs.counts == ours.counts
    assert [event.kind for event in theirs.event_log] == [event.kind for event in ours.event_log]
    np.testing.assert_allclose(theirs.q, ours.q, rtol=0, atol=1e-6)


def first_end(made: Scene, before: float | None = None) -> int:
    """How the first call ends that takes a step of 0.1 s; v of body 1 was `before` 0.1 s ago."""
    options = StepperOptions.of(made.eps, fixed_step=0.1)
    stepper = Stepper(made, make_solver("glambda"), options, keep_qps=False)
    stepper.start()
    history = stepper.system.history
    if before is not None:
        v_before = np.array([0.0, before, 0.0])
        history.resume(history.v, v_before, [np.zeros(3), np.zeros(3)], 0.1, 2)
    stepper._driver.begin(0.1)
    return stepper._driver.go_on()


def box_at(y: float, speed: float) -> Scene:
    """A box of height 1 above the ground, without gravity."""
    still = {"bodies": (box(1.0, 1.0),), "gravity": 0.0}
    return Scene(q0=[(0.0, y, 0.0)], v0=[(0.0, speed, 0.0)], **still)


@pytest.mark.parametrize(
    ("speed", "hits"), [(-1.0, False), (-1.99, False), (-2.01, True), (0.0, False)]
)
def test_what_may_be_hit_is_for_the_stepper(speed, hits):
    """A box 0.2 above the ground falls for 0.1 s."""
    assert (first_end(box_at(0.7, speed)) == records.MEETS) == hits


@pytest.mark.parametrize(("speed", "hits"), [(-10.0, True), (-5.0, False)])
def test_what_is_hit_on_the_way_is_seen(speed, hits):
    """Down and up again within the step: at the end the box is where it was."""
    assert (first_end(box_at(0.7, speed), before=3 * speed) == records.MEETS) == hits


@pytest.mark.parametrize("shift", [0.0, 7.4, 7.6, -7.4, -7.6])
def test_corners_beyond_their_edge_are_for_the_stepper(shift):
    """A box slides along another, 1.5 long, on which its lower left corner is in the middle."""
    made = Scene(
        bodies=(box(1.5, 1.0, 1e9), polygon_body([(0, 0), (0.4, 1.0), (-0.4, 1.0)])),
        q0=[(0.0, 0.5, 0.0), (0.0, 1.0 + 2 / 3, 0.0)],
        v0=[(0.0, 0.0, 0.0), (shift, 0.0, 0.0)],
    )
    assert (first_end(made) == records.MEETS) == (abs(shift) > 7.5)


@pytest.mark.parametrize("keep", [True, False])
def test_a_hand_over_of_a_longer_trial_is_undone_with_it(keep):
    """A trial in which a corner would leave its edge is redone, shorter, and it does not."""
    made = scene("tower", bodies=3, lean=0.1)
    run = simulate(made, make_solver("glambda"), eps=1e-6, until=0.08, keep_qps=keep)
    assert run.t[-1] == pytest.approx(0.08)


def test_two_first_order_steps_after_a_restart(monkeypatch):
    monkeypatch.setattr(driver, "MOST", 1)  # a step a call
    stepper = Stepper(scene("fig2"), make_solver("glambda"), StepperOptions.of(1e-3))
    stepper.start()
    orders = []
    for _ in range(4):
        stepper.advance(1.0)
        orders.append(int(stepper._driver.trial["order"]))
    assert stepper.system.counts["steps"] == 4
    assert orders == [1, 1, 2, 2]


@pytest.mark.parametrize(("name", "until"), [("fig2", 0.7), ("fig4", 1.5), ("fig5", 2.0)])
def test_most_steps_are_left_to_compiled_code(name, until, monkeypatch):
    seen, see = [], Stepper._see_to_step
    monkeypatch.setattr(
        Stepper, "_see_to_step", lambda self, *args: seen.append(self.system.t) or see(self, *args)
    )
    run = simulate(scene(name), make_solver("glambda"), until=until, keep_qps=False)
    assert len(seen) < 0.3 * run.counts["steps"]


def test_redundant_contacts_that_all_slide_share_their_load():
    """Three tall feet of one body slide on the ground; friction takes the load off the hindmost."""
    places = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    sledge = Scene(
        name="sledge",
        bodies=(polygon_body([box_corners(0.4, 3.0) + place for place in places]),),
        ground=(HalfPlane(),),
        q0=np.array([[0.0, 1.5, 0.0]]),
        v0=np.array([[2.0, 0.0, 0.0]]),
        mu=0.45,
        end_time=0.3,
    )
    solver = make_solver("glambda")
    kept, left = (simulate(sledge, solver, keep_qps=keep) for keep in (True, False))
    assert left.counts == kept.counts and kept.counts["qps"] > 2 * kept.counts["steps"]
    np.testing.assert_allclose(left.q, kept.q, rtol=0, atol=SAME)
    for one, other in zip(left.multipliers, kept.multipliers, strict=True):
        np.testing.assert_allclose(list(one.values()), list(other.values()), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("name", "until"), [("fig2", 0.9), ("fig4", 0.5), ("fig5", 0.5)])
def test_steps_of_several_calls_are_those_of_one(name, until, monkeypatch):
    runs = []
    for most in (driver.MOST, 2, 1):
        monkeypatch.setattr(driver, "MOST", most)
        runs.append(simulate(scene(name), make_solver("glambda"), until=until, keep_qps=False))
    for run in runs[1:]:
        np.testing.assert_array_equal(run.q, runs[0].q)
        np.testing.assert_array_equal(run.gaps, runs[0].gaps)
        assert run.multipliers == runs[0].multipliers
        assert run.event_log == runs[0].event_log and run.counts == runs[0].counts


def test_compiled_calls_are_made_with_the_same_types_always(monkeypatch):
    """What is called directly does not look at them."""
    import numba

    calls = (driver, "run_steps"), (newton_coulomb, "run_fixed_point")
    for module, name in calls:
        code, seen = getattr(module, name), set()

        def watched(*arguments, code=code, seen=seen):
            seen.add(tuple(numba.typeof(argument) for argument in arguments))
            return code(*arguments)

        monkeypatch.setattr(module, name, watched)
        for case, parameters in (
            ("fig2", {}),
            ("fig4", {"mu_I": 0.5}),
            ("fig5", {"mu_I": 0.4}),
            ("heap", {"bodies": 2, "mu": 0.4}),
            ("tower", {"bodies": 1}),
        ):
            simulate(
                scene(case, **parameters),
                make_solver("glambda", accuracy=1e-9 if case == "fig4" else None),
                until=0.6,
                eps=0.01,
                impulses="newton_coulomb",
                keep_qps=case == "fig5",
            )
        assert len(seen) == 1


def test_a_solver_without_compiled_steps_goes_step_by_step():
    runs = [
        simulate(scene("fig2"), make_solver("daqp"), until=0.2, keep_qps=keep)
        for keep in (True, False)
    ]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    assert runs[0].counts == runs[1].counts and not runs[1].qps


def test_a_load_that_begins_is_obeyed():
    from dataclasses import replace

    from problems.bodies.forces import Load

    pushed = replace(scene("fig2"), forces=(Load(4, (1.5, 0.0, 0.0), 0.1, 0.2),))
    kept, left = (
        simulate(pushed, make_solver("glambda"), until=0.35, keep_qps=keep)
        for keep in (True, False)
    )
    np.testing.assert_allclose(left.q, kept.q, rtol=0, atol=SAME)
    assert abs(left.v[-1, 4, 0] - 0.1) < 1e-2


def test_a_rest_that_has_ended_is_forgotten():
    """A box slows down to rest within compiled steps; that it had rested before counts no more."""
    sliding = Scene(
        bodies=(box(1.0, 1.0),),
        q0=np.array([[0.0, 0.5, 0.0]]),
        v0=np.array([[2.2e-3, 0.0, 0.0]]),
        forces=(Load(0, (-5e-3, 0.0, 0.0)),),
        stop_at_rest=True,
    )
    options = StepperOptions.of(sliding.eps)
    stepper = Stepper(sliding, make_solver("glambda"), options, keep_qps=False)
    stepper.start()
    stepper.system.rest_since = -1.0
    stepper.advance(1.0)
    assert stepper.system.counts["steps"] > 1
    assert [event.kind for event in stepper.system.event_log] == ["rest"]
    assert stepper.system.rest_since == stepper.system.t


def test_a_corner_that_left_sunk_comes_back_to_the_edge():
    """Its reference level is forgotten far outside, on the way too."""
    fig4 = scene("fig4")
    sunk = replace(fig4, q0=fig4.q0 - [0.0, 1e-5, 0.0])
    stepper = Stepper(sunk, make_solver("glambda"), StepperOptions.of(1e-4), keep_qps=False)
    stepper.start()
    assert stepper.system.graph.candidates.levels()
    while stepper.system.t < 0.1:
        stepper.advance(0.1)
    assert stepper.system.t == 0.1
    assert [event.kind for event in stepper.system.event_log].count("drop") == 2
    candidates = stepper.system.graph.candidates
    pose = stepper.system.graph.geometry.pose(stepper.system.q)
    clearance = stepper.system.graph.geometry.clearance(pose, candidates.corner, candidates.part)
    assert not candidates.level[clearance > 1e-3].any()
