"""Certificates hold, whoever checks them needs nothing of ours, and tampered ones are refused."""

from __future__ import annotations

import ast
import copy
import json
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.exchange.certificates import CHECKER, certify
from harness.exchange.check_certificate import check_file
from harness.recordings.of_qps import recording_from
from harness.recordings.recording import Recording, write_recording
from tests.fakes.random_qps import KINDS, contact_sequence, random_qp


@pytest.fixture(scope="module")
def recording() -> Recording:
    """QPs of every kind, from a zero column to rank deficiency."""
    qps = [random_qp(kind, seed)[0] for kind in KINDS for seed in range(2)]
    return recording_from([*qps, *(qp for qp, _ in contact_sequence(1))], "every kind")


@pytest.fixture(scope="module")
def content(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("certificates") / "all.cert"
    made = certify(recording, path)
    assert made.made + len(made.without) == len(recording.qps)
    empty = sum(qp.k == 0 for qp in recording.qps)
    assert len(made.without) <= empty + 2
    return dict(json.loads(path.read_text()))


def test_the_checker_stands_alone() -> None:
    text = CHECKER.read_text()
    assert len(text.splitlines()) < 100
    named = {
        alias.name.partition(".")[0]
        for node in ast.walk(ast.parse(text))
        for alias in getattr(node, "names", [])
        if isinstance(node, ast.Import)
    } | {n.module for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom)}
    assert named == {"json", "sys", "fractions"}


def test_it_runs_anywhere(content: dict[str, Any], tmp_path: Path) -> None:
    shutil.copy(CHECKER, tmp_path)
    (tmp_path / "all.cert").write_text(json.dumps(content))
    command = [sys.executable, "-I", CHECKER.name, "all.cert"]
    told = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert told.returncode == 0, told.stdout
    assert f"{len(content['qps'])} of {content['count']} QPs of 'every kind' hold" in told.stdout


def test_it_is_of_the_recorded_data(content: dict[str, Any], recording: Recording) -> None:
    assert content["digest"] == recording.digest
    for entry in content["qps"]:
        qp, known = recording.qps[entry["number"]], recording.references[entry["number"]]
        assert known is not None
        A = np.zeros((qp.m, qp.k))
        for j, column in enumerate(entry["A"]):
            for row, value in column:
                A[row, j] = float.fromhex(value)
        assert np.array_equal(A, qp.dense_A)
        for name in ("d", "lower", "upper"):
            values = [float.fromhex(value) for value in entry[name]]
            assert np.array_equal(values, getattr(qp, name))
        one = int(entry["denominator"], 16)
        x = np.array([float(Fraction(int(value, 16), one)) for value in entry["numerators"]])
        assert np.allclose(qp.A @ x, known.Ax, rtol=1e-12, atol=1e-12 * np.abs(known.Ax).max())


def busy(content: dict[str, Any]) -> dict[str, Any]:
    """A certificate with free rows and rows at a bound, and a gradient there."""
    return next(qp for qp in content["qps"] if 0 in qp["working_set"] and -1 in qp["working_set"]
                and len(qp["d"]) > 3)  # fmt: skip


def off_x(qp: dict[str, Any]) -> None:
    i = qp["working_set"].index(0)
    qp["numerators"][i] = hex(int(qp["numerators"][i], 16) + 1)


def off_d(qp: dict[str, Any]) -> None:
    value = max((float.fromhex(v) for v in qp["d"]), key=abs)
    i = [float.fromhex(v) for v in qp["d"]].index(value)
    qp["d"][i] = float(np.nextafter(value, np.inf)).hex()


def off_A(qp: dict[str, Any]) -> None:
    entry = qp["A"][qp["working_set"].index(0)][0]
    entry[1] = float(np.nextafter(float.fromhex(entry[1]), np.inf)).hex()


def off_bound(qp: dict[str, Any]) -> None:
    i = qp["working_set"].index(-1)
    qp["lower"][i] = float(np.nextafter(float.fromhex(qp["lower"][i]), np.inf)).hex()


def freed(qp: dict[str, Any]) -> None:
    for i, member in enumerate(qp["working_set"]):
        if member == -1:
            qp["working_set"][i] = 0


def all_at_lower(qp: dict[str, Any]) -> None:
    qp["working_set"] = [-1] * len(qp["working_set"])


def other_side(qp: dict[str, Any]) -> None:
    """x at its bound, but the sign wants it to leave."""
    i = qp["working_set"].index(-1)
    qp["upper"][i], qp["lower"][i] = qp["lower"][i], "-inf"
    qp["working_set"][i] = 1


def negative_one(qp: dict[str, Any]) -> None:
    qp["denominator"] = "-" + qp["denominator"]
    qp["numerators"] = [hex(-int(value, 16)) for value in qp["numerators"]]


def shorter(qp: dict[str, Any]) -> None:
    for name in ("A", "lower", "upper", "working_set"):
        qp[name].pop()


def no_number(qp: dict[str, Any]) -> None:
    qp["d"][0] = "nan"


def doubled(qp: dict[str, Any]) -> None:
    column = qp["A"][qp["working_set"].index(0)]
    column.append(column[0])


def negative_row(qp: dict[str, Any]) -> None:
    column = qp["A"][qp["working_set"].index(0)]
    column[-1][0] -= len(qp["d"])


def unknown_member(qp: dict[str, Any]) -> None:
    qp["working_set"][0] = 2


def without_field(qp: dict[str, Any]) -> None:
    del qp["upper"]


TAMPER = (
    *(off_x, off_d, off_A, off_bound, freed, all_at_lower, other_side, negative_one, shorter),
    *(no_number, doubled, negative_row, unknown_member, without_field),
)


@pytest.mark.parametrize("tamper", TAMPER)
def test_a_tampered_certificate_is_refused(
    tamper: Any, content: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = copy.deepcopy(content)
    tamper(busy(changed))
    (tmp_path / "bad.cert").write_text(json.dumps(changed))
    assert not check_file(tmp_path / "bad.cert")
    told = capsys.readouterr().out
    assert told.count("REFUSED") == 1 and f"{len(content['qps']) - 1} of" in told


@pytest.mark.parametrize("text", ["", "[]", '{"format": "glambda certificate 1"}', "{"])
def test_what_is_no_certificate_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.cert").write_text(text)
    assert not check_file(tmp_path / "bad.cert")
    assert not check_file(tmp_path / "absent.cert")


def test_no_qp_may_be_left_out_in_silence(content: dict[str, Any], tmp_path: Path) -> None:
    changed = copy.deepcopy(content)
    changed["qps"].pop()
    (tmp_path / "bad.cert").write_text(json.dumps(changed))
    assert not check_file(tmp_path / "bad.cert")


def test_the_command(recording: Recording, tmp_path: Path) -> None:
    write_recording(tmp_path / "all.h5", recording)
    for _ in range(2):  # it may be written again
        words = ["certify", str(tmp_path / "all.h5"), "-o", str(tmp_path / "all.cert")]
        told = CliRunner().invoke(app, words)
        assert told.exit_code == 0 and "check_certificate.py" in told.output, told.output
    assert check_file(tmp_path / "all.cert")
    both = CliRunner().invoke(app, ["certify", *[str(tmp_path / "all.h5")] * 2, "-o", "x.cert"])
    assert both.exit_code == 2
