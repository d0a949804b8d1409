"""The player of a scene: its numbers are those of the recording, and its keys move it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.recordings.recording import write_recording
from problems.bodies.bodies import ellipse
from problems.contacts.geometry import Geometry, HalfPlane
from problems.qp import AT_UPPER, FREE, ContactQP, Solution, Status
from problems.stepping.run import Event
from reports.motions.contact_forces import IMPULSE, SLIDES, STICKS, forces, qps_of_frames
from reports.motions.motion import ROUND, Motion
from reports.motions.player import MOST, player_data, write_player
from reports.rows.results import prepare
from tests.reports.browser import Browser, found
from tests.reports.test_reports import make_recording, make_rows

BOX = [np.array([(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)])]
DISC = [np.array([(0.5, 0.0)])]
D = np.array([2.0, 2.0, 3.0])
MOST_STEPS = 200


def pressed(features, G, x, members=None, kind="step"):
    """A QP of one body with Gᵀ given by its columns, and its answer."""
    k = len(x)
    qp = ContactQP(np.array(G, float).T / D[:, None], np.zeros(3), np.full(k, -9.0),
                   np.full(k, 9.0), feature=features, D=D, kind=kind)  # fmt: skip
    set_ = np.array([FREE] * k if members is None else members, dtype=np.int8)
    return qp, Solution(np.array(x, float), qp.row_id, Status.SOLVED, set_)


def corner_0(kind="step", members=None):
    features = [(0, 0, -1, 0, 0), (0, 0, -1, 0, 1)]
    return pressed(features, [(0, 1, -1.0), (1, 0, 0.5)], [4.0, 1.5], members, kind)


def test_normal_and_friction_of_a_corner_are_one_force() -> None:
    (force,) = forces(*corner_0(), np.array([[3.0, 0.5, 0.0]]), [BOX])
    np.testing.assert_allclose(force.at, (2.0, 0.0))
    np.testing.assert_allclose(force.force, (1.5, 4.0))
    assert (force.body, force.state) == (0, STICKS)


def test_a_corner_turns_with_its_body() -> None:
    (force,) = forces(*corner_0(), np.array([[3.0, 2.0, np.pi / 2]]), [BOX])
    np.testing.assert_allclose(force.at, (3.5, 1.0))


def test_friction_at_its_bound_slides_and_an_impulse_is_one() -> None:
    pose = np.zeros((1, 3))
    assert forces(*corner_0(members=[FREE, AT_UPPER]), pose, [BOX])[0].state == SLIDES
    assert forces(*corner_0(kind="impulse"), pose, [BOX])[0].state == IMPULSE
    alone = pressed([(0, 0, -1, 0, 0)], [(0, 1, -1)], [4.0])
    assert forces(*alone, pose, [BOX])[0].state == SLIDES


def test_a_disc_is_pressed_at_its_periphery() -> None:
    touching = pressed([(0, 0, -1, 0, 0)], [(0, 1, 0)], [4.0])
    (force,) = forces(*touching, np.array([[1.0, 0.5, 0.7]]), [DISC])
    np.testing.assert_allclose(force.at, (1.0, 0.0), atol=1e-15)


def test_an_ellipse_is_pressed_where_it_is_farthest_down() -> None:
    touching = pressed([(0, 0, -1, 0, 0)], [(0, 1, 0)], [4.0])
    geometry = Geometry((ellipse(0.5, 0.2),), (HalfPlane(),))
    pose = geometry.pose(np.array([1.0, 0.5, 0.7]))
    (force,) = forces(*touching, np.array([[1.0, 0.5, 0.7]]), [ellipse(0.5, 0.2).polygons])
    np.testing.assert_allclose(force.at, geometry.touched(pose, 0, np.array([0.0, 1.0])))
    low = geometry.clearance(pose, np.array([0]), np.array([1]))[0]
    assert force.at[1] == pytest.approx(low)


def test_what_is_round_is_drawn_by_its_outline() -> None:
    parts = [ellipse(0.5, 0.2).polygons, DISC, BOX]
    pose = np.array([(1.0, 2.0, np.pi / 2)] * 3)
    motion = Motion("three", np.zeros(1), pose[None], np.zeros((1, 3, 3)), parts)
    (tall,), (round_,), (box,) = (motion.corners(pose, body) for body in range(3))
    assert len(tall) == len(round_) == ROUND
    assert len(box) == 4
    x, y = (tall - (1.0, 2.0)).T
    np.testing.assert_allclose((x / 0.2) ** 2 + (y / 0.5) ** 2, 1.0)
    np.testing.assert_allclose(np.hypot(*(round_ - (1.0, 2.0)).T), 0.5)


def test_columns_that_are_no_contact_press_nowhere() -> None:
    assert forces(*pressed(None, [(0, 1, 0)], [4.0]), np.zeros((1, 3)), [BOX]) == []


def test_a_step_has_its_last_pass_and_an_impulse_stands_behind_it() -> None:
    def posed(t, kind="step", accepted=True):
        return SimpleNamespace(t=t, kind=kind, accepted=accepted)

    qps = [posed(0.1), posed(0.1, "corrector"), posed(0.1, "impulse"), posed(0.3, accepted=False)]
    recording = SimpleNamespace(t=np.array([0.0, 0.1, 0.1, 0.2]), qps=qps)
    assert qps_of_frames(recording) == [-1, 1, 2, -1]


@pytest.fixture(scope="module")
def recording():
    """Two hundred steps of two boxes, each QP on one of them."""
    made = make_recording(steps=MOST_STEPS)
    spread = np.linspace(0, MOST_STEPS - 1, len(made.qps)).astype(int)
    qps = [replace(qp, t=float(made.t[i]), D=np.ones(6), accepted=True)
           for i, qp in zip(spread, made.qps, strict=True)]  # fmt: skip
    features = np.array([(0, 0, 1, 0, 0), (0, 0, 1, 0, 1), (1, 2, -1, 0, 0), (1, 3, -1, 0, 0)])
    qps = [replace(qp, feature=features) for qp in qps]
    solutions = [replace(each, x=np.arange(1.0, 5.0)) for each in made.solutions]
    return replace(made, qps=qps, solutions=solutions)


def test_poses_forces_and_events_are_those_of_the_recording(recording) -> None:
    data = player_data(recording)
    assert data["t"] == recording.t.tolist() and data["left_out"] == 0
    np.testing.assert_allclose(data["q"], recording.q.reshape(MOST_STEPS, -1), rtol=1e-5)
    numbers = qps_of_frames(recording)
    for frame in np.flatnonzero(np.array(numbers) >= 0):
        qp, x = recording.qps[numbers[frame]], recording.solutions[numbers[frame]].x
        total = np.zeros((2, 2))
        for body, _, _, fx, fy, _ in data["forces"][frame]:
            total[body] += fx, fy
        # of the corner's body alone: columns 0 and 1 press body 0, columns 2 and 3 body 1
        np.testing.assert_allclose(total[0], (qp.A[:2, :2] @ x[:2]), rtol=1e-5)
        np.testing.assert_allclose(total[1], (qp.A[3:5, 2:] @ x[2:]), rtol=1e-5)
        assert data["qps"][frame] == [numbers[frame], qp.kind, 4, "FFFF"]
    assert data["events"] == [[0.3, "impulse", "1 and 2"], [0.4, "slide_off", ""]]


def test_rank_and_iterations_are_those_of_the_rows(recording) -> None:
    rows = prepare(make_rows(scenes=("fig2",), arms=("warm",)))
    data = player_data(recording, rows)
    frame = qps_of_frames(recording).index(7)
    assert data["iterations"]["daqp"][frame] == 1 and data["rank"][frame] == 4
    assert data["iterations"]["daqp"][1] is None  # no QP was posed there


def test_a_long_motion_is_thinned_and_keeps_its_ends(recording) -> None:
    many = [[BOX[0]]] * (MOST // 50)
    still = np.zeros((MOST_STEPS, len(many), 3))
    long = replace(recording, polygons=many, q=still, v=still)
    data = player_data(long)
    assert len(data["t"]) == 50 and data["left_out"] == MOST_STEPS - 50
    assert (data["t"][0], data["t"][-1]) == (recording.t[0], recording.t[-1])


def test_a_name_cannot_break_the_page(recording, tmp_path: Path) -> None:
    odd = replace(recording, events=[Event(0.1, "impulse", "</script><b>")])
    text = write_player(odd, tmp_path / "odd.html").read_text(encoding="utf-8")
    (inside,) = re.findall(r'type="application/json">(.*?)</script>', text)
    assert json.loads(inside)["events"] == [[0.1, "impulse", "</script><b>"]]


def test_the_command_plays_a_recording_and_refuses_a_wrong_suffix(
    recording, tmp_path: Path
) -> None:
    write_recording(tmp_path / "fig2.h5", recording)
    command = ["play", str(tmp_path / "fig2.h5"), "-o"]
    done = CliRunner().invoke(app, [*command, str(tmp_path / "p.html")])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "to the report" not in text and '"scene":"fig2"' in text
    refused = CliRunner().invoke(app, [*command, str(tmp_path / "p.pdf")])
    assert refused.exit_code == 2 and not (tmp_path / "p.pdf").exists()


@pytest.fixture(scope="module")
def browser(recording, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if found() is None:
        pytest.skip("no Chromium is installed")
    rows = prepare(make_rows(scenes=("fig2",), arms=("warm",)))
    page = write_player(recording, tmp_path_factory.mktemp("player") / "p.html", rows, "index.html")
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        opened.open(page)
        yield opened


def shown(browser: Browser) -> int:
    """The step that is seen."""
    browser("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    said = browser("document.getElementById('clock').textContent")
    return int(re.findall(r"step (\d+) of", said)[0])


def test_keys_step_and_go_to_the_ends(browser: Browser) -> None:
    browser.press("End")
    assert shown(browser) == MOST_STEPS
    browser.press("ArrowLeft")
    assert shown(browser) == MOST_STEPS - 1
    browser.press("Home")
    browser.press("ArrowRight")
    assert shown(browser) == 2
    assert browser.said == []


def test_space_plays_and_pauses(browser: Browser) -> None:
    browser.press("Home")
    browser("KEYS[' '](); new Promise((done) => setTimeout(done, 300))")
    assert shown(browser) > 1
    browser("KEYS[' ']()")
    here = shown(browser)
    browser("new Promise((done) => setTimeout(done, 100))")
    assert shown(browser) == here


def test_a_mark_jumps_to_its_event_and_says_it(browser: Browser) -> None:
    browser("document.querySelector('#events .slide_off').click()")
    frame = shown(browser)
    assert "slide off" in browser("document.getElementById('said').textContent")
    assert browser("data.t[frame] <= 0.4 && data.t[frame + 1] > 0.4") and frame > 1


def test_the_tables_follow_the_picture(browser: Browser) -> None:
    browser.press("Home")
    shown(browser)
    assert "daqp1" in browser("document.getElementById('work').textContent")
    browser.press("ArrowRight")
    shown(browser)
    assert "daqpnot stored" in browser("document.getElementById('work').textContent")


def test_it_draws_and_fits_a_phone_in_the_dark(browser: Browser) -> None:
    browser.size(400, 800, phone=True)
    browser.media(scheme="dark")
    drawn = "pen.getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0)"
    assert browser(drawn)
    assert browser("document.documentElement.scrollWidth") <= 400
    browser.media()
