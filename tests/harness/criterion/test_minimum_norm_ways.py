"""The least multipliers by an old decomposition and conjugate gradients, and what it costs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest

from harness.criterion import minimum_norm_ways as ways_module
from harness.criterion.least_norm import decompose, least_norm, project
from harness.criterion.minimum_norm_ways import (
    MinimumNormWays,
    case_rows,
    keep_old,
    redundant,
    way_rows,
)
from harness.recordings.recording import Recording
from problems.least_norm.minimum_norm import minimum_norm
from problems.qp import ContactQP
from problems.sequence import QPSequence
from reports.criterion.minimum_norm import minimum_norm_table
from solvers import make_solver
from tests.fakes.fake_recordings import fake_recording, solution_of
from tests.fakes.runs import scene_recording

SEEDS = range(12)


def low_rank(seed: int, m: int = 9, k: int = 12, rank: int = 6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((m, rank)) @ rng.standard_normal((rank, k))


def unbounded(k: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(k, -inf), np.full(k, inf)


def recording_of(matrices: list[np.ndarray]) -> Recording:
    """QPs with these A, x ≥ 0 and λ* = 1, without a restart."""
    qps = [
        ContactQP(A, np.ones(len(A)), np.zeros(A.shape[1]), np.full(A.shape[1], inf), t=0.01 * i)
        for i, A in enumerate(matrices)
    ]
    return replace(
        fake_recording(),
        qps=tuple(qps),
        solutions=tuple(solution_of(qp, np.ones(qp.k)) for qp in qps),
        references=(None,) * len(qps),
    )


def ways_of(recording: Recording) -> MinimumNormWays:
    """What the rows say, without a folder between."""
    calls, examined, cases = redundant(recording)
    return MinimumNormWays(recording.scene, calls, examined, case_rows(cases), way_rows(cases))


@cache
def fig5() -> MinimumNormWays:
    return ways_of(scene_recording("fig5"))


@pytest.mark.parametrize("seed", SEEDS)
def test_todays_decomposition_needs_one_iteration(seed: int) -> None:
    A = low_rank(seed)
    b = A @ np.random.default_rng(seed).standard_normal(12)
    found = least_norm(A, b, *unbounded(12), decompose(A))
    assert (found.refused, found.iterations, found.rounds) == ("", 1, 1)
    np.testing.assert_allclose(found.lam, np.linalg.pinv(A) @ b, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_an_old_decomposition_gives_the_pseudo_inverse_s_answer(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    left, right = rng.standard_normal((9, 6)), rng.standard_normal((6, 12))
    old = decompose(left @ right)
    A = (left + 0.01 * rng.standard_normal((9, 6))) @ (right + 0.01 * rng.standard_normal((6, 12)))
    b = A @ rng.standard_normal(12)
    found = least_norm(A, b, *unbounded(12), old)
    assert found.refused == "" and 1 < found.iterations <= 6 + 10
    truth = np.linalg.pinv(A, rcond=1e-10) @ b
    np.testing.assert_allclose(found.lam, truth, atol=1e-7 * np.abs(truth).max())


def test_bounds_are_kept_as_the_paper_s_way_keeps_them() -> None:
    accepted, bounded = 0, 0
    for seed in SEEDS:
        rng = np.random.default_rng(200 + seed)
        A = rng.standard_normal((4, 12))
        x = np.where(rng.uniform(size=12) < 0.5, 0.0, rng.uniform(0, 3, 12))
        qp = ContactQP(A, np.ones(4), np.zeros(12), np.full(12, inf))
        kept = minimum_norm(QPSequence(make_solver("glambda")), qp, x, None)
        found = least_norm(A, A @ x, qp.lower, qp.upper, decompose(A))
        if not found.refused:
            accepted, bounded = accepted + 1, bounded + (found.members != 0).any()
            np.testing.assert_allclose(found.lam, kept, atol=1e-7)
    assert accepted >= 10 and bounded >= 10


def test_a_set_at_bounds_is_found_and_carried() -> None:
    A = np.array([[1.0, 1.0, -1.0, 0.0], [0.0, 1.0, 1.0, 1.0]])
    x, lower, upper = np.array([4.0, 0.0, 0.0, 0.2]), np.zeros(4), np.full(4, inf)
    found = least_norm(A, A @ x, lower, upper, decompose(A))
    assert found.refused == "" and found.rounds > 1 and (found.members != 0).any()
    again = least_norm(A, A @ x, lower, upper, decompose(A), guess=found.members)
    assert again.rounds == 1
    np.testing.assert_allclose(again.lam, found.lam, atol=1e-12)
    np.testing.assert_allclose(A @ found.lam, A @ x, atol=1e-9)


def test_a_contact_that_comes_or_goes_costs_an_iteration_each() -> None:
    """R belongs to the rows of A: columns may come and go while the rank stays."""
    A = low_rank(3, m=6, k=14, rank=6)
    old = decompose(A)
    rng = np.random.default_rng(3)
    less, more = A[:, 2:], np.hstack([A, rng.standard_normal((6, 1))])
    for B, changed in ((less, 2), (more, 1)):
        b = B @ rng.standard_normal(B.shape[1])
        lam, _, made = project(B[old.rows], old.R, b[old.rows])
        assert 1 <= made <= changed + 2
        np.testing.assert_allclose(lam, np.linalg.pinv(B) @ b, atol=1e-8)


def test_a_risen_rank_is_refused_and_a_fallen_one_does_no_harm() -> None:
    rng = np.random.default_rng(5)
    low, high = low_rank(5, rank=5), low_rank(5, rank=5)
    high[:, 4] += rng.standard_normal(9)
    x = rng.standard_normal(12)
    assert least_norm(high, high @ x, *unbounded(12), decompose(low)).refused == "rank"
    fallen = np.zeros((9, 12))
    fallen[:3, :] = rng.standard_normal((3, 12))
    whole = fallen.copy()
    whole[3, 0] = 1.0
    found = least_norm(fallen, fallen @ x, *unbounded(12), decompose(whole))
    assert decompose(whole).rows.size == 4 and found.refused == ""
    np.testing.assert_allclose(found.lam, np.linalg.pinv(fallen) @ (fallen @ x), atol=1e-8)


def test_a_projection_that_cannot_converge_says_so() -> None:
    assert project(np.zeros((2, 3)), np.eye(2), np.ones(2))[2] < 0
    contradiction = np.ones((2, 3)), np.eye(2), np.array([1.0, -1.0])
    assert project(*contradiction)[2] < 0


def test_a_risen_rank_makes_a_new_decomposition_in_a_sequence() -> None:
    first = low_rank(11, rank=4)
    second = first.copy()
    second[:, 5] += np.random.default_rng(11).standard_normal(9)
    recording = recording_of([first, first, second, second])
    _, examined, cases = redundant(recording)
    assert examined == 4 and [case.rank for case in cases] == [4, 4, 5, 5]
    rows = keep_old(cases, inf)
    assert rows["decompositions"].tolist() == [1, 0, 1, 0]
    assert rows["refused"].tolist() == ["", "", "rank", ""]
    assert rows["age"].tolist() == [0, 1, 0, 1] and rows["order"].tolist() == [4, 4, 5, 5]
    assert rows["error"].max() < 1e-8
    table = case_rows(cases)
    assert table["same_A"].tolist() == [False, True, False, True]
    assert (table["per_step"] < table["per_pass"]).tolist() == [False, True, False, True]


def test_full_column_rank_needs_neither_way() -> None:
    tall = np.random.default_rng(1).standard_normal((9, 4))
    assert redundant(recording_of([tall, tall]))[2] == []


def test_every_way_agrees_with_the_svd_on_fig5() -> None:
    found = fig5()
    assert found.calls == found.examined and len(found.cases) > 40
    assert (found.cases["rank"] < found.cases["k"]).all()
    assert found.cases["error"].max() < 1e-10
    for run in (*found.kept.values(), found.paper):
        assert run["error"].max() < 1e-9 and not run["printed"].any()
    fresh = found.kept[1]
    assert (fresh["age"] == 0).all() and (fresh["decompositions"] == 1).all()
    single = fresh[(fresh["rounds"] == 1) & (fresh["bounded"] == 0)]
    assert len(single) > 30 and (single["iterations"] == 1).all()
    assert found.kept[inf]["iterations"].mean() > fresh["iterations"].mean()
    assert found.loose["iterations"].sum() <= found.kept[inf]["iterations"].sum()


def test_a_long_recording_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recording_of([low_rank(2)] * 6)
    monkeypatch.setattr(ways_module, "BUDGET", 20.0 * 9 * 12 * 9 * 3)
    calls, examined, cases = redundant(recording)
    assert (calls, examined, len(cases)) == (6, 3, 3)


def test_the_table_says_who_wins_and_what_is_missing() -> None:
    empty = ways_of(recording_of([np.eye(3)] * 2))
    table = minimum_norm_table([fig5(), replace(empty, scene="empty")])
    row = table.data.iloc[0]
    assert row["QR per pass"] == fig5().cases["per_pass"].mean()
    assert row["R kept"] == min(run["flops"].mean() for run in fig5().kept.values())
    assert row["error CG"] < 1e-9 and table.data.iloc[1]["QPs"] == 0
    text = table.to_markdown()
    assert "nan" not in text and "empty: no QP with redundant columns" in text
    wins = row["QR per step"] > row["paper"]
    said = "An old R by the paper's threshold is cheaper" if wins else "A QR per step is cheaper"
    assert any(note.startswith(said) and "fig5" in note for note in table.notes)


def test_a_wrong_answer_of_the_paper_s_way_is_told() -> None:
    cases = fig5().cases.copy()
    cases.loc[3, "error"] = 0.1
    wrong = replace(fig5(), cases=cases)
    table = minimum_norm_table([wrong])
    place = cases.loc[3, "place"]
    assert any("is not solved at QP" in note and str(place) in note for note in table.notes)
