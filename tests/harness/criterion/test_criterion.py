"""The refactorization criterion: the fits, the runs, and the tables of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from math import inf, isnan, nan, sqrt
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.criterion.column_drift import compare, drift, effort, predicted_exponent
from harness.criterion.cost_model import fit_growth
from harness.criterion.criterion import moves, rule_runs
from harness.criterion.examination import examination_claims
from harness.criterion.factor_rules import (
    as_shipped,
    drive,
    exact,
    fixed,
    online,
    paper,
    paper_deferred,
    sequence,
)
from harness.criterion.measurement import RULES, Measurement, growth_of, measurements
from harness.criterion.unit_times import PARTS, fit_unit_times
from harness.recordings.recording import Recording, read_recording, write_recording
from harness.study.record import recording_of
from problems import scene, simulate
from problems.qp import ContactQP
from reports.criterion.advice import DO, advice, keeps
from reports.criterion.page import tables_of, write_criterion
from solvers import make_solver
from solvers.active_set.flops import qr_flops
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.runs import short_recording


@pytest.fixture(scope="module", autouse=True)
def shortly() -> Iterator[None]:
    """Times are measured, but not for long: no test here hangs on them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("harness.criterion.criterion.ENOUGH", 1e-3)
        patch.setattr("harness.criterion.kept_factors.INTERVALS", (1, 5))
        yield


COUNTED = ["age", "descent_directions", "qr_factorizations", "cg_iterations", "flops", "m", "f"]


# Fits


def test_a_power_law_is_recovered_with_its_spread() -> None:
    random = np.random.default_rng(1)
    age = np.tile(np.arange(60), 40)
    blocks = np.repeat(np.arange(40), 60)
    exact = fit_growth(age, 3.0 * age**0.4, blocks)
    assert exact is not None
    # a class holds several ages, so the law is exact up to its curvature in a class
    assert exact.c == pytest.approx(3.0, rel=5e-3) and exact.r == pytest.approx(0.4, abs=2e-3)
    noise = random.lognormal(0, 0.3, 40)[blocks] * random.lognormal(0, 0.2, age.size)
    noisy = fit_growth(age, 3.0 * age**0.4 * noise, blocks)
    assert noisy is not None
    assert noisy.c_range[0] < noisy.c < noisy.c_range[1]
    assert noisy.r_range[0] < 0.4 < noisy.r_range[1]
    assert noisy.r_range[1] - noisy.r_range[0] > 10 * (exact.r_range[1] - exact.r_range[0])
    again = fit_growth(age, 3.0 * age**0.4 * noise, blocks)
    assert again is not None and again.r_range == noisy.r_range


def test_ages_are_gathered_in_classes_of_enough_qps() -> None:
    age = np.repeat([0, 1, 2, 4, 5, 6, 30], [9, 5, 5, 3, 3, 5, 4])
    found = fit_growth(age, np.where(age > 0, 2.0, 100.0), np.zeros(age.size))
    assert found is not None
    assert found.counts.tolist() == [5, 5, 6, 5]  # 1, 2, 4-5, 6-8; 0 and 30 are left out
    np.testing.assert_allclose(found.ages, [1, 2, sqrt(20), 6])
    assert found.r == pytest.approx(0.0, abs=1e-12) and found.c == pytest.approx(2.0)


def test_no_growth_is_told_apart_from_no_data() -> None:
    assert fit_growth([], [], []) is None
    assert fit_growth([0, 0, 1, 1], [1, 1, 2, 2], [0, 0, 0, 0]) is None
    age = np.repeat([1, 2, 3], 10)
    falling = fit_growth(age, 4.0 / age, np.zeros(30))
    assert falling is not None and falling.r == pytest.approx(-1.0)
    c, r = falling.prediction()
    assert r == 0.0 and c == pytest.approx(np.mean(4.0 / age))


def solves(n: int = 400, seed: int = 0) -> pd.DataFrame:
    """Solves with random counts that cost 40, 5, 20 and 8 µs each, and 30 µs at least."""
    random = np.random.default_rng(seed)
    counts = np.column_stack([random.integers(0, high, n) for high in (2, 6, 3, 3)])
    table = pd.DataFrame(counts, columns=list(PARTS))
    table["runtime"] = 1e-6 * (counts @ np.array([40.0, 5.0, 20.0, 8.0]) + 30.0)
    return table


