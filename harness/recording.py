"""A recording: every QP of one run, in solve order, with the answers and the motion around it.

The file is HDF5 and holds flat arrays only, so that it can be read with h5py, MATLAB or Julia
alone.  Every dataset carries the attributes `meaning` and `unit`; the same table is `FIELDS` in
`harness.recording_layout`.  A quantity that has a different size in each QP is one long array:
QP i owns the entries

    offset[i] … offset[i+1],   offset = cumulative sum of its size over the QPs

with size m for d, D and references/Ax, k for lower, upper, mu, row_id, feature, x and working_set,
m·k for a dense A (row by row), A_nnz and k+1 for the parts of a sparse one (CSC), and l·k for the
generators V.  In Python:

    with h5py.File("fig4.h5") as file:
        m, k = file["qps/m"][:], file["qps/k"][:]
        start = (m * k)[:i].sum()                       # all A dense
        A = file["qps/A_data"][start : start + m[i] * k[i]].reshape(m[i], k[i])

Attributes of the file: `format`, `version`, `scene` (label), `parameters` (JSON), `eps`, `gravity`
[m/s²], `code_version` and `digest`; attributes of the group `counts`: the stepper's work counts.

The digest is the sha256 of names, types, shapes and bytes of all datasets and of all attributes but
`digest` and `code_version`: two versions of the code that pose the same QPs make recordings that
are the same to every study.  Two runs of one version make bit-identical files.

A reader trusts nothing: format and version, then names, types and sizes of all datasets (before
anything is allocated), then the digest, then the values.  Timings and solver memory are not stored.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from harness.recording_layout import FIELDS, MAY_BE_INFINITE, check_lengths, pack, unpack
from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE, ContactQP, Solution, Vector

FORMAT = "glambda recording"
VERSION = 2
REMEDY = "record the scene again with 'glambda record'"
MEMBERS = (AT_LOWER, FREE, AT_UPPER, PASSIVE)


PROOFS = ("exact", "bound", "ill-posed")
"""What a reference rests on: the answer in exact arithmetic (`harness.proof`); the bound that
trusts nobody (`harness.error_bound`), which holds up to rounding; the same, where the recorded data
taken exactly have another answer, which any other rounding of them would change."""


Wrong = Callable[[str, str], "RecordingError"]
"""Makes the error for (field, what is wrong)."""


class RecordingError(ValueError):
    """A file that is no sound recording: which file, which field, what to do.  One line."""


class Event(NamedTuple):
    """Something that happened at time t [s]."""

    t: float
    kind: str
    detail: str


@dataclass(frozen=True, eq=False)
class Reference:
    """The oracle's answer: A x* is unique, x is one of perhaps many.

    x : (k,);  Ax : (m,);  error_bound : bound on ‖Ax − A x*‖ of the recorded data
    proof : one of `PROOFS`, what `error_bound` rests on

    Raises ValueError for an unknown proof.
    """

    x: Vector
    Ax: Vector
    error_bound: float
    proof: str = "bound"

    def __post_init__(self) -> None:
        if self.proof not in PROOFS:
            raise ValueError(f"references/proof: {self.proof!r} is unknown; known: {PROOFS}")


@dataclass(frozen=True, eq=False)
class Recording:
    """All QPs of one run in solve order, with the answers of the stepper and of the oracle.

    scene : label, such as "fig4,mu_I=0.8";  parameters : everything that was chosen
    eps, gravity : of the run;  code_version : of the code that made it
    qps, solutions, references : one each per QP; a reference that was not accepted is None
    mu : for each QP (k,), the friction coefficient of a tangent row's contact; 0 elsewhere
    polygons : for each body its convex polygons, (c, 2) corners in body coordinates [m]
    t : (n,), q, v : (n, bodies, 3)   the accepted steps
    events : `Event`s in order of time;  counts : the stepper's work counts
    """

    scene: str
    parameters: Mapping[str, Any]
    eps: float
    gravity: float
    code_version: str
    qps: Sequence[ContactQP]
    solutions: Sequence[Solution]
    references: Sequence[Reference | None]
    mu: Sequence[Vector]
    polygons: Sequence[Sequence[Vector]]
    t: Vector
    q: Vector
    v: Vector
    events: Sequence[Event]
    counts: Mapping[str, int]

    @cached_property
    def digest(self) -> str:
        """sha256 of the content, as hexadecimal digits."""
        return _digest(pack(self), _header(self), dict(self.counts))


def write_recording(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write `recording` to `path`, at once or not at all.

    Identical content makes identical bytes.  Raises ValueError for content that does not fit
    together, so that nothing is written that `read_recording` would refuse.
    """
    path = Path(path)
    arrays = pack(recording)

    def wrong(name: str, what: str) -> ValueError:
        return ValueError(f"recording: {name}: {what}")

    check_lengths(arrays, wrong)
    _check_label(recording.scene, wrong)
    header, counts = _header(recording), {n: int(c) for n, c in recording.counts.items()}
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with h5py.File(temporary, "w", track_order=False) as file:
            for name, field in FIELDS.items():
                dataset = file.create_dataset(name, data=arrays[name], track_times=False)
                dataset.attrs["meaning"] = field.meaning
                dataset.attrs["unit"] = field.unit
            for key in sorted(header):
                file.attrs[key] = header[key]
            file.attrs["code_version"] = recording.code_version
            file.attrs["digest"] = _digest(arrays, header, counts)
            group = file.create_group("counts")
            for key in sorted(counts):
                group.attrs[key] = counts[key]
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and check a recording.

    Raises `RecordingError` (a ValueError of one line: file, field, remedy) for a file that is
    absent, truncated, foreign, of another version, inconsistent, altered or holding NaN.
    """
    path = Path(path)

    def wrong(field: str, what: str) -> RecordingError:
        return RecordingError(" ".join(f"{path}: {field}: {what}; {REMEDY}".split()))

    if not path.is_file():
        raise wrong("file", "there is no such file")
    try:
        with h5py.File(path, "r") as file:
            header = _read_header(file, wrong)
            arrays = _read_arrays(file, path.stat().st_size, wrong)
            counts = {str(n): int(c) for n, c in file["counts"].attrs.items()}
            stored, code_version = str(file.attrs["digest"]), str(file.attrs["code_version"])
    except RecordingError:
        raise
    # The bytes are foreign: h5py raises any of these on a damaged file.
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise wrong("file", f"cannot be read as HDF5 ({error}): truncated or foreign") from None
    if _digest(arrays, header, counts) != stored:
        raise wrong("digest", "the content does not match it: the file was damaged or altered")
    for name, array in arrays.items():
        if array.dtype.kind == "f":
            bad = np.isnan(array) if name in MAY_BE_INFINITE else ~np.isfinite(array)
            if bad.any():
                where = np.argwhere(bad)[0].tolist()
                raise wrong(name, f"holds {array[tuple(where)]} at index {where}")
    if (arrays["references/error_bound"] < 0).any():
        raise wrong("references/error_bound", "is negative somewhere")
    if not np.isin(arrays["solutions/working_set"], MEMBERS).all():
        raise wrong("solutions/working_set", f"holds something else than {MEMBERS}")
    try:
        content = unpack(arrays)
        content["references"] = tuple(r and Reference(*r) for r in content["references"])
        content["events"] = tuple(Event(*event) for event in content["events"])
        return Recording(
            scene=header["scene"],
            parameters=_parameters(header["parameters"]),
            eps=header["eps"],
            gravity=header["gravity"],
            code_version=code_version,
            counts=dict(sorted(counts.items())),
            **content,
        )
    except (ValueError, KeyError) as error:
        raise wrong("content", str(error)) from None


def _read_header(file: h5py.File, wrong: Wrong) -> dict[str, Any]:
    """Attributes of the file, after a look at format and version."""
    if file.attrs.get("format") != FORMAT:
        raise wrong("format", f"is {file.attrs.get('format')!r}, not {FORMAT!r}: a foreign file")
    if file.attrs.get("version") != VERSION:
        raise wrong("version", f"is {file.attrs.get('version')}; this glambda reads {VERSION}")
    header: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    for key, kind in {"scene": str, "parameters": str, "eps": float, "gravity": float}.items():
        if key not in file.attrs:
            raise wrong(key, "is missing")
        header[key] = kind(file.attrs[key])
        if kind is float and not np.isfinite(header[key]):
            raise wrong(key, f"is {header[key]}; it must be finite")
    _check_label(header["scene"], wrong)
    for key in ("code_version", "digest"):
        if key not in file.attrs:
            raise wrong(key, "is missing")
    return header


def _check_label(label: str, wrong: Callable[[str, str], ValueError]) -> None:
    """Refuse a label that is no file name: recordings and shards are stored under it."""
    if not label.isprintable() or not label.strip(". ") or {*"/\\"} & {*label} or len(label) > 200:
        raise wrong("scene", f"is {label[:60]!r}, which cannot be the name of a file")


def _parameters(text: str) -> dict[str, Any]:
    values = json.loads(text)
    if not isinstance(values, dict):
        raise ValueError("parameters: is no JSON object of names and values")
    return values


def _read_arrays(file: h5py.File, size: int, wrong: Wrong) -> dict[str, NDArray[Any]]:
    """All datasets, once their types and sizes are known to be sound."""
    shapes: dict[str, tuple[int, ...]] = {}
    for name, field in FIELDS.items():
        dataset = file.get(name)
        if not isinstance(dataset, h5py.Dataset):
            raise wrong(name, "is missing")
        if dataset.chunks is not None or dataset.is_virtual or dataset.external:
            raise wrong(name, "is not stored as one plain block")
        kind = "S" if dataset.dtype.kind == "S" else dataset.dtype.str
        if kind != field.dtype or len(dataset.shape) != 1 + len(field.columns):
            raise wrong(name, f"has type {dataset.dtype} and shape {dataset.shape}")
        size -= dataset.nbytes
        shapes[name] = dataset.shape
    if size < 0:
        raise wrong("file", "is smaller than the arrays it claims to hold: truncated")
    arrays = {name: np.ascontiguousarray(file[name][()]) for name in FIELDS}
    check_lengths(arrays, wrong)
    return arrays


def _header(recording: Recording) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "scene": recording.scene,
        "parameters": json.dumps(dict(recording.parameters), sort_keys=True, allow_nan=False),
        "eps": float(recording.eps),
        "gravity": float(recording.gravity),
    }


def _digest(
    arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any], counts: Mapping[str, int]
) -> str:
    total = hashlib.sha256(json.dumps([header, counts], sort_keys=True).encode())
    for name in sorted(arrays):
        array = arrays[name]
        total.update(f"{name} {array.dtype.str} {array.shape}".encode())
        total.update(array.tobytes())
    return total.hexdigest()
