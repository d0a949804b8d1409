"""Recordings: what is written is read back, and nothing unsound is."""

from __future__ import annotations

import hashlib
import json
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from harness.files.seal import sealed
from harness.judging.disc_bound import disc_error_bound
from harness.recordings import file as recording_file
from harness.recordings.file import ENTRY_BYTES, QP_BYTES
from harness.recordings.layout import FIELDS
from harness.recordings.recording import Recording, RecordingError, read_recording, write_recording
from harness.study.record import record
from problems import scene
from problems.stepping.run import Event
from tests.endurance.forged_recordings import forge
from tests.fakes.fake_recordings import fake_in_space, fake_recording

OF_EACH_QP = ("qps", "solutions", "references", "mu")


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
    for (disc, x), (other, y) in zip(a.discs, b.discs, strict=True):
        assert sp.issparse(disc.A) == sp.issparse(other.A) and disc.t == other.t
        np.testing.assert_array_equal(disc.residual(x), other.residual(y))
        for name in ("d", "lower", "upper", "discs", "radius"):
            np.testing.assert_array_equal(getattr(disc, name), getattr(other, name))


def test_write_and_read_is_the_identity(file: Path) -> None:
    made, read = fake_recording(), read_recording(file)
    assert_same(made, read)
    assert made.digest == read.digest
    assert any(sp.issparse(qp.A) for qp in read.qps)
    assert any(qp.generators is not None for qp in read.qps)
    assert any(qp.m * qp.k == 0 for qp in read.qps)


def test_bodies_in_space_and_discs_are_read_as_they_were_written(tmp_path: Path) -> None:
    made = fake_in_space()
    write_recording(tmp_path / "a.h5", made)
    read = read_recording(tmp_path / "a.h5")
    assert_same(made, read)
    assert made.digest == read.digest
    assert read.space is not None and made.space is not None
    for mine, yours in zip(made.space, read.space, strict=True):
        np.testing.assert_array_equal(mine, yours)


def test_the_discs_of_a_step_are_recorded_with_their_answer(tmp_path: Path) -> None:
    made = record(scene("slope", heading=0.3), until=0.05, fixed_step=0.01)
    write_recording(tmp_path / "slope.h5", made)
    read = read_recording(tmp_path / "slope.h5")
    assert_same(made, read)
    assert [qp.t for qp, _ in read.discs] == pytest.approx(read.t[1:])
    for qp, x in read.discs:
        assert disc_error_bound(qp, x) < 1e-4 * np.linalg.norm(qp.A @ x)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("discs/pairs", 99, "a column that there is not"),
        ("discs/pairs", -1, "a column that there is not"),
        ("discs/radius", -1.0, "radii must be at least 0"),
        ("discs/radius", np.nan, "discs/radius: holds nan"),
        ("discs/count", 2, "discs/pairs: has shape"),
        ("discs/k", -1, "discs/m: it or another size is negative"),
        ("discs/A_indices", 99, "no CSC matrix"),
    ],
)
def test_discs_that_are_none_are_refused_even_if_signed(
    tmp_path: Path, name: str, value: float, words: str
) -> None:
    path = tmp_path / "a.h5"
    write_recording(path, fake_in_space())
    edit(path, name, lambda values: np.full_like(values, value))
    assert words in refusal(path)


def test_arrays_are_read_only(file: Path) -> None:
    read = read_recording(file)
    assert not read.q.flags.writeable
    assert not read.qps[0].d.flags.writeable
    assert not read.references[0].Ax.flags.writeable


def test_a_disc_is_read_as_it_was_written(tmp_path: Path) -> None:
    path, made = tmp_path / "wheel_edge.h5", scene("wheel_edge")
    write_recording(path, record(made, until=0.3))
    read = [part for body in read_recording(path).polygons for part in body]
    drawn = [part for body in made.bodies for part in body.polygons]
    assert sorted(len(part) for part in read) == [1, 4]
    for one, two in zip(read, drawn, strict=True):
        np.testing.assert_array_equal(one, two)


def test_an_ellipse_is_read_as_it_was_written(tmp_path: Path) -> None:
    path, made = tmp_path / "rocking.h5", scene("rocking")
    write_recording(path, record(made, until=0.1))
    (read,) = read_recording(path).polygons[0]
    np.testing.assert_array_equal(read, [(0.5, 0.0), (0.0, 0.3)])


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


def edit(path: Path, name: str, change: Callable[[Any], Any]) -> None:
    """Replace a dataset by change(its values), and sign and seal the file again."""

    def replaced(raw: h5py.File) -> None:
        values = change(raw[name][()])
        del raw[name]
        raw[name] = values

    forge(path, replaced)