def test_times_of_the_parts_are_recovered_despite_interruptions() -> None:
    table = solves()
    table.loc[::9, "runtime"] += 5e-3
    times = fit_unit_times([table[:150], table[150:]])
    assert times.factorization == pytest.approx(40e-6, rel=0.2)
    assert times.iteration == pytest.approx(5e-6, rel=0.2)
    exact = fit_unit_times([solves()])
    found = (exact.factorization, exact.iteration, exact.direction, exact.change, exact.other)
    assert found == pytest.approx((40e-6, 5e-6, 20e-6, 8e-6, 30e-6), rel=1e-6)
    assert exact.explained == pytest.approx(1.0)
    assert exact.ratio == pytest.approx(8.0) and exact.threshold == pytest.approx(4.0)


def test_a_part_that_cannot_be_told_apart_has_no_time() -> None:
    table = solves()
    table["cg_iterations"] = table["descent_directions"]
    times = fit_unit_times([table])
    assert isnan(times.iteration) and isnan(times.direction) and isnan(times.ratio)
    assert times.change == pytest.approx(8e-6, rel=0.5)
    with pytest.raises(ValueError, match="no solves"):
        fit_unit_times([table[:0]])


# How far A moves


def test_an_unmoved_or_rescaled_A_keeps_its_R_perfect() -> None:
    random = np.random.default_rng(3)
    A, free = random.standard_normal((8, 5)), np.array([0, 2, 3])
    old = ContactQP(A, np.ones(8), np.zeros(5), np.full(5, np.inf))
    same = compare(old, old, free)
    assert same is not None
    assert same.moved == 0.0 and same.condition == pytest.approx(1.0) and same.outlying == 0
    scaled = compare(old, replace(old, A=3.0 * A), free)
    assert scaled is not None
    assert scaled.moved == pytest.approx(2 / 3) and scaled.condition == pytest.approx(1.0)


def test_condition_and_outlying_values_are_those_of_A_R_inverse() -> None:
    random = np.random.default_rng(4)
    A = np.linalg.qr(random.standard_normal((12, 6)))[0]
    B = A.copy()
    B[:, 2] = A @ random.standard_normal(6) + random.standard_normal(12)
    B[:, 2] /= np.linalg.norm(B[:, 2])
    bounds = np.zeros(6), np.full(6, np.inf)
    old = ContactQP(A, np.ones(12), *bounds)
    # rows are matched by row_id, not by position
    turned = ContactQP(B[:, ::-1], np.ones(12), *bounds, row_id=np.arange(6)[::-1])
    pair = compare(old, turned, np.arange(6)[::-1])
    assert pair is not None
    values = np.linalg.svd(B @ np.linalg.inv(np.linalg.qr(A)[1]), compute_uv=False)
    assert pair.condition == pytest.approx(values[0] / values[-1])
    assert 1 <= pair.outlying <= 2  # one column has moved
    assert pair.moved == pytest.approx(np.linalg.norm(B - A) / np.linalg.norm(B))


def test_nothing_is_said_of_pairs_that_cannot_be_compared() -> None:
    A = np.ones((3, 2))
    old = ContactQP(A, np.ones(3), np.zeros(2), np.ones(2))
    assert compare(old, old, np.array([0, 1])) is None  # dependent columns
    other = replace(old, row_id=np.array([7, 8]))
    assert compare(old, other, np.array([7])) is None  # nothing in common


def test_the_bound_grows_slowly_while_the_condition_is_near_1() -> None:
    age = np.array([1, 2, 3, 5, 8])
    for slope, low, high in ((1e-6, 0.0, 0.1), (1e-2, 0.1, 0.35), (1.0, 0.7, 1.1)):
        table = pd.DataFrame({"age": age, "effort": effort(1.0 + slope * age)})
        assert low < predicted_exponent(table) < high
    assert isnan(predicted_exponent(table[:1]))


# Runs


def measure(recording: Recording) -> Measurement:
    """What runs say, without a folder between."""
    told = {"scene": recording.scene, "digest": recording.digest}
    (found,) = measurements(rule_runs(recording, 1).assign(**told), moves(recording).assign(**told))
    return found


@cache
def measured(name: str, length: int = 150) -> Measurement:
    return measure(short_recording(name, length))


def test_the_sequence_leaves_out_impulses_and_begins_anew_at_restarts() -> None:
    recording = short_recording("fig4", 150)
    links = sequence(recording)
    assert [link.place for link in links] == [
        i for i, qp in enumerate(recording.qps) if qp.kind not in ("impulse", "minimum_norm")
    ]
    assert len(links) < len(recording.qps)
    for link in links:
        assert link.warm != link.qp.restart or link.place == links[0].place
    assert links[-1].chain == sum(not link.warm for link in links) - 1 > 0


