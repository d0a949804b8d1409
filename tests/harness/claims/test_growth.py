"""Growth of the time per QP: what is asked of whom, when a backend is given up, what is written.

No time is asserted; where times matter they are made up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

from harness.claims import growth
from harness.claims.growth import Plan, exponent, measure_growth, sequence, whole_bodies
from harness.judging.facts import facts_of
from harness.judging.judge import judge
from harness.passes.measure import run_pass
from harness.recordings.recording import Recording
from reports.claims.growth import (
    exponents_table,
    least_ahead,
    limits_table,
    ratios_table,
    times_table,
    write_growth,
)
from solvers import make_solver

SMALL = Plan(families=("tower",), bodies=(3, 30), solvers=("glambda", "quadprog"), repeats=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("growth")


@pytest.fixture(scope="module")
def points(folder: Path) -> pd.DataFrame:
    return measure_growth(SMALL, folder)


def test_each_size_and_solver_has_one_row(points: pd.DataFrame) -> None:
    assert list(points["k"]) == [6, 6, 60, 60]
    assert list(points["solver"]) == ["glambda", "quadprog"] * 2
    assert list(points["arm"]) == ["warm", "cold"] * 2  # quadprog keeps nothing
    assert points["tried"].all()
    assert (points["verified"] == 1).all()
    assert (points["qps"] == growth.STEPS).all()
    assert (points["runtime"] > 0).all()
    assert (points["call_time"] >= points["runtime"]).all()
    assert (points["runtime_from"] >= points["runtime"]).all()  # that of each QP's fastest pass
    assert (points["runtime_to"] >= points["runtime_from"]).all()
    assert points["factorizations"].isna().tolist() == [False, True] * 2


def test_a_folder_is_continued(points: pd.DataFrame, folder: Path) -> None:
    files = [path for path in folder.rglob("*.*") if path.name != ".lock"]
    before = {path: path.stat().st_mtime_ns for path in files}
    again = measure_growth(SMALL, folder)
    pd.testing.assert_frame_equal(points, again)
    assert {path: path.stat().st_mtime_ns for path in files} == before


def test_a_damaged_recording_is_made_anew(tmp_path: Path) -> None:
    first = sequence(tmp_path, "tower", 3)
    path = tmp_path / "recordings" / f"{first.scene}.h5"
    path.write_bytes(path.read_bytes()[:1000])
    assert sequence(tmp_path, "tower", 3).digest == first.digest


def test_no_more_than_the_first_qps_of_a_sequence_are_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(growth, "MOST", 12)
    recording = sequence(tmp_path, "wall,mu=0.5", 12)
    assert len(recording.qps) == len(recording.solutions) == 12
    assert recording.qps[0].restart


def test_of_large_qps_fewer_are_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "COLUMNS", 100)
    recording = sequence(tmp_path, "wall,mu=0.5", 12)
    assert len(recording.qps) == len(recording.solutions) == growth.LEAST


def test_large_matrices_are_stored_sparse_and_keep_their_pattern(folder: Path) -> None:
    small, large = sequence(folder, "tower", 3), sequence(folder, "tower", 30)
    assert not any(sp.issparse(qp.A) for qp in small.qps)
    patterns = {(qp.A.indices.tobytes(), qp.A.indptr.tobytes()) for qp in large.qps}
    assert len(patterns) == 1
    # boxes that stand straight have zeros, which are stored
    assert (large.qps[0].A.data == 0).any()


@pytest.mark.parametrize("m", [12, 13, 18])
@pytest.mark.parametrize("dense", [True, False])
def test_whole_bodies_keeps_the_matrix(dense: bool, m: int) -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((m, 5)) * (rng.random((m, 5)) < 0.3)
    A[:, 2] = 0.0
    stored = whole_bodies(A if dense else sp.csc_array(A), 12)
    assert (stored.toarray() == A).all()
    touched = (A[:12].reshape(4, 3, 5) != 0).any(axis=1)
    assert stored.nnz == 3 * touched.sum() + np.count_nonzero(A[12:])


def made_up(times: dict[str, list[float]], verified: float = 1.0) -> pd.DataFrame:
    """Points of the family tower at k = 100, 1000, …, with the given runtimes."""
    rows = [
        {
            "family": "tower", "bodies": 50 * 10**i, "m": 150 * 10**i, "k": 100 * 10**i,
            "solver": solver, "arm": "warm", "tried": True, "runtime": time, "slowest": time,
            "runtime_from": 1.1 * time, "runtime_to": 1.5 * time,
            "call_time": 2 * time, "verified": verified if solver == "osqp" else 1.0, "qps": 8,
            "undecided": 0, "iterations": 1.0, "factorizations": np.nan, "reason": "",
        }
        for solver, own in times.items()
        for i, time in enumerate(own)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def replayed_as(frame: pd.DataFrame) -> object:
    """A replay whose answers are known beforehand: call time and share verified by solver."""

    def replay(recording: Recording, solvers: list[str], *_: object, **__: object) -> pd.DataFrame:
        rows = []
        for solver in solvers:
            known = frame[(frame["solver"] == solver) & (frame["k"] == recording.qps[0].k)].iloc[0]
            for i in range(8):
                rows.append(
                    {
                        "problem": f"{recording.scene}/{i:06}", "scene": recording.scene,
                        "solver": solver, "arm": "warm",
                        "verdict": "verified" if i < 8 * known["verified"] else "inaccurate",
                        "runtime": known["time"], "call_time": known["time"],
                        "iterations": 1, "qr_factorizations": None,
                    }
                )  # fmt: skip
        return pd.DataFrame(rows)

    return replay


def test_who_exceeds_the_limit_or_is_wrong_is_not_tried_again(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    known = [
        *(("glambda", k, 0.1, 1.0) for k in (4, 6, 8)),
        *(("osqp", k, 0.1, share) for k, share in ((4, 1.0), (6, 0.25))),
        *(("daqp", k, time, 1.0) for k, time in ((4, 0.5), (6, 2.5))),
        *(("scs", k, 0.1, 0.75) for k in (4, 6, 8)),
    ]
    frame = pd.DataFrame(known, columns=["solver", "k", "time", "verified"])
    monkeypatch.setattr(growth, "replay", replayed_as(frame))
    plan = Plan(
        families=("tower",), bodies=(2, 3, 4), solvers=("glambda", "osqp", "daqp", "scs"), limit=2
    )
    points = measure_growth(plan, folder)
    tried = {s: part["tried"].tolist() for s, part in points.groupby("solver", sort=False)}
    assert tried == {
        "glambda": [True, True, True],
        "osqp": [True, True, False],
        "daqp": [True, True, False],
        "scs": [True, True, True],
    }
    why = points[points["k"] == 8].set_index("solver")["reason"]
    assert why["osqp"] == "6 of 8 not verified (inaccurate) at k = 6"
    assert why["daqp"] == "2.5 s per call at k = 6"
    stops = limits_table(points).display().set_index("solver")
    assert stops.loc["daqp", "last k"] == "6"
    assert stops.loc["daqp", "why no further"] == "2.5 s per call"
    assert stops.loc["glambda", "why no further"] == "all sizes were tried"


def test_the_last_size_of_all_needs_no_reason() -> None:
    points = made_up({"glambda": [1e-5, 1e-4], "osqp": [1e-5, 5.0], "daqp": [5.0, 5.0]})
    points.loc[points["runtime"] > 1, "reason"] = "10.0 s per call"
    points.loc[points["solver"].eq("daqp") & (points["k"] == 1000), "tried"] = False
    stops = limits_table(points).data.set_index("solver")
    assert stops.loc["osqp", "why no further"] == "all sizes were tried"
    assert stops.loc["daqp", "why no further"] == "10.0 s per call"


def test_the_exponent_of_a_power_is_found() -> None:
    found = exponent([10, 100, 1000, 10_000], [9.0, 1e-4, 1e-4 * 10**1.5, 1e-1])
    assert found is not None
    assert found.p == pytest.approx(1.5)
    assert found.low == pytest.approx(1.5)
    assert found.high == pytest.approx(1.5)
    assert (found.k_from, found.k_to) == (100, 10_000)  # what is below 100 does not count
    uneven = exponent([100, 1000, 10_000], [1e-4, 1e-3, 1e-1])
    assert uneven is not None
    assert (uneven.low, uneven.high) == (pytest.approx(1.0), pytest.approx(2.0))
    assert exponent([10, 100, 1000], [1.0, 1.0, 1.0]) is None


def test_ratios_are_to_the_fastest_that_is_right() -> None:
    points = made_up(
        {"glambda": [1e-5, 1e-4], "lotstedt": [1e-6, 1e-6], "osqp": [2e-5, 2e-4],
         "piqp": [5e-6, 2e-3]},
        verified=0.75,
    )  # fmt: skip
    table = ratios_table(points)
    assert list(table.data["best other"]) == ["piqp", "piqp"]  # osqp is not right everywhere
    assert list(table.data["ratio"]) == pytest.approx([0.5, 20.0])
    assert list(table.data["ratio from"]) == pytest.approx([0.5 * 1.1 / 1.5, 20.0 * 1.1 / 1.5])
    assert list(table.data["ratio to"]) == pytest.approx([0.5 * 1.5 / 1.1, 20.0 * 1.5 / 1.1])
    assert least_ahead(table.data, 1).startswith(
        "Our method is least ahead of the fastest other backend, by set-up and solve tower of "
    )
    assert "bodies (0.500×); by the whole call" in least_ahead(table.data, 1)
    assert least_ahead(table.data.head(0)) == ""
    assert table.notes == [
        "tower: another backend is faster at k = 100 (piqp).",
        "tower: from k = 100 on the ratio is 0.500× to 20.0×.",
    ]


def test_where_everybody_has_been_given_up_the_sizes_are_told_all_the_same(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    slow = pd.DataFrame([("osqp", 4, 5.0, 1.0)], columns=["solver", "k", "time", "verified"])
    monkeypatch.setattr(growth, "replay", replayed_as(slow))
    plan = Plan(families=("tower",), bodies=(2, 3), solvers=("osqp",), limit=2)
    points = measure_growth(plan, folder)
    assert points["tried"].tolist() == [True, False] and points["k"].tolist() == [4, 6]


def test_of_a_qp_nobody_can_judge_only_the_time_counts(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    """Two of osqp's answers are undecided: to one of these QPs glambda's is verified."""

    def replay(recording: Recording, solvers: list[str], *_: object, **__: object) -> pd.DataFrame:
        verdicts = {
            "glambda": ["verified"] * 3 + ["undecided"],
            "osqp": ["verified"] * 2 + ["undecided"] * 2,
        }
        rows = [
            {
                "problem": f"tower/{i}", "scene": recording.scene, "solver": solver, "arm": "warm",
                "verdict": verdict, "runtime": 1.0 + i, "call_time": 1.0, "iterations": 1,
                "qr_factorizations": None,
            }
            for solver in solvers
            for i, verdict in enumerate(verdicts[solver])
        ]  # fmt: skip
        return pd.DataFrame(rows)

    monkeypatch.setattr(growth, "replay", replay)
    plan = Plan(families=("tower",), bodies=(2,), solvers=("glambda", "osqp"))
    points = measure_growth(plan, folder).set_index("solver")
    assert points["verified"].to_dict() == {"glambda": 1.0, "osqp": pytest.approx(2 / 3)}
    assert points["undecided"].tolist() == [1, 1] and points["qps"].tolist() == [4, 4]
    assert points["slowest"].tolist() == [4.0, 4.0]
    told = times_table(points.reset_index(), "tower").notes
    assert any("of 1 of 4 QPs nobody's answer is proved right or wrong" in note for note in told)


def test_unverified_times_are_told_and_not_fitted() -> None:
    points = made_up({"glambda": [1e-5, 1e-4, 1e-3], "osqp": [1e-5, 1e-4, 1e-3]}, verified=0.875)
    assert list(exponents_table(points).data["solver"]) == ["glambda"]
    assert times_table(points, "tower").notes[0] == (
        "osqp at k = 100: 87.5 % of the answers are verified."
    )


def test_the_page_and_its_tables_are_written(points: pd.DataFrame, tmp_path: Path) -> None:
    page = write_growth(points, tmp_path)
    text = page.read_text(encoding="utf-8")
    for title in ("Time per QP, tower", "Where they stop", "Exponents", "growth.png"):
        assert title in text
    assert (tmp_path / "growth.png").stat().st_size > 10_000
    assert (tmp_path / "growth.svg").exists()
    kept = pd.read_csv(tmp_path / "growth.csv")
    assert list(kept["k"]) == list(points["k"])
    assert kept["runtime"].to_numpy() == pytest.approx(points["runtime"].to_numpy())
    write_growth(points, tmp_path / "again")
    for name in ("growth.md", "growth.csv", "growth.svg", "growth.png"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"families": ("nowhere",)}, "nowhere"),
        ({"families": ("tower,bodies=5",)}, "names its bodies"),
        ({"families": ("fig2",)}, "bodies"),
        ({"bodies": (0,)}, "at least one"),
        ({"limit": 0.0}, "positive"),
        ({"solvers": ("nobody",)}, "nobody"),
    ],
)
def test_a_bad_plan_is_refused(fields: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Plan(**fields)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def large(folder: Path) -> list[Recording]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(growth, "STEPS", 2)
        return [sequence(folder, "tower", 110), sequence(folder, "wall", 50)]


@pytest.mark.parametrize("solver", ["osqp", "piqp", "proxqp", "clarabel", "daqp"])
def test_large_qps_do_not_ask_a_package_for_less_than_rounding(
    large: list[Recording], solver: str
) -> None:
    """With tolerances that serve small QPs they went on to their caps, to the same answer."""
    for recording in large:
        facts = [facts_of(qp) for qp in recording.qps]
        posed = [f.qp.with_accuracy(f.asked("high")) for f in facts]
        outcomes, _ = run_pass(make_solver(solver), posed, arm="warm")
        for i, (qp, outcome, f) in enumerate(zip(posed, outcomes, facts, strict=True)):
            assert outcome.status == "SOLVED"  # and not at its cap
            known = recording.references[i]
            assert known is not None
            assert (
                judge(qp, outcome.x, asked=qp.eps0, facts=f, reference=known).verdict == "verified"
            )


def test_no_large_tower_is_called_unbounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OSQP and ProxQP took a tower of 500 boxes for an unbounded problem."""
    monkeypatch.setattr(growth, "STEPS", 2)
    qps = sequence(folder, "tower", 500).qps
    for solver in ("osqp", "proxqp"):
        outcomes, _ = run_pass(make_solver(solver), qps, arm="warm")
        assert [outcome.status for outcome in outcomes] == ["SOLVED", "SOLVED"]
