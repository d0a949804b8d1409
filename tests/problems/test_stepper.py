"""Algorithm 1: orders, events, laws of the motion, and the paper's figures."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from problems import scene, simulate
from problems.bodies.bodies import box, polygon_body
from problems.bodies.forces import Impulse, Load
from problems.qp import Solution, Status
from problems.scenes import Scene
from problems.sequence import SimulationError
from problems.stepping.events import TOUCH_TOL
from problems.stepping.run import EVENT_KINDS
from problems.stepping.stepper import Stepper
from solvers import make_solver
from tests.fakes.runs import leaning_box, one_box, scene_run

SCENES = ("fig2", "fig3", "fig4", "fig5")


def glambda():
    return make_solver("glambda")


# --- order of convergence ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "start",
    [
        leaning_box(),
        leaning_box(spring=True),
        leaning_box(mu=0.3, speed=8.0),
        leaning_box(mu=0.3, speed=-8.0),
    ],
    ids=["frictionless", "spring-damper", "sliding right", "sliding left"],
)
def test_order_two_in_q_v_lambda_and_phi(start):
    """Self-convergence at fixed h on a smooth stretch (§3.1; §4.1 with a converged start)."""
    results = []
    for h in (0.005, 0.0025, 0.00125):
        run = simulate(start, glambda(), eps=1e-9, fixed_step=h)
        assert not run.event_log, "the stretch is smooth"
        at = np.searchsorted(run.t, 0.05 * np.arange(1, 9) - 1e-6)
        lam = np.array([run.multipliers[i][0] for i in at])
        results.append((run.q[at], run.v[at], lam, run.gaps[at]))
    for coarse, middle, fine in zip(*results, strict=True):
        ratio = np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)
        assert np.log2(ratio) == pytest.approx(2.0, abs=0.1)


def test_a_start_by_4_4_is_first_order_with_sliding_friction():
    """The paper's rule, published as it is."""
    results = [
        simulate(
            leaning_box(mu=0.3, speed=8.0), glambda(), eps=1e-9, fixed_step=h, friction="paper"
        ).q[-1]
        for h in (0.005, 0.0025, 0.00125)
    ]
    ratio = np.linalg.norm(results[0] - results[1]) / np.linalg.norm(results[1] - results[2])
    assert np.log2(ratio) == pytest.approx(1.0, abs=0.3)


# --- laws ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENES)
def test_energy_never_rises_and_nothing_sinks_in(name):
    run = scene_run(name)
    energy = run.kinetic_energy() + run.potential_energy()
    start = 1 if run.scene.impulses else 0  # after the initial impulse
    energy = energy[start:]
    rise = (energy - np.minimum.accumulate(energy)).max() / energy[0]
    assert rise <= 1e-3
    assert run.gaps.min() >= -5e-3


def test_momentum_of_fig2_is_kept():
    run = scene_run("fig2")
    masses = np.array([body.mass for body in run.scene.bodies])
    np.testing.assert_allclose(run.v[:, :, 0] @ masses, 3.0, atol=1e-9)


def test_resting_tower_stays():
    run = simulate(scene("fig2", velocity=0.0, mu=0.5), glambda(), until=1.0)
    assert np.abs(run.q[-1] - run.q[0]).max() < 1e-9
    assert np.abs(run.v).max() < 1e-9
    assert not run.event_log


@pytest.mark.parametrize("velocity", [0.0, 1e-6])
@pytest.mark.parametrize("boxes", [5, 60])
def test_towers_at_rest_do_not_drift(boxes, velocity):
    """100 fixed steps, from rest and after random velocities; `benchmarks/steps.py` has 1,000."""
    start = scene("tower", bodies=boxes, mu=0.5, speed=0.0, jitter=0.0)
    kick = velocity * np.random.default_rng(0).uniform(-1, 1, (boxes, 3))
    run = simulate(
        replace(start, v0=kick),
        glambda(),
        eps=1e-9,
        drop_tol=1e-3,
        fixed_step=1 / 240,
        until=100 / 240,
    )
    assert run.t[-1] == pytest.approx(100 / 240)
    assert np.abs(run.q[-1] - start.q0).max() <= (1e-9 if velocity else 1e-12)
    assert np.abs(run.v[-1]).max() <= 1e-10


