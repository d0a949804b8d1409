"""Damaged and forged shards of results, drawn by number (`tests/endurance/fuzz.py` and its
test)."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness.files.seal import SEAL, UNSEALED, sealed
from harness.files.sealed_parquet import METADATA
from harness.machine.unrest import Unrest
from harness.results.shard_file import (
    COLUMNS,
    FROM_PASSES,
    TIMES,
    Shard,
    ShardKey,
    StoreError,
    read_shard,
    shard_bytes,
)
from tests.endurance.damage import SORTS, Random, damage


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
        self.sound = shard_bytes(Shard(KEY, rows, passes, [Unrest(), QUIET], "study"))
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
        self.path.write_bytes(content if sort == "damaged" else sealed(content))
        return sort, what

    def read(self) -> bool:
        """Read the file; whether it holds what the sound one does."""
        key, rows, passes, unrest = read_shard(self.path)
        same = np.array_equal(passes, self.table.passes, equal_nan=True)
        same &= repr(unrest) == repr(self.table.unrest)  # NaN is not itself
        return key == self.table.key and rows.equals(self.table.rows) and bool(same)


KEY = ShardKey("fake", "abc", "daqp", "paper", "cold", "daqp 1.0", "a machine", 1.0)
QUIET = Unrest(1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 1.0)
ABOUT = {"key": asdict(KEY), "unrest": [Unrest().as_json(), QUIET.as_json()]}


def parquet(table: pa.Table, about: Any = None, **how: Any) -> bytes:
    """A Parquet file as `shard_bytes` writes it, or otherwise; `about` is bytes, or made JSON."""
    text = about if isinstance(about, bytes) else json.dumps(ABOUT if about is None else about)
    sink = io.BytesIO()
    plain = {"compression": "none", "store_schema": False, "write_statistics": False}
    times = [name for name in table.column_names if name in FROM_PASSES or name[-1].isdigit()]
    kept = [name for name in table.column_names if name not in times]
    with pq.ParquetWriter(
        sink, table.schema, **({**plain, "use_dictionary": kept} | how)
    ) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({METADATA: text, "seal": SEAL + UNSEALED})
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


STRANGE: tuple[Any, ...] = (*(None, True, 7, 1e400, [1], {"a": 1}, "../../x", "é" * 5_000, 2**80),)


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
    ]
    chosen = how[rng.integers(len(how))]
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
    about = ABOUT["key"]
    name = str(rng.choice(list(about)))
    texts = (b"", b"{", b"[]", b"[" * 100_000, b"\xff\xfe", b"9" * 100_000, b"x" * 5_000_000)
    how = rng.integers(4)
    if how == 0:
        return parquet(_table(sound), texts[rng.integers(len(texts))])
    if how == 1:
        key: Any = {n: v for n, v in about.items() if n != name}
    elif how == 2:
        key = STRANGE[rng.integers(len(STRANGE))]
    else:
        key = about | {name: STRANGE[rng.integers(len(STRANGE))]}
    return parquet(_table(sound), {**ABOUT, "key": key})


def _shard_unrest(rng: Random, sound: bytes) -> bytes:
    told: Any = [list(each) for each in ABOUT["unrest"]]
    how = rng.integers(4)
    if how == 0:
        told = STRANGE[rng.integers(len(STRANGE))]
    elif how == 1:
        told = told[: rng.integers(2)] if rng.integers(2) else told * 2
    elif how == 2:
        told[0] = STRANGE[rng.integers(len(STRANGE))]
    else:
        told[0][rng.integers(7)] = STRANGE[rng.integers(1, len(STRANGE))]
    return parquet(_table(sound), {**ABOUT, "unrest": told})


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
    "unrest": _shard_unrest,
    "values": _shard_values,
    "foreign": _shard_foreign,
}
