"""A recording: every QP of one run, in solve order, with the answers and the motion around it.

The file is HDF5 and holds flat arrays only, so that it can be read with h5py, MATLAB or Julia
alone.  Every dataset carries the attributes `meaning` and `unit`; the same table is `FIELDS` in
`harness.recordings.layout`.  A quantity that has a different size in each QP is one long array:
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
[m/s²] (NaN where they are not known), `code_version` and `digest`; attributes of the group
`counts`: the stepper's work counts.  Texts are UTF-8 of fixed length, which h5py shows as bytes.

The digest is the sha256 of names, types, shapes and bytes of all datasets and of all attributes but
`digest` and `code_version`: two versions of the code that pose the same QPs make recordings that
are the same to every study.  Two runs of one version make bit-identical files on one type of
processor; on another, BLAS and compiled kernels may round otherwise.

A reader trusts nothing: first the seal over all bytes, then names, types and sizes of everything,
before anything is allocated (`harness.recordings.file`), then the digest, then the values.  Timings
and solver memory are not stored.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.files.whole_files import write_whole
from harness.recordings.file import HEADER, RecordingError, Stored, file_bytes, read_file
from harness.recordings.layout import (
    MAY_BE_INFINITE,
    SpaceMotion,
    check_lengths,
    pack,
    unpack,
)
from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE, ContactQP, Solution, Vector
from problems.short import Short
from problems.space.discs import DiscQP
from problems.stepping.run import Event

REMEDY = "record the scene again with 'glambda record'"
MEMBERS = (AT_LOWER, FREE, AT_UPPER, PASSIVE)
LABEL_LIMIT = 150
"""Longest label [bytes]: with a solver's name it still makes a file name."""
PROVED = ("exact", "bound")
"""What a reference rests on that is proved: the answer in exact arithmetic
(`harness.judging.proof`); the bound that trusts nobody (`harness.judging.error_bound`)."""
PROOFS = (*PROVED, "nearby", "ill-posed")
"""What a reference rests on.  nearby: the bound of a QP that differs by rounding, for columns that
are dependent but for it; ill-posed: the same, where the recorded data taken exactly are known to
have another answer, which any other rounding of them would change."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The oracle's answer: A x* is unique, x is one of perhaps many.

    x : (k,);  Ax : (m,);  error_bound : bound on ‖Ax − A x*‖ of the recorded data
    proof : one of `PROOFS`, what `error_bound` rests on;  proved : whether that is a proof

    Raises ValueError for an unknown proof.
    """

    x: Vector
    Ax: Vector
    error_bound: float
    proof: str = "bound"

    def __post_init__(self) -> None:
        if self.proof not in PROOFS:
            raise ValueError(f"references/proof: {self.proof!r} is unknown; known: {PROOFS}")

    @property
    def proved(self) -> bool:
        return self.proof in PROVED


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Short):
    """All QPs of one run in solve order, with the answers of the stepper and of the oracle.

    scene : label, such as "fig4,mu_I=0.8";  parameters : everything that was chosen
    eps, gravity : of the run, NaN where nobody knows;  code_version : of the code that made it
    qps, solutions, references : one each per QP; a reference that was not accepted is None
    mu : for each QP (k,), the friction coefficient of a tangent row's contact; 0 elsewhere
    polygons : for each body its convex polygons, (c, 2) corners in body coordinates [m]; a disc is
        one of one corner, (radius, 0), an ellipse one of two, (a, 0) and (0, b)
    t : (n,), q, v : (n, bodies, 3)   the accepted steps
    events : `Event`s in order of time;  counts : the stepper's work counts
    space : how its bodies have moved where they do in space, and q and v hold none
    discs : of each accepted step in space with Coulomb's discs (6.1), the QP with them, which `qps`
        solve by bounds alone, and the stepper's x (k,)
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
    space: SpaceMotion | None = None
    discs: Sequence[tuple[DiscQP, Vector]] = ()

    def _title(self) -> str:
        return self.scene

    def _sizes(self) -> dict[str, Any]:
        return {
            **({"t": f"{self.t[-1]:.4g} s"} if len(self.t) else {}),
            "bodies": self.bodies,
            "QPs": len(self.qps),
            "references": sum(each is not None for each in self.references),
            "events": len(self.events),
        }

    @property
    def bodies(self) -> int:
        """How many have moved."""
        return len(self.polygons if self.space is None else self.space.solids)

    def without_motion(self, **changes: Any) -> Recording:
        """The recording with these changes of its QPs, whose motion it then no longer is."""
        none = np.zeros((0, self.q.shape[1], 3))
        motion: dict[str, Any] = {"t": np.zeros(0), "q": none, "v": none, "space": None}
        return replace(self, **motion, events=(), counts={}, discs=(), **changes)

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
    attributes = {
        **header,
        "code_version": recording.code_version,
        "digest": _digest(arrays, header, counts),
    }
    write_whole(path, file_bytes(Stored(attributes, arrays, counts)))


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and check a recording.

    Raises `RecordingError` (a ValueError of one line: file, field, remedy) for a file that is
    absent, truncated, foreign, of another version, inconsistent, altered or holding NaN.
    """
    path = Path(path)

    def wrong(field: str, what: str) -> RecordingError:
        return RecordingError(" ".join(f"{path}: {field}: {what}; {REMEDY}".split()))

    attributes, arrays, counts = read_file(path, wrong)
    header = {name: attributes[name] for name in HEADER}
    for name in ("eps", "gravity"):
        if np.isinf(header[name]):
            raise wrong(name, f"is {header[name]}; it must be finite, or NaN where it is not known")
    _check_label(header["scene"], wrong)
    if _digest(arrays, header, counts) != attributes["digest"]:
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
            code_version=attributes["code_version"],
            counts=dict(counts),
            **content,
        )
    except (ValueError, KeyError) as error:
        raise wrong("content", str(error)) from None


def _check_label(label: str, wrong: Callable[[str, str], ValueError]) -> None:
    """Refuse a label that is no file name: recordings and shards are stored under it."""
    sound = label.isprintable() and label.strip(". ") and not {*"/\\"} & {*label}
    if not sound or len(label.encode()) > LABEL_LIMIT:
        raise wrong("scene", f"is {label[:60]!r}, which cannot be the name of a file")


def _parameters(text: str) -> dict[str, Any]:
    """Names and values from JSON, which must be written as `_header` does, or digests differ."""
    try:
        values = json.loads(text)
        if isinstance(values, dict) and _json(values) == text:
            return values
    except (ValueError, RecursionError):
        pass
    raise ValueError("parameters: is no JSON object of names and values as glambda writes it")


def _json(parameters: Mapping[str, Any]) -> str:
    return json.dumps(dict(parameters), sort_keys=True, allow_nan=False)


def _header(recording: Recording) -> dict[str, Any]:
    return {
        "scene": recording.scene,
        "parameters": _json(recording.parameters),
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
