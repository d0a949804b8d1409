"""The benchmarks: a rise of work counts is seen, rounding is not taken for one, ratios are told."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks import times, work_counts

LABEL = "tower,bodies=5"
CHOICE = ["--sequences", LABEL, "--solvers", "glambda"]
Baseline = dict[str, Any]


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return work_counts.baseline_of([LABEL], ["glambda"])


@pytest.fixture(scope="module")
def measured() -> Baseline:
    return work_counts.measure([LABEL], ["glambda"])


@pytest.fixture
def today(measured: Baseline, monkeypatch: pytest.MonkeyPatch) -> Baseline:
    """What today's code does, which the program hears as well without doing it again."""
    monkeypatch.setattr(work_counts, "measure", lambda *_: copy.deepcopy(measured))
    return copy.deepcopy(measured)


def exit_code(baseline: Baseline, folder: Path) -> int:
    path = folder / "baseline.json"
    path.write_text(json.dumps(baseline))
    return work_counts.main([*CHOICE, "--baseline", str(path)])


def with_rise(baseline: Baseline, count: str, percent: float) -> Baseline:
    """The baseline that today's code exceeds by so much in one count."""
    tampered = copy.deepcopy(baseline)
    counts = tampered[LABEL]["counts"]["glambda warm"]
    counts[count] = round(counts[count] / (1 + percent / 100))
    return tampered


def test_the_same_code_does_the_same_work(baseline: Baseline, tmp_path: Path) -> None:
    today = work_counts.measure([LABEL], ["glambda"])
    assert {name: baseline[LABEL][name] for name in today[LABEL]} == today[LABEL]
    assert exit_code(baseline, tmp_path) == 0


