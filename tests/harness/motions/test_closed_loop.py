"""Solvers in the loop: what is asked of them, what becomes of them, and what is reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.judging.facts import facts_of
from harness.motions import isolated_loops, loop
from harness.motions.closed_loop import Findings, LoopPlan, close_loops
from harness.motions.in_loop import NOISES, SLOPPY, InLoop, Sloppy, check_backend, exact, posed
from harness.motions.isolated_loops import run_isolated
from harness.motions.loop import Loop, LoopResult, run_loop
from harness.motions.loop_store import load_loop, loop_path, write_loop
from harness.results.store import StoreError
from problems.qp import ContactQP, Solution
from reports.motions.closed_loop import COLUMNS, sloppy_table, write_closed_loop
from reports.motions.closed_loop_figures import plot_separation
from reports.motions.closed_loop_findings import (
    as_large_as_eps,
    discretization,
    findings_of,
    harmless,
    is_good,
)
from solvers import make_solver
from solvers.base import Unsupported
from tests.fakes.loop_crimes import CRIMES
from tests.fakes.runs import scene_run

LOOP = Loop("fig3", "glambda", "paper", 1e-3, 1e-3, 2e-3, until=0.9, time_limit=60.0)
SMALL = LoopPlan(
    scenes=("fig3",),
    solvers=("glambda", "clarabel"),
    settings=("paper",),
    sweep=("1x", "1e5x"),
    until=0.9,
    finer=100.0,
    check=10.0,
    workers=2,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("closed_loop")


@pytest.fixture(scope="module")
def found(folder: Path) -> Findings:
    return close_loops(SMALL, folder)[0]


def some_qps() -> list[ContactQP]:
    qps = scene_run("fig5").qps
    return [qp for qp in qps if qp.kind != "minimum_norm" and qp.k][:: len(qps) // 12]


# --- what is asked, and who is sloppy ------------------------------------------------------------


def test_settings_ask_for_multiples_of_eps0_or_of_the_scale() -> None:
    qp = some_qps()[0]
    scale = facts_of(qp).scale
    for setting, asked in (
        ("paper", qp.eps0),
        ("default", qp.eps0),
        ("100x", 100 * qp.eps0),
        ("high", 1e-9 * scale),
        ("1e-3", 1e-3 * scale),
    ):
        assert posed(setting, qp).eps0 == pytest.approx(asked, rel=1e-12)


@pytest.mark.parametrize(
    ("solver", "setting", "complaint"),
    [
        ("glambda", "precise", "precise"),
        ("glambda", "-1x", "multiple of ε₀"),
        ("nobody", "paper", "nobody"),
        ("sloppy[very]", "1x", "sloppy"),
        ("sloppy[any]", "default", "default"),
    ],
)
def test_unknown_solvers_and_settings_are_refused(
    solver: str, setting: str, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        check_backend(solver, setting)


@pytest.mark.parametrize("noise", NOISES)
def test_a_sloppy_answer_is_wrong_by_what_was_asked(noise: str) -> None:
    for qp in some_qps():
        x = exact(qp)
        spoilt = Sloppy(noise).solve(qp.with_accuracy(1e-3)).x
        error = np.linalg.norm(qp.A @ (spoilt - x))
        assert error == pytest.approx(1e-3, rel=1e-6) or (
            noise in ("free", "inside") and error == 0
        )
        if noise == "free":
            assert (spoilt[x == qp.lower] == qp.lower[x == qp.lower]).all()
            assert (spoilt[x == qp.upper] == qp.upper[x == qp.upper]).all()
        if noise == "inside":
            at_bound = (x == qp.lower) | (x == qp.upper)
            assert (spoilt[~at_bound] == x[~at_bound]).all()
            assert (spoilt > qp.lower)[(x == qp.lower) & (qp.lower < qp.upper)].all()
        if noise in ("more", "less"):
            stronger = np.linalg.norm(qp.A @ spoilt) > np.linalg.norm(qp.A @ x)
            assert stronger == (noise == "more")


def test_sloppiness_is_the_same_every_time_and_another_at_each_qp() -> None:
    qps = some_qps()[:2]
    one, other = Sloppy("any"), Sloppy("any")
    first = [one.solve(qp).x for qp in (qps[0], qps[0])]
    assert (other.solve(qps[0]).x == first[0]).all()
    assert (first[0] != first[1]).any()


def test_what_a_solver_cost_is_counted_and_its_time_runs_out() -> None:
    driver = InLoop("glambda", "high")
    for qp in some_qps():
        driver.solve(qp)
    assert driver.calls == len(some_qps())
    assert driver.call_time >= driver.solve_time > 0
    late = InLoop("glambda", "high", time_limit=0.0)
    with pytest.raises(RuntimeError, match="time limit"):
        late.solve(some_qps()[0])
    assert late.out_of_time


# --- one loop ------------------------------------------------------------------------------------


class GivesUp:
    """Solves exactly up to t = 0.3 s, and then does something else."""

    def __init__(self, instead: Callable[[ContactQP], Solution]) -> None:
        self.instead = instead

    def solve(self, qp: ContactQP, start: Solution | None = None) -> Solution:
        return self.instead(qp) if qp.t > 0.3 else make_solver("glambda").solve(qp)


def fails(qp: ContactQP) -> Solution:
    raise ZeroDivisionError("on purpose")


def refuses(qp: ContactQP) -> Solution:
    raise Unsupported("more than I take")


@pytest.mark.parametrize(
    ("instead", "verdict", "reason"),
    [(fails, "stopped", "on purpose"), (refuses, "refused", "more than I take")],
)
def test_a_loop_that_stops_is_measured_up_to_there(
    monkeypatch: pytest.MonkeyPatch,
    instead: Callable[[ContactQP], Solution],
    verdict: str,
    reason: str,
) -> None:
    class Driver(InLoop):
        def __init__(self, *arguments: object) -> None:
            super().__init__("glambda", "paper")
            self.solver = GivesUp(instead)

    monkeypatch.setattr(loop, "InLoop", Driver)
    told: list[float] = []
    result = run_loop(LOOP, told.append)
    assert (result.verdict, reason in result.reason) == (verdict, True)
    assert 0.2 < result.reached <= 0.3
    assert told[-1] == result.reached
    assert result.motion is not None
    assert result.motion.t[-1] == pytest.approx(result.reached)
    assert result.measures["steps"] > 5


def test_a_loop_that_takes_too_long_says_so() -> None:
    result = run_loop(replace(LOOP, time_limit=1e-9))
    assert (result.verdict, result.reached, result.motion) == ("timeout", 0.0, None)


def test_a_result_is_read_back_as_it_was(tmp_path: Path) -> None:
    result = run_loop(replace(LOOP, until=0.2))
    write_loop(tmp_path, result)
    kept = load_loop(tmp_path, result.loop)
    assert kept is not None
    assert kept.measures == result.measures
    assert kept.motion is not None
    assert result.motion is not None
    for name in ("t", "q", "v", "radius"):
        assert (getattr(kept.motion, name) == getattr(result.motion, name)).all()
    assert kept.motion.events == result.motion.events
    table = pd.read_parquet(loop_path(tmp_path, result.loop))
    assert list(table.columns) == ["t", "body", "x", "y", "phi", "vx", "vy", "omega"]


def test_results_of_something_else_are_refused(tmp_path: Path) -> None:
    write_loop(tmp_path, LoopResult(LOOP, "stopped", "", 0.0, {}, None))
    assert load_loop(tmp_path, replace(LOOP, solver="daqp")) is None
    with pytest.raises(StoreError, match="until"):
        load_loop(tmp_path, replace(LOOP, until=0.5))
    path = loop_path(tmp_path, LOOP)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(StoreError, match="seal is missing"):
        load_loop(tmp_path, LOOP)


# --- processes -----------------------------------------------------------------------------------


def test_crashes_and_hangs_cost_one_loop(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(isolated_loops, "GRACE", 3.0)
    monkeypatch.setattr("harness.motions.loop_store.solver_version", lambda name: "none")
    limits = {crime: 0.1 if crime == "hangs" else 60.0 for crime in CRIMES}
    loops = [replace(LOOP, solver=crime, time_limit=limits[crime]) for crime in CRIMES]
    seen: list[float] = []
    run_isolated(
        loops,
        tmp_path,
        workers=3,
        work="tests.fakes.loop_crimes:commit",
        progress=lambda what, done, n: seen.append(done),
    )
    results = [load_loop(tmp_path, each) for each in loops]
    assert [r.verdict for r in results if r] == ["crashed", "crashed", "timeout"]
    assert [r.reached for r in results if r] == [0.25] * 3
    reasons = [r.reason for r in results if r]
    assert "SIGSEGV" in reasons[0]
    assert "last words" in reasons[0]
    assert "exit code 3" in reasons[1]
    assert seen[-1] == 3.0


def test_a_loop_writes_no_machine_code_into_its_own_folder(tmp_path: Path) -> None:
    """It would be lost with the process, and every loop would compile for half a minute."""
    run_isolated([LOOP], tmp_path, work="tests.fakes.compiled_loop:run_and_look")
    result = load_loop(tmp_path, LOOP)
    assert result is not None
    assert (result.verdict, result.reason) == ("finished", "")


# --- a campaign ----------------------------------------------------------------------------------


def test_each_loop_has_a_row(found: Findings) -> None:
    rows = found.rows
    sloppy = [(name, setting) for name in SLOPPY for setting in SMALL.sweep]
    wanted = [("glambda", "1e-12"), ("glambda", "paper"), ("clarabel", "paper"), *sloppy]
    assert list(zip(rows["solver"], rows["setting"], strict=True)) == wanted
    assert (rows["verdict"] == "finished").all()
    assert (rows["matched"] == 1).all()  # one impact, at 0.738
    assert found.first_impact == pytest.approx(0.738, abs=1e-3)


def test_motions_are_as_near_as_they_should_be(found: Findings) -> None:
    rows = found.rows.set_index(["solver", "setting"])
    error, own = rows["error"], rows["from_twin"]
    assert own["glambda", "1e-12"] == 0.0
    assert own["clarabel", "paper"] < 1e-6
    # the reference is much better than what it judges, and ε is what the errors come from
    twin = error["glambda", "1e-12"]
    assert found.check_error.largest(found.common) < 0.3 * twin
    for noise in ("any", "more", "less"):
        assert own[f"sloppy[{noise}]", "1x"] < 0.1 * twin
        assert own[f"sloppy[{noise}]", "1e5x"] > 10 * own[f"sloppy[{noise}]", "1x"]
    # too large forces lift contacts until they are dropped
    assert error["sloppy[more]", "1e5x"] < 3 * twin
    assert rows["pumped"]["sloppy[more]", "1e5x"] > 1e-3  # [J]; exact ones do no such work
    assert rows["pumped"]["glambda", "1e-12"] < 1e-12
    assert is_good(found)[:3].all()
    assert harmless(found, "sloppy[more]") >= 1.0


def test_a_folder_is_continued_and_belongs_to_its_parameters(found: Findings, folder: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.parquet")}
    lost = sorted(before)[0]
    lost.unlink()
    again = close_loops(SMALL, folder)[0]
    kept = [path for path in before if path != lost]
    assert lost.exists()
    assert all(path.stat().st_mtime_ns == before[path] for path in kept)
    timed = ["wall_time", "call_time", "solve_time"]
    pd.testing.assert_frame_equal(again.rows.drop(columns=timed), found.rows.drop(columns=timed))
    with pytest.raises(StoreError, match="until"):
        close_loops(replace(SMALL, until=0.8), folder)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"scenes": ()}, "no scenes"),
        ({"scenes": ("nowhere",)}, "nowhere"),
        ({"solvers": ("nobody",)}, "nobody"),
        ({"settings": ("fast",)}, "fast"),
        ({"sweep": ("fast",)}, "fast"),
        ({"until": -1.0}, "until"),
        ({"workers": 0}, "workers"),
        ({"check": 1e4}, "check"),
    ],
)
def test_a_bad_plan_is_refused(fields: dict[str, object], complaint: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=complaint):
        close_loops(replace(SMALL, **fields), tmp_path / "none")  # type: ignore[arg-type]
    assert not (tmp_path / "none").exists()


# --- the report ----------------------------------------------------------------------------------


def test_the_page_tells_what_was_found(found: Findings, tmp_path: Path) -> None:
    text = write_closed_loop([found], tmp_path).read_text(encoding="utf-8")
    assert "1 of 1 " not in text
    assert "2 of 2 loops of the backends came to their end." in text
    assert "2 of 2 loops of the backends are as good as exact QPs" in text
    assert "wrong by a known" in text and "closed_loop.csv" in text
    rows = pd.read_csv(tmp_path / "closed_loop.csv")
    names = ", ".join([*COLUMNS, "rms", "event_error", "mismatch", "energy_end", "peak_kinetic"])
    assert {*names.split(", ")} <= {*rows.columns}
    assert list(rows["solver"]) == list(found.rows["solver"])
    for name in ("accuracy", "separation", "physics"):
        assert (tmp_path / f"closed_loop_{name}.png").stat().st_size > 10_000
    again = plot_separation([found], tmp_path / "again.svg")
    assert again.read_bytes() == (tmp_path / "closed_loop_separation.svg").read_bytes()


def with_row(found: Findings, solver: str, **values: object) -> Findings:
    rows = found.rows.copy()
    for name, value in values.items():
        rows.loc[rows["solver"] == solver, name] = value
    return replace(found, rows=rows)


def test_bad_news_is_told(found: Findings) -> None:
    wrong = with_row(found, "clarabel", error=0.5, missed=0, pumped=5.0, overlap=0.1, approach=0.2,
        reach=0.04,
    )  # fmt: skip
    text = " ".join(findings_of([wrong]))
    assert "Not so: clarabel at paper (500 mm); the stepper noticed nothing." in text
    assert "Of these, clarabel at paper met the accuracy that every QP" in text
    assert "forces too large pump energy in: clarabel at paper" in text
    assert "bodies overlap by more than 10.0× what they do with exact QPs" in text
    assert "go on pushing, across more than 10.0× what they do with exact QPs" in text
    assert "fastest approach of a closed contact is 2.0e-01 m/s (clarabel at paper)" in text
    lost = with_row(found, "clarabel", verdict="stopped", reached=0.4, reason="it fell")
    text = " ".join(findings_of([lost]))
    assert "1 of 2 loops of the backends came to their end." in text
    assert "fig3: clarabel at paper (stopped at t = 0.40)" in text


def test_the_accuracy_that_suffices_is_read_off_the_sweep(found: Findings) -> None:
    rows = found.rows.copy()
    rows.loc[(rows["solver"] == "sloppy[more]") & (rows["setting"] == "1e5x"), "error"] = 1.0
    table = sloppy_table([replace(found, rows=rows)]).display().set_index("δx")
    assert table.loc["more", "harmless to"] == "1x"
    text = " ".join(findings_of([found]))
    assert "(3.13) is enough, for any, free, inside, more and less." in text
    spoilt = with_row(found, "sloppy[free]", error=1.0)
    text = " ".join(findings_of([spoilt]))
    assert "(3.13) is enough for any, inside, more and less, and not for free." in text
    assert "free not even at 1 ε₀" in text


def test_where_sloppiness_is_as_large_as_eps_is_interpolated(found: Findings) -> None:
    rows, eps = found.rows.copy(), discretization(found)
    more = rows["solver"] == "sloppy[more]"
    rows.loc[more, "from_twin"] = [eps / 10, 10 * eps]  # at 1x and 1e5x
    assert as_large_as_eps(replace(found, rows=rows), "sloppy[more]") == pytest.approx(10**2.5)
    rows.loc[more, "from_twin"] = [eps / 10, eps / 2]
    assert np.isnan(as_large_as_eps(replace(found, rows=rows), "sloppy[more]"))
    rows.loc[more, "from_twin"] = [2 * eps, 3 * eps]
    assert as_large_as_eps(replace(found, rows=rows), "sloppy[more]") == 1.0
    rows.loc[more, "verdict"] = "stopped"
    stopped = replace(found, rows=rows)
    assert np.isnan(as_large_as_eps(stopped, "sloppy[more]"))
    assert sloppy_table([stopped]).display().set_index("δx").loc["more", "1e5x"] == "–"


def test_the_command_runs_and_refuses(folder: Path, found: Findings) -> None:
    runner = CliRunner()
    asked = ["closed-loop", "fig3", "--solvers", "glambda", "--settings", "fast"]
    refused = runner.invoke(app, [*asked, "-o", str(folder / "none")])
    assert refused.exit_code == 2
    assert "fast" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
