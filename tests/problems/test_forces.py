"""Forces against finite differences of their potentials, and the damper against power."""

import numpy as np
import pytest

from problems.bodies.forces import Gravity, Load, SpringDamper


def force_of(force, q, v, t=0.0):
    f = np.zeros_like(q)
    force.add(f, q, v, t)
    return f


@pytest.mark.parametrize(
    "force",
    [
        Gravity(np.array([2.0, 3.0]), 9.81),
        SpringDamper(1, (0.3, -0.4), (1.0, 5.0), stiffness=6.0, damping=0.0, length=0.7),
    ],
)
def test_conservative_forces_are_minus_the_gradient(force):
    q, step = np.random.default_rng(0).normal(size=6), 1e-6
    numeric = [
        -(force.potential(q + step * e) - force.potential(q - step * e)) / (2 * step)
        for e in np.eye(6)
    ]
    np.testing.assert_allclose(force_of(force, q, np.zeros(6)), numeric, atol=1e-7)


def test_a_damper_only_takes_energy():
    rng = np.random.default_rng(1)
    damper = SpringDamper(0, (0.3, -0.4), (1.0, 5.0), stiffness=0.0, damping=6.0)
    for _ in range(50):
        q, v = rng.normal(size=3), rng.normal(size=3)
        assert force_of(damper, q, v) @ v <= 1e-12
    assert damper.velocity_dependent


def test_a_load_acts_between_its_times():
    load = Load(0, (1.0, 2.0, 3.0), start=0.5, end=1.0)
    assert load.jumps == (0.5, 1.0)
    assert force_of(load, np.zeros(3), np.zeros(3), 0.5).tolist() == [0, 0, 0]
    assert force_of(load, np.zeros(3), np.zeros(3), 0.7).tolist() == [1, 2, 3]
    assert force_of(load, np.zeros(3), np.zeros(3), 1.1).tolist() == [0, 0, 0]
