"""The friction model of §4: cases with known answers, gains, transitions."""

from dataclasses import replace

import numpy as np
import pytest

from problems import scene, simulate
from problems.contacts.assembly import Assembly
from problems.friction.kernels import force_change
from problems.friction.newton import newton_multipliers
from problems.scenes import Scene
from problems.scenes.calm import calm_scene
from problems.stepping.driver import Driver
from problems.stepping.stepper import Stepper, StepperOptions
from solvers import make_solver
from tests.fakes.runs import leaning_box, one_box, scene_run


def run_of(scene: Scene, **options):
    return simulate(scene, make_solver("glambda"), **options)


def test_a_sliding_box_stops_where_coulomb_says():
    """v² / (2 μ g) after v / (μ g) seconds."""
    run = run_of(one_box(v=(2.0, 0, 0), mu=0.4, end_time=3.0, stop_at_rest=True))
    assert run.q[-1, 0, 0] == pytest.approx(4.0 / (2 * 0.4 * 9.81), rel=1e-3)
    stops = [e.t for e in run.event_log if e.kind == "slip_to_stick"]
    assert stops == [pytest.approx(2.0 / (0.4 * 9.81), rel=1e-3)]


@pytest.mark.parametrize("slope", [0.2, 0.35])
def test_a_box_on_a_slope_sticks_or_slides_by_mu(slope):
    from problems.bodies.bodies import box
    from problems.contacts.geometry import HalfPlane

    c, s = np.cos(slope), np.sin(slope)
    scene = Scene(
        bodies=(box(2.0, 0.5),),
        q0=np.array([[-0.25 * s, 0.25 * c, slope]]),
        v0=np.zeros((1, 3)),
        ground=(HalfPlane((0, 0), (-s, c)),),
        mu=0.3,
        end_time=0.5,
    )
    run = run_of(scene)
    along = (run.q[-1, 0, :2] - run.q[0, 0, :2]) @ np.array([c, s])
    acceleration = min(0.0, -9.81 * (s - 0.3 * c))
    # a sticking contact begins to slide within a step or two: O(h) late
    assert along == pytest.approx(0.5 * acceleration * 0.25, rel=0.02, abs=1e-5)


def test_paper_friction_on_a_steep_contact_oscillates_and_corrected_does_not():
    """(4.2) is unstable for gains below −1/3 at any h; the corrected rule is not."""
    steep = leaning_box(mu=0.8, speed=-6.0, tilt=0.9)
    steps = {
        rule: run_of(steep, friction=rule, until=0.2).counts["steps"]
        for rule in ("paper", "corrected")
    }
    assert steps["paper"] > 2 * steps["corrected"], steps


def test_another_pass_would_change_less_than_was_asked(monkeypatch):
    """‖δq̇‖_M ≤ 0.1 ε (3.14) if sliding forces were those of the λ_N that they led to."""
    left, last_step, set_clock = [], Driver.last_step, Driver._set_clock

    def look_at_all(self, asks, watched):
        set_clock(self, asks, True)

    def watched(self, settled=True):
        step = last_step(self, settled)
        signs, alpha0 = self.signs, self._run.passes.now[0]["alpha0"]
        if settled and not self.trial["stuck"] and signs.any():
            off = np.where(signs != 0, signs * step.assembly.bound(step.lam_N) - step.lam_F, 0.0)
            push = step.assembly.friction_force(off) / self.system.D
            left.append(step.h / alpha0 * np.linalg.norm(push) / self.system.options.eps)
        return step

    monkeypatch.setattr(Driver, "last_step", watched)
    monkeypatch.setattr(Driver, "_set_clock", look_at_all)
    run_of(scene("rain", bodies=12, mu=0.7), until=1.0)
    assert len(left) > 500
    assert max(left) <= 0.1


def test_rounding_has_no_say_in_which_forces_follow_from_which():
    """At the start of fig5 contacts without a load do not slip: λ_F and slip are rounding there."""
    runs = [run_of(scene("fig5", gravity=g), until=0.01) for g in 9.81 * (1 + 1e-14 * np.arange(6))]
    assert len({len(run.qps) for run in runs}) == 1
    for run in runs[1:]:
        np.testing.assert_allclose(run.t, runs[0].t, rtol=1e-9)


