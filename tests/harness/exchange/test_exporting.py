"""What is written for others is what they read: loaded, solved there, and judged here."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.exchange.exporting import WRITERS, export
from harness.exchange.fclib import ASSOCIATED
from harness.exchange.importing import import_files
from harness.judging.judge import judge
from harness.recordings.recording import Recording, write_recording
from harness.study.record import record
from problems import scene
from tests.fakes.fake_recordings import fake_recording


@pytest.fixture(scope="module")
def fig4() -> Recording:
    return record(scene("fig4"), until=0.5)


def loaded(path: Path) -> ModuleType:
    """A module of that file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_npz_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    before = fake_recording()
    (path,) = export(before, "npz", tmp_path)
    after = import_files([path])
    for one, other in zip(before.qps, after.qps, strict=True):
        for name in ("dense_A", "d", "lower", "upper", "row_id"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_a_test_set_is_solved_there_and_judged_here(fig4: Recording, tmp_path: Path) -> None:
    qpbenchmark = pytest.importorskip("qpbenchmark")
    import qpsolvers

    _, source = export(fig4, "qpbenchmark", tmp_path)
    problems = list(loaded(source).Fig4())
    assert isinstance(problems[0], qpbenchmark.Problem)
    assert len(problems) == len(fig4.qps)
    judged = 0
    for problem, qp, known in zip(problems, fig4.qps, fig4.references, strict=True):
        if qp.k == 0:
            continue
        x = qpsolvers.solve_problem(problem, solver="daqp").x
        assert judge(qp, x, asked=1e-6, reference=known).verdict == "verified"
        judged += 1
    assert judged > 50


def test_a_test_set_comes_back(fig4: Recording, tmp_path: Path) -> None:
    data, source = export(fig4, "qpbenchmark", tmp_path)
    assert "class Fig4(qpbenchmark.ParquetTestSet)" in source.read_text()
    after = import_files([data])
    for one, other in zip(fig4.qps, after.qps, strict=True):
        assert np.allclose(one.dense_A.T @ one.dense_A, other.dense_A.T @ other.dense_A)
        assert np.array_equal(one.lower, other.lower) and np.array_equal(one.upper, other.upper)
    i = next(i for i, qp in enumerate(fig4.qps) if qp.k > 2)
    known = after.references[i]
    assert known is not None
    assert (
        judge(fig4.qps[i], known.x, asked=1e-9, reference=fig4.references[i]).verdict == "verified"
    )


def test_fclib_without_friction_is_the_qp(tmp_path: Path) -> None:
    before = record(scene("fig2"), until=0.3)
    written = export(before, "fclib", tmp_path)
    assert len(written) > 10
    number = int(written[-1].stem.rpartition("_")[2])
    qp = before.qps[number]
    with h5py.File(written[-1]) as file:
        assert file["fclib_local/info/math_info"][()] == b""
        assert not file["fclib_local/vectors/mu"][:].any()
        assert file["fclib_local/spacedim"][0] == 2
    (again,) = import_files([written[-1]]).qps
    known = import_files([written[-1]]).references[0]
    assert known is not None and again.k == qp.k
    assert judge(qp, known.x, asked=1e-9, reference=before.references[number]).verdict == "verified"


def test_fclib_with_friction_says_so(fig4: Recording, tmp_path: Path) -> None:
    written = export(fig4, "fclib", tmp_path)
    marks = []
    for path in written:
        with h5py.File(path) as file:
            mu = file["fclib_local/vectors/mu"][:]
            marks.append(file["fclib_local/info/math_info"][()].decode())
            assert (marks[-1] == ASSOCIATED) == bool(mu.any())
            assert set(mu.tolist()) <= {0.0, 0.5}
    assert ASSOCIATED in marks and len(written) < len(fig4.qps)


def test_what_is_in_no_plane_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="export it as npz"):
        export(fake_recording(), "fclib", tmp_path)
    with pytest.raises(ValueError, match="form 'xls' is unknown"):
        export(fake_recording(), "xls", tmp_path)


def test_a_benchopt_dataset(fig4: Recording, tmp_path: Path, monkeypatch: Any) -> None:
    """By benchopt's classes where it is installed, by stand-ins of them where not."""
    written = export(fig4, "benchopt", tmp_path)
    if importlib.util.find_spec("benchopt") is None:
        fake = ModuleType("benchopt")
        for name in ("BaseDataset", "BaseObjective", "BaseSolver"):
            setattr(fake, name, type(name, (), {}))
        monkeypatch.setitem(sys.modules, "benchopt", fake)
    objective, dataset, solver = (loaded(path) for path in written[:3])
    numbers = dataset.Dataset.parameters["number"]
    assert numbers == sorted(numbers) and len(numbers) == 5
    for number in numbers:
        made = object.__new__(dataset.Dataset)
        made.number = number
        data = made.get_data()
        aim, solved = object.__new__(objective.Objective), object.__new__(solver.Solver)
        aim.set_data(**data)
        solved.set_objective(**aim.get_objective())
        solved.run(None)
        x = solved.get_result()["x"]
        qp, known = fig4.qps[number], fig4.references[number]
        assert known is not None
        told = aim.evaluate_result(x)
        assert told["value"] == pytest.approx(qp.objective(known.x), rel=1e-9)
        assert told["violation"] == 0
        assert aim.evaluate_result(qp.lower - 1)["violation"] > 0.9


def test_the_command(fig4: Recording, tmp_path: Path) -> None:
    write_recording(tmp_path / "fig4.h5", fig4)
    for form in WRITERS:
        out = tmp_path / form
        words = ["export", str(tmp_path / "fig4.h5"), "--as", form, "-o", str(out)]
        told = CliRunner().invoke(app, words)
        assert told.exit_code == 0 and str(out) in told.output, told.output
    bad = CliRunner().invoke(app, ["export", str(tmp_path / "fig4.h5"), "--as", "xls"])
    assert bad.exit_code == 2 and "choose from" in bad.output
