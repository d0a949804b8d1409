"""Scores that speed cannot buy, and what disturbances do."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest

from reports.rows.results import Results, prepare, set_apart
from reports.sections.disturbances import disturbances_table
from reports.sections.protocol import record_command
from reports.sections.ranking import ranking_table
from tests.reports.test_reports import make_rows


def results_of(rows: pd.DataFrame) -> Results:
    of_study, apart = set_apart(prepare(rows))
    return Results(of_study, campaigns=apart)


def test_who_is_wrong_comes_last_however_fast() -> None:
    """osqp: fast, once wrong; daqp: slower, once without an answer; glambda: slowest, right."""
    speed = {"glambda": 30e-6, "daqp": 10e-6, "osqp": 1e-6}

    def verdict(scene: str, solver: str, setting: str, arm: str, i: int) -> str:
        bad = {"daqp": "failed", "osqp": "claimed_wrong"}
        return bad.get(solver, "verified") if i == 2 and scene == "fig2" else "verified"

    rows = make_rows(runtime=lambda *key: speed[key[1]], verdict=verdict, arms=("cold",))
    rows["found"] = rows["verdict"] != "failed"
    results = results_of(rows)
    table = ranking_table(results, "paper", "cold")
    data = table.data.set_index("solver")
    assert list(data.index) == ["glambda", "daqp", "osqp"]
    assert data["rank"].tolist() == [1, 2, 3]
    assert data.loc["osqp", ["wrong", "unsolved"]].tolist() == [1, 0]
    assert data.loc["daqp", ["wrong", "unsolved"]].tolist() == [0, 1]
    expected = (19 * 1e-6 + 2 * results.time_limit) / 20
    assert data.loc["osqp", "PAR-2"] == pytest.approx(expected)
    assert data.loc["osqp", "by mean"] == 1.0 and data.loc["osqp", "by PAR-2"] == 2.0
    assert table.notes == [
        "osqp would be number 1 by its mean, and is number 3: 1 wrong answers, 0 unsolved.",
    ]


def test_between_equals_time_decides() -> None:
    speed = {"glambda": 3e-6, "daqp": 2e-6, "osqp": 1e-6}
    rows = make_rows(runtime=lambda *key: speed[key[1]])
    data = ranking_table(results_of(rows), "paper", "warm").data
    assert data["solver"].tolist() == ["osqp", "daqp", "glambda"]
    assert not ranking_table(results_of(rows), "paper", "warm").notes


def disturbed_rows(**changes: Any) -> pd.DataFrame:
    scenes = ("fig2", "fig2,disturbed=permuted", "fig2,disturbed=1e-9")

    def runtime(scene: str, solver: str, setting: str, arm: str, i: int) -> float:
        slow = 3.0 if solver == "osqp" and "permuted" in scene else 1.0
        return 1e-6 * slow * (1 + i)

    def verdict(scene: str, solver: str, setting: str, arm: str, i: int) -> str:
        return "failed" if solver == "daqp" and "1e-9" in scene and i == 4 else "verified"

    rows = make_rows(scenes=scenes, runtime=runtime, verdict=verdict, **changes)
    rows["warm_started"] = rows["arm"] == "warm"
    return rows


def test_disturbed_qps_stand_against_their_originals() -> None:
    table = disturbances_table(results_of(disturbed_rows()))
    assert table is not None
    data = table.data.set_index(["solver", "disturbed"])
    assert data.loc[("osqp", "permuted"), "time"] == pytest.approx(3.0)
    assert data.loc[("glambda", "permuted"), "time"] == pytest.approx(1.0)
    assert data.loc[("daqp", "1e-9"), "verified"] == 0.9
    assert data.loc[("daqp", "1e-9"), "before"] == 1.0
    assert data.loc[("daqp", "1e-9"), "QPs"] == 10
    assert table.notes == [
        "With noise of 1e-9 fewer are verified of daqp (90.0 %, was 100 %).",
        "In another order these take longer than others: osqp (3.00).",
    ]


def test_disturbed_recordings_are_no_scenes_of_the_study() -> None:
    results = results_of(disturbed_rows())
    assert results.scenes == ["fig2"]
    undisturbed = disturbed_rows()
    undisturbed = undisturbed[undisturbed["scene"] == "fig2"]
    assert disturbances_table(results_of(undisturbed)) is None


def test_the_command_that_disturbs_again() -> None:
    said = record_command("fig2,disturbed=1e-9", {"disturbed.seed": 7})
    assert said == "glambda disturb recordings/fig2.h5 --kinds 1e-9 --seed 7 -o recordings"
