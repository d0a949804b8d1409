"""Damaged and forged recordings and shards, drawn by number (`benchmarks/fuzz.py` and its test).

A target keeps a sound file at `path`.  `change(i)` puts the i-th change of it there, and says of
what sort it is and what it is.  `read()` reads it, and says whether it holds what it did at first.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness import recording as recordings
from harness import shard_file
from harness.recording import RecordingError, read_recording, write_recording
from harness.recording_file import BLOCK, HEADER, sealed
from harness.recording_layout import FIELDS
from harness.shard_file import (
    COLUMNS,
    FROM_PASSES,
    METADATA,
    TIMES,
    Shard,
    ShardKey,
    StoreError,
    read_shard,
    shard_bytes,
)
from tests.fake_recordings import fake_recording

Random = np.random.Generator
SORTS = ("damaged", "forged", "hostile")


def damage(rng: Random, content: bytes) -> tuple[str, bytes]:
    """What an accident does to bytes: (what, the changed bytes)."""
    n = len(content)
    changed = bytearray(content)
    start = [0, 0, max(0, n - 4096)][rng.integers(3)]  # mostly where formats keep their structure
    width = [n, 4096, 4096][rng.integers(3)]
    at = int(rng.integers(start, min(n, start + width)))
    length = int(2 ** rng.uniform(0, 10))
    kind = rng.choice(["cut", "flip", "set", "ones", "zeros", "noise", "drop", "copy", "append"])
    if kind == "cut":
        changed = changed[: int(rng.integers(n))]
    elif kind == "flip":
        for where in (at, *rng.integers(n, size=rng.integers(8))):
            changed[where] ^= 1 << int(rng.integers(8))
    elif kind == "set":
        changed[at] = int(rng.integers(256))
    elif kind in ("ones", "zeros"):
        length = min(8, length)
        changed[at : at + length] = (b"\xff" if kind == "ones" else b"\0") * length
    elif kind == "noise":
        changed[at : at + length] = rng.bytes(length)
    elif kind == "drop":
        del changed[at : at + length]
    elif kind == "copy":
        changed[at:at] = changed[at : at + length]
    else:
        changed += rng.bytes(length)
    return str(kind), bytes(changed)


class RecordingTarget:
    """A recording of a few odd QPs."""

    error: type[Exception] = RecordingError

    def __init__(self, folder: Path) -> None:
        self.path = folder / "fake.h5"
        self.made = fake_recording()
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


LARGE = 100_000_000
"""Arrays of more bytes than this are not signed."""


def forge(path: Path, change: Callable[[h5py.File], None]) -> None:
    """Change a recording's file, and make its digest and its seal right, as a forger would."""
    with h5py.File(path, "r+") as file:
        change(file)
        try:
            if sum(file[name].nbytes for name in FIELDS) > LARGE:
                raise ValueError
            arrays = {name: np.asarray(file[name][()]) for name in FIELDS}
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


def _name(rng: Random) -> str:
    return str(rng.choice(list(FIELDS)))


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
    name = _name(rng)
    shape = file[name].shape
    _replace(file, name, shape=shape, dtype=TYPES[rng.integers(len(TYPES))])


def _other_shape(rng: Random, file: h5py.File) -> None:
    name = _name(rng)
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
    name = _name(rng)
    shape = (int(10 ** rng.uniform(6, 15)), *file[name].shape[1:])
    _replace(file, name, shape=shape, dtype=file[name].dtype)


def _packed(rng: Random, file: h5py.File) -> None:
    name = _name(rng)
    values = file[name]
    shape = (int(10 ** rng.uniform(3, 6)), *values.shape[1:])
    data = np.zeros(shape, values.dtype)
    filters = ("gzip", "lzf")[rng.integers(2)]
    _replace(file, name, data=data, compression=filters, chunks=True)


def _elsewhere(rng: Random, file: h5py.File) -> None:
    name = _name(rng)
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
    name = _name(rng)
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
    name = _name(rng)
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


