"""Forces that begin and end where a function of the state changes its sign."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.bodies.bodies import box
from problems.bodies.forces import Drive, Load, SpringDamper, Switched
from solvers import make_solver


def pushed(when: Any, **more: Any) -> Scene:
    """A box of 1 kg without weight that 2 N push while `when` is positive."""
    start = {"q0": [(0, 0, 0)], "v0": [(0, 0, 0)], "gravity": 0.0, "ground": (), "end_time": 2.0}
    return Scene(
        bodies=(box(1.0, 1.0),), forces=(Switched(Load(0, (2.0, 0, 0)), when),), **start | more
    )


def end(made: Scene, **how: Any) -> Any:
    return simulate(made, make_solver("glambda"), keep_qps=False, **how)


def test_a_place_is_located_as_precisely_as_the_path() -> None:
    errors = []
    for h in (4e-2, 2e-2, 1e-2):
        run = end(pushed(lambda q, v, t: 1.0 - q[0, 0]), fixed_step=h)
        errors.append(abs(run.q[-1, 0, 0] - (1.0 + 2.0 * (2.0 - 1.0))))
    assert errors[-1] < 1e-4 and errors[0] / errors[-1] > 8


def test_a_velocity_is_located_too() -> None:
    run = end(pushed(lambda q, v, t: 1.0 - v[0, 0]), fixed_step=1e-2)
    assert [event.kind for event in run.event_log] == ["force_jump"]
    assert run.event_log[0].t == pytest.approx(0.5, abs=1e-4)
    assert run.v[-1, 0, 0] == pytest.approx(1.0, abs=1e-4)


def test_a_force_may_begin() -> None:
    run = end(pushed(lambda q, v, t: q[0, 0] - 1.0, v0=[(1, 0, 0)]), fixed_step=1e-2)
    assert "Load begins" in run.event_log[0].detail
    assert run.q[-1, 0, 0] == pytest.approx(1.0 + 1.0 + 1.0, abs=1e-3)


def test_a_force_that_switches_back_at_once_keeps_the_state_there() -> None:
    """Pushed to v = 1 from both sides: it stays there, to what a first step may change."""
    made = replace(
        pushed(lambda q, v, t: 1.0, v0=[(1.5, 0, 0)]),
        forces=tuple(
            Switched(Load(0, (-s * 2.0, 0, 0)), lambda q, v, t, s=s: s * (v[0, 0] - 1.0))
            for s in (1, -1)
        ),
    )
    run = end(made, h_first=1e-3)
    assert np.abs(run.v[run.t > 0.26, 0, 0] - 1.0).max() <= 2.0 * 1e-3


def test_runs_are_the_same_with_and_without_their_qps() -> None:
    runs = [simulate(scene("motor"), make_solver("glambda"), keep_qps=keep) for keep in (0, 1)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


def test_a_spring_between_bodies_pulls_both_alike() -> None:
    spring = SpringDamper(0, (0.1, 0.2), (-0.2, 0.1), 30.0, 2.0, 0.4, other=1)
    rng = np.random.default_rng(3)
    q, v, f = rng.normal(size=6), rng.normal(size=6), np.zeros(6)
    spring.add(f, q, v, 0.0)
    np.testing.assert_allclose(f[:2], -f[3:5])
    torque = q[0] * f[1] - q[1] * f[0] + f[2] + q[3] * f[4] - q[4] * f[3] + f[5]
    assert torque == pytest.approx(0.0, abs=1e-12)
    free = SpringDamper(0, (0.1, 0.2), (-0.2, 0.1), 30.0, 0.0, 0.4, other=1)
    f = np.zeros(6)
    free.add(f, q, v, 0.0)
    for i in range(6):
        step = np.zeros(6)
        step[i] = 1e-6
        slope = (free.potential(q + step) - free.potential(q - step)) / 2e-6
        assert f[i] == pytest.approx(-slope, abs=1e-6)


def test_a_string_does_not_push() -> None:
    string = SpringDamper(0, (0.0, 0.0), (0.0, 0.0), 30.0, 5.0, 1.0, slack=True)
    f = np.zeros(3)
    string.add(f, np.array([0.5, 0.0, 0.0]), np.ones(3), 0.0)
    assert not f.any() and string.potential(np.array([0.5, 0.0, 0.0])) == 0.0
    string.add(f, np.array([1.5, 0.0, 0.0]), np.zeros(3), 0.0)
    assert f[0] == pytest.approx(-15.0)


def test_a_drive_swings() -> None:
    made = Scene(
        bodies=(box(1.0, 1.0),), q0=[(0, 0, 0)], v0=[(0, 0, 0)], gravity=0.0, ground=(),
        forces=(Drive(0, (3.0, 0, 0), 1.0),), end_time=1.0,
    )  # fmt: skip
    run = end(made, fixed_step=1e-3)
    assert run.q[-1, 0, 0] == pytest.approx(3.0 / (2 * np.pi), abs=1e-4)
