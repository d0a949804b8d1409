"""Polygons that are dropped in a heap: every simulation ends, and ends well."""

import json
from dataclasses import replace

import numpy as np
import pytest

from harness.motions.run_physics import overlap
from harness.study.record import recording_of
from problems import scene, simulate
from problems.bodies.bodies import polygon_body
from problems.scenes import Scene
from reports.motions.frames import window_of
from reports.motions.motion import motion_of
from solvers import make_solver
from tests.endurance import heaps
from tests.endurance.heaps import Case, case, energy_rise, examined, load, run_case, save


def glambda():
    return make_solver("glambda")


def test_tips_that_meet_on_the_ground_do_not_pass_through_each_other():
    """Both stay on the line of the other's lower edge: neither is ever inside the other."""
    wedge = polygon_body([(0.0, 0.0), (2.0, 0.0), (1.0, 0.5)])
    height = -wedge.polygons[0][:, 1].min()
    for turn in (0.0, 1e-9, -1e-9):
        sliding = Scene(
            bodies=(wedge, wedge),
            q0=np.array([[-2.0, height, 0.0], [2.0, height, turn]]),
            v0=np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]]),
            end_time=1.0,
        )
        run = simulate(sliding, glambda())
        assert overlap(sliding, run.q).max() < run.options["eps"]


@pytest.mark.parametrize("number", range(20))
def test_a_heap_ends_well(number):
    made = case(20, number)
    small = {**made.parameters, "bodies": 5 + number % 4, "end_time": 1.0}
    outcome = run_case(Case("rain", small))
    assert not outcome.failure, outcome.detail
    assert outcome.impulses > 0


@pytest.mark.parametrize("number", [406, 420, 914])
def test_tips_that_drift_has_let_pass_each_other_stay_in_contact(number):
    """No corner is inside the other body then: dropping the contact let their edges cross."""
    outcome = run_case(case(0, number))
    assert not outcome.failure, outcome.detail
    assert outcome.depth < 1.0


def test_jams_catch_contacts():
    """Bodies wedged under gains of 1.8: each jam names what has caught, and the run gets on."""
    made = case(0, 1)
    run = simulate(scene(made.scene, **made.parameters), glambda(), until=0.9, keep_qps=False)
    jams = [event for event in run.event_log if event.kind == "jam"]
    assert 0 < len(jams) < 20
    assert all("body" in jam.detail for jam in jams)
    assert run.counts["steps"] < 1000


def test_impulses_with_friction_leave_nothing_to_jam():
    """Those without leave wedged bodies sliding; at once, or in the step after, they jam."""
    made = case(0, 37)
    frictionless, rough = (
        simulate(scene("rain", **{**made.parameters, "mu_I": mu_I}), glambda(), keep_qps=False)
        for mu_I in (0.0, made.parameters["mu"])
    )
    jams = [event.t for event in frictionless.event_log if event.kind == "jam"]
    struck = [event.t for event in frictionless.event_log if event.kind == "impulse"]
    assert jams and all(min(t - s for s in struck if s <= t) < 2e-3 for t in jams)
    assert "jam" not in {event.kind for event in rough.event_log}


def test_a_case_is_the_same_again_from_its_file(tmp_path):
    made = case(0, 5)
    small = Case(made.scene, {**made.parameters, "bodies": 5, "end_time": 0.5}, {"eps": 2e-3})
    outcome = run_case(small)
    again = load(save(tmp_path, 5, small, outcome))
    assert again == small
    assert {**vars(run_case(again)), "cpu": 0.0} == {**vars(outcome), "cpu": 0.0}
    assert heaps.main(["--reproduce", str(tmp_path / "5.json")]) == 0
    (tmp_path / "bad.json").write_text(json.dumps({"scene": "rain"}))
    with pytest.raises(ValueError, match=r"bad\.json: no case of this benchmark"):
        load(tmp_path / "bad.json")


def test_what_goes_wrong_is_a_failure():
    assert run_case(Case("rain", {"bodies": 0})).failure == "error"
    run = simulate(scene("rain", bodies=5, end_time=0.8), glambda(), keep_qps=False)
    assert not examined(run, 0.8, 0.0).failure
    assert run_case(case(0, 1), limit=1e-6).failure == "time"
    run.q[-1, 0] = run.q[-1, 1]
    assert examined(run, 0.8, 0.0).failure == "overlap"
    run = simulate(scene("rain", bodies=5, end_time=0.8), glambda(), keep_qps=False)
    assert energy_rise(run) < 1e-3
    run.v[-1] *= 2.0
    assert examined(run, 0.8, 0.0).failure == "energy"
    run.t[-1] = 0.7
    assert examined(run, 0.8, 0.0).failure == "early"


def test_the_table_counts_failures(tmp_path, capsys):
    arguments = ["--count", "2", "--workers", "1", "--limit", "1e-6", "--out", str(tmp_path)]
    assert heaps.main(arguments) == 1
    row = next(line for line in capsys.readouterr().out.splitlines() if "failed: time" in line)
    assert [cell.strip() for cell in row.strip("│").split("│")[1:]] == ["2", "1", "1"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.json", "1.json"]


def test_walls_are_in_the_picture_from_runs_and_recordings():
    made = scene("rain", bodies=5, columns=2, end_time=0.1)
    run = simulate(made, glambda())
    walls = [plane.point[0] for plane in made.ground[1:]]
    for source in (run, recording_of(run, "glambda")):
        motion = motion_of(source)
        window = window_of(motion, [run.q[0]])
        assert window.left < min(walls) < max(walls) < window.right
        assert window.bottom < 0.0
    stranger = motion_of(replace(recording_of(run, "glambda"), scene="of a plug-in"))
    assert list(stranger.ground) == [((0.0, 0.0), (0.0, 1.0))]