class ShardTarget:
    """A shard of some rows and two passes."""

    error: type[Exception] = StoreError

    def __init__(self, folder: Path) -> None:
        self.path = folder / f"{KEY.name}.parquet"
        rng = np.random.default_rng(0)
        passes = rng.random((2, 40, len(TIMES)))
        rows = [
            {
                "problem": f"fake/{i:06d}",
                "found": i % 2 == 0,
                "step": i,
                "kind": "step",
                "verdict": "verified",
                "status_text": "µ" * i,
                "iterations": None if i % 3 else i,
                "glambda_error": rng.random(),
                "scale": None,
            }
            for i in range(40)
        ]
        self.sound = shard_bytes(Shard(KEY, rows, passes, "study"))
        self.path.write_bytes(self.sound)
        self.table = read_shard(self.path)

    def change(self, number: int) -> tuple[str, str]:
        """Put change `number` in place: (its sort, what it is)."""
        rng = np.random.default_rng([2, number])
        sort = SORTS[number % 3]
        if sort == "forged":
            what = str(rng.choice(list(SHARD_FORGERIES)))
            content = SHARD_FORGERIES[what](rng, self.sound)
        else:
            what, content = damage(rng, self.sound)
        self.path.write_bytes(content if sort == "damaged" else shard_file.sealed(content))
        return sort, what

    def read(self) -> bool:
        """Read the file; whether it holds what the sound one does."""
        key, rows, passes = read_shard(self.path)
        same = np.array_equal(passes, self.table.passes, equal_nan=True)
        return key == self.table.key and rows.equals(self.table.rows) and same


KEY = ShardKey("fake", "abc", "daqp", "paper", "cold", "daqp 1.0", "a machine", 1.0)


def parquet(table: pa.Table, key: Any = None, **how: Any) -> bytes:
    """A Parquet file as `shard_bytes` writes it, or otherwise; `key` is bytes, or made JSON."""
    text = key if isinstance(key, bytes) else json.dumps(asdict(KEY) if key is None else key)
    sink = io.BytesIO()
    plain = {"compression": "none", "store_schema": False, "write_statistics": False}
    times = [name for name in table.column_names if name in FROM_PASSES or name[-1].isdigit()]
    kept = [name for name in table.column_names if name not in times]
    with pq.ParquetWriter(
        sink, table.schema, **({**plain, "use_dictionary": kept} | how)
    ) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({METADATA: text, "seal": shard_file.SEAL + b"0" * 64})
    return sink.getvalue()


def _table(sound: bytes) -> pa.Table:
    return pq.ParquetFile(io.BytesIO(sound)).read()


def _shard_type(rng: Random, sound: bytes) -> bytes:
    table = _table(sound)
    n = table.num_rows
    columns: tuple[Any, ...] = (
        pa.array([{"a": 1}] * n),
        pa.array([[1.0, 2.0]] * n),
        pa.array([[["x"]]] * n),
        pa.array([{"k": [1]}] * n),
        pa.array([b"\xff"] * n),
        pa.array([1] * n, pa.int32()),
        pa.array(["x"] * n, pa.large_string()),
        pa.array([0] * n, pa.timestamp("ns")),
        pa.array([None] * n, pa.decimal128(38, 2)),
        pa.array([b"12345678"] * n, pa.binary(8)),
        pa.array(["x"] * n).dictionary_encode(),
        pa.array([1.0] * n, pa.float32()),
        pa.array([True] * n),
        pa.nulls(n, pa.float64()),
        pa.nulls(n, pa.string()),
        pa.nulls(n, pa.int64()),
    )
    at = int(rng.integers(table.num_columns))
    column = columns[rng.integers(len(columns))]
    return parquet(table.set_column(at, table.column_names[at], column))