def test_a_fixed_interval_bounds_the_age_of_R() -> None:
    links = sequence(short_recording("fig2", 120))
    always, third, never = (drive(links, fixed(s)) for s in (1, 3, inf))
    with_R = always["f"] > 0
    assert (always.loc[with_R & always["warm"], "qr_factorizations"] == 1).all()
    assert third["age"].max() == 2
    assert never.loc[never["warm"], "qr_factorizations"].sum() == 0
    assert never["age"].max() == never.groupby("chain").size().max() - 1


def test_counts_are_the_same_in_every_run() -> None:
    links = sequence(short_recording("fig5", 100))
    for rule in (paper(), exact(), paper_deferred(), online(), as_shipped()):
        pd.testing.assert_frame_equal(drive(links, rule)[COUNTED], drive(links, rule)[COUNTED])


def test_the_deferred_rule_factorizes_after_a_direction_of_too_many_iterations() -> None:
    steps = drive(sequence(short_recording("fig4", 150)), paper_deferred())
    limit = np.sqrt(2 * steps["C_QR"] / steps["C_IT"].clip(lower=1.0))
    one = (steps["descent_directions"] <= 1) & (steps["working_set_changes"] == 0)
    settled, follows = one & (steps["f"] > 0), steps["warm"] & (steps["f"] > 0)
    for beyond in (False, True):
        told = (steps["cg_iterations"] > limit) == beyond
        after = (settled & told).shift(fill_value=False) & follows
        assert after.sum() > 10
        assert (steps.loc[after, "qr_factorizations"] == int(beyond)).all()


def test_costs_are_means_over_qps_with_a_predecessor_and_a_free_column() -> None:
    found = measured("fig4")
    steps = found.rules["paper"].steps
    assert (found.counted == (steps["warm"] & (steps["f"] > 0))).all()
    assert 0 < found.counted.sum() < len(steps)
    expected = steps.loc[found.counted, "flops"].mean()
    assert found.rules["paper"].cost == pytest.approx(expected)
    best = min(run.cost for run in found.sweep)
    assert found.regret("paper") == pytest.approx(expected / best - 1)
    assert found.criterion.calls == found.counted.sum()
    assert found.predicted["paper"] == pytest.approx(found.criterion.threshold)


def test_no_fixed_interval_has_a_negative_regret() -> None:
    found = measured("fig4")
    assert tuple(found.rules) == RULES
    assert min(run.cost for run in found.sweep) == found.best().cost
    for rule in ("always", "never", "s* paper", "s* fitted"):
        assert found.regret(rule) >= 0.0
    intervals = [run.interval for run in found.sweep]
    assert intervals == sorted(intervals) and intervals[-1] == inf


def test_growth_is_fitted_to_the_ages_of_all_runs() -> None:
    found = measured("fig4")
    assert found.growth is not None
    never = growth_of([found.rules["never"]])
    assert never is not None
    assert found.growth.counts.sum() > never.counts.sum()
    assert found.growth.means[0] >= 1.0


def test_a_sparse_recording_is_measured_by_the_costs_of_its_own_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(recording_of.__globals__, "reference", lambda *_, **__: None)
    run = simulate(scene("wall", bodies=25), make_solver("glambda"), until=0.25)
    found = measure(recording_of(run, "glambda"))
    assert found.criterion.sparse == 1.0
    always = found.rules["always"].steps[found.counted]
    assert pytest.approx(always["C_QR"].mean()) == found.criterion.C_QR
    dense = qr_flops(int(found.criterion.rows), int(found.criterion.free))
    assert 0 < found.criterion.C_QR < dense / 10
    # F may hold more columns than are independent; κ is told all the same
    assert found.criterion.free > 0.9 * found.criterion.rows
    assert len(found.drift) >= 3 and (found.drift["condition"] >= 1.0).all()


def test_drift_is_sampled_within_a_stretch() -> None:
    found = measured("fig4")
    table = found.drift
    assert table["age"].is_monotonic_increasing and len(table) >= 3
    assert (table["condition"] >= 1.0).all() and (table["moved"] >= 0.0).all()
    assert table["moved"].iloc[-1] > table["moved"].iloc[0]
    links = sequence(short_recording("fig4", 150))
    # every QP a stretch of its own: no pairs
    none = drift([link.qp for link in links], range(len(links)), [link.qp.row_id for link in links])
    assert not len(none)


def test_a_recording_without_a_warm_qp_has_nothing_to_measure() -> None:
    made = fake_recording()
    only_impulses = replace(made, qps=[replace(qp, kind="impulse") for qp in made.qps])
    assert rule_runs(only_impulses).empty
    restarts = replace(made, qps=[replace(qp, restart=True) for qp in made.qps])
    assert rule_runs(restarts).empty