@pytest.mark.usefixtures("today")
def test_a_rise_of_six_percent_fails(
    baseline: Baseline, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(with_rise(baseline, "flops", 6.0), tmp_path) == 1
    told = capsys.readouterr().out
    assert "flops" in told
    assert "+6.0 %" in told
    assert "RISEN" in told


@pytest.mark.usefixtures("today")
def test_a_rise_of_four_percent_passes(baseline: Baseline, tmp_path: Path) -> None:
    assert exit_code(with_rise(baseline, "flops", 4.0), tmp_path) == 0


@pytest.mark.parametrize("count", ["descent_directions", "qr_factorizations", "flops"])
def test_each_count_is_looked_at(baseline: Baseline, count: str, today: Baseline) -> None:
    table = work_counts.compare(with_rise(baseline, count, 50.0), today)
    risen = table[table["risen"]]
    assert list(risen["count"]) == [count]
    assert list(risen["solver"]) == ["glambda warm"]


def test_what_rounding_explains_is_no_rise(baseline: Baseline, today: Baseline) -> None:
    tampered = with_rise(baseline, "flops", 6.0)
    was = tampered[LABEL]["counts"]["glambda warm"]["flops"]
    now = today[LABEL]["counts"]["glambda warm"]["flops"]
    for rounding, risen in ((now - was, 0), (now - was - 1, 1)):
        tampered[LABEL]["rounding"]["glambda warm"]["flops"] = rounding
        assert work_counts.compare(tampered, today)["risen"].sum() == risen


def test_a_count_that_was_zero_may_not_appear(baseline: Baseline, today: Baseline) -> None:
    today[LABEL]["counts"]["glambda warm"]["cg_iterations"] += 1
    before = copy.deepcopy(baseline)
    before[LABEL]["counts"]["glambda warm"]["cg_iterations"] = 0
    assert work_counts.compare(before, today)["risen"].sum() == 1


def test_other_questions_are_named(baseline: Baseline, today: Baseline) -> None:
    before = copy.deepcopy(baseline)
    before[LABEL]["digest"] = "0" * 16
    assert work_counts.remarks(before, today) == [
        f"{LABEL}: the QPs differ from the baseline's, if only in the last bits"
    ]
    before[LABEL]["qps"] += 1
    assert "QPs instead of" in work_counts.remarks(before, today)[0]
    assert work_counts.remarks({}, today) == [f"{LABEL}: not in the baseline"]
    assert work_counts.remarks(baseline, today) == []


def test_only_solvers_that_are_gone_are_missed(baseline: Baseline, today: Baseline) -> None:
    before = copy.deepcopy(baseline)
    for solver in ("lotstedt[exact_qr]", "lotstedt[gone]"):
        before[LABEL]["counts"][f"{solver} warm"] = before[LABEL]["counts"]["glambda warm"]
    assert work_counts.remarks(before, today) == [f"{LABEL}: lotstedt[gone] is not in the code"]
    assert "lotstedt[exact_qr]" in work_counts.SOLVERS
    del before[LABEL]["counts"]["glambda warm"], before[LABEL]["counts"]["glambda cold"]
    assert work_counts.remarks(before, today)[0] == f"{LABEL}: glambda is not in the baseline"


def test_an_update_of_a_part_keeps_the_rest(baseline: Baseline, tmp_path: Path) -> None:
    before = with_rise(baseline, "flops", 50.0)
    entry = copy.deepcopy(before[LABEL])
    for part in ("counts", "rounding"):
        before[LABEL][part]["lotstedt[exact_qr] warm"] = entry[part]["glambda warm"]
    before["another"] = entry
    path = tmp_path / "baseline.json"
    path.write_text(json.dumps(before))
    update = [*CHOICE, "--baseline", str(path), "--update"]
    assert work_counts.main(update) == 0
    after = json.loads(path.read_text())
    assert after["another"] == entry
    for part in ("counts", "rounding"):
        other = after[LABEL][part].pop("lotstedt[exact_qr] warm")
        assert other == before[LABEL][part]["lotstedt[exact_qr] warm"]
    assert after[LABEL] == baseline[LABEL]


def test_counts_of_other_qps_are_not_kept_beside_new_ones(
    baseline: Baseline, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = copy.deepcopy(baseline)
    before[LABEL]["digest"] = "0" * 16
    assert work_counts.updated(before, baseline) == baseline  # of the same solvers: all are new
    before[LABEL]["counts"]["lotstedt[exact_qr] warm"] = {}
    path = tmp_path / "baseline.json"
    path.write_text(json.dumps(before))
    assert work_counts.main([*CHOICE, "--baseline", str(path), "--update"]) == 2
    assert "leave --solvers out" in capsys.readouterr().err
    assert json.loads(path.read_text()) == before


def test_nothing_to_compare_with_is_bad_input(tmp_path: Path) -> None:
    assert work_counts.main([*CHOICE, "--baseline", str(tmp_path / "none.json")]) == 2
    assert exit_code({}, tmp_path) == 2


def test_the_committed_baseline_holds_every_sequence() -> None:
    kept = json.loads(work_counts.BASELINE.read_text())
    assert set(kept) == set(work_counts.SEQUENCES)
    for found in kept.values():
        assert found["counts"].keys() == found["rounding"].keys()
        assert {"glambda cold", "glambda warm"} <= found["counts"].keys()


def test_disturbing_moves_the_last_bits_only() -> None:
    plain, other = work_counts.sequence(LABEL), work_counts.sequence(LABEL, seed=1)
    assert work_counts.digest(plain) == work_counts.digest(work_counts.sequence(LABEL))
    assert work_counts.digest(plain) != work_counts.digest(other)
    for one, two in zip(plain, other, strict=True):
        assert two.dense_A == pytest.approx(one.dense_A, rel=1e-9, abs=1e-12)


def test_ratios_of_times_are_printed_and_no_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    names = ["glambda", f"{times.ROOT}:scipy_bvls"]
    assert times.main([*names, "--sequences", LABEL, "--rounds", "2"]) == 0
    told = capsys.readouterr().out
    assert "over that of glambda" in told
    assert "×" in told
    assert " to " in told
    assert "µs" not in told


def test_a_folder_without_the_code_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert times.main(["glambda", f"{tmp_path}:glambda", "--sequences", LABEL]) == 2
    assert "no checkout" in capsys.readouterr().err
    assert times.main(["glambda"]) == 2