# --- the figures ---------------------------------------------------------------------------------


def test_fig2_ends_as_the_paper_says():
    """Body 1 moves right, 4 and 5 left, when the simulation is interrupted."""
    run = scene_run("fig2")
    vx = run.v[-1, :, 0]
    assert run.t[-1] == pytest.approx(6.0)
    assert vx[0] > 0
    assert vx[3] < 0
    assert vx[4] < 0
    assert 25 <= run.counts["impulses"] <= 50


def test_fig3_hits_when_the_paper_says():
    run = scene_run("fig3")
    hits = [e.t for e in run.event_log if e.kind == "impulse"]
    assert hits[0] == pytest.approx(0.7302, abs=0.01)
    assert hits[1] == pytest.approx(2.1151, abs=0.01)
    vx = np.interp(4.60, run.t, run.v[:, 0, 0])
    assert vx == pytest.approx(0.69, abs=0.005)
    energy = run.kinetic_energy()
    late = run.t > 3
    inner = energy[1:-1]
    peaks = inner[late[1:-1] & (inner > energy[:-2]) & (inner >= energy[2:])]
    assert len(peaks) >= 3
    assert (np.diff(peaks) < 0).all(), "each swing has less kinetic energy than the one before"


def test_fig4_comes_to_rest_indeterminate():
    run = scene_run("fig4")
    assert run.event_log[-1].kind == "rest"
    last = [qp for qp in run.qps if qp.kind in ("step", "corrector") and qp.accepted][-1]
    assert last.A.shape == (9, 11)
    assert np.linalg.matrix_rank(last.dense_A) == 9


def test_fig4_zigzags_with_friction_impulses():
    assert scene_run("fig4", mu_I=0.8).event_log[-1].kind == "rest"
    many, few = (scene_run("fig4", **kw).counts["impulses"] for kw in ({"mu_I": 0.8}, {}))
    assert many > 5 * few


def test_fig4_with_friction_impulses_is_near_its_limit():
    """With ε = 1e-3 an impulse passed a gap of 11 µm; body 1 came to rest 5 cm from here."""
    fine = simulate(scene("fig4", mu_I=0.8), glambda(), eps=5e-4, keep_qps=False)
    found = scene_run("fig4", mu_I=0.8).q[-1]
    np.testing.assert_allclose(found, fine.q[-1], rtol=0, atol=1e-2)


def test_fig5_is_indeterminate_first_and_last_and_comes_to_rest():
    run = scene_run("fig5")
    assert run.event_log[-1].kind == "rest"
    steps = [qp for qp in run.qps if qp.kind in ("step", "corrector") and qp.accepted]
    for qp in (steps[0], steps[-1]):
        assert np.linalg.matrix_rank(qp.dense_A) < qp.k


def test_another_solver_in_the_loop_gives_the_same_motion():
    """The motion depends on Gλ, which is unique, not on λ, which is not."""
    ours, theirs = scene_run("fig4"), simulate(scene("fig4"), make_solver("daqp"))
    assert [e.kind for e in ours.event_log] == [e.kind for e in theirs.event_log]
    np.testing.assert_allclose(ours.q[-1], theirs.q[-1], atol=1e-4)


# --- events --------------------------------------------------------------------------------------


def test_a_falling_box_hits_when_it_should():
    run = simulate(one_box(y=1.5, end_time=1.0), glambda(), eps=1e-5)
    hit = next(e for e in run.event_log if e.kind == "impulse")
    assert hit.t == pytest.approx(np.sqrt(2 * 1.0 / 9.81), abs=1e-4)
    assert abs(run.q[-1, 0, 1] - 0.5) < 1e-5


def test_the_collision_is_located_on_the_position():
    run = simulate(one_box(y=1.5, angle=0.3, end_time=1.0), glambda())
    hit = next(e for e in run.event_log if e.kind == "impulse")
    at = np.flatnonzero(run.t == hit.t)[0]
    _, y, angle = run.q[at, 0]
    c, s = np.cos(angle), np.sin(angle)
    lowest = min(y + s * a + c * b for a in (-0.5, 0.5) for b in (-0.5, 0.5))
    assert abs(lowest) < 1e-12