# Tables, figures, command


def test_tables_say_who_loses() -> None:
    found = [measured("fig4"), measured("fig5", 100)]
    tables = {table.name: table for table in tables_of(found)}
    assert list(tables) == [
        *("criterion_costs", "criterion_growth", "criterion_interval", "criterion_regret"),
        *("criterion_time", "criterion_premise", "criterion_age"),
    ]
    assert "exact" in tables["criterion_time"].data and "shipped" in tables["criterion_time"].data
    regret = tables["criterion_regret"].data.set_index("scene")
    for one in found:
        assert regret.loc[one.scene, "paper"] == pytest.approx(one.regret("paper"))
        told = any(
            one.scene in note and "paper costs" in note for note in tables["criterion_regret"].notes
        )
        assert told == (one.regret("paper") > 0.05)
    premise = tables["criterion_premise"].data
    np.testing.assert_allclose(premise[["none", "one", "several"]].sum(axis=1), 1.0)
    for table in tables.values():
        assert "nan" not in table.to_markdown()


def test_the_advice_is_the_cheapest_rule_that_can_be_followed() -> None:
    found = [measured("fig4"), measured("fig5", 100)]
    whether, when = advice(found)
    assert all(not keeps(one) for one in found)
    assert whether.startswith("Factorize at every QP and keep no R on ") and "fig5" in whether
    worst = {rule: max(one.regret(rule) for one in found) for rule in DO}
    best = min(worst, key=worst.__getitem__)
    assert f"factorize {DO[best]}:" in when
    # where the rules that keep R are the cheaper ones, it says so
    dear = replace(found[0], rules={**found[0].rules, "exact QR": found[0].rules["always"]})
    assert keeps(dear) and advice([dear])[0].startswith("Keep R on ")


def test_the_premise_is_judged_on_the_qps_of_several_directions() -> None:
    found = measured("fig5", 100)
    several = found.counted & (found.directions > 1)
    assert several.any()
    data = tables_of([found])[5].data
    paper = found.rules["paper"].steps.loc[several, "flops"].mean()
    best = min(run.steps.loc[several, "flops"].mean() for run in found.sweep)
    assert data["paper > 1"][0] == pytest.approx(paper / best - 1)
    assert data["several"][0] == pytest.approx(several.sum() / found.counted.sum())


def test_a_recording_of_less_than_three_cycles_is_told() -> None:
    one = measured("fig4")
    longest = one.sweep[0].steps.groupby("chain").size().max()
    for cycle, told in ((longest / 3 - 0.1, False), (longest / 3 + 0.1, True), (inf, False)):
        changed = replace(one, predicted={**one.predicted, "fitted": cycle})
        assert bool(tables_of([changed])[2].notes) == told


def test_growth_that_is_unknown_is_a_dash(tmp_path: Path) -> None:
    one = replace(measured("fig4"), growth=None, exponent=nan, drift=measured("fig4").drift[:0])
    page = write_criterion([one], tmp_path)
    assert "–" in page.read_text(encoding="utf-8")
    assert (tmp_path / "criterion_sweep.png").stat().st_size > 5000


def test_the_command_prints_tables_and_writes_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    claims = partial(examination_claims, largest=4)
    monkeypatch.setattr("harness.criterion.examination.examination_claims", claims)
    monkeypatch.setattr("harness.criterion.kept_factors.LONGEST", 20)
    path = tmp_path / "fig5.h5"
    write_recording(path, short_recording("fig5", 40))
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["criterion", str(path), "--repeats", "1", "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert "Regret of each rule, in counted operations" in result.stdout
    runs = pd.read_csv(out / "criterion_runs.csv")
    assert {"paper", "online", "interval 1", "interval inf"} <= set(runs["rule"])
    assert (runs["flops"] > 0).all()
    names = {path.name for path in out.iterdir()}
    assert {"criterion.md", "criterion_sweep.svg", "criterion_growth.png"} <= names


def test_the_command_refuses_what_it_cannot_measure(tmp_path: Path) -> None:
    made = fake_recording()
    path = tmp_path / "still.h5"
    write_recording(path, replace(made, qps=[replace(qp, kind="impulse") for qp in made.qps]))
    with pytest.raises(ValueError, match="record a longer motion"):
        measure(read_recording(path))
    result = CliRunner().invoke(app, ["criterion", str(path)])
    assert result.exit_code == 2 and "longer motion" in result.stderr
    assert CliRunner().invoke(app, ["criterion", str(tmp_path / "no.h5")]).exit_code == 2
