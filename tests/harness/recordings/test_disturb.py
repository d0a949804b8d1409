"""Disturbed recordings: the same problem in other numbers, or another one by so much."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.recordings.recording import Recording, read_recording, write_recording
from harness.study.disturb import KINDS, disturbance, disturbed
from solvers import make_solver
from tests.fakes.fake_recordings import fake_in_space, fake_recording
from tests.fakes.runs import short_recording


def part(name: str = "fig4", length: int = 60) -> Recording:
    return short_recording(name, length)


@pytest.mark.parametrize("kind", KINDS)
def test_the_force_is_the_same_in_another_order(kind: str) -> None:
    recording = part()
    made = disturbed(recording, kind)
    for qp, other, known, new in zip(
        recording.qps, made.qps, recording.references, made.references, strict=True
    ):
        if known is None or new is None:
            continue
        size = np.linalg.norm(known.Ax)
        np.testing.assert_allclose(np.sort(new.Ax), np.sort(known.Ax), atol=1e-9 * size)
        x = make_solver("glambda", accuracy=1e-9 * size if size else 1e-9).solve(other).x
        assert (other.lower <= x).all() and (x <= other.upper).all()
        assert np.linalg.norm(other.A @ x - new.Ax) <= 1e-8 * size + 1e-12
        assert other.eps0 == qp.eps0 and other.kind == qp.kind and other.restart == qp.restart


def test_an_order_belongs_to_rows_and_bodies_and_not_to_a_qp() -> None:
    recording = part("fig2")
    made = disturbed(recording, "permuted")
    places = [
        {int(i): n for n, i in enumerate(qp.row_id)} for qp in made.qps if qp.k == made.qps[5].k
    ]
    assert any(list(qp.row_id) != sorted(qp.row_id) for qp in made.qps)
    shared = [place for place in places if place.keys() == places[0].keys()]
    assert len(shared) > 10 and all(place == shared[0] for place in shared)
    recording = fake_recording()  # no two entries of d are alike
    same = [i for i, qp in enumerate(recording.qps) if qp.m == recording.qps[0].m]
    made = disturbed(recording, "permuted")
    orders = {
        tuple(np.argsort(made.qps[i].d)[np.argsort(np.argsort(recording.qps[i].d))].tolist())
        for i in same
    }
    assert len(same) > 3 and len(orders) == 1


def test_copies_share_the_bounds_and_have_names_of_their_own() -> None:
    recording = part()
    made = disturbed(recording, "duplicated")
    for qp, other, mu in zip(recording.qps, made.qps, made.mu, strict=True):
        copies = other.row_id[other.row_id < 0]
        assert set(-1 - copies) <= set(qp.row_id) and other.k == qp.k + copies.size == mu.size
        for j, name in enumerate(qp.row_id):
            twins = (other.row_id == name) | (other.row_id == -1 - name)
            assert other.upper[twins].sum() == pytest.approx(qp.upper[j])
            assert other.lower[twins].sum() == pytest.approx(qp.lower[j])
    assert any(other.k > qp.k for qp, other in zip(recording.qps, made.qps, strict=True))


def test_scales_turn_lower_bounds_into_upper_ones() -> None:
    recording = part()
    made = disturbed(recording, "scaled")
    assert any((np.isneginf(qp.lower) & np.isfinite(qp.upper)).any() for qp in made.qps)
    lengths = [np.linalg.norm(qp.dense_A, axis=0) for qp in made.qps if qp.k > 2]
    assert max(length.max() / length.min() for length in lengths) > 100


def test_noise_is_of_the_size_asked_and_seeded() -> None:
    recording = part()
    made, again, other = (disturbed(recording, "1e-6", seed) for seed in (1, 1, 2))
    assert made.digest == again.digest != other.digest
    for old, new in zip(recording.qps, made.qps, strict=True):
        if old.k:
            change = np.abs(new.dense_A - old.dense_A).max() / np.abs(old.dense_A).max()
            assert 1e-8 < change < 1e-5
            assert ((new.dense_A == 0) == (old.dense_A == 0)).all()


@pytest.mark.parametrize("kind", ["duplicated", "1e-9"])
def test_what_moved_in_space_is_disturbed_and_stored_too(tmp_path: Path, kind: str) -> None:
    made = disturbed(fake_in_space(), kind)
    write_recording(tmp_path / "it.h5", made)
    assert read_recording(tmp_path / "it.h5").digest == made.digest


@pytest.mark.parametrize("kind", ["shuffled", "0", "-1e-6", "0.1", "nan"])
def test_an_unknown_disturbance_is_refused(kind: str) -> None:
    with pytest.raises(ValueError, match="is unknown; choose from permuted"):
        disturbance(kind)


def test_the_command_writes_one_file_for_each_kind(tmp_path: Path) -> None:
    write_recording(tmp_path / "fig5.h5", part("fig5", 30))
    out = tmp_path / "out"
    asked = ["disturb", str(tmp_path / "fig5.h5"), "-o", str(out), "--kinds"]
    told = CliRunner().invoke(app, [*asked, "duplicated,1e-9"])
    assert told.exit_code == 0, told.output
    names = {path.name for path in out.iterdir()}
    assert names == {"fig5,disturbed=duplicated.h5", "fig5,disturbed=1e-9.h5"}
    made = read_recording(out / "fig5,disturbed=duplicated.h5")
    assert made.parameters["disturbed.seed"] == 1984 and len(made.qps) == 30
    assert CliRunner().invoke(app, [*asked, "shaken"]).exit_code == 2