def test_rest_is_rest_with_the_corrected_rule_and_not_with_the_paper_s():
    """Minimum-norm multipliers against lagged bounds alone cycle between stick and slip."""
    corrected = scene_run("fig5")
    slips = sum(e.kind == "slip_to_stick" for e in corrected.event_log)
    made = replace(corrected.scene, stop_at_rest=False)
    paper = simulate(made, make_solver("glambda"), friction="paper", until=1.5)
    assert slips <= 4
    assert sum(e.kind == "slip_to_stick" for e in paper.event_log) > 10 * slips


def test_force_change_knows_when_another_pass_matters():
    new, old = np.array([1.5, 1.5, 0.5, 1.5, 1.5]), np.ones(5)
    sliding = np.array([1.0, 0, 0, 0, 0])
    stuck = np.array([0.0, 0.2, 0.8, 1.0, -1.0])
    moved = force_change(sliding, stuck, old, new)
    np.testing.assert_allclose(moved, [0.5, 0.0, -0.3, 0.5, -0.5])


def test_force_change_from_a_start_that_sticks_whatever_the_load():
    stuck, new = np.array([0.4, -0.8, 0.0]), np.array([0.5, 0.5, 0.0])
    moved = force_change(np.zeros(3), stuck, np.full(3, np.inf), new)
    np.testing.assert_allclose(moved, [0.0, 0.3, 0.0])


def test_force_change_of_a_contact_whose_load_was_rounding():
    """Its force is at its bound, whichever way that is off 0."""
    old, new = np.array([1.0, 1e-18, 0.0]), np.array([1.5, 0.5, 0.5])
    moved = force_change(np.zeros(3), np.array([0.2, 0.0, 0.0]), old, new)
    np.testing.assert_allclose(moved, [0.0, 0.5, 0.5])


def sliding_box(gain):
    """A leaning box whose λ_N(λ_*) has this slope, and its one contact."""
    speed = 1.0 if gain < 0 else -1.0
    scene = leaning_box(mu=1.0, speed=speed)
    stepper = Stepper(scene, make_solver("glambda"), StepperOptions(1e-3, 1e-3, rest_speed=1.0))
    stepper.start()
    assembly = Assembly(stepper.system.graph, stepper.system.q)
    A = (
        np.column_stack([assembly.G_N.toarray(), assembly.G_F.toarray()])
        / stepper.system.D[:, None]
    )
    sign = -np.sign(speed)
    assembly.mu[:] = gain / (-sign * (A[:, 0] @ A[:, 1]) / (A[:, 0] @ A[:, 0]))
    return assembly, stepper.system.D, np.array([sign])


@pytest.mark.parametrize("gain", [-0.9, -1.5, -20.0, 0.6])
def test_newton_finds_the_fixed_point_of_one_sliding_contact_at_once(gain):
    assembly, D, signs = sliding_box(gain)
    star = np.array([1.0])
    lam = 3.0 + gain * star
    found = newton_multipliers(assembly, D, signs, star, np.abs(lam), np.zeros(1), np.zeros(3))
    np.testing.assert_allclose(found, star + (np.abs(lam) - star) / (1 - gain), rtol=1e-9)


def test_newton_gives_way_where_there_is_no_fixed_point():
    """With a gain beyond 1 λ_* would be negative (Painlevé): λ_N is all there is."""
    assembly, D, signs = sliding_box(1.5)
    lam = np.array([4.5])
    found = newton_multipliers(assembly, D, signs, np.ones(1), lam, np.zeros(1), np.zeros(3))
    np.testing.assert_array_equal(found, lam)


def test_newton_leaves_the_ground_where_lambda_falls_to_zero():
    """Below 0 with a gain below 1 is a contact without a load, which λ_* = 0 finds at once."""
    assembly, D, signs = sliding_box(0.9)
    star, lam = np.array([4.0]), np.array([3.5])  # fixed point −1
    found = newton_multipliers(assembly, D, signs, star, lam, np.zeros(1), np.zeros(3))
    np.testing.assert_array_equal(found, [0.0])


