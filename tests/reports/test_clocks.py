"""Three clocks: a lead is stated only where they agree, and a loss first."""

from __future__ import annotations

import pandas as pd
import pytest

from reports.page.page import report
from reports.sections.clocks import CLOCKS, agreement, by_clock, clocks_table, leads
from reports.sections.findings import which_method
from tests.reports.test_reports import make_rows, results_of

SOLVERS = ("glambda", "daqp", "osqp")


def rows_of(inside: float, ready: float, whole: float, verdict=None) -> pd.DataFrame:
    """glambda takes 10 µs by each clock, daqp what is given, osqp 50 and has no clock."""
    rows = make_rows(solvers=SOLVERS, runtime=lambda *key: 10e-6, verdict=verdict)
    none = float("nan")
    given = {"daqp": (inside, ready, whole), "glambda": (10, 10, 10), "osqp": (none, 50, 50)}
    for solver, times in given.items():
        for column, time in zip(CLOCKS.values(), times, strict=True):
            rows.loc[rows["solver"] == solver, column] = 1e-6 * time
    return rows


def first_said(rows: pd.DataFrame) -> list[str]:
    answer = which_method(results_of(rows))
    assert answer is not None
    return list(answer.sentences)


def test_a_lead_by_all_clocks_is_the_least_of_them() -> None:
    said = first_said(rows_of(20, 30, 15))
    assert "by all clocks that there are (3), by a factor of 1.50 at least" in said[1]
    assert "from A, d and bounds, over daqp" in said[1]


def test_a_loss_by_one_clock_is_said_first() -> None:
    said = first_said(rows_of(5, 30, 15))
    assert said[0].startswith("The clocks do not agree: inside the package daqp is 2.00 times")
    assert "from ready arrays glambda is 3.00 times faster than daqp" in said[0]


def test_a_loss_by_all_is_said_first() -> None:
    said = first_said(rows_of(5, 5, 5))
    assert said[0].startswith("glambda is not the fastest by any clock: ")


def test_who_misses_is_no_rival() -> None:
    def verdict(scene: str, solver: str, setting: str, arm: str, i: int) -> str:
        return "inaccurate" if solver == "daqp" and i == 2 else "verified"

    rows = rows_of(5, 5, 5, verdict)
    said = first_said(rows)
    assert "by all clocks that there are (2), by a factor of 5.00" in said[1]


def test_means_by_each_clock() -> None:
    results = results_of(rows_of(20, 30, 15))
    rows = results.rows[(results.rows["k"] > 0) & (results.rows["arm"] == "warm")]
    table = by_clock(rows)
    assert table.loc["daqp", "from ready arrays"] == pytest.approx(30e-6)
    assert pd.isna(table.loc["osqp", "inside the package"])
    assert [lead.rival for lead in leads(table)] == ["daqp"] * 3
    assert agreement([]) == ""


def test_the_table_has_a_line_per_scene_and_one_of_all(tmp_path) -> None:
    results = results_of(rows_of(5, 30, 15))
    data = clocks_table(results, "paper", "warm").data.set_index(["scene", "solver"])
    assert data.loc[("all scenes", "glambda"), "inside the package ÷ best"] == pytest.approx(2.0)
    assert set(data.index.get_level_values("scene")) == {"fig2", "fig4", "all scenes"}
    report(results, tmp_path)
    assert 'href="tables/clocks.csv"' in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert (tmp_path / "tables" / "clocks.csv").exists()