def test_absent_foreign_and_empty_files(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent.h5")
    (tmp_path / "text.h5").write_text("hello")
    assert "foreign" in refusal(tmp_path / "text.h5")
    (tmp_path / "empty.h5").write_bytes(b"")
    assert "truncated" in refusal(tmp_path / "empty.h5")
    with h5py.File(tmp_path / "other.h5", "w") as raw:
        raw["x"] = [1.0]
    assert "foreign or of an older version" in refusal(tmp_path / "other.h5")
    assert "is no file, but a folder" in refusal(tmp_path)


def test_other_version(file: Path) -> None:
    whole = file.read_bytes()
    file.write_bytes(whole.replace(b"glambda recording 3\n", b"glambda recording 9\n", 1))
    assert "version: is '9'; this glambda reads 3" in refusal(file)
    file.write_bytes(whole)
    forge(file, lambda raw: raw.attrs.__setitem__("version", 99))
    assert "version: is '99' instead of 3" in refusal(file)


def test_the_seal_can_be_checked_by_hand(file: Path) -> None:
    whole = file.read_bytes()
    first, second = whole[:512].decode().split("\n")[:2]
    assert first == "glambda recording 3"
    assert second == f"sha256 {hashlib.sha256(whole[512:]).hexdigest()}"


def test_missing_and_mistyped_fields(file: Path) -> None:
    edit(file, "qps/d", lambda d: d.astype(np.float32))
    assert "qps/d: has type float32" in refusal(file)
    forge(file, lambda raw: raw.__delitem__("qps/d"))
    assert "qps/d: is missing" in refusal(file)
    forge(file, lambda raw: raw.create_group("qps/d"))
    assert "qps/d: is no dataset" in refusal(file)


def test_links_to_other_places_are_not_followed(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    (tmp_path / "other.h5").write_bytes(whole)
    links = (h5py.ExternalLink("other.h5", "qps"), h5py.SoftLink("/aside"), h5py.SoftLink("/qps"))
    for link in links:
        file.write_bytes(whole)

        def point(raw: h5py.File, link: Any = link) -> None:
            raw.move("qps", "aside")
            raw["qps"] = link

        forge(file, point)
        assert "qps: is a link elsewhere" in refusal(file)


def test_arrays_that_are_elsewhere_or_nowhere_are_not_read(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    (tmp_path / "other.h5").write_bytes(whole)
    (tmp_path / "raw").write_bytes(bytes(10_000))
    virtual = h5py.VirtualLayout((11,), "<f8")
    virtual[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "qps/t", (11,))
    for make in (
        lambda raw: raw.create_virtual_dataset("qps/t", virtual),
        lambda raw: raw.create_dataset(
            "qps/t", (11,), "<f8", external=[(str(tmp_path / "raw"), 0, 88)]
        ),
        lambda raw: raw.create_dataset("qps/t", (10**12,), "<f8"),  # without storage
        lambda raw: raw.create_dataset("qps/t", (10**6,), "<f8", compression="gzip"),
    ):
        file.write_bytes(whole)

        def put(raw: h5py.File, make: Any = make) -> None:
            del raw["qps/t"]
            make(raw)

        forge(file, put)
        assert "qps/t: is not stored as one plain block" in refusal(file)


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
    assert "shape" in refusal(file) or "negative" in refusal(file)


def test_generators_of_no_columns_are_refused(file: Path) -> None:
    """They take no bytes in the file, and λ = V x would take terabytes."""
    none = next(i for i, qp in enumerate(fake_recording().qps) if qp.k == 0)

    def many(rows: np.ndarray) -> np.ndarray:
        rows[none] = 10**12
        return rows

    edit(file, "qps/V_rows", many)
    assert "qps/V_rows: asks for generators of no columns" in refusal(file)


def test_a_file_is_refused_before_memory_is_gone(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_file, "available_memory", lambda: 1000.0)
    assert "needs 0.0 GB of memory" in refusal(file)


def test_a_file_with_a_wrong_seal_takes_no_memory(file: Path) -> None:
    with open(file, "r+b") as raw:
        raw.truncate(100_000_000)  # nearly all of it is a hole
    tracemalloc.start()
    try:
        assert "seal" in refusal(file)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_objects_take_no_more_memory_than_is_expected_of_them(tmp_path: Path) -> None:
    """QPs without a row or column, and events of one letter: next to nothing in the file."""
    made = fake_recording()
    none = next(i for i, qp in enumerate(made.qps) if qp.k == 0)
    parts: dict[str, Any] = {name: [getattr(made, name)[none]] * 500 for name in OF_EACH_QP}
    parts["qps"] = [replace(made.qps[none], generators=None)] * 500
    parts |= {"polygons": [[np.zeros((0, 2))] * 5000], "q": made.q[:, :1], "v": made.v[:, :1]}
    write_recording(tmp_path / "x.h5", replace(made, **parts, events=[Event(0.0, "a", "b")] * 5000))
    tracemalloc.start()
    try:
        read = read_recording(tmp_path / "x.h5")
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(read.qps) == 500
    size = (tmp_path / "x.h5").stat().st_size
    assert taken < size + 500 * QP_BYTES + 10_001 * ENTRY_BYTES


def test_a_changed_bit_is_noticed(file: Path) -> None:
    with h5py.File(file, "r+") as raw:
        raw["qps/d"][...] = np.nextafter(raw["qps/d"][()], np.inf)
    assert "seal" in refusal(file)
    file.write_bytes(sealed(file.read_bytes()))
    assert "digest" in refusal(file)


@pytest.mark.parametrize("name", ["qps/A_data", "qps/d", "qps/lower", "references/Ax", "motion/q"])
def test_nan_is_refused_by_name_even_if_signed(file: Path, name: str) -> None:
    def poison(values: np.ndarray) -> np.ndarray:
        values.flat[0] = np.nan
        return values

    edit(file, name, poison)
    assert f"{name}: holds nan" in refusal(file)


def test_contradictions_are_refused_even_if_signed(file: Path) -> None:
    edit(file, "qps/kind", lambda kind: np.array([b"nonsense"] * len(kind)))
    assert "kind 'nonsense' is unknown" in refusal(file)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("scene", "../../elsewhere/x", "scene: is '../../elsewhere/x', which cannot be the name"),
        ("scene", "\x1b[31mred", "cannot be the name of a file"),
        ("scene", "..", "cannot be the name of a file"),
        ("scene", "ü" * 76, "cannot be the name of a file"),
        ("parameters", "[1, 2]", "no JSON object"),
        ("parameters", "{", "no JSON object"),
        ("parameters", "[" * 50_000, "no JSON object"),
        ("parameters", '{"b":1}', "as glambda writes it"),
        ("parameters", '{"b": NaN}', "as glambda writes it"),
        ("code_version", h5py.Empty("S1"), "code_version: has type"),
        ("code_version", np.zeros(7000), "code_version: has type float64 and shape (7000,)"),
        ("eps", "0.001", "eps: has type"),
        ("eps", float("inf"), "eps: is inf; it must be finite"),
        ("gravity", float("inf"), "gravity: is inf; it must be finite"),
    ],
)
def test_bad_attributes_are_refused_even_if_signed(
    file: Path, name: str, value: object, words: str
) -> None:
    kept = np.bytes_(value.encode()) if isinstance(value, str) else value
    forge(file, lambda raw: raw.attrs.__setitem__(name, kept))
    assert words in refusal(file)


def test_a_text_of_any_length_is_not_read(file: Path) -> None:
    """Such texts lie in HDF5's global heap, where damage can keep the library busy for ever."""
    forge(file, lambda raw: raw.attrs.__setitem__("code_version", "text"))
    assert "code_version: has type object" in refusal(file)


def test_counts_must_be_whole_numbers(file: Path) -> None:
    forge(file, lambda raw: raw["counts"].attrs.__setitem__("steps", 1.5))
    assert "counts/steps: has type float64" in refusal(file)


def test_without_text_there_is_text(tmp_path: Path) -> None:
    write_recording(tmp_path / "x.h5", replace(fake_recording(), code_version="", parameters={}))
    read = read_recording(tmp_path / "x.h5")
    assert read.code_version == "" and read.parameters == {}


def test_an_unknown_proof_is_refused_even_if_signed(file: Path) -> None:
    edit(file, "references/proof", lambda proof: np.array([b"my word"] * len(proof)))
    assert "references/proof: 'my word' is unknown" in refusal(file)


@pytest.mark.parametrize(
    ("name", "value"), [("solutions/working_set", 77), ("references/error_bound", -1.0)]
)
def test_values_out_of_range_are_refused_even_if_signed(
    file: Path, name: str, value: float
) -> None:
    edit(file, name, lambda values: np.full_like(values, value))
    assert f"{name}: " in refusal(file)


def test_a_label_that_is_no_file_name_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be the name of a file"):
        write_recording(tmp_path / "x.h5", replace(fake_recording(), scene="a/b"))
    assert list(tmp_path.iterdir()) == []


def test_bad_sparse_structure_is_refused_even_if_signed(file: Path) -> None:
    edit(file, "qps/A_indices", lambda indices: indices + 10_000)
    assert "CSC" in refusal(file)


def test_every_truncation_is_refused(file: Path) -> None:
    whole = file.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 60).astype(int):
        file.write_bytes(whole[:length])
        refusal(file)
