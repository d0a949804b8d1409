"""Damaged and forged recordings, drawn by number (`tests/endurance/fuzz.py` and its test)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from harness.files.seal import BLOCK, sealed
from harness.recordings import recording as recordings
from harness.recordings.file import HEADER, beyond_the_plane
from harness.recordings.layout import fields_of
from harness.recordings.recording import (
    Recording,
    RecordingError,
    read_recording,
    write_recording,
)
from tests.endurance.damage import SORTS, Random, damage
from tests.fakes.fake_recordings import fake_in_space, fake_recording


class RecordingTarget:
    """A recording of a few odd QPs."""

    error: type[Exception] = RecordingError
    make: Callable[[], Recording] = staticmethod(fake_recording)

    def __init__(self, folder: Path) -> None:
        self.path = folder / "fake.h5"
        self.made = self.make()
        write_recording(self.path, self.made)
        self.sound = self.path.read_bytes()
        (folder / "other").write_bytes(self.sound)

    def change(self, number: int) -> tuple[str, str]:
        """Put change `number` in place: (its sort, what it is)."""
        rng = np.random.default_rng([1, number])
        sort = SORTS[number % 3]
        if sort == "damaged":
            what, content = damage(rng, self.sound)
            self.path.write_bytes(content)
            return sort, what
        if sort == "hostile":
            what, content = damage(rng, self.sound[BLOCK:])
            self.path.write_bytes(sealed(self.sound[:BLOCK] + content))
            return sort, what
        name = str(rng.choice(list(RECORDING_FORGERIES)))
        self.path.write_bytes(self.sound)
        forge(self.path, lambda file: RECORDING_FORGERIES[name](rng, file))
        return sort, name

    def read(self) -> bool:
        """Read the file; whether it holds what the sound one does."""
        read = read_recording(self.path)
        return (read.digest, read.code_version) == (self.made.digest, self.made.code_version)


class SpaceTarget(RecordingTarget):
    """The same of bodies in space."""

    make = staticmethod(fake_in_space)


LARGE = 100_000_000
"""Arrays of more bytes than this are not signed."""


def forge(path: Path, change: Callable[[h5py.File], None]) -> None:
    """Change a recording's file, and make its digest and its seal right, as a forger would."""
    with h5py.File(path, "r+") as file:
        change(file)
        try:
            names = _names(file)
            if sum(file[name].nbytes for name in names) > LARGE:
                raise ValueError
            arrays = {name: np.asarray(file[name][()]) for name in names}
            header = {name: file.attrs[name] for name in HEADER}
            texts = {name: v.decode() for name, v in header.items() if isinstance(v, bytes)}
            counts = {name: int(count.real) for name, count in file["counts"].attrs.items()}
            digest = recordings._digest(arrays, header | texts, counts)
            file.attrs["digest"] = np.bytes_(digest)
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            OSError,
            RuntimeError,
            TypeError,
            ValueError,
        ):
            pass  # nothing that could be signed is left
    path.write_bytes(sealed(path.read_bytes()))


def _names(file: h5py.File) -> list[str]:
    """Of the datasets that it holds, or should."""
    return list(fields_of(beyond_the_plane(file)))


def _name(rng: Random, file: h5py.File) -> str:
    return str(rng.choice(_names(file)))


def _replace(file: h5py.File, name: str, **how: Any) -> None:
    del file[name]
    file.create_dataset(name, **how)


TYPES: tuple[Any, ...] = (
    *("<f4", ">f8", "<f2", "<u8", "<i4", "<c16", "S3", "S70000", "V8", "?"),
    np.dtype([("a", "<f8"), ("b", "<i4")]),
    np.dtype(("<f8", (3,))),
    h5py.string_dtype(),
    h5py.vlen_dtype("<f8"),
    h5py.ref_dtype,
    h5py.enum_dtype({"A": 0}),
)
NUMBERS = (0, -1, 1, 2**31, 2**40, 2**62, -(2**63))