def _shard_columns(rng: Random, sound: bytes) -> bytes:
    table = _table(sound)
    names, at = table.column_names, int(rng.integers(table.num_columns))
    how = rng.integers(5)
    if how == 0:
        return parquet(table.drop_columns([names[at]]))
    if how == 1:
        return parquet(table.append_column("more", table.column(at)))
    if how == 2:
        return parquet(table.append_column(names[at], table.column(at)))
    if how == 3:
        return parquet(table.select([str(n) for n in rng.permutation(names)]))
    return parquet(table.rename_columns([f"{n}/../x" if n == names[at] else n for n in names]))


def _shard_rows(rng: Random, sound: bytes) -> bytes:
    """Rows without end, which in Parquet take next to no room."""
    table = _table(sound)
    n = int(10 ** rng.uniform(3, 5.5))
    columns = [pa.repeat(column[0], n) for column in table.columns]
    made = pa.Table.from_arrays(columns, schema=table.schema)
    how: list[dict[str, Any]] = [
        {},
        {"compression": "zstd"},
        {"compression": "gzip"},
        {"use_dictionary": True},
        {"row_group_size": 100},
    ]
    chosen = how[rng.integers(len(how))]
    chosen.pop("row_group_size", None)
    return parquet(made, **chosen)


def _shard_written_otherwise(rng: Random, sound: bytes) -> bytes:
    how: list[dict[str, Any]] = [
        *({"compression": c} for c in ("snappy", "gzip", "zstd", "brotli", "lz4")),
        {"use_dictionary": True},
        {"data_page_version": "2.0"},
        {"version": "1.0"},
        {"use_dictionary": False},
        {"store_schema": True},
        {"write_page_checksum": True},
    ]
    return parquet(_table(sound), **how[rng.integers(len(how))])


def _shard_key(rng: Random, sound: bytes) -> bytes:
    about = asdict(KEY)
    name = str(rng.choice(list(about)))
    texts = (b"", b"{", b"[]", b"[" * 100_000, b"\xff\xfe", b"9" * 100_000, b"x" * 5_000_000)
    values: tuple[Any, ...] = (None, True, 7, 1e400, [1], {"a": 1}, "../../x", "é" * 5_000, 2**80)
    how = rng.integers(3)
    if how == 0:
        return parquet(_table(sound), texts[rng.integers(len(texts))])
    if how == 1:
        return parquet(_table(sound), {n: v for n, v in about.items() if n != name})
    return parquet(_table(sound), about | {name: values[rng.integers(len(values))]})


def _shard_values(rng: Random, sound: bytes) -> bytes:
    table = _table(sound)
    at = int(rng.integers(table.num_columns))
    column = table.column(at).to_pylist()
    kind = table.schema.types[at]
    values: dict[Any, tuple[Any, ...]] = {
        pa.float64(): (np.nan, np.inf, -1.0, 0.0, None),
        pa.int64(): (-1, 2**62, None),
        pa.string(): ("x" * 1_000_000, "", None, "../x", "\n"),
        pa.bool_(): (True, False, None),
    }
    column[int(rng.integers(len(column)))] = values[kind][rng.integers(len(values[kind]))]
    return parquet(table.set_column(at, table.column_names[at], pa.array(column, kind)))


def _shard_foreign(rng: Random, sound: bytes) -> bytes:
    sink = io.BytesIO()
    made = pa.table({name: [1.0] for name in COLUMNS})
    if rng.integers(2):
        pq.write_table(made, sink)
    else:
        with pa.ipc.new_file(sink, made.schema) as writer:
            writer.write_table(made)
    return sink.getvalue()


SHARD_FORGERIES: dict[str, Callable[[Random, bytes], bytes]] = {
    "other type": _shard_type,
    "other columns": _shard_columns,
    "many rows": _shard_rows,
    "written otherwise": _shard_written_otherwise,
    "other key": _shard_key,
    "values": _shard_values,
    "foreign": _shard_foreign,
}

TARGETS: dict[str, Callable[[Path], Any]] = {"recording": RecordingTarget, "shard": ShardTarget}
