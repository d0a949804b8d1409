"""The error against ε and the rules of drift: fits, stretches, errors and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.claims.convergence import (
    NO_FIT,
    ROUNDING,
    Converged,
    convergence_claims,
    exponents,
    fit,
)
from harness.claims.reference_motion import (
    STOCK,
    Case,
    cases_of,
    longest_step,
    reference_of,
    run_case,
)
from harness.claims.stabilization import NONE, Rule
from harness.peers.ours import BOUNDED
from harness.results.claim import measure
from problems import scene
from reports.claims.convergence import convergence_tables, exponent, write_convergence
from reports.parts.table import short
from solvers import make_solver

RULES = (
    Rule("none", compiled=True),
    NONE,
    Rule("baumgarte", 0.01),
    Rule("baumgarte", 1.0),
    Rule("projection"),
)
LABEL = "tower,bodies=3,lean=0.1,speed=0.01"


def converged(label: str, folder: Path) -> Converged:
    """The campaign on one scene."""
    return Converged(**measure(convergence_claims([label], make_solver("glambda")), folder))


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Converged:
    """A small campaign: an impact, drift, and a reference that is coarse, but fine enough."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("harness.claims.convergence.SWEEP", (1e-3, 1e-4, 1e-5))
        patch.setattr("harness.claims.reference_motion.REFERENCE", 1e-7)
        patch.setattr("harness.claims.stabilization.RULES", RULES)
        return converged(LABEL, tmp_path_factory.mktemp("convergence"))


# --- fits -----------------------------------------------------------------------------------------


def test_a_power_is_found_with_its_spread() -> None:
    eps = 10.0 ** -np.arange(2, 7)
    found = fit(eps, 3.0 * eps**1.5)
    assert found.p == pytest.approx(1.5, abs=1e-12)
    assert found.spread < 1e-7
    assert found.least == pytest.approx(found.largest) == pytest.approx(1.5)
    wavy = fit(eps, eps * np.array([1.0, 2.0, 1.0, 2.0, 1.0]))
    assert wavy.p == pytest.approx(1.0, abs=1e-12)  # the wave is even
    assert wavy.spread > 0.05 and wavy.least < 0.8 and wavy.largest > 1.2


def test_errors_of_rounding_are_left_out() -> None:
    eps = 10.0 ** -np.arange(2, 8)
    errors = np.maximum(1e-3 * eps**2, 1e-3 * ROUNDING)
    assert fit(eps, errors).p == pytest.approx(2.0)
    assert fit(eps, errors).points == 3
    assert fit(eps, 0.0 * eps) == pytest.approx(NO_FIT, nan_ok=True)
    assert fit(eps[:2], eps[:2]).points == 0


# --- the sweep ------------------------------------------------------------------------------------


def test_a_scene_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="fig9"):
        cases_of(["fig9"])


def test_bounds_of_the_step() -> None:
    assert longest_step(1e-6, STOCK) == longest_step(1e-2, STOCK) == 0.02
    assert longest_step(1e-6, BOUNDED) == pytest.approx(3e-4)
    run, _ = run_case(cases_of(["fig3"])[0]._replace(until=0.2), make_solver("glambda"), 1e-4)
    assert np.diff(run.t).max() <= 3e-3 * (1 + 1e-9)


def test_a_run_has_no_error_against_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("harness.claims.reference_motion.REFERENCE", 1e-4)
    case = Case("fig4", scene("fig4"), 0.5)
    reference = reference_of(case, make_solver("glambda"))
    run, _ = run_case(case, make_solver("glambda"), 1e-4)
    pose, velocity = reference.errors(run)
    assert not pose.any() and not velocity.any()
    first, impact, late = reference.ends
    assert 0.1 < impact < 0.2 and first <= impact and late == 0.5
    before, after = reference.within("before"), reference.within("after")
    assert (before ^ after).all() and not reference.within("smooth")[after].any()


