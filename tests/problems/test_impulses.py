"""Impulses (2.13)–(2.15), §4.3: laws at every impulse of the scenes, and cases by hand."""

import numpy as np
import pytest

from problems import simulate
from problems.bodies.forces import Impulse
from solvers import make_solver
from tests.fakes.runs import one_box, scene_run


def impulses_of(run):
    """(qp, x) of every accepted impulse."""
    return [
        (qp, solution.x)
        for qp, solution in zip(run.qps, run.solutions, strict=True)
        if qp.kind == "impulse" and qp.accepted
    ]


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("fig2", {}), ("fig3", {}), ("fig4", {}), ("fig4", {"mu_I": 0.8}), ("fig5", {})],
)
def test_energy_falls_by_half_the_square_of_the_impulse(name, parameters):
    """2ΔT = −‖AΛ‖² where F = 0, from (4.11), whatever μ_I."""
    run = scene_run(name, **parameters)
    external = {i.t for i in run.scene.impulses}
    checked = 0
    for qp, x in impulses_of(run):
        if qp.t in external:
            continue
        before, after = qp.d, qp.residual(x)  # D q̇₋ and D q̇₊
        change = after @ after - before @ before
        assert change == pytest.approx(-np.sum((qp.A @ x) ** 2), abs=1e-11 * (before @ before))
        checked += 1
    assert checked >= 2


def test_signorini_holds_after_every_impulse():
    for qp, x in impulses_of(scene_run("fig2")):
        scale = np.linalg.norm(qp.d)
        gradient = qp.gradient(x)
        assert (x >= 0).all()
        assert gradient.min() >= -1e-11 * scale
        assert np.abs(x * gradient).max() <= 1e-11 * scale**2


def test_tangential_contacts_bounce_by_mu_I():
    """§4.3: where |Λ_F| = μ_I Λ_N > 0, g_Nᵀq̇₊ = μ_I |g_Fᵀq̇₊|: the bodies bounce."""
    scene = one_box(y=0.6, v=(3.0, -2.0, 0.0), mu=0.5, mu_I=0.4, gravity=0.0, end_time=0.2)
    run = simulate(scene, make_solver("glambda"))
    assert run.counts["impulses"] == 1
    vx, vy, omega = run.v[-1, 0]
    # both corners of the flat box strike: speeds of the contact points
    normal = [vy + omega * x for x in (-0.5, 0.5)]
    slip = vx + omega * 0.5
    assert min(normal) == pytest.approx(0.4 * abs(slip), abs=1e-9)
    assert vy > 0, "it bounces off"


def test_without_mu_I_a_drop_is_inelastic():
    run = simulate(
        one_box(y=0.7, v=(3.0, -2.0, 0.0), gravity=0.0, end_time=0.3), make_solver("glambda")
    )
    np.testing.assert_allclose(run.v[-1, 0], [3.0, 0.0, 0.0], atol=1e-12)


def test_external_impulse_in_free_flight_is_M_inverse_F():
    scene = one_box(y=5.0, gravity=0.0, impulses=(Impulse(0.1, 0, (1.0, 2.0, 0.5)),), end_time=0.2)
    run = simulate(scene, make_solver("glambda"))
    np.testing.assert_allclose(run.v[-1, 0], [1.0, 2.0, 0.5 * 6], rtol=1e-12)
    assert [e.kind for e in run.event_log] == ["impulse"]
    assert run.event_log[0].t == pytest.approx(0.1, abs=1e-9)


def test_generators_are_kept_and_give_a_coulomb_cone():
    run = scene_run("fig5")
    posed = [(qp, x) for qp, x in impulses_of(run) if qp.generators is not None]
    assert posed
    for qp, x in posed:
        V = qp.generators
        assert V.shape[1] == qp.k
        Lam = qp.multipliers(x)
        n_frictions = int((np.abs(V).max(axis=1) == 0.8).sum())
        assert n_frictions > 0
        normals, frictions = Lam[: V.shape[0] - n_frictions], Lam[-n_frictions:]
        assert (normals >= 0).all()
        assert np.abs(frictions).sum() <= 0.8 * normals.sum() + 1e-12
