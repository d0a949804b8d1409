"""Other engines on our scenes: that each is given the scene as it is, and what is made of its runs.

An engine that is absent is skipped, with the reason.  No time is asserted.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from glambda.cli import app
from harness.files.folder_lock import Locked
from harness.peers import ENGINES, OURS, describe_engine, engine_class
from harness.peers.base import Peer, ground_boxes
from harness.peers.campaign import Outcome, Plan, Run, run_campaign, runs_of
from harness.peers.compare import cheapest, compared, frontier, order_of, table_of
from harness.peers.observe import energy, observe, penetration
from harness.peers.ours import BOUNDED, Glambda
from harness.peers.tasks import DEFAULT, FRAME, Task, digest_of, started, tasks_of
from problems import Scene, scene
from problems.bodies.bodies import box, disc, ellipse
from problems.contacts.geometry import HalfPlane
from problems.joints.joints import Pin
from reports.peers.page import write_peers
from reports.peers.tables import least_table, rest_table
from tests.fakes.runs import leaning_box, one_box, scene_run

GOOD = {
    "pymunk": ("100 iterations", 1 / 960),
    "box2d": ("50 and 20 iterations", 1 / 960),
    "box2d3": ("4 sub-steps", 1 / 960),
    "mujoco": ("hard", 1 / 960),
    "dart": ("split impulse", 1 / 960),
    "drake": ("lagged, corners 0.1 mm", 1 / 1920),
    "cenic": ("1e6 N/m", 1e-5),
    "cundall": ("critical", 1 / 3840),
    OURS: ("stock", 1e-4),
}
"""A setting of each engine, and a step or accuracy, at which it is good to some thousandths."""
FEW_THOUSANDTHS = 6e-3


def made(engine: str, scene: Scene) -> Peer:
    """The scene in an engine, in its good setting; skips where the engine is absent."""
    info = describe_engine(engine)
    if not info.available:
        pytest.skip(info.reason)
    cls, (setting, resolution) = engine_class(engine), GOOD[engine]
    return cls(scene, resolution, **cls.settings[setting])


every_engine = pytest.mark.parametrize("engine", ENGINES)


# --- engines are given the scene as it is ---------------------------------------------------------


def test_every_engine_has_a_good_setting() -> None:
    assert set(GOOD) == set(ENGINES)


@every_engine
def test_free_flight_with_spin(engine: str) -> None:
    thrown = one_box(1.0, 5.0, 0.3, v=(1.5, 2.0, -2.0))
    times = [0.1, 0.2, 0.3]
    motion = made(engine, thrown).run(times)
    t = np.array(times)
    exact = np.column_stack([1 + 1.5 * t, 5 + 2 * t - 4.905 * t**2, 0.3 - 2 * t])
    np.testing.assert_allclose(motion.q[:, 0], exact, atol=FEW_THOUSANDTHS)
    np.testing.assert_allclose(motion.v[-1, 0], [1.5, 2 - 9.81 * 0.3, -2.0], atol=0.03)
    assert motion.steps > 0 and motion.cpu > 0


@every_engine
def test_friction_stops_a_sliding_box_where_coulomb_says(engine: str) -> None:
    sliding = one_box(v=(1.0, 0.0, 0.0), mu=0.4)
    motion = made(engine, sliding).run([0.1, 0.4])
    before = 0.1 - 0.5 * 0.4 * 9.81 * 0.1**2
    at_rest = 1.0 / (2 * 0.4 * 9.81)
    np.testing.assert_allclose(motion.q[:, 0, 0], [before, at_rest], atol=FEW_THOUSANDTHS)
    np.testing.assert_allclose(motion.q[:, 0, 1:], [[0.5, 0.0]] * 2, atol=FEW_THOUSANDTHS)


@every_engine
def test_a_box_slides_down_a_slope_without_friction(engine: str) -> None:
    slope = 0.4
    normal = (-np.sin(slope), np.cos(slope))
    sliding = Scene(
        bodies=(box(1.0, 1.0),),
        q0=np.array([[0.5 * normal[0], 0.5 * normal[1], slope]]),
        v0=np.zeros((1, 3)),
        ground=(HalfPlane((0.0, 0.0), normal),),
    )
    motion = made(engine, sliding).run([0.3])
    along = 0.5 * 9.81 * np.sin(slope) * 0.3**2
    moved = motion.q[0, 0] - sliding.q0[0]
    expected = [-along * np.cos(slope), -along * np.sin(slope), 0.0]
    np.testing.assert_allclose(moved, expected, atol=FEW_THOUSANDTHS)


@every_engine
def test_a_leaning_box_falls_as_its_moment_of_inertia_says(engine: str) -> None:
    leaning = leaning_box(speed=0.5, tilt=0.3)
    ours = Glambda(leaning, 1e-6, bounded=True).run([0.1, 0.2])
    motion = made(engine, leaning).run([0.1, 0.2])
    np.testing.assert_allclose(motion.q, ours.q, atol=FEW_THOUSANDTHS)


@every_engine
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mu_pairs", {(1, 0): 0.3}),
        ("forces", leaning_box(spring=True).forces),
        ("bodies", (disc(0.5),)),
        ("bodies", (ellipse(0.5, 0.3),)),
        ("joints", (Pin(0, (0.0, 0.0)),)),
        ("restitution", 0.5),
    ],
)
def test_what_engines_cannot_be_given_is_refused(engine: str, field: str, value: Any) -> None:
    if engine == OURS:
        return
    with pytest.raises(ValueError, match="scene"):
        made(engine, replace(one_box(), **{field: value}))


@pytest.mark.parametrize("engine", ["pymunk", "box2d", "box2d3", "mujoco"])
def test_other_polygons_than_boxes_come_to_rest_on_the_ground(engine: str) -> None:
    heap = scene("heap", bodies=1, seed=3, mu=0.0)
    motion = made(engine, heap).run([0.2])
    assert penetration(heap, motion.q) < FEW_THOUSANDTHS
    ours = Glambda(heap, 1e-4).run([0.2])
    np.testing.assert_allclose(motion.q, ours.q, atol=2e-2)


@pytest.mark.parametrize("engine", ["dart", "drake"])
def test_other_polygons_are_refused_where_only_boxes_are_given(engine: str) -> None:
    with pytest.raises(ValueError, match="boxes only"):
        made(engine, scene("heap", bodies=1))


def test_the_ground_of_an_engine_has_its_surface_on_the_half_plane() -> None:
    ((*_, corners),) = ground_boxes(one_box(3.0))
    assert (corners[2:, 1] == 0).all()
    assert (corners[:2, 1] < 0).all()
    assert corners[:, 0].min() < 3 - 20 < 3 + 20 < corners[:, 0].max()


# --- our own runs, and the reference --------------------------------------------------------------


def falling_tower(t: float) -> np.ndarray:
    """fig2 from t = 0.375 to t < 0.56 by a code of its own: bodies 3, 4 and 5 tip over a corner.

    Equations of motion of five bodies with nine constraints, which are written down here anew and
    differentiated by complex steps; DOP853 at 1e-10.  (5, 3)
    """
    half = np.array([0.75, 0.5])
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    M = np.tile([1.5, 1.5, 1.5 * (1.5**2 + 1) / 12], 5)
    f = np.tile([0.0, -1.5 * 9.81, 0.0], 5)

    def corner(q: np.ndarray, body: int, number: int) -> np.ndarray:
        x, y, angle = q[3 * body : 3 * body + 3]
        a, b = signs[number] * half
        c, s = np.cos(angle), np.sin(angle)
        return np.array([x + c * a - s * b, y + s * a + c * b])

    def above(q: np.ndarray, body: int, point: np.ndarray, side: int) -> Any:
        x, y, angle = q[3 * body : 3 * body + 3]
        return side * (np.cos(angle) * (point[1] - y) - np.sin(angle) * (point[0] - x)) - 0.5

    def constraints(q: np.ndarray) -> np.ndarray:
        on_ground = [corner(q, 0, 0)[1], corner(q, 0, 1)[1]]
        lower = [above(q, 0, corner(q, 1, n), 1) for n in (0, 1)]
        tipping = [above(q, 2, corner(q, 1, 3), -1)]
        upper = [above(q, b - 1, corner(q, b, n), 1) for b in (3, 4) for n in (0, 1)]
        return np.array(on_ground + lower + tipping + upper)

    def jacobian(q: np.ndarray) -> np.ndarray:
        moved = q + 1e-30j * np.eye(15)
        return np.array([constraints(row).imag for row in moved]).T / 1e-30

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        q, v = state[:15], state[15:]
        J, d = jacobian(q), 1e-6
        turning = (jacobian(q + d * v) - jacobian(q - d * v)) @ v / (2 * d)
        lam = np.linalg.solve(J / M @ J.T, -J @ (f / M) - turning)
        return np.concatenate([v, (f + J.T @ lam) / M])

    start = np.zeros((2, 5, 3))
    start[0, :, 1] = np.arange(5) + 0.5
    start[0, 1, 0], start[1, 1, 0] = 2.0 * 0.375, 2.0
    end = solve_ivp(slope, (0.375, t), start.ravel(), method="DOP853", rtol=1e-10, atol=1e-11)
    return end.y[:15, -1].reshape(5, 3)


def test_the_reference_agrees_with_an_integration_by_a_code_of_its_own() -> None:
    motion = Glambda(scene("fig2"), 1e-5, bounded=True).run([0.3, 0.5])
    np.testing.assert_allclose(motion.q[1], falling_tower(0.5), atol=2e-5)
    assert motion.q[0, 1, 0] == pytest.approx(0.6, abs=1e-9)


def test_impacts_with_friction_are_the_same_as_those_of_an_engine_with_rigid_contacts() -> None:
    start = started("fig4")
    times = [0.1, 0.2, 0.3, 0.4, 0.5]  # impacts at 0.133 and 0.369
    ours = Glambda(start, 1e-4).run(times)
    cls = type(made("pymunk", start))
    theirs = cls(start, 1 / 7680, **cls.settings["100 iterations"]).run(times)
    np.testing.assert_allclose(ours.q, theirs.q, atol=1e-3)


# --- what is asked and measured -------------------------------------------------------------------


def test_the_default_tasks() -> None:
    tasks = tasks_of(DEFAULT)
    motions = {task.name for task in tasks if task.kind == "motion"}
    assert {"fig2 to 0.8", f"fig4 to {7 * FRAME:.3g}"} <= motions  # 0.133: the first impact of fig4
    wholes = [task for task in tasks if task.kind == "whole"]
    assert len(wholes) == len({task.scene for task in wholes})
    towers = [task for task in tasks if task.kind == "rest" and not task.in_space]
    assert [len(task.start().bodies) for task in towers] == [10, 100, 1000, 1000]
    assert np.abs(towers[-1].start().v0).max() <= 1e-6


@pytest.mark.parametrize("task", [Task("motion", "fig2", 0.8), Task("motion", "fig2", 1.0)])
def test_times_end_at_the_end_and_are_multiples_of_a_frame(task: Task) -> None:
    frames = np.array(task.times) / FRAME
    np.testing.assert_allclose(frames, np.rint(frames), atol=1e-9)
    assert task.times[-1] == pytest.approx(task.until)
    assert len(task.times) <= 16


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fig2@0.81", "multiple"),
        ("fig2@soon", "time or rest"),
        ("fig2@-1", "multiple"),
        ("fig99", "unknown scene"),
    ],
)
def test_a_task_that_cannot_be_is_told(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tasks_of([name])


def test_engines_start_after_the_external_impulse() -> None:
    start, run = started("fig4"), scene_run("fig4")
    after = run.v[np.flatnonzero(run.t == 0)[-1]]
    np.testing.assert_allclose(start.v0, after, atol=1e-9)
    assert np.abs(start.v0).max() > 1 and not start.impulses


def test_another_scene_is_another_start() -> None:
    one = started("tower,bodies=2,mu=0.5")
    assert digest_of(one) == digest_of(replace(one, name="other", stop_at_rest=True))
    for change in ({"mu": 0.4}, {"v0": one.v0 + 1e-16}, {"ground": ()}, {"gravity": 9.8}):
        assert digest_of(replace(one, **change)) != digest_of(one)


def test_overlap_and_energy_are_those_of_the_boxes() -> None:
    two = Scene(
        bodies=(box(1.0, 1.0), box(1.0, 2.0)),
        q0=np.array([(0.0, 0.5, 0.0), (0.0, 2.0, 0.0)]),
        v0=np.zeros((2, 3)),
    )
    q = np.array([[(0.0, 0.49, 0.0), (0.0, 1.95, 0.0)], [(0.0, 0.5, 0.0), (0.0, 2.2, 0.0)]])
    assert penetration(two, q) == pytest.approx(0.04)
    assert penetration(two, q[1:]) == 0.0
    v = np.array([[(1.0, 0.0, 2.0), (0.0, -1.0, 0.0)]])
    kinetic = 0.5 * 1 * 1 + 0.5 * (1 / 6) * 4 + 0.5 * 2 * 1
    expected = kinetic + 9.81 * (1 * 0.49 + 2 * 1.95)
    assert energy(two, q[:1], v)[0] == pytest.approx(expected)


def test_a_rise_of_energy_is_measured_from_the_lowest_before() -> None:
    class Bouncing(Glambda):
        def run(self, times: Any) -> Any:
            motion = super().run([0.1, 0.2, 0.3])
            q = np.array([[[0.0, y, 0.0]] for y in (0.5, 0.2, 0.6)])
            return replace(motion, q=q, v=np.zeros_like(q))

    task = Task("whole", "fig4,boxes=1,push=0.0,moment=0.0", 0.05)
    found = observe(Bouncing, {}, 1e-2, task, lambda _: None)
    assert found["gain"] == pytest.approx((0.6 - 0.2) / 1.5)
    assert found["repeats"] == 3


# --- the campaign ---------------------------------------------------------------------------------

FLIGHT = "fig4,mu=0.0,end_time=0.05@0.05"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("peers")


@pytest.fixture(autouse=True)
def few_runs_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Glambda, "resolutions", (1e-2, 1e-3))
    monkeypatch.setattr(Glambda, "middling", (1e-2,))


def campaign(folder: Path, fake: str, limit: float = 20.0) -> pd.DataFrame:
    engine = f"tests.fakes.fake_engines:{fake}"
    rows = table_of(run_campaign(Plan((FLIGHT,), (engine,), limit), folder))
    return rows[(rows["engine"] == engine) & (rows["kind"] == "motion")]


def test_an_engine_that_crashes_is_a_row_and_the_others_go_on(folder: Path) -> None:
    rows = campaign(folder, "Crashing")
    assert list(rows["status"]) == ["done", "crashed", "done"]
    assert "SIGABRT" in rows["reason"].iloc[1] and "out of luck" in rows["reason"].iloc[1]


def test_an_engine_that_hangs_is_ended_and_finer_steps_are_left_out(folder: Path) -> None:
    rows = campaign(folder, "Hanging", limit=2.0)
    assert list(rows["status"]) == ["done", "timeout", "skipped"]
    assert "2 s" in rows["reason"].iloc[1]


def test_a_motion_that_is_no_number_failed(folder: Path) -> None:
    rows = campaign(folder, "Diverging")
    assert (rows["status"] == "failed").all()
    assert "no convergence" in rows["reason"].iloc[0]
    assert "not finite" in rows["reason"].iloc[1]


def test_a_folder_is_continued_and_a_damaged_run_made_anew(folder: Path) -> None:
    first = campaign(folder, "Flying")
    assert (first["error"] > 0).all()
    files = {path: path.stat().st_mtime_ns for path in (folder / "runs").glob("*.json")}
    again = campaign(folder, "Flying")
    pd.testing.assert_frame_equal(first, again)
    assert {path: path.stat().st_mtime_ns for path in files} == files
    one = next(p for p in files if json.loads(p.read_text())["engine"].endswith(":Flying"))
    sound = one.read_bytes()
    other = next(p for p in files if json.loads(p.read_text())["engine"] == OURS)
    altered = re.sub(rb'"cpu": [0-9.e-]+', b'"cpu": 5.5', sound)
    assert altered != sound
    for content in (b"{", altered, other.read_bytes()):
        one.write_bytes(content)
        pd.testing.assert_frame_equal(first, campaign(folder, "Flying"))
        assert one.read_bytes() == sound


def test_two_campaigns_do_not_share_a_folder(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib; from harness.files.folder_lock import lock_folder\n"
        "lock = lock_folder(pathlib.Path(sys.argv[1]), 'run'); print('held', flush=True); input()"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"held\n"
        with pytest.raises(Locked, match="another campaign"):
            run_campaign(Plan((FLIGHT,), (OURS,)), tmp_path)
        other.communicate(b"\n")


def test_a_run_of_another_version_is_another_run() -> None:
    run = next(runs_of(OURS, Task("motion", "fig4", 0.1)))
    paths = {each.path(Path("x")) for each in (run, replace(run, version="other"))}
    assert len(paths) == 2


# --- comparison and report ------------------------------------------------------------------------


def synthetic(errors: dict[str, Callable[[float], float]]) -> list[tuple[Run, Outcome]]:
    """Runs of a motion with made-up errors and CPU times ~ steps; ours is the reference."""
    task, runs = Task("motion", "fig2", 0.8), []
    for engine, error in {OURS: lambda h: h * h, **errors}.items():
        for h in (0.1, 0.03, 0.01, 0.003, 0.001, 0.0):
            if h == 0.0 and engine != OURS:
                continue
            steps = round(0.8 / (h or 1e-4))
            run = Run(engine, BOUNDED, "h", h, task, "start", "1", "m")
            outcome = {
                "status": "done", "reason": "", "cpu": 1e-5 * steps, "steps": steps, "repeats": 3,
                "penetration": 0.0, "energy": [1.0 - h], "q": [[[error(h), 0.0, 0.0]]],
            }  # fmt: skip
            runs.append((run, outcome))
    return runs


def test_orders_are_fitted_to_runs_that_the_reference_can_tell_apart() -> None:
    rows = table_of(synthetic({"pymunk": lambda h: 0.5 * h}))
    part = compared(rows)
    assert not part["is_reference"].any() and rows["is_reference"].sum() == 1
    assert part["reference_error"].iloc[0] == pytest.approx(1e-6)
    for engine, p in ((OURS, 2.0), ("pymunk", 1.0)):
        order = order_of(part[part["engine"] == engine])
        assert order is not None and order.p == pytest.approx(p, rel=0.02)


def test_the_cheapest_run_and_the_frontier_leave_out_what_is_beaten() -> None:
    rows = pd.DataFrame({"cpu": [1.0, 2.0, 3.0, 4.0], "error": [0.5, 0.6, 0.1, 0.05]})
    best = cheapest(rows, 0.2, "error")
    assert best is not None and best["cpu"] == 3.0
    assert cheapest(rows, 0.01, "error") is None
    assert list(frontier(rows)["cpu"]) == [1.0, 3.0, 4.0]


def test_an_accuracy_that_a_finer_step_loses_again_was_luck() -> None:
    runs = synthetic({"pymunk": lambda h: 1e-5 if h == 0.01 else 0.5 * h})
    part = compared(table_of(runs))
    part = part[part["engine"] == "pymunk"]
    kept, lucky = cheapest(part, 2e-3), cheapest(part, 1e-4, "error")
    assert kept is not None and kept["resolution"] == 0.01
    assert lucky is not None and lucky["resolution"] == 0.01
    assert cheapest(part, 1e-4) is None
    notes = " ".join(least_table(table_of(runs), "fig2 to 0.8").notes)
    assert "Lucky runs, whose finer ones are worse: pymunk" in notes and "pymunk ≤ 1e-4 in" in notes


def test_the_page_says_who_is_cheaper_and_who_is_alone(tmp_path: Path) -> None:
    rows = table_of(synthetic({"pymunk": lambda h: 0.01 * h, "dart": lambda h: h}))
    table = least_table(rows, "fig2 to 0.8")
    notes = " ".join(table.notes)
    assert "At an error of 1e-3 glambda takes" in notes and "cheaper than it: pymunk." in notes
    assert "At an error of 1e-6 glambda" in notes
    engines = [describe_engine(OURS)]
    page = write_peers(rows, engines, tmp_path)
    assert "glambda takes" in page.read_text()
    assert (tmp_path / "peers.png").stat().st_size > 10_000
    assert set(pd.read_csv(tmp_path / "peers.csv")["engine"]) == {OURS, "pymunk", "dart"}


def test_the_page_says_whose_tower_falls_and_that_ours_does_not_finish() -> None:
    task = Task("rest", "tower", 100 / 240)
    runs: list[tuple[Run, Outcome]] = []
    for engine, drift in (("pymunk", 0.85), ("dart", 1e-3)):
        outcome = {
            "status": "done", "reason": "", "cpu": 0.1, "steps": 100, "repeats": 3,
            "penetration": 0.0, "drift": [0.0, drift], "turn": [0.0, 0.0],
        }  # fmt: skip
        runs.append((Run(engine, "stock", "h", 1 / 240, task, "start", "1", "m"), outcome))
    lost = {"status": "timeout", "reason": "a pass took more than 3 s"}
    runs.append((Run(OURS, "fixed step", "h", 1 / 240, task, "start", "1", "m"), lost))
    notes = " ".join(rest_table(table_of(runs)).notes)
    assert "glambda does not finish (a pass took more than 3 s)" in notes
    assert "dart (stock) drifts least, by 1.0e-03 m" in notes
    assert "in no setting of pymunk is the top held" in notes


def test_the_page_says_how_the_time_of_a_step_grows() -> None:
    runs: list[tuple[Run, Outcome]] = []
    for bodies in (2, 4, 8):
        task = Task("rest", f"tower,bodies={bodies}", 100 / 240)
        for engine, power in (("pymunk", 1), ("dart", 2)):
            outcome = {
                "status": "done", "reason": "", "cpu": 0.1 * bodies**power, "steps": 100,
                "repeats": 3, "penetration": 0.0, "drift": [0.0], "turn": [0.0],
            }  # fmt: skip
            runs.append((Run(engine, "stock", "h", 1 / 240, task, "start", "1", "m"), outcome))
    notes = " ".join(rest_table(table_of(runs)).notes)
    assert "with their number to the power pymunk 1.00 and dart 2.00." in notes


# --- the command ----------------------------------------------------------------------------------


def test_an_unknown_engine_is_told_in_one_line() -> None:
    result = CliRunner().invoke(app, ["peers", "--engines", "havok"])
    assert result.exit_code == 2
    assert "unknown engine 'havok'" in result.output


def test_an_absent_engine_is_told_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "pymunk", "no_such_package:Pymunk")
    info = describe_engine("pymunk")
    assert not info.available
    assert "no_such_package" in info.reason and "pip install 'glambda[peers]'" in info.reason
    with pytest.raises(ValueError, match="is not installed"):
        Plan(engines=("pymunk",))
