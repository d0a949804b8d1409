"""Joints: what each lets through, what drifts and what is put right, redundant ones, bad ones."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, pi, sin
from typing import Any

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.bodies.bodies import GROUND, box, disc
from problems.bodies.forces import Load
from problems.joints.joints import Apart, Blade, Gear, Guide, Joint, Pin, Rod, Stop, Weld, all_rows
from problems.joints.row_kernels import rows_at
from solvers import make_solver

METHOD = "glambda"
SCENES = ("slider_crank", "double_pendulum", "skate", "arm", "vehicle", "human", "frame")


def bar(*joints: Joint, v: tuple[float, float, float] = (0, 0, 0), **more: Any) -> Scene:
    """A bar from the origin to (cos 1, sin 1)."""
    at = 0.5 * cos(1.0), 0.5 * sin(1.0), 1.0
    made = {"bodies": (box(1.0, 0.1),), "q0": [at], "v0": [v], "ground": (), "end_time": 0.5}
    return Scene(**made | {"joints": joints} | more)


def run_of(made: Scene, **how: Any) -> Any:
    return simulate(made, make_solver(METHOD), **how)


def some_rows() -> tuple[Any, np.ndarray]:
    rng = np.random.default_rng(5)
    q = rng.normal(size=12)
    joints = (
        Pin(0, (0.3, 0.1), 1, (-0.2, 0.4)), Rod(2, (0.1, 0.2), 3, (0.0, -0.3)),
        Guide(1, (0.2, 0.0), (1.0, 2.0), 2, (0.3, 0.3), fixes_angle=True), Weld(0, 3, (0.5, 0.1)),
        Gear(1, 3, -2.0), Blade(2, (0.1, 0.4), (1.0, 1.0)), Stop(3, 0, -1.0, 2.0),
        Pin(3, (0.0, 0.1)), Rod(0, (0.2, 0.2), GROUND, (4.0, 4.0)),
    )  # fmt: skip
    return all_rows(joints, q), q + 0.1 * rng.normal(size=12)


def test_columns_are_the_derivatives_of_phi() -> None:
    rows, q = some_rows()
    phi, entries, bodies = rows_at(rows, q)
    for i in range(12):
        step = np.zeros(12)
        step[i] = 1e-6
        slope = (rows_at(rows, q + step)[0] - rows_at(rows, q - step)[0]) / 2e-6
        body, k = divmod(i, 3)
        column = sum(np.where(bodies[:, s] == body, entries[:, 3 * s + k], 0.0) for s in (0, 1))
        with_phi = rows.has_phi > 0
        np.testing.assert_allclose(slope[with_phi], column[with_phi], atol=1e-8)
    assert phi.size == 15 and not phi[rows.has_phi == 0].any()


def test_a_blade_is_crossed_at_its_own_point() -> None:
    rows, q = some_rows()
    blade = int(np.flatnonzero(rows.has_phi == 0)[0])
    _, entries, _ = rows_at(rows, q)
    v = np.array([0.3, -0.4, 0.7])
    angle = q[8]
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
    arm = turn @ (0.1, 0.4)
    across = turn @ (np.array([-1.0, 1.0]) / np.sqrt(2))
    speed = across @ (v[:2] + v[2] * np.array([-arm[1], arm[0]]))
    assert entries[blade, :3] @ v == pytest.approx(speed, abs=1e-14)


def test_all_rows_vanish_where_a_scene_begins() -> None:
    for name in SCENES:
        made = scene(name)
        rows = all_rows(made.joints, made.q0.ravel())
        phi = rows_at(rows, made.q0.ravel())[0]
        np.testing.assert_allclose(phi[rows.stop == 0], 0.0, atol=1e-12, err_msg=name)
        assert (phi[rows.stop == 1] >= -1e-12).all(), name


@pytest.mark.parametrize("name", SCENES)
def test_a_run_is_the_same_with_and_without_its_qps(name: str) -> None:
    one, two = (run_of(scene(name), until=0.4, keep_qps=keep) for keep in (True, False))
    assert [event.kind for event in one.event_log] == [event.kind for event in two.event_log]
    np.testing.assert_allclose(one.q[-1], two.q[-1], atol=1e-9)
    assert len(one.qps) == one.counts["qps"] and not two.qps


def test_drift_of_a_pin_is_of_second_order_and_is_put_right() -> None:
    def drift(run: Any) -> float:
        x, y, phi = run.q[-1, 0]
        return float(np.hypot(x - 0.5 * cos(phi), y - 0.5 * sin(phi)))

    made = bar(Pin(0, (-0.5, 0.0)))
    plain = [drift(run_of(made, fixed_step=h)) for h in (4e-3, 2e-3, 1e-3)]
    order = np.log2(plain[0] / plain[2]) / 2
    assert 1.8 < order < 2.2
    assert drift(run_of(made, fixed_step=4e-3, drift="baumgarte")) < 0.6 * plain[0]
    assert drift(run_of(made, fixed_step=4e-3, drift="projection")) < 1e-9


def test_twice_the_same_joint_is_once() -> None:
    once = run_of(bar(Pin(0, (-0.5, 0.0))))
    twice = run_of(bar(Pin(0, (-0.5, 0.0)), Pin(0, (-0.5, 0.0))))
    assert twice.qps[-1].k == 2 * once.qps[-1].k
    np.testing.assert_allclose(twice.q[-1], once.q[-1], atol=1e-9)


def test_a_joint_that_the_first_velocities_break_is_mended_by_an_impulse() -> None:
    run = run_of(bar(Pin(0, (-0.5, 0.0)), v=(1.0, 0.0, 0.0)), until=0.01)
    assert run.event_log[0].kind == "impulse"
    arm = 0.5 * np.array([cos(1.0), sin(1.0)])
    after = run.v[1, 0]
    np.testing.assert_allclose(after[:2], after[2] * np.array([-arm[1], arm[0]]), atol=1e-9)
    inertia = box(1.0, 0.1).inertia + 0.1 * 0.25  # angular momentum about the pin is kept
    assert after[2] == pytest.approx(-0.1 * arm[1] / inertia, rel=1e-9)


def test_a_rod_that_yields_bears_what_it_can() -> None:
    body = box(0.2, 0.2, 25.0)
    made = Scene(
        bodies=(body,), q0=[(0, -1, 0)], v0=[(0, 0, 0)], ground=(), end_time=0.5,
        joints=(Rod(0, (0.0, 0.0), tension=4.0, compression=inf),),
    )  # fmt: skip
    run = run_of(made, fixed_step=1e-3)
    down = 9.81 - 4.0 / body.mass
    assert run.q[-1, 0, 1] == pytest.approx(-1 - 0.5 * down * 0.25, abs=1e-5)
    holds = run_of(replace(made, joints=(Rod(0, (0.0, 0.0), tension=10.0),)))
    assert holds.q[-1, 0, 1] == pytest.approx(-1, abs=1e-9)


def test_welded_bodies_are_one() -> None:
    both = Scene(
        bodies=(box(0.5, 0.2), box(0.5, 0.2)), q0=[(0.25, 1, 0), (0.75, 1, 0)],
        v0=[(0, 0, 0)] * 2, joints=(Weld(0, 1, (0.25, 0.0)),), end_time=0.6, ground=(),
        forces=(Load(0, (0.0, 0.0, -0.075)),),
    )  # fmt: skip
    one = Scene(
        bodies=(box(1.0, 0.2),), q0=[(0.5, 1, 0)], v0=[(0, 0, 0)], end_time=0.6, ground=(),
        forces=(Load(0, (0.0, 0.0, -0.075)),),
    )  # fmt: skip
    apart, together = (run_of(made, eps=1e-5).q[-1] for made in (both, one))
    np.testing.assert_allclose(apart[0, 2], together[0, 2], atol=2e-4)
    np.testing.assert_allclose(apart.mean(axis=0)[:2], together[0, :2], atol=2e-4)


def test_wheels_in_mesh_turn_against_each_other() -> None:
    wheels = Scene(
        bodies=(disc(0.2), disc(0.4)), q0=[(-0.2, 0, 0), (0.4, 0, 0)], v0=[(0, 0, 0)] * 2,
        ground=(), gravity=0.0, end_time=0.5, forces=(Load(0, (0.0, 0.0, 0.1)),),
        joints=(Pin(0, (0, 0), GROUND, (-0.2, 0)), Pin(1, (0, 0), GROUND, (0.4, 0)), Gear(0, 1, 2)),
    )  # fmt: skip
    run = run_of(wheels, fixed_step=1e-3)
    inertia = disc(0.2).inertia + disc(0.4).inertia / 4
    assert run.v[-1, 0, 2] == pytest.approx(0.1 / inertia * 0.5, rel=1e-6)
    assert run.v[-1, 1, 2] == pytest.approx(-run.v[-1, 0, 2] / 2, rel=1e-9)


def test_a_stop_is_pressed_until_it_is_let_go() -> None:
    """A bar falls on its stop, which holds it until a load lifts it off."""
    lift = Load(0, (0.0, 3.0, 0.0), start=0.4)
    made = bar(Pin(0, (-0.5, 0.0)), Stop(0, least=0.9), forces=(lift,), end_time=0.5)
    run = run_of(made, eps=1e-4)
    kinds = [(event.kind, event.detail) for event in run.event_log]
    assert kinds[0] == ("impulse", "the stop of body 1 and the ground")
    assert ("drop", kinds[0][1]) in kinds
    rests = (run.t > run.event_log[0].t + 1e-6) & (run.t < 0.4)
    assert rests.sum() > 3 and np.abs(run.v[rests]).max() < 1e-9
    assert run.q[:, 0, 2].min() > 0.9 - 1e-6 and run.q[-1, 0, 2] > 0.9


def test_bodies_that_pass_each_other_do_not_touch() -> None:
    at: Any = {"bodies": (box(0.4, 0.4),), "q0": [(0, 0.5, 0)], "v0": [(0, 0, 0)], "end_time": 0.5}
    lands, falls = (run_of(Scene(**at, joints=joints)) for joints in ((), (Apart(0),)))
    assert lands.q[-1, 0, 1] == pytest.approx(0.2, abs=1e-3)
    assert falls.q[-1, 0, 1] < -0.5 and not falls.event_log


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Pin(0, (0.0, np.nan)), "Pin: point"),
        (lambda: Pin(0, (0, 0), 0), "it needs two"),
        (lambda: Pin(-1, (0, 0)), "Pin: body"),
        (lambda: Rod(0, (0, 0), tension=-1.0), "Rod: tension"),
        (lambda: Guide(0, (0, 0), (0, 0)), "must point somewhere"),
        (lambda: Stop(0, least=1.0, most=0.5), "least must be smaller"),
        (lambda: bar(Pin(3, (0, 0))), "Pin: body = 3"),
        (lambda: run_of(bar(Rod(0, (-0.5, 0.0)))), "its two ends are at one place"),
        (lambda: run_of(bar(Pin(0, (-0.4, 0.0)))), "a joint of body 1 and the ground is open by"),
    ],
)
def test_what_is_no_joint_is_refused(make: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()


def test_half_a_turn_of_a_pendulum_keeps_its_energy() -> None:
    run = run_of(bar(Pin(0, (-0.5, 0.0)), end_time=2.0), fixed_step=1e-3)
    body = run.scene.bodies[0]
    energy = 0.5 * body.mass * (run.v[:, 0, :2] ** 2).sum(axis=1) + 0.5 * body.inertia * (
        run.v[:, 0, 2] ** 2
    )
    energy += body.mass * 9.81 * run.q[:, 0, 1]
    assert run.q[:, 0, 2].min() < -pi / 2
    assert np.ptp(energy) < 1e-3 * body.mass * 9.81
