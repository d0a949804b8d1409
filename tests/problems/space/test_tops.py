"""Tops in space against elliptic integrals and the equation of steady precession; order 2."""

from __future__ import annotations

import numpy as np
import pytest

from harness.cases.space import euler_flips, flips, precession_rate
from problems import scene, simulate
from problems.space.attitude import attitude, product, rotations, turned
from problems.space.run import SpaceRun
from problems.space.scenes.top import precession
from solvers import make_solver

STEPS = (0.01, 0.005, 0.0025)


def run(name: str, h: float, **parameters: float) -> SpaceRun:
    return simulate(scene(name, **parameters), make_solver("glambda"), fixed_step=h, keep_qps=False)


def order(errors: list[float]) -> float:
    return float(np.log2(np.array(errors[:-1]) / np.array(errors[1:])).mean())


def test_a_free_top_keeps_its_momentum_and_its_energy_to_second_order():
    energies = []
    for h in STEPS:
        found = run("free_top", h, end_time=1.0)
        np.testing.assert_allclose(found.momenta[:, 0, 3:] - found.momenta[0, 0, 3:], 0, atol=1e-11)
        energies.append(float(np.abs(found.energy / found.energy[0] - 1).max()))
    assert order(energies) == pytest.approx(2.0, abs=0.1)
    assert energies[-1] < 1e-4


def test_it_flips_as_elliptic_integrals_say():
    exact = euler_flips(6.0, 2.0)
    firsts = [flips(run("free_top", h, nudge=2.0, end_time=1.7))[0] for h in STEPS]
    errors = [abs(float(first) - exact.first) for first in firsts]
    assert order(errors) == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 1e-3
    first, second = flips(run("free_top", 0.005, nudge=2.0, end_time=3.7))
    assert second - first == pytest.approx(exact.interval, abs=3e-3)


def test_a_heavy_top_precesses_steadily_about_the_tip_that_is_held():
    exact = precession(40.0, 0.5, 1.0, 0.3, 0.1, 0.2, 9.81)
    runs = [run("heavy_top", h, end_time=0.6) for h in STEPS]
    errors = [abs(precession_rate(found) - exact) for found in runs]
    assert order(errors) == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 5e-3 * exact
    nods = [float(np.ptp(found.poses[:, 0, 2])) for found in runs]
    assert order(nods) == pytest.approx(2.0, abs=0.1)
    drifts = [abs(float(np.linalg.norm(found.poses[-1, 0, :3])) - 0.3) for found in runs]
    assert order(drifts) == pytest.approx(2.0, abs=0.1)


def test_the_tip_bears_weight_and_what_turns_the_top():
    found = run("heavy_top", 0.0025, end_time=0.2)
    centre, force = found.poses[-1, 0, :3], found.reactions[-1, 0, :3]
    flat = centre * (1, 1, 0)
    rate = precession(40.0, 0.5, 1.0, 0.3, 0.1, 0.2, 9.81)
    np.testing.assert_allclose(force, (0, 0, 9.81) - rate**2 * flat, atol=0.02)


def test_attitudes_turn_as_rotation_matrices_do_and_keep_their_length():
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(5, 3))
    e = turned(np.tile(attitude((1.0, 2.0, 3.0), 0.7), (5, 1)), turn)
    np.testing.assert_allclose(np.linalg.norm(e, axis=1), 1.0, rtol=1e-15)
    R = rotations(e)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-14)
    for i in range(5):
        axis, angle = turn[i], float(np.linalg.norm(turn[i]))
        one = rotations(attitude(tuple(axis), angle)[None])[0]
        first = rotations(attitude((1.0, 2.0, 3.0), 0.7)[None])[0]
        np.testing.assert_allclose(R[i], one @ first, atol=1e-14)
    np.testing.assert_allclose(product(e, e * (1, -1, -1, -1))[:, 1:], 0.0, atol=1e-15)


def test_too_slow_a_top_has_no_steady_precession():
    with pytest.raises(ValueError, match="spin it faster"):
        scene("heavy_top", spin=1.0)
