"""Painlevé's rod: gains, what the two friction rules make of it, and what a run reports."""

from __future__ import annotations

import numpy as np
import pytest

from problems import Run, scene, simulate
from problems.assembly import Assembly
from problems.friction_passes import largest_gain
from problems.stepper import Stepper, StepperOptions
from solvers import make_solver

FLUSH = {"angle": np.pi / 2, "thickness": 1.0}
"""A box that slides on its whole side, twice as high as wide."""


def run_of(
    until: float = 0.01, friction: str = "corrected", eps: float = 1e-3, **parameters
) -> Run:
    made = scene("painleve", **parameters)
    return simulate(made, make_solver("lotstedt"), until=until, friction=friction, eps=eps)  # type: ignore[arg-type]


def gains(run: Run) -> list[float]:
    return [float(e.detail.rsplit("= ", 1)[1]) for e in run.event_log if e.kind == "gain"]


def kinds(run: Run) -> list[str]:
    return [event.kind for event in run.event_log]


def test_the_end_of_the_rod_touches_and_slides() -> None:
    for parameters in ({}, {"angle": 0.3, "spin": 2.0}, FLUSH):
        run = run_of(1e-4, mu=0.1, **parameters)
        assert run.multipliers[1]
        _, y, phi = run.q[0, 0]
        corner = run.scene.bodies[0].polygons[0][1]
        arm = corner @ np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        vx, vy, omega = run.v[0, 0]
        assert y + arm[1] == pytest.approx(0.0, abs=1e-14)
        assert vx - omega * arm[1] == pytest.approx(1.0)
        assert vy + omega * arm[0] == pytest.approx(0.0, abs=1e-14)


def test_an_angle_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match=r"angle = 2; it must be above 0"):
        scene("painleve", angle=2.0)


@pytest.mark.parametrize("friction", ["paper", "corrected"])
@pytest.mark.parametrize("parameters", [{}, {"spin": 4.0}, FLUSH], ids=["none", "two", "flush"])
def test_a_gain_of_one_or_more_is_an_event_once(friction: str, parameters: dict) -> None:
    found = gains(run_of(friction=friction, **parameters))
    assert found == [pytest.approx(1.2, abs=0.01)]  # μ · 3 tan θ/(4 + tan²θ)


@pytest.mark.parametrize("friction", ["paper", "corrected"])
def test_compiled_steps_leave_gains_to_the_stepper(friction: str) -> None:
    """The rod rises, slides past γ = 1 and is seen there, whether its QPs are kept or not."""
    rising = scene("painleve", angle=0.7, spin=3.0, slip=3.0)
    kept, quick = (
        simulate(rising, make_solver("lotstedt"), until=0.06, friction=friction, keep_qps=keep)  # type: ignore[arg-type]
        for keep in (True, False)
    )
    assert "gain" in kinds(kept) and kinds(quick) == kinds(kept)
    np.testing.assert_allclose([e.t for e in quick.event_log], [e.t for e in kept.event_log])
    assert quick.counts["qps"] > 0 and not quick.qps


@pytest.mark.parametrize("friction", ["paper", "corrected"])
@pytest.mark.parametrize("changes", [{"mu": 1.3}, {"slip": -1.0}, {"mu": 1.3, **FLUSH}])
def test_below_one_there_is_no_event(friction: str, changes: dict) -> None:
    assert "gain" not in kinds(run_of(friction=friction, **changes))


def test_gains_of_several_contacts_are_found_where_the_passes_fail() -> None:
    """Boxes that slide on each other: no contact has a gain of 1 by itself with μ = 0.5."""
    run = simulate(scene("fig2", boxes=8, mu=0.5), make_solver("lotstedt"), until=0.08)
    assert gains(run) and min(gains(run)) >= 1
    first = next(event.t for event in run.event_log if event.kind == "gain")
    assert min(abs(first - event.t) for event in run.event_log if event.kind == "jam") < 1e-3


@pytest.mark.parametrize("entries", [10**6, 0], ids=["dense", "sparse"])
def test_the_largest_gain_is_an_eigenvalue_of_the_slope(monkeypatch, entries: int) -> None:
    monkeypatch.setattr("problems.assembly.DENSE_ENTRIES", entries)
    stepper = Stepper(
        scene("tower", bodies=6, mu=0.5),
        make_solver("lotstedt"),
        StepperOptions(1e-3, 1e-3, rest_speed=1.0),
    )
    stepper.start()
    assembly, D = Assembly(stepper.graph, stepper.q), stepper.D
    n, f = len(assembly.normals), len(assembly.frictions)
    rng = np.random.default_rng(4)
    sigma = rng.integers(-1, 2, f).astype(float)
    lam_N = np.where(rng.uniform(size=n) < 0.2, 0.0, 1.0)
    free, inside = lam_N > 0, sigma == 0
    S = np.column_stack([assembly.G_N.toarray()[:, free], assembly.G_F.toarray()[:, inside]])
    forces = [assembly.friction_force(sigma * assembly.bound(e)) for e in np.eye(n)[free]]
    slope = -np.linalg.pinv(S / D[:, None])[: free.sum()] @ (np.array(forces) / D).T
    gain, at = largest_gain(assembly, D, sigma, ~inside, lam_N)
    assert gain == pytest.approx(np.linalg.eigvals(slope).real.max(), rel=1e-5)
    assert free[at] and gain > 0.1
    assert largest_gain(assembly, D, sigma, ~inside, 0 * lam_N)[0] == -np.inf