def _other_type(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    shape = file[name].shape
    _replace(file, name, shape=shape, dtype=TYPES[rng.integers(len(TYPES))])


def _other_shape(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    values = file[name][()]
    how = rng.integers(6)
    if how == 0:
        _replace(file, name, data=values.ravel()[: values.size // 2])
    elif how == 1:
        _replace(file, name, data=values[None])
    elif how == 2:
        _replace(file, name, data=np.concatenate([values, values]))
    elif how == 3:
        _replace(file, name, data=h5py.Empty(values.dtype))
    elif how == 4:
        _replace(file, name, shape=(), dtype=values.dtype)
    else:
        _replace(file, name, shape=(0, *values.shape[1:]), dtype=values.dtype)


def _never_written(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    shape = (int(10 ** rng.uniform(6, 15)), *file[name].shape[1:])
    _replace(file, name, shape=shape, dtype=file[name].dtype)


def _packed(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    values = file[name]
    shape = (int(10 ** rng.uniform(3, 6)), *values.shape[1:])
    data = np.zeros(shape, values.dtype)
    filters = ("gzip", "lzf")[rng.integers(2)]
    _replace(file, name, data=data, compression=filters, chunks=True)


def _elsewhere(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    dtype, shape = file[name].dtype, file[name].shape
    group = name.partition("/")[0]
    how = rng.integers(8)
    if how == 0:
        del file[name]
        file[name] = h5py.ExternalLink("other", name)
    elif how == 1:
        del file[group]
        file[group] = h5py.ExternalLink("other", group)
    elif how == 2:
        file.move(name, "aside")
        file[name] = h5py.SoftLink("/aside")
    elif how == 3:
        file.move(group, "aside")
        file[group] = h5py.SoftLink("/aside")
    elif how == 4:
        layout = h5py.VirtualLayout(shape, dtype)
        layout[...] = h5py.VirtualSource("other", name, shape)
        del file[name]
        file.create_virtual_dataset(name, layout)
    elif how == 5:
        _replace(file, name, shape=shape, dtype=dtype, external=[("/etc/passwd", 0, 10**6)])
    elif how == 6:
        del file[group]
        file[group] = file["/"]
    else:
        del file[name]
        file[name] = h5py.SoftLink("/" + name)


def _missing(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    how = rng.integers(4)
    if how == 0:
        del file[name.partition("/")[0]]
    elif how == 1:
        del file[name]
        file.create_group(name)
    elif how == 2:
        del file["counts"]
    else:
        del file[name]


def _extra(rng: Random, file: h5py.File) -> None:
    file["qps/more"] = np.zeros(10)
    file["notes"] = "of mine"
    file.attrs["more"] = np.zeros(1000)


LABELS = (
    *("../../x", "/etc/passwd", "a\\b", "..", " . ", "", "a\0b", "x" * 300, "ü" * 100, "a\nb"),
    *("\u202eh5", "con", "~", "-rf", "a" * 60_000),
)


def _attribute(rng: Random, file: h5py.File) -> None:
    where = file if rng.integers(4) else file["counts"]
    names = list(where.attrs)
    name = str(rng.choice(names))
    values: tuple[Any, ...] = (
        *(np.nan, np.inf, -1.0, 10**18, np.zeros(7000), np.bytes_(b"\xff\xfe"), "text", b"text"),
        *(h5py.Empty("f8"), np.array([b"a", b"b"]), True, 1j, 2**63 - 1),
        np.void(b"raw"),
    )
    del where.attrs[name]
    if rng.integers(10):
        where.attrs[name] = values[rng.integers(len(values))]


def _label(rng: Random, file: h5py.File) -> None:
    label = LABELS[rng.integers(len(LABELS))].encode()
    file.attrs["scene"] = np.bytes_(label or b"\0")


def _parameters(rng: Random, file: h5py.File) -> None:
    texts = ("[" * 50_000, "{", "[1]", '{"a": NaN}', '{"a":1}', '{"a": 1, "a": 2}', "9" * 60_000)
    file.attrs["parameters"] = np.bytes_(texts[rng.integers(len(texts))])


def _many_counts(rng: Random, file: h5py.File) -> None:
    for i in range(int(10 ** rng.uniform(0, 3))):
        file["counts"].attrs[f"{i}"] = NUMBERS[i % len(NUMBERS)]


def _values(rng: Random, file: h5py.File) -> None:
    name = _name(rng, file)
    values = file[name][()]
    if not values.size:
        return
    some = rng.integers(values.size, size=rng.integers(1, 4))
    kind = values.dtype.kind
    if kind == "f":
        values.flat[some] = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e308, 5e-324])
    elif kind == "S":
        values.flat[some] = rng.choice([b"", b"\xff", b"nonsense", b"a\nb"])
    else:
        limits = np.iinfo(values.dtype)
        number = NUMBERS[rng.integers(len(NUMBERS))]
        values.flat[some] = min(max(number, int(limits.min)), int(limits.max))
    file[name][...] = values


RECORDING_FORGERIES: dict[str, Callable[[Random, h5py.File], None]] = {
    "other type": _other_type,
    "other shape": _other_shape,
    "never written": _never_written,
    "packed": _packed,
    "elsewhere": _elsewhere,
    "missing": _missing,
    "extra": _extra,
    "attribute": _attribute,
    "label": _label,
    "parameters": _parameters,
    "many counts": _many_counts,
    "values": _values,
}