def test_a_load_restarts_at_its_jumps_and_moves_the_box():
    scene_ = one_box(
        mu=0.3, forces=(Load(0, (6.0, 0, 0), 0.5, 1.0),), end_time=4.0, stop_at_rest=True
    )
    run = simulate(scene_, glambda())
    jumps = [e.t for e in run.event_log if e.kind == "force_jump"]
    assert jumps == [pytest.approx(0.5), pytest.approx(1.0)]
    # (6 − μ m g) for 0.5 s, then −μ g until it stands
    speed = (6 - 0.3 * 9.81) * 0.5
    expected = speed * 0.5 / 2 + speed**2 / (2 * 0.3 * 9.81)
    assert run.q[-1, 0, 0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize("nudge", [0.03, 0.07, 0.11, 0.19])
def test_a_step_that_ends_where_a_load_begins_is_not_of_it(nudge, keep):
    """0.03 + (0.3 − 0.03) > 0.3 in floating point."""
    scene_ = one_box(
        impulses=(Impulse(nudge, 0, (0.0, 0.0, 0.1)),),
        forces=(Load(0, (1.0, 0.0, 0.0), 0.3),),
        gravity=0.0,
    )
    scene_ = replace(scene_, ground=())
    run = simulate(scene_, glambda(), fixed_step=0.5, keep_qps=keep)
    assert run.v[-1, 0, 0] == pytest.approx(0.7, abs=1e-12)
    assert [event.kind for event in run.event_log] == ["impulse", "force_jump"]


def test_a_box_pushed_over_the_end_of_a_table_slides_off():
    table, slider = box(3.0, 1.0), box(0.5, 0.5)
    scene_ = Scene(
        bodies=(table, slider),
        q0=np.array([[0, 0.5, 0], [1.0, 1.25, 0]]),
        v0=np.array([[0, 0, 0], [3.0, 0, 0]]),
        end_time=1.5,
    )
    run = simulate(scene_, glambda())
    kinds = {e.kind for e in run.event_log}
    assert {"hand_over", "impulse"} <= kinds
    assert run.q[-1, 1, 1] == pytest.approx(0.25, abs=1e-3), "it lies on the ground"
    assert run.q[-1, 1, 0] > 1.75


def test_separating_bodies_are_dropped_without_restart():
    scene_ = one_box(forces=(Load(0, (0, 20.0, 0), 0.2),), end_time=0.5)
    run = simulate(scene_, glambda())
    assert run.event_log[0].kind == "force_jump"
    assert "drop" in {e.kind for e in run.event_log}
    assert run.counts["restarts"] == 1
    assert run.q[-1, 0, 1] > 0.5


@pytest.mark.parametrize("keep", [True, False])
def test_a_box_that_rose_slowly_is_pressed_back_to_the_ground(keep):
    load = Load(0, (0, -1.0, 0), 20.0)
    slow = one_box(v=(0, 9e-4, 0), gravity=0.0, forces=(load,), end_time=25.0)
    run = simulate(slow, glambda(), keep_qps=keep)
    assert run.q[np.searchsorted(run.t, 20.0), 0, 1] == pytest.approx(0.518), "it rises"
    assert run.q[-1, 0, 1] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("keep", [True, False])
def test_a_wheel_that_rolls_slowly_stays_on_the_ground(keep):
    corners, spin = 100, 0.005
    angle = 2 * np.pi * (np.arange(corners) + 0.5) / corners - np.pi / 2
    wheel = polygon_body(np.column_stack([np.cos(angle), np.sin(angle)]))
    height = np.cos(np.pi / corners)
    rolls = Scene(
        bodies=(wheel,),
        q0=[[0, height, 0]],
        v0=[[spin * height, 0, -spin]],
        gravity=0.0,
        forces=(Load(0, (0, -1e-3, 0)),),
        end_time=60.0,
    )
    run = simulate(rolls, glambda(), h_max=0.2, keep_qps=keep)
    assert (run.q[:, 0, 1] >= height - 1e-4).all()
    assert (run.q[:, 0, 1] <= 1 + 1e-4).all()


def flat(*ends):
    """Corners of flush parts 1 m high, from end to end."""
    return [np.array([(a, -0.5), (b, -0.5), (b, 0.5), (a, 0.5)]) for a, b in pairwise(ends)]


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize("mu", [0.0, 0.1])
@pytest.mark.parametrize("apart", [False, True])
def test_a_seam_is_not_in_the_way_of_a_box_that_slides(apart, mu, keep):
    table = (box(2, 1, 1e6),) * 2 if apart else (polygon_body(flat(-2, 0, 2), 1e6),)
    below = [[-1, 0.5, 0], [1, 0.5, 0]] if apart else [[0, 0.5, 0]]
    slides = Scene(
        bodies=(*table, box(0.6, 0.3)),
        q0=[*below, [-1.2, 1.15, 0]],
        v0=[*np.zeros((len(table), 3)), [2.0, 0, 0]],
        mu=mu,
        end_time=1.0,
    )
    run = simulate(slides, glambda(), keep_qps=keep)
    brake = mu * slides.gravity
    np.testing.assert_allclose(run.q[-1, -1], [0.8 - brake / 2, 1.15, 0], rtol=0, atol=1e-3)
    np.testing.assert_allclose(run.v[-1, -1], [2.0 - brake, 0, 0], rtol=0, atol=2e-3)


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize("eps", [1e-3, 3e-4])
def test_a_corner_that_has_sunk_in_slides_off_without_a_collision(eps, keep):
    rng = np.random.default_rng(853)
    q = [rng.uniform(-0.8, 0.8), 1.8, rng.uniform(-0.9, 0.9)]
    v = [rng.uniform(-2, 2), 0, rng.uniform(-2, 2)]
    tilts = Scene(
        bodies=(box(1, 1), box(1, 0.4)),
        q0=[[0, 0.5, 0], q],
        v0=[[0, 0, 0], v],
        end_time=1.5,
    )
    run = simulate(tilts, glambda(), eps=eps, keep_qps=keep)
    assert [e.kind for e in run.event_log if 0.6 < e.t < 0.8] == ["slide_off"]
    assert run.q[-1, 1, 0] == pytest.approx(2.12234, abs=0.5 * eps), "the limit for small eps"


def test_a_tiny_body_far_away_changes_nothing():
    """What counts as the same point is of the two parts that meet, not of all."""
    rng = np.random.default_rng(1954)
    bodies = (box(1, 1), box(1, 0.5), box(1, 0.5), box(0.01, 0.01))
    q = [[0, 0.5, 0], *([rng.uniform(-0.6, 0.6), y, rng.uniform(-0.5, 0.5)] for y in (1.6, 2.8))]
    v = [[0, 0, 0], [rng.uniform(-1, 1), 0, rng.uniform(-1, 1)], [0, 0, 0]]
    far, still = [[100.0, 0.005, 0.0]], [[0.0, 0.0, 0.0]]
    alone = simulate(Scene(bodies[:3], q, v, end_time=2.0), glambda())
    both = simulate(Scene(bodies, [*q, *far], [*v, *still], end_time=2.0), glambda())
    np.testing.assert_allclose(both.q[-1, :3], alone.q[-1], rtol=0, atol=1e-6)


# --- going on from a state of another run ---------------------------------------------------------


def test_a_run_goes_on_from_a_state_of_another():
    whole = simulate(scene("fig5"), glambda())
    i = len(whole.t) * 3 // 4
    rest = replace(whole.scene, q0=whole.q[i], v0=whole.v[i], impulses=())
    run = simulate(rest, glambda(), until=whole.t[-1] - whole.t[i])
    assert np.abs(run.q[-1] - whole.q[-1]).max() < 10 * whole.options["eps"]


def test_what_rested_with_its_drift_rests_on():
    whole = simulate(scene("fig5"), glambda())
    assert whole.gaps[-1] < -TOUCH_TOL  # so that it would collide as new
    run = simulate(replace(whole.scene, q0=whole.q[-1], v0=whole.v[-1], impulses=()), glambda())
    assert {event.kind for event in run.event_log} == {"rest"}
    np.testing.assert_allclose(run.q[-1], whole.q[-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("thrown", "impulses", "y"), [(0.0, 0, 0.5 - 5e-4), (1.0, 1, 0.5)])
def test_a_box_that_has_sunk_a_little_touches_until_it_is_out(thrown, impulses, y):
    run = simulate(one_box(y=0.5 - 5e-4, v=(0.0, thrown, 0.0)), glambda(), until=0.3)
    assert [event.kind for event in run.event_log].count("impulse") == impulses
    assert run.q[-1, 0, 1] == pytest.approx(y, abs=1e-5)


# --- refusals ------------------------------------------------------------------------------------


def test_overlapping_bodies_are_refused_with_the_depth():
    scene_ = Scene(
        bodies=(box(1, 1), box(1, 1)),
        q0=np.array([[0, 0.5, 0], [0.9, 0.5, 0]]),
        v0=np.zeros((2, 3)),
    )
    with pytest.raises(ValueError, match=r"body 1 and body 2 overlap by 0\.1 m"):
        simulate(scene_, glambda())


def test_a_body_in_the_ground_is_refused():
    with pytest.raises(ValueError, match=r"body 1 and the ground overlap by 0\.2 m"):
        simulate(one_box(y=0.3), glambda())


@pytest.mark.parametrize(
    ("size", "eps", "words"),
    [
        (1e-6, 1e-3, r"body 2 is 1\.41e-06 m across.*choose a smaller eps"),
        (5e-3, 1e-3, r"body 2 is 0\.00707 m across"),
        (1e7, 1e-3, r"body 2 reaches to .*e\+07 m.*choose a larger unit of length"),
    ],
)
def test_a_body_of_a_size_that_the_tolerances_are_not_for_is_refused(size, eps, words):
    """The small ones gained energy without a word, the large ones made steps of 1e-8 s."""
    odd = Scene((box(1, 1), box(size, size)), [[0, 0.5, 0], [size, size, 0]], np.zeros((2, 3)))
    with pytest.raises(ValueError, match=words):
        simulate(odd, glambda(), eps=eps)


def test_steps_that_have_become_too_short_end_the_simulation(monkeypatch):
    """As they do for a body whose corners are rounded by more than what counts as touching."""
    monkeypatch.setattr(Stepper, "_check_sizes", lambda _: None)
    large = box(1e7, 1e7)
    spins = Scene((large,), [[0, 5e6 + 0.1, 0]], [[1.0, 0, 1.0]], mu=0.5)
    with pytest.raises(SimulationError, match=r"steps were .* long; body 1, of 1e\+14 kg, counts"):
        simulate(spins, glambda(), keep_qps=False)


@pytest.mark.parametrize("size", [0.01, 1e6])
def test_bodies_of_many_sizes_are_not_refused(size):
    lies = Scene((box(size, size),), [[0, size / 2, 0]], np.zeros((1, 3)), end_time=0.05)
    assert simulate(lies, glambda()).t[-1] == pytest.approx(0.05)


def test_an_impulse_is_not_passed_on_across_a_gap():
    """Two boxes fall; they part more slowly than `drop_tol`, but are apart when one lands."""
    falls = Scene(
        bodies=(box(1, 1), box(1, 1)),
        q0=[[0, 1.5, 0], [0, 2.5, 0]],
        v0=[[0, 0, 0], [0, 5e-4, 0]],
        end_time=0.6,
    )
    run = simulate(falls, glambda())
    assert "drop" in [event.kind for event in run.event_log if event.t < 0.46]
    landed = int(np.flatnonzero(np.diff(run.t) == 0)[0]) + 1
    assert abs(run.v[landed, 0, 1]) < 1e-6 < 4 < -run.v[landed, 1, 1]
    assert run.q[-1, 1, 1] == pytest.approx(1.5, abs=1e-3), "a moment later it is on the other"


class Liar:
    """Claims that no force acts."""

    def solve(self, qp, start=None):
        return Solution(
            x=np.zeros(qp.k),
            row_id=qp.row_id,
            status=Status.SOLVED,
            working_set=np.zeros(qp.k, np.int8),
        )


class Mute:
    """Never has an answer."""

    def solve(self, qp, start=None):
        return Solution(
            x=None, row_id=qp.row_id, status=Status.FAILED, working_set=np.zeros(qp.k, np.int8)
        )


def test_a_lying_solver_is_caught_by_the_motion():
    with pytest.raises(SimulationError, match="although it is active"):
        simulate(one_box(), Liar())


def test_a_mute_solver_ends_the_simulation_with_a_reason():
    with pytest.raises(SimulationError, match="gave no answer to a step QP"):
        simulate(one_box(), Mute())


class Mortal:
    """Solves as it should until t = 0.1 s, and then ends in its own way."""

    def __init__(self, end):
        self.end, self.inner = end, glambda()

    def solve(self, qp, start=None):
        if qp.t > 0.1:
            raise self.end
        return self.inner.solve(qp, start)


@pytest.mark.parametrize("keep", [True, False])
def test_a_run_that_ends_early_keeps_its_motion(keep):
    whole = simulate(one_box(y=0.7), glambda(), until=0.3)
    for end, seen in (
        (ValueError("tired"), SimulationError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):
        with pytest.raises(seen) as told:
            simulate(one_box(y=0.7), Mortal(end), until=0.3, keep_qps=keep)
        run, n = told.value.run, len(told.value.run.t)
        assert 0 < n < len(whole.t) and 0.05 < run.t[-1] < 0.11
        np.testing.assert_array_equal(run.q, whole.q[:n])
        assert run.event_log == whole.event_log[: len(run.event_log)]
        assert run.counts["steps"] == n - 1 - run.counts["impulses"]
        assert len(run.trajectory) == n
        assert all(qp.t <= 0.1 for qp in run.qps) and bool(run.qps) == keep


def test_what_cannot_begin_has_no_motion():
    with pytest.raises(ValueError, match="overlap") as told:
        simulate(one_box(y=0.1), glambda())
    assert not hasattr(told.value, "run")


class Broken:
    """Answers every QP in the same wrong way."""

    def __init__(self, answer):
        self.answer = answer

    def solve(self, qp, start=None):
        return self.answer(qp)


def crash(qp):
    raise ValueError("no licence")


def nan(qp):
    return Solution(
        x=np.full(qp.k, np.nan),
        row_id=qp.row_id,
        status=Status.SOLVED,
        working_set=np.zeros(qp.k, np.int8),
    )


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (crash, r"raised ValueError: no licence \(test_stepper.py, line \d+\); try another solver"),
        (nan, "not 2 finite numbers"),
        (lambda qp: None, "returned NoneType"),
    ],
)
def test_whatever_a_solver_does_wrong_is_said(answer, words):
    with pytest.raises(SimulationError, match=words):
        simulate(one_box(), Broken(answer))


# --- what is kept --------------------------------------------------------------------------------


def test_everything_that_was_posed_is_kept():
    run = scene_run("fig4")
    assert len(run.qps) == len(run.solutions) == run.counts["qps"]
    kinds = {qp.kind for qp in run.qps}
    assert {"step", "corrector", "impulse", "minimum_norm"} <= kinds
    assert any(not qp.accepted for qp in run.qps)
    restarts = [qp for qp in run.qps if qp.restart]
    assert len(restarts) >= run.counts["impulses"]
    rows = run.trajectory
    assert list(rows.columns) == ["t", "body", "x", "y", "phi", "vx", "vy", "omega"]
    assert rows["body"].unique().tolist() == [1, 2, 3]
    assert (np.diff(run.t) >= 0).all()
    assert run.t.size >= run.counts["steps"]


def test_the_kinds_of_event_that_are_listed_are_those_that_are_logged():
    sources = Path(__file__).parents[2].joinpath("problems").rglob("*.py")
    logged = (re.findall(r'\.log\(\s*"(\w+)"', source.read_text("utf-8")) for source in sources)
    assert {kind for kinds in logged for kind in kinds} == set(EVENT_KINDS)
    assert {event.kind for event in scene_run("fig4").event_log} <= set(EVENT_KINDS)


def test_two_runs_are_identical():
    one, two = (simulate(scene("fig5"), glambda()) for _ in range(2))
    assert one.q.tobytes() == two.q.tobytes()
    assert len(one.qps) == len(two.qps)
    for a, b in zip(one.qps, two.qps, strict=True):
        assert a.d.tobytes() == b.d.tobytes()
        assert a.dense_A.tobytes() == b.dense_A.tobytes()


def test_row_ids_survive_from_step_to_step():
    run = scene_run("fig2")
    steps = [qp for qp in run.qps if qp.kind == "step"]
    same = sum(np.isin(b.row_id, a.row_id).all() for a, b in pairwise(steps))
    assert same / len(steps) > 0.9