def test_it_is_late_after_some_impacts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("harness.claims.reference_motion.REFERENCE", 1e-4)
    monkeypatch.setattr("harness.claims.reference_motion.LATE", 2)
    reference = reference_of(Case("fig4", scene("fig4"), 0.5), make_solver("glambda"))
    parts = [reference.within(stretch) for stretch in ("before", "after", "late")]
    assert (np.sum(parts, axis=0) == 1).all() and all(part.any() for part in parts)
    assert 0.29 < reference.ends[2] < 0.3


def test_the_error_is_proportional_to_eps(measured: Converged) -> None:
    found = exponents(measured.swept).set_index(["bound", "stretch"])
    for stretch in ("before", "after"):
        assert found.loc[(BOUNDED, stretch), "p"] == pytest.approx(1.0, abs=0.15)
    # and it is of the size of ε
    assert (measured.swept["pose"] < measured.swept["eps"]).all()
    steps = measured.swept.groupby("eps")["steps"].max()
    assert steps.is_monotonic_decreasing


# --- drift ----------------------------------------------------------------------------------------


def test_rules_close_gaps(measured: Converged) -> None:
    for _, part in measured.drifted.groupby("eps"):
        found = part.set_index("rule")
        assert found["depth"]["projection"] < 1e-4 * found["depth"]["none"]
        decays = [found["depth"][f"baumgarte, τ = {tau}"] for tau in ("0.01", "1")]
        assert decays[0] < 0.5 * decays[1] < 0.6 * found["depth"]["none"]
        assert found["gap"]["projection"] < 1e-9 < found["gap"]["none"]
        assert found["depth"]["none, compiled"] == pytest.approx(found["depth"]["none"], rel=1e-3)
        assert found["ratio"]["none"] == 1.0
        # none is another motion
        assert found["after"].max() < 3 * found["after"].min()


# --- the page -------------------------------------------------------------------------------------


def test_the_page_tells_what_was_measured(measured: Converged, tmp_path: Path) -> None:
    page = write_convergence(measured, tmp_path).read_text(encoding="utf-8")
    tables = convergence_tables(measured)
    assert page.count("*How to read:*") == len(tables) == 4
    assert (tmp_path / "convergence.png").stat().st_size > 20_000
    for table in tables:
        lines = (tmp_path / f"{table.name}.csv").read_text(encoding="utf-8").splitlines()
        assert len(lines) == 1 + len(table.data) > 1
    notes = "\n".join(tables[-1].notes)
    assert "projection: −min φ is" in notes
    assert "No drift above rounding" not in notes


def test_no_drift_is_said(tmp_path: Path) -> None:
    from reports.claims.convergence import drift_table

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("harness.claims.convergence.SWEEP", (1e-2, 1e-3, 1e-4))
        patch.setattr("harness.claims.reference_motion.REFERENCE", 1e-4)
        still = converged("wall,bodies=3", tmp_path)
    table = drift_table(still.drifted)
    assert table.data.empty
    assert table.notes == ["No drift above rounding: wall,bodies=3."]
    assert "No drift above rounding" in write_convergence(still, tmp_path).read_text("utf-8")


def test_what_has_no_size_is_shown() -> None:
    """As the ratio of two errors, where the smaller one is 0."""
    assert [short(value) for value in (np.inf, -np.inf, np.nan, 1234.5)] == [
        "∞",
        "-∞",
        "–",
        "1,234",
    ]


def test_zero_has_no_sign() -> None:
    assert exponent(-0.001) == "0.00"
    assert exponent(-0.5) == "-0.50"


# --- the command line -----------------------------------------------------------------------------


def test_drift_on_the_command_line(tmp_path: Path) -> None:
    from harness.recordings.recording import read_recording

    asked = "record fig2 --until 0.05 --drift baumgarte --drift-time 0.2 -o"
    run = CliRunner().invoke(app, [*asked.split(), str(tmp_path)])
    assert run.exit_code == 0, run.output
    made = read_recording(next(tmp_path.glob("*.h5")))
    assert made.parameters["run.drift"] == "baumgarte"
    assert made.parameters["run.drift_time"] == 0.2
    wrong = CliRunner().invoke(app, ["simulate", "fig2", "--drift-time", "0.2"])
    assert wrong.exit_code == 2
    assert "give --drift baumgarte" in wrong.stderr
