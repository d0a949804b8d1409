"""Recordings: what is written is read back, and nothing unsound is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from harness.recording import Recording, RecordingError, read_recording, write_recording
from harness.recording_layout import FIELDS
from tests.fake_recordings import fake_recording


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fake.h5"
    write_recording(path, fake_recording())
    return path


def assert_same(a: Recording, b: Recording) -> None:
    assert a.scene == b.scene and dict(a.parameters) == dict(b.parameters)
    assert (a.eps, a.gravity, a.code_version) == (b.eps, b.gravity, b.code_version)
    assert list(a.events) == list(b.events) and dict(a.counts) == dict(b.counts)
    for name in ("t", "q", "v"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for first, second in zip(a.qps, b.qps, strict=True):
        assert sp.issparse(first.A) == sp.issparse(second.A)
        for name in ("dense_A", "d", "lower", "upper", "row_id", "feature", "D", "generators"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        for name in ("kind", "accepted", "restart", "t", "h", "alpha0", "eps0"):
            assert getattr(first, name) == getattr(second, name)
    for one, two in zip(a.solutions, b.solutions, strict=True):
        for name in ("x", "working_set", "row_id"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        for name in ("status", "status_text", "iterations", "work"):
            assert getattr(one, name) == getattr(two, name)
    for left, right in zip(a.references, b.references, strict=True):
        assert (left is None) == (right is None)
        if left is not None and right is not None:
            np.testing.assert_array_equal(left.Ax, right.Ax)
            np.testing.assert_array_equal(left.x, right.x)
            assert (left.error_bound, left.proof) == (right.error_bound, right.proof)
    for mine, yours in zip(a.mu, b.mu, strict=True):
        np.testing.assert_array_equal(mine, yours)
    for mine, yours in zip(a.polygons, b.polygons, strict=True):
        for p, q in zip(mine, yours, strict=True):
            np.testing.assert_array_equal(p, q)


def test_write_and_read_is_the_identity(file: Path) -> None:
    made, read = fake_recording(), read_recording(file)
    assert_same(made, read)
    assert made.digest == read.digest
    assert any(sp.issparse(qp.A) for qp in read.qps)
    assert any(qp.generators is not None for qp in read.qps)
    assert any(qp.m * qp.k == 0 for qp in read.qps)


def test_arrays_are_read_only(file: Path) -> None:
    read = read_recording(file)
    assert not read.q.flags.writeable
    assert not read.qps[0].d.flags.writeable
    assert not read.references[0].Ax.flags.writeable


def test_empty_recording(tmp_path: Path) -> None:
    made = replace(
        fake_recording(),
        qps=(),
        solutions=(),
        references=(),
        mu=(),
        polygons=(),
        events=(),
        t=np.zeros(0),
        q=np.zeros((0, 0, 3)),
        v=np.zeros((0, 0, 3)),
    )
    write_recording(tmp_path / "none.h5", made)
    assert read_recording(tmp_path / "none.h5").qps == ()


def test_same_content_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_recording(tmp_path / f"{name}.h5", fake_recording())
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_digest_is_of_the_content_not_of_the_code() -> None:
    made = fake_recording()
    assert replace(made, code_version="other").digest == made.digest
    assert replace(made, eps=2e-3).digest != made.digest
    assert replace(made, qps=(*made.qps[:-1], replace(made.qps[-1], t=9.0))).digest != made.digest


def test_readable_with_h5py_alone(file: Path) -> None:
    made = fake_recording()
    with h5py.File(file) as raw:
        m, k, nnz = raw["qps/m"][:], raw["qps/k"][:], raw["qps/A_nnz"][:]
        sizes = np.where(nnz < 0, m * k, nnz)
        start = sizes[:3].sum()
        A = raw["qps/A_data"][start : start + sizes[3]].reshape(m[3], k[3])
        np.testing.assert_array_equal(A, made.qps[3].dense_A)
        assert json.loads(raw.attrs["parameters"])["mu"] == 0.5
        for name, field in FIELDS.items():
            assert raw[name].attrs["meaning"] == field.meaning
            assert raw[name].attrs["unit"] == field.unit


def test_nothing_is_left_behind_by_a_write_that_fails(tmp_path: Path) -> None:
    made = replace(fake_recording(), q=np.zeros((2, 2, 3)))
    with pytest.raises(ValueError, match="motion/q: has shape"):
        write_recording(tmp_path / "x.h5", made)
    assert list(tmp_path.iterdir()) == []


def test_solutions_must_belong_to_their_qps(tmp_path: Path) -> None:
    made = fake_recording()
    with pytest.raises(ValueError, match="11 QPs need as many solutions, references and mu"):
        write_recording(tmp_path / "x.h5", replace(made, solutions=made.solutions[:-1]))
    swapped = replace(made.solutions[0], row_id=made.solutions[0].row_id + 1)
    with pytest.raises(ValueError, match="solution 0 has other row_ids"):
        write_recording(tmp_path / "x.h5", replace(made, solutions=(swapped, *made.solutions[1:])))


def refusal(path: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message and "glambda record" in message
    return message


def edit(path: Path, name: str, change: object) -> None:
    """Replace a dataset by change(its values), attributes kept."""
    with h5py.File(path, "r+") as raw:
        values = change(raw[name][()])
        attributes = dict(raw[name].attrs)
        del raw[name]
        raw.create_dataset(name, data=values).attrs.update(attributes)


def sign_again(path: Path) -> None:
    """Make the digest of an edited file right, as a forger would."""
    from harness import recording as module

    with h5py.File(path, "r+") as raw:
        arrays = {name: raw[name][()] for name in FIELDS}
        keys = ("format", "version", "scene", "parameters", "eps", "gravity")
        header = {key: raw.attrs[key] for key in keys}
        header.update(version=int(header["version"]), eps=float(header["eps"]))
        header["gravity"] = float(header["gravity"])
        counts = {name: int(count) for name, count in raw["counts"].attrs.items()}
        raw.attrs["digest"] = module._digest(arrays, header, counts)


def test_absent_foreign_and_empty_files(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent.h5")
    (tmp_path / "text.h5").write_text("hello")
    assert "cannot be read as HDF5" in refusal(tmp_path / "text.h5")
    (tmp_path / "empty.h5").write_bytes(b"")
    assert "cannot be read as HDF5" in refusal(tmp_path / "empty.h5")
    with h5py.File(tmp_path / "other.h5", "w") as raw:
        raw["x"] = [1.0]
    assert "foreign" in refusal(tmp_path / "other.h5")


def test_other_version(file: Path) -> None:
    with h5py.File(file, "r+") as raw:
        raw.attrs["version"] = 99
    assert "version: is 99; this glambda reads 2" in refusal(file)


def test_missing_and_mistyped_fields(file: Path) -> None:
    edit(file, "qps/d", lambda d: d.astype(np.float32))
    assert "qps/d: has type float32" in refusal(file)
    with h5py.File(file, "r+") as raw:
        del raw["qps/d"]
    assert "qps/d: is missing" in refusal(file)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("qps/d", lambda d: d[:-1]),
        ("qps/k", lambda k: k + 1),
        ("qps/m", lambda m: np.full_like(m, 2**62)),
        ("qps/m", lambda m: -m),
        ("qps/A_nnz", lambda nnz: nnz - 7),
        ("motion/q", lambda q: q[:, :1]),
        ("bodies/corner_count", lambda c: c + 2**40),
        ("events/t", lambda t: np.zeros(0)),
    ],
)
def test_sizes_that_do_not_fit(file: Path, name: str, change: object) -> None:
    edit(file, name, change)
    sign_again(file)
    assert "shape" in refusal(file) or "negative" in refusal(file)


def test_a_changed_bit_is_noticed(file: Path) -> None:
    edit(file, "qps/d", lambda d: np.nextafter(d, np.inf))
    assert "digest" in refusal(file)


@pytest.mark.parametrize("name", ["qps/A_data", "qps/d", "qps/lower", "references/Ax", "motion/q"])
def test_nan_is_refused_by_name_even_if_signed(file: Path, name: str) -> None:
    def poison(values: np.ndarray) -> np.ndarray:
        values.flat[0] = np.nan
        return values

    edit(file, name, poison)
    sign_again(file)
    assert f"{name}: holds nan" in refusal(file)


def test_contradictions_are_refused_even_if_signed(file: Path) -> None:
    edit(file, "qps/kind", lambda kind: np.array([b"nonsense"] * len(kind)))
    sign_again(file)
    assert "kind 'nonsense' is unknown" in refusal(file)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("scene", "../../elsewhere/x", "scene: is '../../elsewhere/x', which cannot be the name"),
        ("scene", "\x1b[31mred", "cannot be the name of a file"),
        ("scene", "..", "cannot be the name of a file"),
        ("parameters", "[1, 2]", "no JSON object"),
        ("parameters", "{", "content"),
        ("eps", float("nan"), "eps: is nan; it must be finite"),
        ("gravity", float("inf"), "gravity: is inf; it must be finite"),
    ],
)
def test_bad_attributes_are_refused_even_if_signed(
    file: Path, name: str, value: object, words: str
) -> None:
    with h5py.File(file, "r+") as raw:
        raw.attrs[name] = value
    sign_again(file)
    assert words in refusal(file)


def test_an_unknown_proof_is_refused_even_if_signed(file: Path) -> None:
    edit(file, "references/proof", lambda proof: np.array([b"my word"] * len(proof)))
    sign_again(file)
    assert "references/proof: 'my word' is unknown" in refusal(file)


@pytest.mark.parametrize(
    ("name", "value"), [("solutions/working_set", 77), ("references/error_bound", -1.0)]
)
def test_values_out_of_range_are_refused_even_if_signed(
    file: Path, name: str, value: float
) -> None:
    edit(file, name, lambda values: np.full_like(values, value))
    sign_again(file)
    assert f"{name}: " in refusal(file)


def test_a_label_that_is_no_file_name_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be the name of a file"):
        write_recording(tmp_path / "x.h5", replace(fake_recording(), scene="a/b"))
    assert list(tmp_path.iterdir()) == []


def test_bad_sparse_structure_is_refused_even_if_signed(file: Path) -> None:
    edit(file, "qps/A_indices", lambda indices: indices + 10_000)
    sign_again(file)
    assert "CSC" in refusal(file)


def test_every_truncation_is_refused(file: Path) -> None:
    whole = file.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 60).astype(int):
        file.write_bytes(whole[:length])
        refusal(file)


def test_fuzzed_bytes_are_refused_or_harmless(file: Path) -> None:
    """A changed byte is refused, or lies where it changes nothing that is read."""
    whole, made = file.read_bytes(), fake_recording()
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(150):
        changed = bytearray(whole)
        for at in rng.integers(len(whole), size=8):
            changed[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(bytes(changed))
        try:
            assert_same(replace(read_recording(file), code_version=made.code_version), made)
        except RecordingError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 50
