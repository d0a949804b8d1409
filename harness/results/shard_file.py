"""One shard of a results folder as a Parquet file, and how a stranger's is read.

A shard is one (recording, solver, setting, arm): a row per QP with `COLUMNS`, and after them the
times of every pass, `build_time_0`, …, `pace_0`, `build_time_1`, … [s] (`TIMES`).  The file's
metadata holds as JSON its `ShardKey` and what else the machine was doing in each pass (`Unrest`,
null where it is not known).  Where some passes were quiet, the others do not count.

The file is written and read as `harness.files.sealed_parquet` says, with times in plain, so that
each row takes `ROW_BYTES` bytes or more.  Of the key are looked at the fields and their types, and
whether the file has its name; of the table, once it is read, the length of texts, the columns that
repeat the key, those that sum up the passes, and the values (`harness.results.shard_values`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from harness.files.sealed_parquet import (
    Wrong,
    check_layout,
    parquet_bytes,
    read_parquet,
    said_of_itself,
)
from harness.judging.physics import MEASURES
from harness.machine.unrest import Unrest
from harness.results.shard_values import check_key, check_rows, check_times, check_unrest
from problems.qp import WorkCounts

FORMAT_VERSION = 6
TIMES = (
    *("build_time", "setup_time", "solve_time", "call_time", "charged_time", "inside_time", "pace"),
)
"""Columns of `Shard.passes` [s]; charged is what was seen and not told (`harness.passes.clocks`),
pace what `harness.machine.calibration` took before the pass."""

COLUMNS: dict[str, pa.DataType] = {
    # the first eight are qpbenchmark's
    "problem": pa.string(),  # scene/000123
    "solver": pa.string(),
    "settings": pa.string(),  # paper, high, default or a number
    "runtime": pa.float64(),  # setup + solve + charged [s], minimum over the passes
    "found": pa.bool_(),  # the solver's claim
    "primal_residual": pa.float64(),
    "dual_residual": pa.float64(),
    "duality_gap": pa.float64(),
    # which QP
    "scene": pa.string(),
    "recording_digest": pa.string(),
    "step": pa.int64(),  # position in the recording
    "kind": pa.string(),
    "accepted": pa.bool_(),
    "restart": pa.bool_(),
    "t": pa.float64(),
    "m": pa.int64(),
    "k": pa.int64(),
    "rank": pa.int64(),
    "arm": pa.string(),
    # what came of it
    "verdict": pa.string(),
    "status_text": pa.string(),
    "build_time": pa.float64(),  # these times are of the fastest pass [s]
    "setup_time": pa.float64(),
    "solve_time": pa.float64(),
    "call_time": pa.float64(),
    "charged_time": pa.float64(),  # part of runtime that was seen from outside and not told
    "inside_time": pa.float64(),  # setup and solve by the package's own clock; ours: the kernel's
    "believed": pa.bool_(),  # whether runtime is what was told, and no more is charged
    "pace": pa.float64(),
    "runtime_median": pa.float64(),
    "iterations": pa.int64(),
    **dict.fromkeys(WorkCounts.__dataclass_fields__, pa.int64()),
    "glambda_error": pa.float64(),
    "eps0_ratio": pa.float64(),
    "error_bound": pa.float64(),
    "objective_error": pa.float64(),
    "lambda_distance": pa.float64(),
    "proof": pa.string(),  # what the reference rests on, of `PROOFS`; empty: none
    **dict.fromkeys(MEASURES, pa.float64()),
    "machine": pa.string(),
    "versions": pa.string(),
    "study": pa.string(),
    "status": pa.string(),  # name of the solver's Status; empty where it was not reached
    "asked": pa.float64(),  # accuracy that the verdict is measured against, in ‖A δx‖
    "scale": pa.float64(),  # unit of glambda_error
    "warm_started": pa.bool_(),  # whether a start was handed to the solver
    "after_restart": pa.bool_(),  # a QP of the warm group that has no predecessor
    "repeats": pa.int64(),  # passes that count
    "quiet": pa.bool_(),  # whether nothing else is known to have disturbed them
    "executor": pa.string(),  # who counted and limited (`harness.processes.cgroup`); empty: nobody
}
"""One row per QP, in order."""

FROM_KEY = ("scene", "recording_digest", "solver", "settings", "arm", "machine", "versions")
BY_CLOCK = ("runtime", "runtime_median", "believed", *TIMES)
"""Columns that clocks decide: they differ when the same is done again."""
FROM_PASSES = (*BY_CLOCK, "repeats", "quiet")
TEXTS = tuple(name for name, kind in COLUMNS.items() if kind == pa.string())
TEXT_LIMIT = 2000
"""Longest text in a row [bytes]; longer ones are cut when they are written."""
KEY_LIMIT = 100_000
"""Longest key with what is told of passes [bytes], and most columns."""
ROW_BYTES = 8 * (2 + 2 * len(TIMES))
"""Bytes that a row takes at least: runtime, runtime_median, and the times twice."""


class StoreError(ValueError):
    """A results folder that cannot be read or may not be added to, with the remedy."""


def refuse_other(
    path: Path, made: Mapping[str, Any], asked: Mapping[str, Any], otherwise: str = ""
) -> None:
    """Raise StoreError where what is at `path` was made from or by something else.

    otherwise : a further remedy, to be told behind those that always help
    """
    for name, value in asked.items():
        if made.get(name) != value:
            raise StoreError(
                f"{path}: made with {name} {str(made.get(name))[:100]!r}, now {str(value)!r}; "
                "results may not be mixed: use another results folder, or delete this file"
                + otherwise
            )


@dataclass(frozen=True)
class ShardKey:
    """What a shard was made from and by.  Two shards of one name with different keys never mix.

    time_limit : [s] beyond which a solve counts as timed out;  memory_limit : [GiB] of a solver
    versions : of the solver's package and of our code around it
    """

    scene: str
    recording_digest: str
    solver: str
    settings: str
    arm: str
    versions: str
    machine: str
    time_limit: float
    memory_limit: float = 4.0
    format_version: int = FORMAT_VERSION

    @property
    def name(self) -> str:
        """File name of the shard, without its ending."""
        return "__".join((self.scene, self.solver, self.settings, self.arm)).replace("/", "-")


@dataclass(frozen=True, eq=False)
class Shard:
    """Rows of one (recording, solver, setting, arm).

    rows : one mapping per QP; what comes from the key and the passes is left out
    passes : (passes, n, 7) seconds, columns `TIMES`; NaN where nothing was run
    unrest : of each pass
    study : which study it belongs to
    """

    key: ShardKey
    rows: Sequence[Mapping[str, Any]]
    passes: NDArray[np.float64]
    unrest: Sequence[Unrest]
    study: str = ""


class StoredShard(NamedTuple):
    """A shard as it was read: columns `COLUMNS`, and passes and unrest as in `Shard`."""

    key: ShardKey
    rows: pa.Table
    passes: NDArray[np.float64]
    unrest: list[Unrest]

    @property
    def counted(self) -> NDArray[np.float64]:
        """Those of the passes that count."""
        return self.passes[which_count(self.unrest)]


def shard_bytes(shard: Shard) -> bytes:
    """The content of the shard's file."""
    key, (count, n, _) = shard.key, shard.passes.shape
    data: dict[str, Any] = {name: [row.get(name) for row in shard.rows] for name in COLUMNS}
    data |= {name: [getattr(key, name)] * n for name in FROM_KEY}
    data |= {**summarise(shard.passes, shard.unrest), "study": [shard.study] * n}
    data |= {name: [_cut(text) for text in data[name]] for name in TEXTS}
    times = _pass_columns(count)
    data |= zip(times, shard.passes.transpose(0, 2, 1).reshape(len(times), n), strict=True)
    schema = pa.schema([*COLUMNS.items(), *((name, pa.float64()) for name in times)])
    arrays = [pa.array(data[field.name], type=field.type) for field in schema]
    table = pa.Table.from_arrays(arrays, schema=schema)
    packed = [name for name in COLUMNS if name not in FROM_PASSES]
    said = {"key": asdict(key), "unrest": [each.as_json() for each in shard.unrest]}
    return parquet_bytes(table, json.dumps(said, sort_keys=True), packed)


