"""Damaged and forged files of closed loops, drawn by number (`tests/endurance/fuzz.py` and its
test)."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness.files.seal import SEAL, UNSEALED, sealed
from harness.files.sealed_parquet import METADATA
from harness.motions.loop import Loop, LoopResult
from harness.motions.loop_store import load_loop, loop_path, write_loop
from harness.motions.motion_error import Motion
from harness.results.store import StoreError
from problems.stepping.run import Event
from tests.endurance.damage import SORTS, Random, damage

LOOP = Loop("fake", "glambda", "paper", 1e-3, 1e-3, 2e-3, until=1.0, time_limit=60.0)


class LoopTarget:
    """A motion of two bodies with some events."""

    error: type[Exception] = StoreError

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, loop_path(folder, LOOP)
        rng = np.random.default_rng(0)
        t = np.sort(rng.random(60))
        events = [Event(float(at), "impulse", f"body {i}, µ") for i, at in enumerate(t[::9])]
        motion = Motion(t, rng.random((60, 2, 3)), rng.random((60, 2, 3)), np.ones(2), events)
        measures = {"steps": 60, "final_energy": 1.5, "overlap": float("nan")}
        self.made = LoopResult(LOOP, "finished", "", 1.0, measures, motion)
        write_loop(folder, self.made)
        self.sound = self.path.read_bytes()

    def change(self, number: int) -> tuple[str, str]:
        """Put change `number` in place: (its sort, what it is)."""
        rng = np.random.default_rng([3, number])
        sort = SORTS[number % 3]
        if sort == "forged":
            what = str(rng.choice(list(LOOP_FORGERIES)))
            content = LOOP_FORGERIES[what](rng, self.sound)
        else:
            what, content = damage(rng, self.sound)
        self.path.write_bytes(content if sort == "damaged" else sealed(content))
        return sort, what

    def read(self) -> bool:
        """Read the file; whether it holds what the sound one does."""
        read = load_loop(self.folder, LOOP)
        return read is not None and _told(read) == _told(self.made)


def _told(result: LoopResult) -> str:
    """All that a result says, as text."""
    motion = result.motion
    arrays = [] if motion is None else [motion.t, motion.q, motion.v, motion.radius]
    events = [] if motion is None else motion.events
    said = (result.verdict, result.reason, result.reached, dict(result.measures), list(events))
    return json.dumps([*said, *(np.asarray(array).tolist() for array in arrays)])


def _parts(sound: bytes) -> tuple[pa.Table, dict[str, Any]]:
    table = pq.ParquetFile(io.BytesIO(sound)).read()
    return table, json.loads(table.schema.metadata[METADATA])


def _parquet(table: pa.Table, about: Any, **how: Any) -> bytes:
    """A file as `write_loop` makes it, or otherwise; `about` is bytes, or made JSON."""
    text = about if isinstance(about, bytes) else json.dumps(about)
    sink = io.BytesIO()
    plain = {"compression": "none", "use_dictionary": False, "store_schema": False}
    bare = table.replace_schema_metadata(None)
    with pq.ParquetWriter(sink, bare.schema, **(plain | how)) as writer:
        writer.write_table(bare)
        writer.add_key_value_metadata({METADATA: text, "seal": SEAL + UNSEALED})
    return sealed(sink.getvalue())


def _columns(rng: Random, sound: bytes) -> bytes:
    table, about = _parts(sound)
    names, at = table.column_names, int(rng.integers(table.num_columns))
    n = table.num_rows
    changed = (
        table.drop_columns([names[at]]),
        table.append_column("more", table.column(at)),
        table.set_column(at, names[at], pa.array(["x"] * n)),
        table.set_column(at, names[at], pa.nulls(n, table.schema.types[at])),
        table.set_column(at, names[at], pa.array([[1.0]] * n)),
        table.slice(0, n - 1),
        table.slice(0, 0),
        table.set_column(1, "body", pa.array(rng.integers(-9, 9, n))),
        table.set_column(0, "t", pa.array(rng.random(n))),
        table.set_column(0, "t", pa.array([float("nan")] * n)),
    )
    return _parquet(changed[rng.integers(len(changed))], about)


def _rows(rng: Random, sound: bytes) -> bytes:
    """Rows without end, which in Parquet take next to no room."""
    table, about = _parts(sound)
    n = int(10 ** rng.uniform(3, 6))
    made = pa.Table.from_arrays(
        [pa.repeat(column[0], n) for column in table.columns], table.column_names
    )
    how: tuple[dict[str, Any], ...] = (
        {},
        {"compression": "zstd"},
        {"compression": "gzip"},
        {"use_dictionary": True},
    )
    return _parquet(made, about, **how[rng.integers(len(how))])


def _about(rng: Random, sound: bytes) -> bytes:
    table, about = _parts(sound)
    texts = (b"", b"{", b"[]", b"[" * 100_000, b"\xff\xfe", b"9" * 100_000, b"x" * 5_000_000)
    values: tuple[Any, ...] = (
        *(None, True, 7, -1, 1e400, float("nan"), 10**400, "", "x", "\x1b[2J", [], [1], {}, [[]]),
        *({"a": 1}, [["x"] * 3], [[0.0, "impulse"]], [0.0] * 1000, [None, None]),
    )
    name = str(rng.choice(list(about)))
    inner = about[name]
    how = rng.integers(4)
    value = values[rng.integers(len(values))]
    if how == 0:
        return _parquet(table, texts[rng.integers(len(texts))])
    if how == 1:
        return _parquet(table, {n: v for n, v in about.items() if n != name})
    if how == 2 and isinstance(inner, (dict, list)):
        places = list(inner) if isinstance(inner, dict) else range(len(inner))
        inner[places[rng.integers(len(places))]] = value
        return _parquet(table, about)
    return _parquet(table, about | {name: value})


LOOP_FORGERIES: dict[str, Callable[[Random, bytes], bytes]] = {
    "other columns": _columns,
    "many rows": _rows,
    "other words": _about,
}
