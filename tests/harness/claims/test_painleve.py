"""Painlevé's rod: gains, what the two friction rules make of it, and what a run reports."""

from __future__ import annotations

import numpy as np
import pytest

from glambda.display.runs import print_run
from harness.claims.painleve import Painleve, painleve_claims
from harness.claims.slide import STEEPEST, Slide, growth, rod_of_gain, slide_of
from harness.results.claim import measure
from problems import Run, scene, simulate
from problems.contacts.assembly import Assembly
from problems.friction.newton import largest_gain
from problems.stepping.stepper import Stepper, StepperOptions
from reports.claims.painleve import painleve_tables, write_painleve
from solvers import make_solver

FLUSH = {"angle": np.pi / 2, "thickness": 1.0}
"""A box that slides on its whole side, twice as high as wide."""


def run_of(
    until: float = 0.01, friction: str = "corrected", eps: float = 1e-3, **parameters
) -> Run:
    made = scene("painleve", **parameters)
    return simulate(made, make_solver("glambda"), until=until, friction=friction, eps=eps)  # type: ignore[arg-type]


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
        simulate(
            rising, make_solver("glambda"), eps=1e-4, until=0.06, friction=friction, keep_qps=keep
        )
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
    run = simulate(scene("fig2", boxes=8, mu=0.5), make_solver("glambda"), until=0.08)
    assert gains(run) and min(gains(run)) >= 1
    first = next(event.t for event in run.event_log if event.kind == "gain")
    assert min(abs(first - event.t) for event in run.event_log if event.kind == "jam") < 1e-3


@pytest.mark.parametrize("entries", [10**6, 0], ids=["dense", "sparse"])
def test_the_largest_gain_is_an_eigenvalue_of_the_slope(monkeypatch, entries: int) -> None:
    monkeypatch.setattr("problems.contacts.assembly.DENSE_ENTRIES", entries)
    stepper = Stepper(
        scene("tower", bodies=6, mu=0.5),
        make_solver("glambda"),
        StepperOptions(1e-3, 1e-3, rest_speed=1.0),
    )
    stepper.start()
    assembly, D = Assembly(stepper.system.graph, stepper.system.q), stepper.system.D
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


# --- closed forms ---------------------------------------------------------------------------------


def start_of(**parameters) -> Slide:
    made = scene("painleve", **parameters)
    return slide_of(made, made.q0[0], made.v0[0])


@pytest.mark.parametrize("angle", [0.3, 0.8, 1.1, 1.4])
def test_the_gain_of_a_thin_rod(angle: float) -> None:
    tangent = np.tan(angle)
    gain = start_of(angle=angle, thickness=1e-6, mu=2.0).gain
    assert gain == pytest.approx(6 * tangent / (4 + tangent**2), rel=1e-5)
    assert start_of(angle=angle, slip=-1.0).gain == -start_of(angle=angle).gain


def test_catching_stops_the_corner_within_the_cone_from_a_gain_of_one_on() -> None:
    for mu in (1.2, 1.3, 1.4, 3.0):
        slide = start_of(mu=mu, angle=STEEPEST)
        x, y, omega = slide.v + slide.catch
        corner = (x - omega * slide.arm[1], y + omega * slide.arm[0])
        np.testing.assert_allclose(corner, 0.0, atol=1e-12)
        tangential, normal, _ = slide.masses * slide.catch
        assert normal > 0 and (abs(tangential) <= mu * normal) == (slide.gain >= 1)
        assert slide.norm(slide.v + slide.catch) < slide.norm(slide.v)


def test_growth_reaches_one_at_the_ends_of_its_interval() -> None:
    assert growth(1.0) == pytest.approx(1.0, abs=1e-7)
    assert growth(-1 / 3) == pytest.approx(1.0)
    assert all(growth(gain) < 1 for gain in (-0.33, -0.1, 0.3, 0.99))
    assert growth(1.2, "(4.3)") == 1.2 < growth(1.2)
    assert rod_of_gain(-0.4).parameters["slip"] == -1.0


