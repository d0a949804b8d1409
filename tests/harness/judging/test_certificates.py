"""The error bound against answers in exact arithmetic: never below the error, and how sharp."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import harness.judging.oracle as oracle
from harness import judge
from harness.judging.certificates import (
    ANSWERS,
    PREVIOUS,
    certificates,
    summary,
)
from harness.judging.error_bound import error_bound
from harness.judging.facts import facts_of
from harness.judging.oracle import reference
from harness.judging.proof import prove
from harness.recordings.recording import Recording
from problems.qp import ContactQP
from reports.rows.results import Results, empty_rows
from reports.sections.certificates import (
    certificates_answer,
    certificates_of,
    certificates_tables,
    plot_certificates,
    references_table,
)
from tests.fakes.random_qps import KINDS, random_qp
from tests.fakes.runs import scene_recording

INF = np.inf
SCENES = ("fig2", "fig3", "fig4", "fig5")


@pytest.fixture(scope="module")
def found() -> pd.DataFrame:
    return pd.concat([certificates(scene_recording(name), at_most=60) for name in SCENES])


def test_no_bound_on_recorded_qps_is_below_the_error(found: pd.DataFrame) -> None:
    assert len(found) > 3000
    assert set(found["answer"]) == {*ANSWERS, PREVIOUS}
    assert (found["error"] > 0.5).sum() > 500  # answers that are plainly wrong
    assert (~found["independent"]).sum() > 200  # and QPs that lack rank
    assert not found["below"].any()


def test_bounds_on_recorded_qps_are_sharp(found: pd.DataFrame) -> None:
    sharp = found["sharp"].dropna()
    assert sharp.median() < 1.01
    assert sharp.quantile(0.99) < 3
    right = found.loc[found["sharp"].isna() & found["feasible"], "bound"]
    assert right.quantile(0.99) < 1e-12 and right.max() < 1e-6


def test_the_summary_counts_what_was_found(found: pd.DataFrame) -> None:
    table = summary(found, by=("scene", "answer"))
    assert len(table) == len(SCENES) * (len(ANSWERS) + 1)
    assert len(summary(found)) == len(ANSWERS) + 1
    assert table["qps"].sum() == len(found) and table["below"].sum() == 0
    assert (table["median"] <= table["worst"]).sum() > 40


def test_a_reference_that_is_wrong_is_found_out() -> None:
    """If A x* were off by 1e-6, bounds would be seen below the error."""
    recording = scene_recording("fig5")
    off = [replace(r, Ax=r.Ax + 1e-6) for r in recording.references]
    assert certificates(replace(recording, references=off), at_most=20)["below"].any()


def false_references(recording: Recording) -> list[int]:
    """QPs whose reference is said to be exact and cannot be proved again, as a forged one cannot.

    A x* is unique, and so is the float64 nearest to each entry: the proof gives the same bits from
    any x.
    """
    found = []
    for step, (qp, known) in enumerate(zip(recording.qps, recording.references, strict=True)):
        if known is None or known.proof != "exact":
            continue
        proof = prove(qp, known.x)
        proved = proof is not None and np.array_equal(proof.Ax, known.Ax)
        if proof is None or not proved or known.error_bound < proof.error_bound:
            found.append(step)
    return found


def test_forged_references_are_found() -> None:
    recording = scene_recording("fig5")
    assert false_references(recording) == []
    forged = list(recording.references)
    k = next(i for i, r in enumerate(forged) if r.error_bound > 0)
    forged[k] = replace(forged[k], error_bound=0.0)
    forged[30] = replace(forged[30], Ax=np.nextafter(forged[30].Ax, np.inf))
    forged[40] = replace(forged[40], proof="bound", Ax=forged[40].Ax + 1.0)  # does not say so
    assert false_references(replace(recording, references=forged)) == sorted({k, 30})


def test_without_proofs_nothing_is_said() -> None:
    recording = scene_recording("fig5")
    bounded = [replace(r, proof="bound") for r in recording.references]
    none = certificates(replace(recording, references=bounded), at_most=5)
    assert none.empty and summary(none).empty


def answers(qp: ContactQP, x: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    off = 10.0 ** rng.uniform(-13, 1) * np.abs(x).max(initial=1e-3) * rng.standard_normal(qp.k)
    return [x, x + off, np.clip(x + off, qp.lower, qp.upper), -x, np.zeros(qp.k)]


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_no_bound_on_random_qps_is_below_the_error(kind: str) -> None:
    rng, proved = np.random.default_rng(8), 0
    for seed in range(100, 112):
        qp, _ = random_qp(kind, seed)
        facts = facts_of(qp)
        known = reference(qp, facts)
        if known.proof != "exact":  # dependent but for rounding, and so ill-posed at times
            assert kind == "rank_deficient"
            continue
        proved += 1
        for x in answers(qp, known.x, rng):
            error = float(np.linalg.norm(facts.A @ x - known.Ax))
            assert error_bound(qp, x, facts) >= error - known.error_bound
    assert proved >= 6


def nearly_dependent(base: ContactQP, gap: float, rng: np.random.Generator) -> ContactQP:
    """With two more columns that are copies of others, but for a relative `gap`."""
    copied = base.dense_A[:, rng.integers(base.k, size=2)] * [1.0, -1.0]
    copied *= 1 + gap * rng.standard_normal(copied.shape)
    lower, upper = np.append(base.lower, [0.0, -1.0]), np.append(base.upper, [INF, 1.0])
    return ContactQP(np.hstack([base.dense_A, copied]), base.d, lower, upper)


@pytest.mark.parametrize("kind", ["two_sided", "badly_scaled", "contact_large", "degenerate"])
@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-13, 1e-11, 1e-8, 1e-4])
def test_nearly_dependent_columns(kind: str, gap: float) -> None:
    """The bound holds for the recorded data, and not for others that differ by rounding."""
    rng = np.random.default_rng([3, *kind.encode()])
    for seed in range(6):
        qp = nearly_dependent(random_qp(kind, seed)[0], gap, rng)
        facts = facts_of(qp)
        known = reference(qp, facts)
        if known is None or known.proof != "exact":
            assert not facts.independent
            continue
        for x in answers(qp, known.x, rng):
            error = float(np.linalg.norm(facts.A @ x - known.Ax))
            verdict = judge(qp, x, facts=facts, reference=known)
            assert verdict.error_bound >= error
            assert error_bound(qp, x, facts) >= error - known.error_bound


@pytest.mark.parametrize("gap", [1e-10, 1e-13, 1e-16])
def test_the_bound_alone_holds_whatever_the_condition(gap: float) -> None:
    """A column near the middle of two others counted as dependent on them at 1e-13."""
    proved = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        a, b, off, d = rng.standard_normal((4, 3))
        A = np.column_stack([a, b, 0.5 * (a + b) + gap * off])
        qp = ContactQP(A, d, np.zeros(3), np.full(3, INF))
        facts, known = facts_of(qp), prove(qp, np.zeros(3))
        for x in (oracle._active_set(facts).astype(float), known.x, np.ones(3)):
            error = float(np.linalg.norm(facts.A @ x - known.Ax))
            assert error_bound(qp, x, facts) >= error - known.error_bound
            proved += 1
    assert proved == 120


# --- how they are reported -----------------------------------------------------------------------


def test_tables_count_what_references_rest_on(found: pd.DataFrame) -> None:
    recording = scene_recording("fig5")
    proofs = ["exact", "bound", "nearby", "ill-posed"]
    mixed = [
        replace(r, proof=proofs[i % 4]) if i else None for i, r in enumerate(recording.references)
    ]
    results = Results(empty_rows(), {"fig5": replace(recording, references=mixed)})
    line = references_table(results).data.iloc[0]
    assert line["none"] == 1 and line[proofs].sum() + 1 == line["QPs"] == len(mixed)
    said = " ".join(certificates_answer(results, found).sentences)
    assert "are ill-posed" in said and "1 have no reference" in said
    assert "was below the error 0 times" in said


def test_tables_and_figure_of_certificates(found: pd.DataFrame, tmp_path: Path) -> None:
    (table,) = certificates_tables(found)
    assert "the bound is below the error 0 times" in table.to_markdown()
    lied = found.assign(below=found["error"] > 1.0)
    assert "below the error 0 times" not in certificates_tables(lied)[0].to_markdown()
    path = plot_certificates(found, tmp_path / "certificates.svg")
    assert path.stat().st_size > 1000


def test_nothing_is_reported_without_recordings(tmp_path: Path) -> None:
    results = Results(empty_rows())
    nothing = certificates_of(results)
    assert nothing.empty and certificates_tables(nothing) == []
    assert certificates_answer(results, nothing) is None
    assert references_table(results).data.empty
    with pytest.raises(ValueError, match="no recording with proved references"):
        plot_certificates(nothing, tmp_path / "none.svg")
