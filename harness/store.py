"""The results folder: what was replayed, in shards that are whole or absent.

    RESULTS/recordings/<label>.h5          the recordings that were replayed
    RESULTS/solves/<shard>.parquet         one row per QP: `COLUMNS`
    RESULTS/repeats/<shard>.parquet        one row per QP and pass: `REPEAT_COLUMNS`
    RESULTS/study.json                     machine, versions and arguments

A shard is (recording, solver, setting, arm).  It carries its `ShardKey` in the file's metadata:
digest of the recording, versions, machine, time limit.

1. A finished pass is saved at once: written beside, then renamed, repeats before solves, so that a
   reader never sees half a file and an interrupted study loses nothing that was finished.
2. A study that resumes finds its shards by name.  One whose key differs was made from other
   QPs, by other code or on another machine: it refuses to mix, and says which field differs.
3. `read_results` checks the same across shards: one digest per scene, one version per solver.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from harness.recording import Recording, RecordingError, read_recording, write_recording

FORMAT_VERSION = 1
METADATA = b"glambda"
TIMES = ("build_time", "setup_time", "solve_time", "call_time")
"""Columns of `Shard.passes` [s]."""

COLUMNS: dict[str, pa.DataType] = {
    # the first eight are qpbenchmark's
    "problem": pa.string(),  # scene/000123
    "solver": pa.string(),
    "settings": pa.string(),  # paper, high or default
    "runtime": pa.float64(),  # setup + solve [s], minimum over the passes
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
    "build_time": pa.float64(),  # the four times are of the fastest pass [s]
    "setup_time": pa.float64(),
    "solve_time": pa.float64(),
    "call_time": pa.float64(),
    "runtime_median": pa.float64(),
    "iterations": pa.int64(),
    "descent_directions": pa.int64(),
    "working_set_changes": pa.int64(),
    "qr_factorizations": pa.int64(),
    "qr_updates": pa.int64(),
    "cg_iterations": pa.int64(),
    "flops": pa.int64(),
    "glambda_error": pa.float64(),
    "eps0_ratio": pa.float64(),
    "error_bound": pa.float64(),
    "objective_error": pa.float64(),
    "lambda_distance": pa.float64(),
    "machine": pa.string(),
    "versions": pa.string(),
    "study": pa.string(),
    # beyond the contract
    "status": pa.string(),  # name of the solver's Status; empty where it was not reached
    "asked": pa.float64(),  # accuracy that the verdict is measured against, in ‖A δx‖
    "scale": pa.float64(),  # unit of glambda_error
    "warm_started": pa.bool_(),  # whether a start was handed to the solver
    "after_restart": pa.bool_(),  # a QP of the warm group that has no predecessor
    "repeats": pa.int64(),  # passes that were timed
}
"""Columns of `solves/`, in order."""

REPEAT_COLUMNS: dict[str, pa.DataType] = {
    "problem": pa.string(),
    "solver": pa.string(),
    "settings": pa.string(),
    "arm": pa.string(),
    "repeat": pa.int64(),
    **{name: pa.float64() for name in TIMES},
}
"""Columns of `repeats/`, in order."""

FROM_KEY = ("scene", "recording_digest", "solver", "settings", "arm", "machine", "versions")
FROM_PASSES = ("runtime", "runtime_median", "repeats", *TIMES)


class StoreError(ValueError):
    """A results folder that cannot be read or may not be added to, with the remedy."""


@dataclass(frozen=True)
class ShardKey:
    """What a shard was made from and by.  Two shards of one name with different keys never mix.

    time_limit : [s] beyond which a solve counts as timed out
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
    format_version: int = FORMAT_VERSION

    @property
    def name(self) -> str:
        """File name of the shard, without its ending."""
        return "__".join((self.scene, self.solver, self.settings, self.arm)).replace("/", "-")