def read_shard(path: Path) -> StoredShard:
    """Read and check a shard's file.

    Raises StoreError, one line, for a file that is damaged, foreign, of another format, or whose
    parts contradict each other.
    """

    def wrong(what: str) -> StoreError:
        return StoreError(" ".join(f"{path}: {what}; delete it and replay again".split()))

    def check(file: pq.ParquetFile, size: int) -> tuple[ShardKey, int, list[Unrest]]:
        key, said = _read_key(path, file, wrong)
        count = _check_columns(file, size, wrong)
        return key, count, check_unrest(said, count, wrong)

    (key, count, unrest), table = read_parquet(
        path, check, wrong, texts=TEXTS, metadata_limit=KEY_LIMIT
    )
    for name in TEXTS:
        lengths = pc.binary_length(table[name].combine_chunks().dictionary)
        if len(lengths) and pc.max(lengths).as_py() > TEXT_LIMIT:
            raise wrong(f"column {name} holds texts of more than {TEXT_LIMIT} bytes")
    times = np.array([table[name].to_numpy() for name in _pass_columns(count)], np.float64)
    passes = times.reshape(count, len(TIMES), table.num_rows).transpose(0, 2, 1)
    rows = table.select(list(COLUMNS)).cast(pa.schema(list(COLUMNS.items())))
    for name in FROM_KEY:
        if rows[name].unique().to_pylist() not in ([], [getattr(key, name)]):
            raise wrong(f"column {name} contradicts the key of the file")
    for name, column in summarise(passes, unrest).items():
        stored = rows[name].to_numpy().astype(column.dtype)
        if not np.array_equal(stored, column, equal_nan=column.dtype.kind == "f"):
            raise wrong(f"column {name} contradicts the times of the passes")
    check_rows(key.scene, rows, wrong)
    check_times(passes, rows, wrong)
    return StoredShard(key, rows, passes, unrest)


