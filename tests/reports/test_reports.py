"""Reports from stored results: known numbers in, known tables out; the page stands alone."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import glambda
from harness.machine.unrest import Unrest
from harness.passes.limits import TIME_LIMIT
from harness.recordings.recording import Recording
from harness.study.record import recording_of
from problems.qp import FREE, ContactQP, Solution, Status
from problems.stepping.run import Event
from reports.motions.film import ffmpeg
from reports.motions.frames import animate_scene, plot_scene, window_of
from reports.motions.motion import frame_times, motion_of
from reports.page.page import prose, report, unflattering, write_report
from reports.parts.intervals import geometric_mean
from reports.parts.sentences import join, ordinal
from reports.parts.style import drawing, in_letters, save
from reports.parts.table import LONGEST, microseconds, percent, short
from reports.rows.comparison import compare, shifted_geometric_mean
from reports.rows.results import KEY, Results, empty_rows, load_results, prepare
from reports.sections.figures import plot_accuracy, plot_cost, plot_profiles
from reports.sections.findings import how_accurate, warm_start_worth, which_method
from reports.sections.profiles import profile, ratios
from reports.sections.protocol import protocol, record_command, reproduce
from reports.sections.spread import spread_table
from reports.sections.tables import (
    accuracy_table,
    cost_table,
    losses,
    scene_table,
    verified_table,
    warm_table,
)
from reports.sections.thresholds import criterion_answer, criterion_tables, thresholds
from reports.sections.work import plot_work

SCENES = ("fig2", "fig4")


def make_rows(
    scenes=SCENES,
    solvers=("glambda", "daqp", "osqp"),
    settings=("paper",),
    arms=("cold", "warm"),
    qps=10,
    runtime=None,
    verdict=None,
    **changes,
):
    """Rows of a study as a store holds them.

    runtime, verdict : functions (scene, solver, settings, arm, i) → seconds, word
    changes : column → value for all rows
    """
    out = []
    for scene in scenes:
        for solver in solvers:
            for setting in settings:
                for arm in arms:
                    for i in range(qps):
                        key = (scene, solver, setting, arm, i)
                        word = verdict(*key) if verdict else "verified"
                        own = solver.startswith(("glambda", "lotstedt"))
                        row = {
                            "problem": f"{scene}/{i:06d}",
                            "solver": solver,
                            "settings": setting,
                            "runtime": runtime(*key) if runtime else 10e-6,
                            "found": True,
                            "primal_residual": 0.0,
                            "dual_residual": 1e-14,
                            "duality_gap": 1e-14,
                            "scene": scene,
                            "recording_digest": f"digest of {scene}",
                            "step": i,
                            "kind": "impulse" if i == 3 else "step",
                            "accepted": i != 5,
                            "restart": i == 4,
                            "t": 0.01 * i,
                            "m": 9,
                            "k": 4 + i % 3,
                            "rank": 4,
                            "arm": arm,
                            "verdict": word,
                            "status_text": "too many contacts" if word == "skipped" else "",
                            "build_time": 1e-6,
                            "setup_time": 1e-6,
                            "solve_time": 9e-6,
                            "call_time": 30e-6,
                            "charged_time": 0.0,
                            "inside_time": 8e-6,
                            "quiet": True,
                            "believed": True,
                            "runtime_median": 11e-6,
                            "iterations": 1 if arm == "warm" else 4,
                            "descent_directions": (1 if arm == "warm" else 4) if own else 0,
                            "working_set_changes": 0,
                            "qr_factorizations": int(own and i % 4 == 0),
                            "qr_updates": 0,
                            "cg_iterations": 2 if own else 0,
                            "flops": 1200 if own else 0,
                            "glambda_error": 1e-13 if word == "verified" else 1e-3,
                            "eps0_ratio": 1e-4 if word == "verified" else 1e4,
                            "error_bound": 1e-12,
                            "objective_error": 1e-15,
                            "lambda_distance": 1e-12,
                            "machine": "one machine",
                            "versions": '{"daqp": "0.7.2"}',
                            "study": "test",
                            "asked": 1e-6,
                            "scale": 1e-3,
                            "warm_started": arm == "warm" and i not in (0, 3, 4),
                        }
                        out.append({**row, **changes})
    return pd.DataFrame(out)


def results_of(rows, recordings=None):
    return Results(prepare(rows), recordings or {})


def make_recording(scene="fig2", bodies=2, steps=40, **parameters):
    """A recording of boxes that slide apart, with a QP at every step."""
    t = np.linspace(0.0, 1.0, steps)
    q = np.zeros((steps, bodies, 3))
    for body in range(bodies):
        q[:, body, 0] = 2.5 * body + body * t
        q[:, body, 1] = 0.5
        q[:, body, 2] = 0.3 * body * t
    box = np.array([(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)])
    rng = np.random.default_rng(7)
    qps, solutions = [], []
    for i in range(10):
        A = rng.normal(size=(3 * bodies, 4))
        A[:, 3] = A[:, 2]
        kind = "impulse" if i == 3 else "step"
        qp = ContactQP(A, rng.normal(size=3 * bodies), np.zeros(4), np.full(4, np.inf))
        qp = ContactQP(
            qp.A, qp.d, qp.lower, qp.upper, kind=kind, accepted=i != 5, restart=i == 4, t=0.1 * i
        )
        qps.append(qp)
        solutions.append(
            Solution(np.zeros(4), qp.row_id, Status.SOLVED, np.full(4, FREE, dtype=np.int8))
        )
    from harness.judging.oracle import reference

    return Recording(
        scene=scene,
        parameters=parameters,
        eps=1e-3,
        gravity=9.81,
        code_version="test",
        qps=qps,
        solutions=solutions,
        references=[reference(qp) for qp in qps],
        mu=[np.zeros(qp.k) for qp in qps],
        polygons=[[box]] * bodies,
        t=t,
        q=q,
        v=np.gradient(q, t, axis=0),
        events=[Event(0.3, "impulse", "1 and 2"), Event(0.4, "slide_off", "")],
        counts={"steps": steps - 1, "rejected_steps": 1, "impulses": 1},
    )


@pytest.fixture(scope="module")
def study():
    """Two scenes with recordings; glambda, a variant and two others."""

    def runtime(scene, solver, setting, arm, i):
        base = {"glambda": 40e-6, "lotstedt[exact_qr]": 60e-6, "daqp": 4e-6, "osqp": 20e-6}
        return base[solver] * (0.5 if arm == "warm" else 1.0) * (1 + 0.01 * i)

    def verdict(scene, solver, setting, arm, i):
        return "claimed_wrong" if solver == "osqp" and i == 7 else "verified"

    rows = make_rows(
        solvers=("glambda", "lotstedt[exact_qr]", "daqp", "osqp"),
        settings=("paper", "high"),
        runtime=runtime,
        verdict=verdict,
    )
    return results_of(rows, {scene: make_recording(scene) for scene in SCENES})


@pytest.fixture(scope="module")
def written(tmp_path_factory, study):
    """The folder of their report."""
    return report(study, tmp_path_factory.mktemp("written")).parent


# Means, shifts, charges and common sets


def test_shifted_mean_by_hand():
    # log((1+1)(3+1))/2 with a shift of 1 µs: √(2·4) − 1
    assert shifted_geometric_mean([1e-6, 3e-6]) == pytest.approx((np.sqrt(8) - 1) * 1e-6)
    assert np.isnan(shifted_geometric_mean([]))


def test_unverified_rows_are_charged_the_limit():
    rows = make_rows(
        scenes=("fig2",),
        solvers=("daqp",),
        arms=("cold",),
        qps=2,
        runtime=lambda *key: 1e-6,
        verdict=lambda *key: "verified" if key[-1] == 0 else "claimed_wrong",
    )
    comparison = compare(prepare(rows), "fig2", "paper", "cold")
    assert comparison.rows["charged"].tolist() == [1e-6, TIME_LIMIT]
    summary = comparison.summary().loc["daqp"]
    assert summary["median"] == 1e-6
    assert summary["verified"] == 0.5
    assert summary["mean"] == pytest.approx(np.sqrt(2e-6 * (1 + 1e-6)) - 1e-6)
    assert not summary["best"]


def test_a_wrong_answer_cannot_be_the_best():
    rows = make_rows(
        scenes=("fig2",),
        arms=("cold",),
        runtime=lambda scene, solver, *rest: {"glambda": 8e-6, "daqp": 4e-6, "osqp": 1e-6}[solver],
        verdict=lambda *key: "inaccurate" if key[1] == "osqp" and key[-1] == 1 else "verified",
    )
    summary = compare(prepare(rows), "fig2", "paper", "cold").summary()
    assert summary.index[summary["best"]].tolist() == ["daqp"]
    assert summary["ratio"].to_dict() == {"glambda": 2.0, "daqp": 1.0, "osqp": 0.25}


def test_common_set_is_what_no_compared_run_skipped():
    rows = make_rows(
        scenes=("fig2",),
        arms=("cold",),
        qps=20,
        verdict=lambda *key: "skipped" if key[1] == "daqp" and key[-1] in (3, 8) else "verified",
    )
    comparison = compare(prepare(rows), "fig2", "paper", "cold")
    assert (comparison.common, comparison.qps) == (18, 20)
    assert comparison.left_out == ()
    assert comparison.rows.groupby("solver").size().to_dict() == {
        "daqp": 18,
        "glambda": 18,
        "osqp": 18,
    }


def test_a_run_that_skips_much_is_left_out_and_named():
    rows = make_rows(
        scenes=("fig2",),
        arms=("cold",),
        verdict=lambda *key: "skipped" if key[1] == "daqp" and key[-1] < 5 else "verified",
    )
    comparison = compare(prepare(rows), "fig2", "paper", "cold")
    assert comparison.common == 10
    assert [(entry.solver, entry.solved, entry.reason) for entry in comparison.left_out] == [
        ("daqp", 5, "too many contacts")
    ]
    notes = " ".join(cost_table(results_of(rows), "paper").notes)
    assert "daqp is left out, it solved 5 of 10 QPs (too many contacts)" in notes


def test_free_flight_is_not_compared():
    rows = make_rows(scenes=("fig2",), solvers=("daqp",), arms=("cold",))
    rows.loc[rows["step"] < 4, "k"] = 0
    assert compare(prepare(rows), "fig2", "paper", "cold").common == 6


def test_without_a_warm_arm_a_backend_stands_with_its_cold_one():
    rows = make_rows(scenes=("fig2",))
    rows = rows[(rows["solver"] != "osqp") | (rows["arm"] == "cold")]
    comparison = compare(prepare(rows), "fig2", "paper", "warm")
    assert comparison.without_warm == ("osqp",)
    assert comparison.solvers == ["glambda", "daqp", "osqp"]
    data = cost_table(results_of(rows), "paper").data.set_index("solver")
    assert data.loc["osqp", "warm start"] == "no"


def test_machines_do_not_mix_in_a_ratio():
    rows = make_rows(scenes=("fig2",), arms=("cold",))
    rows.loc[rows["solver"] == "osqp", "machine"] = "another"
    comparison = compare(prepare(rows), "fig2", "paper", "cold")
    assert comparison.machines == ("one machine", "another")
    assert comparison.solvers == ["glambda", "daqp"]


# Tables


def test_cost_table_numbers_and_losses():
    def runtime(scene, solver, setting, arm, i):
        return {"glambda": 31e-6, "daqp": 10e-6, "osqp": 20e-6}[solver]

    table = cost_table(results_of(make_rows(scenes=("fig3",), runtime=runtime)), "paper")
    data = table.data.set_index("solver")
    assert data["cold ÷ best"].round(12).to_dict() == {"glambda": 3.1, "daqp": 1.0, "osqp": 2.0}
    assert (
        "On fig3 (cold, paper) daqp is 3.10× faster than glambda (10.0 µs against 31.0 µs)."
        in table.notes
    )
    assert "shift 1 µs" in table.reading and "charged 1 s" in table.reading


def test_no_loss_is_claimed_where_the_method_wins():
    rows = prepare(make_rows(runtime=lambda *key: 1e-6 if key[1] == "glambda" else 2e-6))
    assert losses(compare(rows, "fig2", "paper", "warm")) == []


def test_a_method_that_misses_says_so():
    rows = make_rows(
        verdict=lambda *key: "failed" if key[1] == "glambda" and key[-1] == 2 else "verified"
    )
    said = losses(compare(prepare(rows), "fig2", "paper", "cold"))
    assert said == ["On fig2 (cold, paper) glambda is not verified on 1 of 10 QPs."]
    notes = accuracy_table(results_of(rows), "paper").notes
    assert notes[0] == "On fig2 glambda misses 2 of 20 solves."


def test_accuracy_table_counts(study):
    data = accuracy_table(study, "paper").data.set_index(["scene", "solver"])
    osqp = data.loc[("fig2", "osqp")]
    assert (osqp["solves"], osqp["misses"], osqp["claimed wrong"]) == (20, 2, 2)
    assert osqp["verified"] == 0.9
    assert (osqp["Gλ error, median"], osqp["Gλ error, max"]) == (1e-13, 1e-3)
    assert data.loc[("fig4", "glambda"), "misses"] == 0
    assert next(iter(data.index)) == ("fig2", "glambda")


def test_verified_table_has_a_column_per_scene(study):
    table = verified_table(study, "paper")
    assert list(table.data.columns) == ["solver", "fig2", "fig4"]
    assert table.display().set_index("solver").loc["osqp"].tolist() == ["90.0 %", "90.0 %"]


def test_warm_table_leaves_out_what_was_not_started_warm(study):
    data = warm_table(study, "paper").data.set_index(["scene", "solver"])
    own = data.loc[("fig2", "glambda")]
    # 10 QPs less the first, the impulse and the one that follows the restart
    assert own["QPs"] == own["pairs"] == 7
    assert own["iteration ratio"] == 0.25
    assert (own["one direction, cold"], own["one direction, warm"]) == (0.0, 1.0)
    assert own["time ratio"] == pytest.approx(0.5, abs=1e-3)
    assert data.loc[("fig2", "osqp"), "pairs"] == 6
    assert np.isnan(data.loc[("fig2", "daqp"), "one direction, warm"])


def test_spread_table_has_the_quartiles_the_passes_and_the_range_of_the_ratio():
    def runtime(scene, solver, setting, arm, i):
        return (i + 1) * 1e-6 * (2 if solver == "daqp" else 1)

    rows = make_rows(runtime=runtime)
    rows["runtime_median"] = 1.25 * rows["runtime"]
    rows = rows[rows["solver"].isin(["glambda", "daqp"])]
    table = spread_table(results_of(rows), "paper")
    row = table.data.set_index(["scene", "arm", "solver"]).loc[("fig2", "warm", "daqp")]
    # ten QPs of 2, 4, … 20 µs
    quartiles = row[["lower quartile", "median", "upper quartile"]].to_numpy(float)
    np.testing.assert_allclose(quartiles, [6.5e-6, 11e-6, 15.5e-6])
    assert row["passes"] == pytest.approx(1.25)
    assert row[["ratio", "from", "to"]].to_numpy(float) == pytest.approx([2, 2, 2])
    assert "Quartiles" in table.to_markdown()


def test_the_range_of_a_warm_ratio_holds_it():
    rows = make_rows(
        qps=60, runtime=lambda *key: 1e-6 * (1 + key[4] % 3) if key[3] == "warm" else 2e-6
    )
    row = warm_table(results_of(rows), "paper").data.set_index(["scene", "solver"])
    own = row.loc[("fig2", "glambda")]
    assert own["from"] < own["time ratio"] < own["to"]
    started = [i for i in range(60) if i not in (0, 3, 4)]
    expected = np.exp(np.mean([np.log((1 + i % 3) / 2) for i in started]))
    assert own["time ratio"] == pytest.approx(expected)


def test_a_time_too_short_for_the_clock_is_no_ratio():
    assert geometric_mean([2.0, 0.0, 2.0, np.nan, np.inf]).mean == pytest.approx(2.0)
    assert np.isnan(geometric_mean([0.0]).mean)


def test_a_warm_start_that_costs_is_called_so():
    rows = make_rows(runtime=lambda *key: 3e-6 if key[3] == "warm" else 2e-6)
    notes = warm_table(results_of(rows), "paper").notes
    assert notes[0].startswith("On fig2 a warm start makes glambda slower: 1.50×")
    said = "On fig2 (paper) a warm start makes glambda slower: 1.50× its cold time."
    assert said in unflattering(results_of(rows))


def test_scene_table_from_recording_and_from_rows_agree_on_qps(study):
    recorded = scene_table(study).data.set_index("scene").loc["fig2"]
    assert (recorded["steps"], recorded["rejected"]) == (39, 1)
    assert (recorded["QPs"], recorded["step"], recorded["impulse"]) == (10, 9, 1)
    assert recorded["rank deficient"] == 1.0
    bare = scene_table(Results(study.rows)).data.set_index("scene").loc["fig2"]
    for name in ("QPs", "step", "impulse", "restarts"):
        assert bare[name] == recorded[name]


def test_markdown_and_csv(study):
    table = cost_table(study, "paper")
    text = table.to_markdown()
    assert text.startswith("## Time per QP in µs, setting paper\n\n*How to read:* ")
    assert "\n- On fig2 (cold, paper) daqp is" in text
    from io import StringIO

    back = pd.read_csv(StringIO(table.to_csv()))
    assert back["cold median"].to_numpy() == pytest.approx(table.data["cold median"].to_numpy())


def test_numbers_are_printed_honestly():
    assert percent(0.99999) == "99.9 %" and percent(1.0) == "100 %"
    assert percent(1e-6) == "0.1 %" and percent(0.0) == "0 %"
    assert microseconds(1.234e-6) == "1.23"
    assert [short(v) for v in (0, 9.999, 12.34, 123.4, 5123.4, 1e-5)] == [
        "0",
        "10.0",
        "12.3",
        "123",
        "5,123",
        "1.0e-05",
    ]
    assert [ordinal(n) for n in (1, 2, 3, 4, 11, 12, 13, 21, 112)] == (
        ["1st", "2nd", "3rd", "4th", "11th", "12th", "13th", "21st", "112th"]
    )
    assert join(["a"]) == "a" and join(["a", "b", "c"]) == "a, b and c"
    assert join(list("abcdefgh"), 3) == "a, b and 6 others"


# Profiles


def test_profile_by_hand():
    rows = make_rows(
        scenes=("fig2",),
        solvers=("daqp", "osqp"),
        arms=("cold",),
        qps=4,
        runtime=lambda *key: 1e-6 if key[1] == "daqp" else (4e-6 if key[-1] < 2 else 0.5e-6),
        verdict=lambda *key: "failed" if key[1] == "daqp" and key[-1] == 0 else "verified",
    )
    table = ratios([compare(prepare(rows), "fig2", "paper", "cold")])
    assert table["daqp"].tolist() == [np.inf, 1.0, 2.0, 2.0]
    assert table["osqp"].tolist() == [1.0, 4.0, 1.0, 1.0]
    rho = profile(table, [1, 2, 4])
    assert rho["daqp"].tolist() == [0.25, 0.75, 0.75]
    assert rho["osqp"].tolist() == [0.75, 0.75, 1.0]


def test_what_nobody_solved_counts_against_all():
    rows = make_rows(scenes=("fig2",), arms=("cold",), qps=2, verdict=lambda *key: "failed")
    table = ratios([compare(prepare(rows), "fig2", "paper", "cold")])
    assert np.isinf(table.to_numpy()).all()


# Findings


def test_headlines_follow_the_data():
    slow = results_of(make_rows(runtime=lambda *key: 20e-6 if key[1] == "glambda" else 10e-6))
    answer = which_method(slow)
    assert answer.caption == "daqp" and answer.figure == "10.0 µs"
    assert "loses on fig2 and fig4" in " ".join(answer.sentences)
    assert "2.00 times as much, and stands 3rd of the 3" in " ".join(answer.sentences)
    fast = results_of(make_rows(runtime=lambda *key: 5e-6 if key[1] == "glambda" else 10e-6))
    answer = which_method(fast)
    assert answer.caption == "glambda"
    assert "the fastest on fig2 and fig4" in " ".join(answer.sentences)
    assert "loses" not in " ".join(answer.sentences)


def test_accuracy_headline_names_who_misses(study):
    answer = how_accurate(study)
    assert answer.figure == "3 of 4"
    assert "osqp (90.0 %)" in " ".join(answer.sentences)
    assert "4 answers are more than 1000 times off" in " ".join(answer.sentences)


def test_warm_headline(study):
    answer = warm_start_worth(study)
    assert answer.caption == "the cold time of glambda"
    assert "100 % of them take at most one descent direction, 0 % when cold" in answer.sentences[0]


def test_criterion_tables(study):
    model, alternatives = criterion_tables(study)
    from harness.criterion.cost_model import criterion_of

    counted = criterion_of(study.recordings["fig2"])
    row = model.data.set_index("scene").loc["fig2"]
    assert row["√(2 C_QR/C_IT)"] == counted.threshold == thresholds(study)["fig2"]
    assert row["C(n*)/T"] == counted.cost_per_call
    # Of the 7 QPs started warm (1, 2, 5, 6, 7, 8, 9) one is a multiple of 4.
    assert (row["warm QPs"], row["factorizations"], row["CG per QP"]) == (7, 1, 2.0)
    assert row["QR + CG"] == pytest.approx(counted.C_QR / 7 + 2 * counted.C_IT)
    other = alternatives.data.set_index(["scene", "solver"])
    assert other.loc[("fig2", "lotstedt[exact_qr]"), "time ratio"] == pytest.approx(1.5)
    assert other.loc[("fig2", "daqp"), "time ratio"] == pytest.approx(0.1)
    assert np.isnan(other.loc[("fig2", "daqp"), "flops per QP"])
    assert criterion_answer(study) is None  # nobody keeps R at every size


def test_when_to_refactorize_is_told_in_two_sentences():
    solvers = ("glambda", "lotstedt", "lotstedt[deferred]")
    rows = make_rows(solvers=solvers)
    rows.loc[rows["solver"] == "glambda", "cg_iterations"] = 0
    for solver, flops in zip(solvers, (600, 1200, 900), strict=True):
        rows.loc[rows["solver"] == solver, "flops"] = flops
    answer = criterion_answer(results_of(rows))
    whether, when = answer.sentences
    assert whether.startswith("Do not keep R on QPs like those of fig2 and fig4: glambda, which")
    assert "0.667 times the operations of lotstedt[deferred]" in whether
    assert "factorize at the next QP where a direction took more iterations" in when
    assert "lotstedt does 1.33 times its operations" in when
    assert answer.figure == "at every QP" and answer.caption.startswith("by glambda")
    rows.loc[rows["solver"] == "glambda", "flops"] = 1800
    assert criterion_answer(results_of(rows)).sentences[0].startswith("Keep R on QPs like")


# Reading results


def test_bad_results_are_refused():
    rows = make_rows(qps=2)
    with pytest.raises(ValueError, match="lack the columns verdict"):
        prepare(rows.drop(columns="verdict"))
    with pytest.raises(ValueError, match="stored twice"):
        prepare(pd.concat([rows, rows.iloc[:1].assign(runtime=2e-6)]))
    mixed = rows.copy()
    mixed.loc[mixed["solver"] == "daqp", "recording_digest"] = "another"
    with pytest.raises(ValueError, match="fig2 holds solves of 2 different recordings"):
        prepare(mixed)


def test_an_absent_or_empty_folder_says_what_to_run(tmp_path):
    with pytest.raises(ValueError, match="is not a folder"):
        load_results(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="run `glambda study`"):
        write_report(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_real_folder_from_recording_to_page(tmp_path):
    from harness.study.replay import replay

    recording = make_recording("fig2")
    replay(recording, ["glambda", "scipy_bvls"], results=tmp_path / "results", repeats=1)
    results = load_results(tmp_path / "results")
    assert results.scenes == ["fig2"]
    assert results.missing == ()
    assert results.rows["verified"].all()
    page = write_report(tmp_path / "results", tmp_path / "out")
    assert "2 of 2" in page.read_text(encoding="utf-8")
    table = warm_table(results, "paper").data
    assert table.set_index("solver").loc["glambda", "QPs"] == 7


def test_solves_of_another_recording_than_the_stored_one_are_refused(tmp_path):
    from harness.recordings.recording import write_recording
    from harness.study.replay import replay

    recording = make_recording("fig2")
    replay(recording, ["scipy_bvls"], results=tmp_path, repeats=1)
    other = replace(recording, eps=2 * recording.eps)
    write_recording(tmp_path / "recordings" / "fig2.h5", other)
    with pytest.raises(ValueError, match="solves of fig2 are of another recording"):
        load_results(tmp_path)


# Pictures


def test_motion_of_a_run_and_of_a_recording_agree():
    run = glambda.simulate("fig3", until=0.02)
    recording = recording_of(run, "glambda")
    one, two = motion_of(recording), motion_of(run)
    pose = one.pose(0.01)
    assert np.allclose(one.spring_ends(pose), two.spring_ends(pose)) and len(one.springs) == 1
    assert np.allclose(one.corners(pose, 0), two.corners(pose, 0))
    assert one.ground == two.ground


def test_corners_turn_with_the_body():
    recording = make_recording(bodies=1)
    motion = motion_of(recording)
    corners = motion.corners(np.array([[1.0, 2.0, np.pi / 2]]), 0)[0]
    assert np.allclose(corners, [(1.5, 1.0), (1.5, 3.0), (0.5, 3.0), (0.5, 1.0)])


def test_frames_hold_the_ends_and_the_papers_times():
    recording = make_recording("fig3")
    object.__setattr__(recording, "t", 12 * recording.t)
    times = frame_times(motion_of(recording), 12)
    assert len(times) == 12 and times == sorted(times)
    assert {0.0, 12.0, 0.7302, 2.1151, 4.0002} <= set(times)
    with pytest.raises(ValueError, match="at least one"):
        frame_times(motion_of(recording), 0)


def test_window_holds_every_body_and_the_ground():
    motion = motion_of(make_recording())
    window = window_of(motion, [motion.pose(0.0), motion.pose(1.0)])
    assert window.left < -1 and window.right > 4.5 and window.bottom < 0 and window.top > 1


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_frames_are_drawn_the_same_twice(tmp_path, suffix):
    recording = make_recording("fig3", bodies=2, anchor_above=2.0)
    first = plot_scene(recording, tmp_path / f"a.{suffix}").read_bytes()
    second = plot_scene(recording, tmp_path / "sub" / f"b.{suffix}").read_bytes()
    assert len(first) > 5000
    assert first == second


def test_frames_of_bodies_far_apart_keep_one_scale(tmp_path):
    recording = make_recording()
    q = recording.q.copy()
    q[:, 1, 0] = 2.5 + 60 * recording.t
    object.__setattr__(recording, "q", q)
    assert plot_scene(recording, tmp_path / "a.png").stat().st_size > 5000


def test_frames_at_given_times(tmp_path):
    recording = make_recording()
    assert plot_scene(recording, tmp_path / "a.svg", times=[0.25]).exists()
    with pytest.raises(ValueError, match="times is empty"):
        plot_scene(recording, tmp_path / "a.svg", times=[])


def test_animation(tmp_path):
    recording = make_recording()
    path = animate_scene(recording, tmp_path / "a.gif", fps=5)
    from PIL import Image

    with Image.open(path) as image:
        assert image.n_frames == 6
        dark = []
        for frame in range(6):
            image.seek(frame)
            dark.append(int((np.asarray(image.convert("L")) < 100).sum()))
    # What moved on leaves no trace behind.
    assert max(dark) < 1.2 * min(dark)
    with pytest.raises(ValueError, match=r"is written as \.gif or \.mp4"):
        animate_scene(recording, tmp_path / "a.avi")
    with pytest.raises(ValueError, match="must be positive"):
        animate_scene(recording, tmp_path / "a.gif", fps=0)


@pytest.mark.parametrize(("speed", "pictures"), [(1.0, 6), (0.5, 11)])
def test_a_film_has_its_size_and_speed(speed, pictures, tmp_path):
    from PIL import Image

    path = animate_scene(make_recording(), tmp_path / "a.gif", fps=5, speed=speed, pixels=320)
    with Image.open(path) as image:
        assert image.n_frames == pictures and image.width == 320


def test_an_mp4_needs_ffmpeg(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"extra \[film\]"):
        animate_scene(make_recording(), tmp_path / "a.mp4")


def test_an_mp4_is_written(tmp_path):
    try:
        ffmpeg()
    except ImportError as error:
        pytest.skip(str(error))
    path = animate_scene(make_recording(), tmp_path / "a.mp4", fps=5, pixels=321)
    assert b"ftyp" in path.read_bytes()[:16]


def test_figures_exist(tmp_path, study):
    for draw in (plot_accuracy, plot_cost, plot_profiles):
        assert draw(study, "paper", tmp_path / "a.png").stat().st_size > 5000
        with pytest.raises(ValueError, match="'default' has no solves"):
            draw(study, "default", tmp_path / "a.png")
    assert plot_work(study, "fig2", tmp_path / "w.png", threshold=2.1).stat().st_size > 5000
    with pytest.raises(ValueError, match="was not run warm"):
        plot_work(study, "fig9", tmp_path / "w.png")


# The page


def test_page_stands_alone_and_is_the_same_twice(tmp_path, study, written):
    page = (written / "index.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://", page)
    assert not re.search(r"<(link|iframe|object)\b|<script[^>]+src", page)
    assert all(
        source.startswith("data:") for source in re.findall(r'<img [^>]*src="([^"]+)"', page)
    )
    assert not re.search(r"url\((?!#)", page)
    assert page == report(study, tmp_path).read_text(encoding="utf-8")
    for folder in ("tables", "figures"):
        for path in sorted((written / folder).iterdir()):
            assert path.read_bytes() == (tmp_path / folder / path.name).read_bytes(), path
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))
    anchors = set(re.findall(r'href="#([^"]+)"', page))
    assert anchors <= set(names)


def test_a_table_is_written_once_with_a_column_of_what_was_set(study, written):
    assert {path.suffix for path in (written / "tables").iterdir()} == {".csv"}
    cost = pd.read_csv(written / "tables" / "cost.csv")
    assert cost.columns[0] == "setting" and {*cost["setting"]} == {*study.settings}
    for setting, part in cost.groupby("setting"):
        made = cost_table(study, setting).data["cold median"]
        assert part["cold median"].to_numpy() == pytest.approx(made.to_numpy(), nan_ok=True)


def test_findings_name_the_files_of_the_numbers(written):
    text = (written / "findings.md").read_text(encoding="utf-8")
    linked = {written / name for name in re.findall(r"\]\(([^)]+)\)", text)}
    assert linked == {written / "index.html", *(written / "tables").iterdir()}
    assert "## Which method?" in text and "On fig4 (warm, high) daqp is" in text
    assert "[cost](tables/cost.csv): Time per QP in µs, by setting." in text


def test_a_long_table_is_named_in_markdown_and_not_shown(study):
    table = scene_table(study)
    long = replace(table, data=pd.concat([table.data] * LONGEST, ignore_index=True))
    assert "|" in table.to_markdown() and "[scenes.csv](scenes.csv)" not in table.to_markdown()
    assert "|" not in long.to_markdown() and "[scenes.csv](scenes.csv)" in long.to_markdown()


def test_page_says_where_the_method_loses(written):
    page = (written / "index.html").read_text(encoding="utf-8")
    section = page[page.index('id="unflattering"') :]
    assert "On fig4 (warm, high) daqp is" in section.replace("\u00a0", " ")


def test_page_of_recordings_alone(tmp_path):
    results = Results(empty_rows(), {"fig5": make_recording("fig5")}, ("No solves are stored.",))
    page = report(results, tmp_path).read_text(encoding="utf-8")
    assert "No solves are stored." in page
    assert 'id="accuracy"' not in page and 'id="unflattering"' not in page
    assert (tmp_path / "figures" / "frames_fig5.svg").exists()


@pytest.mark.parametrize(
    "part",
    [
        {"arms": ("cold",)},
        {"arms": ("warm",)},
        {"solvers": ("daqp", "osqp")},
        {"solvers": ("glambda",)},
        {"settings": ("high",), "scenes": ("fig3",)},
        {"verdict": lambda *key: "skipped"},
        {"verdict": lambda *key: "failed", "glambda_error": np.nan, "eps0_ratio": np.nan},
        {"k": 0},
        {"arms": ("warm", "stale5"), "after_restart": False, "repeats": 3},
        {"arms": ("cold", "exact"), "after_restart": False, "repeats": 3, "warm_started": True},
        {"solvers": ("osqp[normal]", "osqp[residual]"), "k": 2000},
    ],
    ids=[
        *("cold", "warm", "no method", "method alone", "high", "all skipped", "all failed"),
        *("free flight", "starts without cold ones", "one start each", "forms of no condition"),
    ],
)
def test_page_of_a_partial_study(tmp_path, part):
    one = {"scenes": ("fig2",), **part}
    page = report(results_of(make_rows(**one)), tmp_path).read_text(encoding="utf-8")
    said = re.sub(r"<script>.*?</script>|data:[^\"]+", "", page, flags=re.DOTALL)
    assert "nan" not in said.lower()
    assert 'id="reproduce"' in page


def test_page_where_nobody_was_swept_on_every_scene(tmp_path):
    one = make_rows(scenes=("fig2",), solvers=("daqp",), settings=("1e-4", "1e-6"))
    two = make_rows(scenes=("fig3",), solvers=("osqp",), settings=("1e-4", "1e-6"))
    study = make_rows(scenes=("fig2", "fig3"))
    both = replace(results_of(study), campaigns=prepare(pd.concat([one, two])))
    page = report(both, tmp_path).read_text(encoding="utf-8")
    assert "Nobody has an error" not in page
    assert (tmp_path / "figures" / "pareto_fig2.svg").exists()
    assert not (tmp_path / "figures" / "pareto_all_scenes.svg").exists()


def test_a_win_is_claimed_for_what_was_compared_only():
    rows = make_rows(scenes=("fig2",), arms=("cold",))
    rows.loc[rows["solver"] == "glambda", "runtime"] = 1e-9
    (said,) = unflattering(results_of(rows))
    assert unflattering(results_of(rows), ["a race is lost"]) == ["a race is lost", said]
    assert "in which it stood against others (1)" in said
    assert unflattering(results_of(make_rows(solvers=("glambda",)))) == [
        "glambda was compared with nobody else."
    ]


def test_what_is_not_verified_is_charged_the_limit_of_its_study():
    rows = make_rows(verdict=lambda *key: "wrong")
    assert (prepare(rows, 10.0)["charged"] == 10.0).all()


def test_prose_is_escaped_and_set():
    assert prose("3 µs < 1 s & C_QR") == "3\u00a0µs &lt; 1\u00a0s &amp; C<sub>QR</sub>"


def test_commands_to_reproduce(study):
    command = "glambda record fig4 --set mu_I=0.8"
    assert record_command("fig4,mu_I=0.8", {}) == f"{command} -o recordings"
    cut = {"run.until": 1.0, "end_time": 15.0}
    assert record_command("fig4,mu_I=0.8", cut) == f"{command} --until 1 -o recordings"
    held = {"eps": 1e-3, "run.eps": 1e-3, "run.drop_tol": 1e-3, "run.fixed_step": 0.005}
    held |= {"run.stops": "held", "run.order": 1, "run.solver": "glambda"}
    assert record_command("fig4,friction=paper", held) == (
        "glambda record fig4 --fixed-step 0.005 --stops held --friction paper -o recordings"
        "  # from Python: order=1"
    )
    text = reproduce(study)
    assert "--settings paper,high --arms cold,warm" in text
    assert "--qp 0" in text


ODD = "fig4,x=$(touch y);'$z{\\frac"


def test_commands_are_quoted_for_a_shell():
    rows = make_rows(scenes=(ODD,), solvers=("glambda", "a b"), settings=("pa;per",))
    text = reproduce(
        results_of(rows, {ODD: make_recording(ODD, **{"run.note": "a\nrm b", "run.eps": []})})
    )
    for line in text.replace("\\\n", "").splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "glambda" and words[1] in ("record", "replay", "report"), line
    words = shlex.split(text.replace("\\\n", ""), comments=True)
    assert {"x=$(touch y);'$z{\\frac", f"recordings/{ODD}.h5", "pa;per", "glambda,a b"} <= {*words}
    told = record_command("a;b,condition=1;c", {})
    assert shlex.split(told) == [
        *("glambda", "stretch", "recordings/a;b.h5", "--condition", "1;c", "-o", "recordings")
    ]


def test_names_are_drawn_as_they_are_and_obeyed_nowhere(tmp_path):
    """A $ begins mathematics in Matplotlib, unless it is told not to."""
    rows = make_rows(scenes=(ODD,), solvers=("glambda", "$\\frac{", "daqp"))
    rows["versions"] = "\x1b[31m1.0\u202e"
    page = report(results_of(rows, {ODD: make_recording(ODD)}), tmp_path)
    for path in (page, tmp_path / "findings.md", *tmp_path.glob("tables/*")):
        text = path.read_text()
        assert "\x1b" not in text and "\u202e" not in text, path
    assert "\\x1b[31m1.0" in page.read_text()


def test_powers_on_logarithmic_axes_are_written_in_letters(tmp_path):
    assert in_letters(r"$\mathdefault{-2\times10^{-12}}$") == "-2×10⁻¹²"
    assert in_letters(r"$\mathdefault{10^{0.50}}$") == "10⁰·⁵⁰"
    assert in_letters("") == ""
    with drawing() as Figure:
        figure = Figure()
        axes = figure.subplots()
        axes.loglog([1e-3, 10.0], [1e-9, 1.0], label="$x_{")
        axes.legend()
        save(figure, tmp_path / "x.svg")
        labels = {text.get_text() for text in (*axes.get_xticklabels(), *axes.get_yticklabels())}
    assert {"10⁻³", "10⁰", "10⁻⁸"} <= labels and not any("$" in text for text in labels)


def test_campaigns_have_their_commands():
    rows = make_rows(scenes=("fig2", "fig4,condition=1e4"), solvers=("glambda", "osqp"))
    study, aside = rows[rows["scene"] == "fig2"], rows[rows["scene"] != "fig2"]
    campaigns = pd.concat([aside.assign(settings="1e-6"), study.assign(arm="exact")])
    made = replace(results_of(study), campaigns=prepare(campaigns.drop_duplicates(KEY)))
    text = reproduce(made)
    assert "glambda stretch recordings/fig4.h5 --condition 1e4" in text
    assert "glambda replay recordings/fig2.h5 --solvers glambda,osqp" in text
    assert "--settings paper --arms exact -o results" in text
    assert "--settings 1e-6 --arms cold,warm -o results" in text


def test_the_protocol_tells_what_is_known_of_clock_pace_and_harness(study):
    bare = dict(protocol(study))
    assert not {"Clock", "Pace", "Unrest", "Harness"} & set(bare)  # nothing is known or said
    passes = pd.DataFrame({
        "pace": (1e-3, 1e-3, 1e-3, 1.5e-3), **dict.fromkeys(Unrest._fields, 0.0),
        "steal": np.nan, "disturbed_by": ("", "pressure", "pressure, switches", ""),
    })  # fmt: skip
    known = replace(
        study,
        passes=passes,
        study={"clock": {"resolution": 4e-8, "empty_call": 4e-6, "empty_runtime": 1e-7}},
        spent={"replaying": 10.0, "in_passes": 8.0, "in_calls": 5.0},
    )
    said = dict(protocol(known))
    assert "0.040 µs or more" in said["Clock"] and "4.00 µs as a whole" in said["Clock"]
    assert "the slowest 1.50" in said["Pace"] and "1 passes began more" in said["Pace"]
    assert (
        "2 of the 4 passes were disturbed (tasks that waited for a processor 2, the process put "
        "aside 1)"
    ) in said["Unrest"]
    assert "does not tell: processors given to others" in said["Unrest"]
    assert (
        "50.0 % of it inside timed calls" in said["Harness"] and "30.0 % around" in said["Harness"]
    )


def test_a_study_json_of_another_kind_is_left_aside(study):
    for clock in (None, {}, {"resolution": "fast"}, [1]):
        assert "Clock" not in dict(protocol(replace(study, study={"clock": clock})))