# --- the study ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Painleve:
    """The study with fewer lengths, spins and tolerances."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("harness.claims.painleve.STEPS", (1e-4, 1e-5, 1e-6, 1e-7))
        patch.setattr("harness.claims.painleve.GAINS", (-0.4, -0.3, 0.9, 1.2, 2.0))
        patch.setattr("harness.claims.painleve.APPROACHES", (2.0, 3.0))
        patch.setattr("harness.claims.painleve.TOLERANCES", (1e-3, 1e-4))
        claims = painleve_claims(make_solver("glambda"))
        return Painleve(**measure(claims, tmp_path_factory.mktemp("painleve")))


def test_the_first_step_does_not_blow_up(measured: Painleve) -> None:
    for motions, part in measured.firsts.groupby("motions"):
        paper = part[part["rule"] == "paper"]
        np.testing.assert_allclose(
            paper["jump"] / paper["h"], paper["jump"].iloc[0] / 1e-4, rtol=0.01
        )
        tight = part[(part["rule"] == "corrected") & (part["eps"] == 1e-9)]
        if str(motions).startswith("none"):
            np.testing.assert_allclose(tight["jump"], tight["catch"], rtol=1e-4)
            assert tight["lam"].max() > 900 * tight["lam"].min()
        else:
            np.testing.assert_allclose(
                tight["jump"] / tight["h"], tight["jump"].iloc[0] / 1e-4, rtol=0.01
            )


def test_lambda_grows_by_the_roots(measured: Painleve) -> None:
    np.testing.assert_allclose(
        measured.growths["measured"], measured.growths["by (4.2)"], rtol=1e-4
    )
    assert (measured.growths["steps"] >= 3).all()


def test_over_a_fixed_time_it_grows_without_limit_where_no_motion_exists(
    measured: Painleve,
) -> None:
    fixed = measured.fixed[measured.fixed["gain"] > 1]
    np.testing.assert_allclose(fixed["measured"], fixed["predicted"], rtol=1e-3)
    for _, part in fixed.groupby("gain"):
        more, power = np.diff(np.log(part["measured"])), np.diff(np.log(part["power"]))
        np.testing.assert_allclose(more[1:], power[1:], rtol=0.1)
    fades = measured.fixed[measured.fixed["gain"] == 0.9]
    assert (fades["measured"] < 1).all()


def test_both_rules_tend_to_the_impulse_without_a_collision(measured: Painleve) -> None:
    catches = measured.catches.groupby(["rule", "h"], sort=False).first()
    for rule in ("paper", "corrected"):
        errors = catches.loc[rule, "error"].to_numpy()
        assert (errors[1:] < 0.2 * errors[:-1]).all() and errors[-1] < 2e-5
    paper = catches.loc["paper"]
    steps = paper["end"] / paper.index
    np.testing.assert_allclose(np.diff(steps), np.log(10) / np.log(growth(1.2)), rtol=0.05)


def test_what_becomes_of_the_rod(measured: Painleve) -> None:
    ends = measured.outcomes.set_index(["motions", "rule"])
    assert ends.loc[("two", "paper"), "end"] == ends.loc[("two", "corrected"), "end"] == "drop"
    for motions in ("none", "none, γ = 7.5", "none, two corners"):
        assert ends.loc[(motions, "paper"), "end"] == "slip_to_stick"
        assert ends.loc[(motions, "corrected"), "end"] == "jam"
        assert ends.loc[(motions, "corrected"), "error"] < 1e-3
    reported = measured.outcomes["reported"]
    told = measured.outcomes["gain"] >= 1
    np.testing.assert_allclose(reported[told], measured.outcomes["gain"][told], rtol=0.01)
    assert reported[~told].isna().all()


def test_no_motion_crosses_a_gain_of_one_where_it_would_be_lost(measured: Painleve) -> None:
    """Beyond γ = 1 there is none while B < 0."""
    beyond = measured.approaches[measured.approaches["gain"] > 1.001]
    assert len(beyond) and (beyond["free"] > -0.05).all()
    assert (measured.approaches["lam"] < 100).all()
    spins = measured.approaches.groupby("spin")["gain"].max()
    assert spins[2.0] < 0.99 < 1 < spins[3.0]


def test_the_page_tells_it(measured: Painleve, tmp_path) -> None:
    page = write_painleve(measured, tmp_path).read_text(encoding="utf-8")
    assert "Nothing blows up" in page and "is decided by ε" in page
    assert page.count("*How to read:*") == len(painleve_tables(measured)) == 6
    assert (tmp_path / "painleve.png").stat().st_size > 20_000
    firsts = (tmp_path / "painleve_first.csv").read_text(encoding="utf-8").splitlines()
    assert len(firsts) == 1 + 5 * 3


def test_simulate_tells_of_gains(capsys) -> None:
    from rich.console import Console

    print_run(Console(width=120), run_of(0.001))
    told = capsys.readouterr().out
    assert "events: 1 gain, 1 jam" in told
    assert "gain of friction, body 1 and the ground: γ = 1.2" in told
    assert "jam: friction whose gain is 1 or more stops contacts at once" in told