def _read_key(path: Path, file: pq.ParquetFile, wrong: Wrong) -> tuple[ShardKey, Any]:
    """The key that the file gives, once it has the right fields and is that of this name; and what
    it says of the unrest in its passes."""
    said = said_of_itself(file, wrong)
    if said is None:
        raise StoreError(f"{path}: is no shard of a glambda study; remove it from the folder")
    stored = said.get("key", said)
    if not isinstance(stored, dict):
        raise wrong("its key is no object of names and values")
    version = stored.get("format_version")
    if version != FORMAT_VERSION:
        raise StoreError(
            f"{path}: has format {str(version)[:20]}, this glambda reads {FORMAT_VERSION}; "
            "replay into an empty folder"
        )
    kinds = get_type_hints(ShardKey)
    if {name: type(value) for name, value in stored.items()} != kinds:
        raise wrong(f"its key needs the fields {', '.join(kinds)}, of their types")
    key = ShardKey(**stored)
    if path.stem != key.name:
        raise wrong(f"it is the shard {key.name[:200]!r} under another name")
    check_key(key, wrong)
    return key, said.get("unrest")


def _check_columns(file: pq.ParquetFile, size: int, wrong: Wrong) -> int:
    """Look at the columns before any is read; the number of passes."""
    count = (len(file.schema_arrow) - len(COLUMNS)) // len(TIMES)
    kinds = COLUMNS | dict.fromkeys(_pass_columns(count), pa.float64())
    check_layout(file, size, kinds, ROW_BYTES, wrong)
    if count < 1:
        raise wrong("holds no pass")
    return count


def runtimes(passes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(passes, n) of (passes, n, times): setup + solve and what is charged beside; or the whole
    call where those are NaN."""
    parts = [TIMES.index(name) for name in ("setup_time", "solve_time", "charged_time")]
    own = passes[:, :, parts].sum(axis=2)
    return np.where(np.isnan(own), passes[:, :, TIMES.index("call_time")], own)


def which_count(unrest: Sequence[Unrest]) -> NDArray[np.bool_]:
    """(passes,) those that were quiet; where none was, all."""
    quiet = np.array([each.is_quiet for each in unrest], dtype=bool)
    return quiet if quiet.any() else np.ones_like(quiet)


def summarise(passes: NDArray[np.float64], unrest: Sequence[Unrest]) -> dict[str, NDArray[Any]]:
    """Columns `FROM_PASSES` of (passes, n, 7) times: the fastest pass of each QP that counts, and
    the median.

    runtime is setup + solve + charged; where those are unknown (a solve that raised) it is the
    whole call.
    """
    counts = which_count(unrest)
    passes = passes[counts]
    count, n, _ = passes.shape
    runtime = runtimes(passes)
    best = np.argmin(np.where(np.isnan(runtime), np.inf, runtime), axis=0)
    fastest = passes[best, np.arange(n)]
    columns = {
        "runtime": runtime[best, np.arange(n)],
        "runtime_median": np.median(runtime, axis=0),
        "repeats": np.full(n, count),
        "quiet": np.full(n, any(each.is_quiet for each in unrest)),
        "believed": np.isfinite(fastest[:, TIMES.index("setup_time")])
        & (fastest[:, TIMES.index("charged_time")] == 0.0),
    }
    columns.update({name: fastest[:, j] for j, name in enumerate(TIMES)})
    return columns


def _pass_columns(count: int) -> list[str]:
    return [f"{name}_{number}" for number in range(count) for name in TIMES]


def _cut(text: str | None) -> str | None:
    """The text within `TEXT_LIMIT`."""
    if text is None or len(text.encode()) <= TEXT_LIMIT:
        return text
    return text.encode()[: TEXT_LIMIT - 3].decode(errors="ignore") + "…"