@dataclass(frozen=True, eq=False)
class Shard:
    """Rows of one (recording, solver, setting, arm).

    rows : one mapping per QP; what comes from the key and the passes is left out
    passes : (passes, n, 4) seconds, columns `TIMES`; NaN where nothing was run
    study : which study it belongs to
    """

    key: ShardKey
    rows: Sequence[Mapping[str, Any]]
    passes: NDArray[np.float64]
    study: str = ""


class Store:
    """A results folder that is written to.

    Raises StoreError where the folder holds results that today's may not be mixed with.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def add_recording(self, recording: Recording) -> None:
        """Keep a copy of the recording; another one under the same label is refused."""
        path = self.folder / "recordings" / f"{recording.scene}.h5"
        if path.exists():
            try:
                digest = read_recording(path).digest
            except RecordingError as error:
                raise StoreError(f"{error}; or use another results folder") from None
            if digest == recording.digest:
                return
            raise StoreError(
                f"{path}: holds another recording of this scene (digest {digest[:12]}…, now "
                f"{recording.digest[:12]}…); use another results folder, or delete this one"
            )
        write_recording(path, recording)

    def load(self, key: ShardKey) -> Shard | None:
        """The shard of this key as far as it was finished, or None.

        Raises StoreError if there is one of the same name that was made from or by something else.
        """
        path = self.folder / "solves" / f"{key.name}.parquet"
        if not path.exists():
            return None
        times_path = self.folder / "repeats" / f"{key.name}.parquet"
        table, stored = _read_table(path)
        for name, value in asdict(key).items():
            if stored[name] != value:
                raise StoreError(
                    f"{path}: made with {name} {stored[name]!r}, now {value!r}; "
                    "results may not be mixed: use another results folder, or delete this file"
                )
        if not times_path.exists():
            return None  # somebody has deleted it: the shard is made anew
        repeats, _ = _read_table(times_path)
        times = np.column_stack([repeats[name].to_numpy(zero_copy_only=False) for name in TIMES])
        study = table["study"][0].as_py() if table.num_rows else ""
        rows = table.drop_columns([*FROM_KEY, *FROM_PASSES, "study"]).to_pylist()
        passes = times.reshape(-1, len(rows), len(TIMES)) if rows else np.empty((1, 0, len(TIMES)))
        return Shard(key, rows, passes, study)

    def save(self, shard: Shard) -> None:
        """Write the shard over an earlier one of the same key, at once or not at all."""
        key = shard.key
        metadata = {METADATA: json.dumps(asdict(key), sort_keys=True).encode()}
        count, n, _ = shard.passes.shape
        problems = [row["problem"] for row in shard.rows]
        repeats: dict[str, Any] = {
            "problem": problems * count,
            "solver": [key.solver] * (count * n),
            "settings": [key.settings] * (count * n),
            "arm": [key.arm] * (count * n),
            "repeat": np.repeat(np.arange(count), n),
        }
        for j, name in enumerate(TIMES):
            repeats[name] = shard.passes[:, :, j].ravel()
        _write_table(
            self.folder / "repeats" / f"{key.name}.parquet", repeats, REPEAT_COLUMNS, metadata
        )
        data: dict[str, Any] = {
            name: [row.get(name) for row in shard.rows]
            for name in COLUMNS
            if name not in FROM_KEY and name not in FROM_PASSES
        }
        data.update({name: [getattr(key, name)] * n for name in FROM_KEY})
        data.update(summarise(shard.passes), study=[shard.study] * n)
        _write_table(self.folder / "solves" / f"{key.name}.parquet", data, COLUMNS, metadata)

    def write_study(self, description: Mapping[str, Any]) -> None:
        """Write study.json: machine, versions, arguments."""
        self.folder.mkdir(parents=True, exist_ok=True)
        temporary = self.folder / f".study.json.{os.getpid()}.tmp"
        temporary.write_text(json.dumps(description, indent=2, sort_keys=True) + "\n")
        os.replace(temporary, self.folder / "study.json")


def summarise(passes: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Columns `FROM_PASSES` of (passes, n, 4) times: the fastest pass of each QP, and the median.

    runtime is setup + solve; where those are unknown (a solve that raised) it is the whole call.
    """
    count, n, _ = passes.shape
    runtime = passes[:, :, 1] + passes[:, :, 2]
    runtime = np.where(np.isnan(runtime), passes[:, :, 3], runtime)
    best = np.argmin(np.where(np.isnan(runtime), np.inf, runtime), axis=0)
    fastest = passes[best, np.arange(n)]
    columns = {
        "runtime": runtime[best, np.arange(n)],
        "runtime_median": np.median(runtime, axis=0),
        "repeats": np.full(n, count),
    }
    columns.update({name: fastest[:, j] for j, name in enumerate(TIMES)})
    return columns


