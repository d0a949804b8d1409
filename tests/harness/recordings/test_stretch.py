"""Stretched recordings: the condition that was asked for, the answer that was there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.judging.facts import facts_of
from harness.recordings.recording import read_recording, write_recording
from harness.study.stretch import stretched, stretched_qp
from tests.fakes.fake_recordings import fake_in_space
from tests.fakes.runs import scene_recording, short_recording


def condition_of(A: np.ndarray) -> float:
    lengths = np.linalg.norm(A, axis=0)
    sigma = np.linalg.svd(A / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    sigma = sigma[sigma > 1e-12 * sigma[0]]
    return float(sigma[0] / sigma[-1])


@pytest.mark.parametrize("condition", [1e2, 1e5])
def test_condition_rank_answer_and_signs(condition: float) -> None:
    recording = scene_recording("fig5")
    for qp, known in list(zip(recording.qps, recording.references, strict=True))[::5]:
        if known is None or qp.k < 2:
            continue
        made = stretched_qp(qp, known, condition)
        rank = np.linalg.matrix_rank(qp.dense_A, tol=1e-10 * np.linalg.norm(qp.dense_A, 2))
        lengths = np.linalg.norm(qp.dense_A, axis=0)
        sigma = np.linalg.svd(made.dense_A / lengths, compute_uv=False)[:rank]
        if rank > 1:
            assert sigma[0] / sigma[-1] == pytest.approx(condition, rel=1e-6)
        old, new = qp.gradient(known.x), made.gradient(known.x)
        rounding = 1e-12 * lengths.max() * np.linalg.norm(made.d)
        at_bound = (known.x <= qp.lower) | (known.x >= qp.upper)
        np.testing.assert_allclose(new[~at_bound], 0.0, atol=rounding)
        clear = at_bound & (np.abs(old) > 1e-9 * lengths * np.linalg.norm(qp.d))
        assert (np.sign(new[clear]) == np.sign(old[clear])).all()
        assert (made.row_id == qp.row_id).all() and (made.lower == qp.lower).all()


def test_proportions_are_kept() -> None:
    """The part of d that no contact can change, and ε₀, in units of the scale."""
    recording = scene_recording("fig5")
    for qp, known in list(zip(recording.qps, recording.references, strict=True))[::20]:
        if known is None or qp.k < 2:
            continue
        made = stretched_qp(qp, known, 1e3)
        old, new = facts_of(qp).scale, facts_of(made).scale
        assert made.eps0 / new == pytest.approx(qp.eps0 / old, rel=1e-6)
        assert np.linalg.norm(made.d) / new == pytest.approx(np.linalg.norm(qp.d) / old, rel=1e-6)


def test_a_stretched_recording_is_one(tmp_path: Path) -> None:
    made = stretched(scene_recording("fig5"), 1e4)
    assert made.scene == "fig5,condition=10000" and len(made.qps) > 100
    assert all(reference is not None for reference in made.references)
    write_recording(tmp_path / "it.h5", made)
    assert read_recording(tmp_path / "it.h5").digest == made.digest
    worst = max(condition_of(qp.dense_A) for qp in made.qps)
    assert 1e3 < worst < 1e5


def test_what_moved_in_space_is_stretched_and_stored_too(tmp_path: Path) -> None:
    made = stretched(fake_in_space(), 1e2)
    write_recording(tmp_path / "it.h5", made)
    assert read_recording(tmp_path / "it.h5").digest == made.digest


def test_the_command_writes_one_file_for_each_condition(tmp_path: Path) -> None:
    write_recording(tmp_path / "fig5.h5", short_recording("fig5", 30))
    source, out = str(tmp_path / "fig5.h5"), tmp_path / "out"
    told = CliRunner().invoke(app, ["stretch", source, "--condition", "1,1e3", "-o", str(out)])
    assert told.exit_code == 0, told.output
    assert {path.name for path in out.iterdir()} == {
        "fig5,condition=1.h5",
        "fig5,condition=1000.h5",
    }
    for text in ("0.5", "nan", "much"):
        told = CliRunner().invoke(app, ["stretch", source, "--condition", text, "-o", str(out)])
        assert told.exit_code == 2, text
