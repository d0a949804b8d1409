"""Reports of the campaigns: starts, forms, accuracy against time.  Known numbers in and out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from harness.passes.starts import EVERY_ARM
from harness.study.stretch import stretched
from reports.parts.intervals import geometric_mean
from reports.parts.names import in_order
from reports.rows.results import Results, form_of, prepare, set_apart
from reports.sections.forms import (
    condition_of,
    conditions,
    form_rows,
    forms_answer,
    forms_tables,
    plot_forms,
)
from reports.sections.pareto import (
    ALL,
    fastest_for,
    pareto_answer,
    pareto_points,
    pareto_tables,
    plot_pareto,
    sweep_rows,
)
from reports.sections.protocol import record_command
from reports.sections.starts import ORDER, plot_starts, start_pairs, starts_answer, starts_tables
from solvers.registry import form_variants, solver_class
from tests.fakes.random_qps import random_qp
from tests.fakes.runs import scene_recording
from tests.reports.test_reports import make_rows


def results_of(rows: pd.DataFrame, recordings: Any = None) -> Results:
    study, campaigns = set_apart(prepare(rows))
    return Results(study, recordings or {}, (), campaigns)


# -- what is set apart -----------------------------------------------------------------------------


def test_campaign_rows_stay_out_of_the_study() -> None:
    rows = make_rows(
        solvers=("glambda", "osqp", "osqp[residual]"),
        settings=("high", "1e-6", "1e-3"),
        arms=("cold", "warm", "exact"),
        after_restart=False,
        repeats=3,
    )
    results = results_of(rows)
    assert set(results.rows["solver"]) == {"glambda", "osqp"}
    assert set(results.rows["arm"]) == {"cold", "warm"}
    assert results.settings == ["high"]
    assert len(results.everything) == len(rows)


def test_a_folder_of_nothing_but_a_campaign_is_reported_with_it() -> None:
    rows = make_rows(solvers=("osqp[normal]",), settings=("1e-6", "1e-3"), arms=("cold",))
    results = results_of(rows)
    assert len(results.rows) == len(rows)
    assert results.settings == ["1e-6", "1e-3"]


def test_numbers_follow_names_the_least_first() -> None:
    given = ["1e-3", "zeal", "1e-12", "high", "2.5e-4", "paper"]
    assert in_order(given, ("paper", "high", "default")) == [
        *("paper", "high", "1e-12", "2.5e-4", "1e-3", "zeal")
    ]


def test_forms_by_name() -> None:
    assert form_of("clarabel[residual]") == "residual"
    assert form_of("clarabel") is None
    assert form_of("lotstedt") is None
    assert {form_of(name) for name in form_variants()} == {"normal", "residual", "velocity"}
    for name in form_variants():
        assert solver_class(name).form == "normal"  # "the adapters' own choice" in the table


# -- intervals -------------------------------------------------------------------------------------


def test_the_interval_holds_the_mean_and_knows_what_is_certain() -> None:
    rng = np.random.default_rng(3)
    found = geometric_mean(0.5 * np.exp(0.2 * rng.standard_normal(400)))
    assert found.low < found.mean < found.high
    assert found.mean == pytest.approx(0.5, rel=0.05)
    assert found == geometric_mean(
        0.5 * np.exp(0.2 * np.random.default_rng(3).standard_normal(400))
    )
    same = geometric_mean([2.0] * 7)
    assert same == pytest.approx((2.0, 2.0, 2.0))
    assert np.isnan(geometric_mean([])).all()


def test_the_interval_is_wider_where_neighbours_are_alike() -> None:
    noise = np.exp(np.random.default_rng(0).standard_normal(60))
    alike = np.repeat(noise, 10)
    apart = np.random.default_rng(1).permutation(alike)
    wide, narrow = geometric_mean(alike), geometric_mean(apart)
    assert wide.mean == pytest.approx(narrow.mean)
    assert np.log(wide.high / wide.low) > 2 * np.log(narrow.high / narrow.low)


# -- starts ----------------------------------------------------------------------------------------

SPEED = {"exact": 0.2, "warm": 0.5, "corrupted": 2.0, "bare": 1.5, "shuffled": 0.9, "cold": 1.0}


def start_rows(**changes: Any) -> pd.DataFrame:
    arms = tuple(SPEED)

    def runtime(scene: str, solver: str, setting: str, arm: str, i: int) -> float:
        return 1e-5 * SPEED[arm] * (1 + 0.1 * i)

    rows = make_rows(
        solvers=("glambda", "osqp"), arms=arms, settings=("high",), runtime=runtime,
        **{"repeats": 3, "after_restart": False, **changes},
    )  # fmt: skip
    rows["warm_started"] = rows["arm"] != "cold"
    return rows.assign(runtime_median=1.01 * rows["runtime"])


def test_every_arm_has_its_place() -> None:
    assert {*ORDER, "cold", "kept"} == set(EVERY_ARM)


def test_ratios_are_those_to_the_own_cold_twin() -> None:
    tables = starts_tables(results_of(start_rows()))
    assert [table.key["scene"] for table in tables] == ["all", "fig2", "fig4"]
    data = tables[0].data.set_index(["solver", "arm"])
    for arm, speed in SPEED.items():
        if arm != "cold":
            row = data.loc[("osqp", arm)]
            assert row["ratio"] == pytest.approx(speed)
            assert row["from"] == pytest.approx(speed) and row["to"] == pytest.approx(speed)
            assert row["QPs"] == 20
            assert row["worse"] == float(speed > 1) and row["better"] == float(speed < 1)


def test_a_loss_within_the_spread_is_no_loss() -> None:
    rows = start_rows()
    rows["runtime_median"] = 2.5 * rows["runtime"]
    pairs = start_pairs(results_of(rows))
    assert not pairs["worse"].any() and not pairs["better"].any()
    pairs = start_pairs(results_of(start_rows(repeats=1)))
    assert pairs["worse"].isna().all() and pairs["better"].isna().all()


def test_what_follows_a_restart_or_was_not_started_or_not_verified_is_left_out() -> None:
    rows = start_rows()
    number = rows["problem"].str[-1].astype(int)
    rows["after_restart"] = number == 0
    rows.loc[(number == 1) & (rows["arm"] == "exact"), "warm_started"] = False
    rows.loc[(number == 2) & (rows["arm"] == "cold"), "verdict"] = "inaccurate"
    pairs = start_pairs(results_of(rows))
    counts = pairs[pairs["solver"] == "osqp"].groupby("arm")["problem"].count()
    assert counts["exact"] == 2 * 7 and counts["warm"] == 2 * 8


def test_the_answer_tells_memory_spoilt_starts_and_the_check() -> None:
    answer = starts_answer(results_of(start_rows()))
    text = " ".join(answer.sentences)
    assert answer.figure == "0.200×"
    assert (
        "0.200 from the right answer, 0.500 from its own last answer and 2.00 from a spoilt" in text
    )
    assert "this many times as long: glambda (3.00) and osqp (3.00)" in text
    assert "To glambda and osqp memory is worth more" in text
    assert "From a spoilt start 2 of 2 are slower than cold" in text
    assert "change by glambda (1.80) and osqp (1.80)" in text
    assert "less than cold for glambda (0.900) and osqp (0.900)" in text


def test_without_such_arms_there_is_no_section() -> None:
    plain = results_of(make_rows(after_restart=False, repeats=3))
    assert starts_tables(plain) == [] and starts_answer(plain) is None
    assert forms_tables(plain) == [] and forms_answer(plain) is None
    assert pareto_tables(plain) == [] and pareto_answer(plain) is None
    for draw in (plot_starts, plot_forms):
        with pytest.raises(ValueError, match=r"was run"):
            draw(plain, Path("nowhere.png"))
    with pytest.raises(ValueError, match="no accuracies given as numbers were run on fig2"):
        plot_pareto(plain, "fig2", Path("nowhere.png"))


def test_starts_are_drawn(tmp_path: Path) -> None:
    for suffix in (".svg", ".png"):
        assert plot_starts(results_of(start_rows()), tmp_path / f"it{suffix}").stat().st_size > 5000


# -- forms -----------------------------------------------------------------------------------------


def test_condition_is_that_of_unit_columns_without_fixed_rows() -> None:
    qp, _ = random_qp("full_rank", 0)
    A = qp.A / np.linalg.norm(qp.A, axis=0)
    assert condition_of(qp) == pytest.approx(np.linalg.cond(A))
    assert condition_of(random_qp("all_fixed", 0)[0]) == 1.0
    deficient = random_qp("rank_deficient", 0)[0]
    assert 1.0 < condition_of(deficient) < 1e4


FORM_SPEED = {"normal": 1.0, "residual": 0.8, "velocity": 2.0}


def form_results() -> Results:
    """Normal loses half of its answers on the stretched recording; residual is faster."""
    plain = scene_recording("fig5")
    recordings = {"fig5": plain, "fig5,condition=10000": stretched(plain, 1e4)}
    parts = []
    for scene, recording in recordings.items():
        hard = "condition" in scene

        def verdict(scene: str, solver: str, setting: str, arm: str, i: int) -> str:
            return "inaccurate" if hard and "normal" in solver and i % 2 else "verified"  # noqa: B023

        def runtime(scene: str, solver: str, setting: str, arm: str, i: int) -> float:
            return 1e-5 * FORM_SPEED[form_of(solver) or "normal"]

        rows = make_rows(
            scenes=(scene,),
            solvers=("osqp[normal]", "osqp[residual]", "osqp[velocity]", "osqp"),
            settings=("high",),
            qps=len(recording.qps),
            verdict=verdict,
            runtime=runtime,
        )
        ks = {f"{scene}/{i:06d}": qp.k for i, qp in enumerate(recording.qps)}
        parts.append(rows.assign(k=rows["problem"].map(ks), recording_digest=scene))
    return results_of(pd.concat(parts, ignore_index=True), recordings)


def test_a_stretched_recording_is_had_again_by_stretching() -> None:
    told = record_command("fig4,mu_I=0.8,condition=10000", {})
    assert told == "glambda stretch recordings/fig4,mu_I=0.8.h5 --condition 10000 -o recordings"


def test_forms_are_compared_by_time_and_by_condition(tmp_path: Path) -> None:
    results = form_results()
    assert set(form_rows(results)["solver"]) == {f"osqp[{form}]" for form in FORM_SPEED}
    forms, decades = forms_tables(results)
    table = forms.data.set_index("form")
    assert table.loc["residual", "÷ normal"] == pytest.approx(0.8)
    assert table.loc["velocity", "÷ normal"] == pytest.approx(2.0)
    assert any("faster in form residual" in note for note in forms.notes)
    low, high = decades.data.iloc[0], decades.data.iloc[-1]
    assert low["condition"] == "1e0 to 1e1" and low["normal, verified"] == 1.0
    # every second answer of the sequence, of which the decade holds some
    assert abs(high["normal, verified"] - 0.5) < 0.15 and high["residual, verified"] == 1.0
    answer = forms_answer(results)
    text = " ".join(answer.sentences)
    assert "residual is the fastest form of osqp" in text.replace("Residual", "residual")
    told = (
        "form velocity keeps, in some decade and by more than 5.0 % of the answers, more of those"
    )
    assert told in text
    assert answer.figure in ("1e3", "1e4")
    assert plot_forms(results, tmp_path / "it.png").stat().st_size > 5000


def test_conditions_are_known_by_problem() -> None:
    recording = scene_recording("fig5")
    known = conditions({"fig5": recording})
    assert known["fig5/000003"] == condition_of(recording.qps[3])


# -- accuracy against time -------------------------------------------------------------------------


def sweep(**changes: Any) -> Results:
    """glambda: exact at 10 µs; osqp: 5 µs at 1e-3 and 50 µs at 1e-9; daqp: never good."""
    speed = {"glambda": (10, 10), "osqp": (5, 50), "daqp": (7, 8)}
    error = {"glambda": (1e-15, 1e-15), "osqp": (1e-3, 1e-9), "daqp": (1e-1, 1e-2)}

    def runtime(scene: str, solver: str, setting: str, arm: str, i: int) -> float:
        return 1e-6 * speed[solver][setting == "1e-9"]

    rows = make_rows(
        solvers=tuple(speed), settings=("high", "1e-9", "1e-3"), runtime=runtime, **changes
    )
    errors = [
        error[solver][setting == "1e-9"]
        for solver, setting in zip(rows["solver"], rows["settings"], strict=True)
    ]
    return results_of(rows.assign(glambda_error=errors))


def test_points_are_times_and_errors_in_order() -> None:
    results = sweep()
    points = pareto_points(sweep_rows(results), ALL, "cold")
    assert points["solver"].tolist() == ["glambda"] * 2 + ["daqp"] * 2 + ["osqp"] * 2
    assert points["asked"].tolist() == ["1e-9", "1e-3"] * 3
    osqp = points[points["solver"] == "osqp"].set_index("asked")
    assert osqp.loc["1e-9", "time"] == pytest.approx(50e-6)
    assert osqp.loc["1e-3", "error"] == 1e-3
    front = points[points["front"]]
    assert set(zip(front["solver"], front["asked"], strict=True)) == {
        ("osqp", "1e-3"),
        ("glambda", "1e-9"),
        ("glambda", "1e-3"),
    }
    assert fastest_for(points, 1e-3)["solver"] == "osqp"
    assert fastest_for(points, 1e-6)["solver"] == "glambda"
    assert fastest_for(points, 1e-16) is None


def test_a_point_promises_nine_answers_in_ten() -> None:
    results = sweep()
    rows = sweep_rows(results)
    last = rows["problem"].str.endswith("9")
    rows = rows.assign(glambda_error=rows["glambda_error"].where(~last, np.nan))
    rows.loc[last, "error_bound"] = np.nan
    points = pareto_points(rows, "fig2", "cold").set_index(["solver", "asked"])
    assert points.loc[("osqp", "1e-9"), "worst"] == np.inf
    rows = rows.assign(glambda_error=rows["glambda_error"].where(rows["step"] < 8, np.nan))
    points = pareto_points(rows, "fig2", "cold")
    assert (points["error"] == np.inf).all() and not points["front"].any()


def test_who_skipped_is_not_compared_and_who_has_no_warm_start_stands_cold() -> None:
    rows = sweep_rows(sweep())
    rows = rows[~((rows["solver"] == "daqp") & (rows["arm"] == "warm"))]
    assert "daqp" in set(pareto_points(rows, ALL, "warm")["solver"])
    rows.loc[rows.index[rows["solver"] == "osqp"][0], "skipped"] = True
    points = pd.concat(pareto_points(rows, ALL, arm) for arm in ("cold", "warm"))
    assert len(points[points["solver"] == "osqp"]) == 3


def test_what_accuracy_costs_in_words_and_pictures(tmp_path: Path) -> None:
    results = sweep()
    answer = pareto_answer(results)
    text = " ".join(answer.sentences)
    assert answer.figure == "2" and "of 3 solvers" in answer.caption
    assert "(warm, all scenes) stand glambda and osqp" in text
    assert "For 1.0e-03 osqp is the fastest, 5.00 µs, then glambda (10.0 µs)" in text
    assert "For 1.0e-12 glambda is the fastest, 10.0 µs; nobody else reaches it" in text
    assert "It more than doubles for osqp (10.0)" in text
    assert "Asked for 1e-9, daqp does not come within ten times of it" in text
    assert [table.key for table in pareto_tables(results)] == [{"arm": "cold"}, {"arm": "warm"}]
    for scene in (ALL, "fig4"):
        assert plot_pareto(results, scene, tmp_path / "it.png").stat().st_size > 5000