def read_results(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """All rows of a results folder, columns `COLUMNS`, ordered by problem, solver, settings, arm.

    Counts that a solver does not keep are NA (type Int64).

    Raises StoreError for a damaged shard, and for shards that may not stand in one table: two
    recordings of one scene, or two versions of one solver on one machine.
    """
    tables = _read_folder(Path(folder) / "solves", COLUMNS)
    frame = tables.to_pandas(types_mapper=_nullable)
    return frame.sort_values(["problem", "solver", "settings", "arm"], ignore_index=True)


def read_repeats(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Times of every pass, columns `REPEAT_COLUMNS`.  Raises StoreError like `read_results`."""
    frame = _read_folder(Path(folder) / "repeats", REPEAT_COLUMNS).to_pandas()
    order = ["problem", "solver", "settings", "arm", "repeat"]
    return frame.sort_values(order, ignore_index=True)


def _read_folder(folder: Path, columns: Mapping[str, pa.DataType]) -> pa.Table:
    seen: dict[tuple[str, ...], tuple[str, Path]] = {}
    tables = [pa.schema(list(columns.items())).empty_table()]
    for path in sorted(folder.glob("*.parquet")):
        table, key = _read_table(path)
        for what, value in (
            (("recording", key["scene"]), key["recording_digest"]),
            (("solver", key["solver"], key["machine"]), key["versions"]),
        ):
            first, where = seen.setdefault(what, (value, path))
            if first != value:
                raise StoreError(
                    f"{path}: made with {value!r}, but {where.name} with {first!r}; "
                    "results may not be mixed: delete one of them"
                )
        if table.column_names != list(columns):
            raise StoreError(f"{path}: has other columns than this version; replay again")
        tables.append(table)
    return pa.concat_tables(tables)


def _read_table(path: Path) -> tuple[pa.Table, dict[str, Any]]:
    try:
        table = pq.ParquetFile(path).read()
    except (OSError, pa.ArrowException) as error:
        line = " ".join(str(error).split())[:200]
        raise StoreError(f"{path}: cannot be read ({line}); delete it and replay again") from None
    metadata = (table.schema.metadata or {}).get(METADATA)
    if metadata is None:
        raise StoreError(f"{path}: is no shard of a glambda study; remove it from the folder")
    key = json.loads(metadata)
    if key.get("format_version") != FORMAT_VERSION:
        raise StoreError(
            f"{path}: has format {key.get('format_version')}, this glambda reads {FORMAT_VERSION}; "
            "replay into an empty folder"
        )
    return table.replace_schema_metadata(), key


def _write_table(
    path: Path,
    data: Mapping[str, Any],
    columns: Mapping[str, pa.DataType],
    metadata: dict[bytes, bytes],
) -> None:
    schema = pa.schema(list(columns.items()), metadata=metadata)
    arrays = [pa.array(data[name], type=kind) for name, kind in columns.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _nullable(kind: pa.DataType) -> Any:
    """Counts may be absent without turning into floats."""
    return pd.Int64Dtype() if kind == pa.int64() else None
