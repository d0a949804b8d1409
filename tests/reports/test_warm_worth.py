"""What is the object's, what is the start's, and who ignores a hint."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from problems.qp import ContactQP
from reports.parts.intervals import line
from reports.rows.results import Results, prepare, set_apart
from reports.sections.findings import warm_start_worth
from reports.sections.warm_worth import (
    change_rows,
    change_table,
    changes_of,
    split_table,
    triples,
)
from tests.reports.test_reports import make_recording, make_rows

COST = {
    "glambda": {"cold": 1.0, "kept": 0.8, "warm": 0.4},
    "osqp": {"cold": 10.0, "kept": 2.0, "warm": 2.0},
    "piqp": {"cold": 4.0, "warm": 3.0},
    "quadprog": {"cold": 5.0},
}
"""Solver → arm → µs; piqp carries an object and no x, quadprog nothing."""


def rows_of_arms(**changes: Any) -> pd.DataFrame:
    def runtime(scene: str, solver: str, setting: str, arm: str, i: int) -> float:
        return 1e-6 * COST[solver].get(arm, np.nan) * (1 + 0.1 * i)

    rows = make_rows(
        solvers=tuple(COST), arms=("cold", "kept", "warm"), runtime=runtime, after_restart=False,
        **changes,
    )  # fmt: skip
    rows["warm_started"] = rows["arm"] != "cold"
    return rows[rows["runtime"].notna()]


def results_of(rows: pd.DataFrame, recordings: Any = None) -> Results:
    of_study, apart = set_apart(prepare(rows))
    return Results(of_study, recordings or {}, campaigns=apart)


def test_the_object_and_the_start_are_told_apart() -> None:
    table = split_table(results_of(rows_of_arms()), "paper")
    assert table is not None
    data = table.data.set_index("solver")
    for name, (object_, start, both) in {
        "glambda": (0.8, 0.5, 0.4),
        "osqp": (0.2, 1.0, 0.2),
        "piqp": (0.75, np.nan, 0.75),
    }.items():
        row = data.loc[name]
        got = row[["object", "start", "both"]].to_numpy(float)
        np.testing.assert_allclose(got, [object_, start, both])
    assert "quadprog" not in data.index
    assert table.notes == [
        "An object and no x is all that is carried by piqp.",
        "Nothing is carried by quadprog.",
    ]


def test_the_card_does_not_credit_a_kept_object_to_the_start() -> None:
    answer = warm_start_worth(results_of(rows_of_arms()))
    assert answer is not None and answer.figure == "0.500×"
    text = " ".join(answer.sentences)
    assert "By the start glambda gains most (0.500" in text
    assert "by the object osqp (0.200" in text


def test_without_the_arm_the_old_table_stands() -> None:
    rows = rows_of_arms()
    results = results_of(rows[rows["arm"] != "kept"])
    assert split_table(results, "paper") is None
    answer = warm_start_worth(results)
    assert answer is not None and "keeping its object included" in answer.sentences[0]


def test_only_what_is_verified_in_every_arm_and_after_no_restart_counts() -> None:
    rows = rows_of_arms()
    number = rows["problem"].str[-1].astype(int)
    rows["after_restart"] = number == 1
    rows.loc[(number == 2) & (rows["arm"] == "kept"), "verdict"] = "inaccurate"
    rows.loc[(number == 3) & (rows["arm"] == "warm"), "verdict"] = "failed"
    count = triples(results_of(rows), "paper").groupby("solver")["problem"].count()
    assert count["glambda"] == 2 * 7 and count["piqp"] == 2 * 8


def test_a_line_through_points() -> None:
    x = np.tile([0.0, 1.0, 2.0, 0.0], 20)
    exact = line(x, 3.0 + 2.0 * x)
    assert exact.at_none == pytest.approx(3.0) and exact.slope == pytest.approx(2.0)
    assert exact.low == pytest.approx(2.0) and exact.high == pytest.approx(2.0)
    noisy = line(x, 3.0 + 2.0 * x + np.random.default_rng(0).standard_normal(80))
    assert noisy.low < 2.0 < noisy.high and noisy.high - noisy.low > 0.1
    flat = line(np.zeros(30), np.arange(30.0))
    assert flat.at_none == pytest.approx(14.5) and np.isnan(flat.slope)


def test_the_true_change_of_the_active_set() -> None:
    """Rows 0 and 1: both carry, then 1 leaves, then it comes back while 0 is gone."""
    made = make_recording()
    A = np.eye(2)
    loads = ([-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, -1.0])
    qps = [ContactQP(A, np.array(d), np.zeros(2), np.full(2, np.inf)) for d in loads]
    qps[3] = replace(qps[3], row_id=np.array([7, 1]))
    from harness.judging.oracle import reference

    recording = replace(made, qps=qps, references=[reference(qp) for qp in qps])
    # the row that is gone was at its bound, and so is the new one
    assert list(changes_of(recording).values()) == [1, 2, 2]
    restarted = replace(recording, qps=[replace(qp, restart=True) for qp in qps])
    assert not changes_of(restarted)


def test_who_ignores_a_hint() -> None:
    recording = make_recording()
    changes = changes_of(recording)
    rows = make_rows(scenes=("fig2",), solvers=("glambda", "piqp"))
    rows["warm_started"] = rows["problem"].isin(list(changes)) & (rows["arm"] == "warm")
    change = rows["problem"].map(changes).fillna(0.0)
    rows["iterations"] = np.where(rows["arm"] == "cold", 6.0, 2.0 + change)
    rows.loc[rows["solver"] == "piqp", "iterations"] = 6.0
    results = results_of(rows, {"fig2": recording})
    assert sum(value > 0 for value in changes.values()) >= 5
    data = change_rows(results, "paper").set_index("solver")
    assert data.loc["glambda", "iterations per row"] == pytest.approx(1.0)
    assert data.loc["glambda", "of cold"] == pytest.approx(2 / 6)
    assert data.loc["piqp", "of cold"] == pytest.approx(1.0)
    table = change_table(results, "paper")
    assert table is not None and table.notes[0].endswith("saves nothing: piqp (1.00).")