def test_a_step_is_not_cut_where_stops_are_held():
    """A box sticks for the whole step in which it would turn: second order all the same."""
    errors = []
    for h in (0.02, 0.01, 0.005):
        run = run_of(one_box(v=(1.0, 0, 0), mu=0.3, end_time=0.4), fixed_step=h, stops="held")
        np.testing.assert_allclose(np.diff(run.t), h)
        assert [event.kind for event in run.event_log] == ["slip_to_stick"]
        np.testing.assert_allclose(run.v[-1], 0.0, atol=1e-12)
        errors.append(abs(run.q[-1, 0, 0] - 1 / (2 * 0.3 * 9.81)))
    assert errors[0] > 3 * errors[1] > 9 * errors[2] > 0


@pytest.mark.parametrize("family", ["wall", "pyramid"])
def test_courses_that_slide_to_and_fro_stop_in_a_few_steps_where_stops_are_held(family):
    """With located events every brick is an event of its own."""
    run = run_of(calm_scene(family, bodies=30, mu=0.3), fixed_step=1e-3, stops="held", until=0.02)
    np.testing.assert_allclose(np.diff(run.t), 1e-3)
    assert run.counts["rejected_steps"] < 40
    assert np.abs(run.v[0]).max() > 5e-3
    np.testing.assert_allclose(run.v[-1], 0.0, atol=1e-9)
    assert np.diff(run.kinetic_energy() + run.potential_energy()).max() <= 1e-9


def test_settings_are_checked():
    with pytest.raises(ValueError, match="friction"):
        run_of(one_box(), friction="dry")
    with pytest.raises(ValueError, match="eps"):
        run_of(one_box(), eps=-1.0)
    with pytest.raises(ValueError, match="fixed_step"):
        run_of(one_box(), fixed_step=0.0)
    with pytest.raises(ValueError, match="stops"):
        run_of(one_box(), stops="never")
    with pytest.raises(ValueError, match="until"):
        run_of(one_box(), until=np.nan)


@pytest.mark.parametrize("fixed_step", [None, 1 / 240])
def test_contacts_jam_where_sliding_forces_feed_back_on_themselves(fixed_step):
    """Courses that slide to and fro, μ = 0.5: with some contacts stuck, the forces of the others
    have no solution, or with short steps and this ε one that is good enough."""
    run = run_of(calm_scene("tower", bodies=20, mu=0.5), until=5 / 240, fixed_step=fixed_step)
    assert run.counts["rejected_steps"] < 40
    assert np.abs(run.v[-1]).max() < 1e-9
    energy = run.kinetic_energy() + run.potential_energy()
    assert np.diff(energy).max() <= 1e-9
    jams = [event for event in run.event_log if event.kind == "jam"]
    assert len(jams) == (0 if fixed_step is None else 1)


def test_the_jump_of_a_jam_does_not_depend_on_the_length_of_its_step(monkeypatch):
    """A catch is an impact: λ grows as 1/h, and the jump in q̇ has a limit."""
    jumps = []
    for length in (1e-6, 1e-7, 1e-8):
        monkeypatch.setattr("problems.stepping.stepper.JAM_STEP", length)
        run = run_of(scene("painleve"), until=1e-4)
        jam = next(event for event in run.event_log if event.kind == "jam")
        after = np.searchsorted(run.t, jam.t)
        jumps.append(run.v[after] - run.v[after - 1])
    size = np.abs(jumps[2]).max()
    assert size > 0.1
    assert np.abs(jumps[0] - jumps[1]).max() < 1e-4 * size
    assert np.abs(jumps[1] - jumps[2]).max() < 1e-5 * size


@pytest.mark.parametrize(
    "parameters",
    [
        {"name": "fig2", "boxes": 8, "mu": 0.5, "end_time": 0.3},
        {"name": "tower", "bodies": 50, "mu": 0.3, "lean": 0.05, "end_time": 0.2},
    ],
    ids=["aligned and pushed", "leaning"],
)
def test_towers_with_friction_get_on(parameters):
    """They chattered: sliding has no solution again and again, and contacts have to catch."""
    run = run_of(calm_scene(**parameters))
    assert run.t[-1] == pytest.approx(run.scene.end_time)
    assert run.counts["steps"] < 400
    energy = run.kinetic_energy() + run.potential_energy()
    assert np.diff(energy).max() <= 1e-3
    assert run.gaps.min() >= -1e-5
