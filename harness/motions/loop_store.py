"""A finished closed loop as a file: whole or absent, never mixed with another code's.

    RESULTS/loops/<scene>__<solver>__<setting>__<eps>.parquet

holds the motion, one row per accepted time and body (t, body, x, y, phi, vx, vy, omega), and in its
metadata what was run (`Loop`), by what (versions, machine), what came of it and all events.  It is
written and read as `harness.files.sealed_parquet` says; what it says of itself has the fields of
`ABOUT`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness.files.sealed_parquet import (
    Wrong,
    check_layout,
    parquet_bytes,
    read_parquet,
    said_of_itself,
)
from harness.files.whole_files import write_whole
from harness.machine.machine import machine_label, problems_version, source_hash
from harness.motions import in_loop, run_physics
from harness.motions.loop import VERDICTS, Loop, LoopResult
from harness.motions.motion_error import Motion
from harness.names import METHOD
from harness.processes.introduction import solver_version
from harness.results.shard_file import StoreError, refuse_other
from problems.qp import Vector
from problems.stepping.run import Event

FORMAT_VERSION = 2
STATE = ("x", "y", "phi", "vx", "vy", "omega")
COLUMNS: dict[str, pa.DataType] = {
    "t": pa.float64(),
    "body": pa.int64(),
    **dict.fromkeys(STATE, pa.float64()),
}
ABOUT: dict[str, type] = {
    "format_version": int,
    "loop": dict,
    "made_by": dict,
    "verdict": str,
    "reason": str,
    "reached": float,
    "measures": dict,
    "radius": list,
    "events": list,
}
"""What a file says of itself, and of what type."""
ABOUT_LIMIT = 100_000_000
"""Longest text that a file says of itself [bytes]; its events are in it."""


def made_by(loop: Loop) -> dict[str, str]:
    """Versions and machine that a result depends on.  Raises ImportError for an absent package."""
    solver = METHOD if loop.solver.startswith("sloppy") else loop.solver
    own = [Path(str(module.__file__)) for module in (in_loop, run_physics)]
    return {
        "problems": problems_version(),
        "solver": solver_version(solver),
        "harness": source_hash(own),
        "machine": machine_label(),
    }


def loop_path(folder: Path, loop: Loop) -> Path:
    """Where the result is kept."""
    return folder / "loops" / f"{loop.name}.parquet"


def write_loop(folder: Path, result: LoopResult) -> None:
    """Keep the result, at once or not at all."""
    motion = result.motion
    about = {
        "format_version": FORMAT_VERSION,
        "loop": asdict(result.loop),
        "made_by": made_by(result.loop),
        "verdict": result.verdict,
        "reason": result.reason,
        "reached": float(result.reached),
        "measures": dict(result.measures),
        "radius": [] if motion is None else motion.radius.tolist(),
        "events": [] if motion is None else [list(event) for event in motion.events],
    }
    table = pa.table(_columns(motion), schema=pa.schema(list(COLUMNS.items())))
    write_whole(loop_path(folder, result.loop), parquet_bytes(table, json.dumps(about)))


def _columns(motion: Motion | None) -> dict[str, Any]:
    t, q, v = (
        (np.empty(0), np.empty((0, 0, 3)), np.empty((0, 0, 3)))
        if motion is None
        else (motion.t, motion.q, motion.v)
    )
    n, bodies, _ = q.shape
    state = np.concatenate([q, v], axis=2).reshape(n * bodies, 6)
    columns = {name: state[:, i] for i, name in enumerate(STATE)}
    return {"t": np.repeat(t, bodies), "body": _numbers(n, bodies), **columns}


def _numbers(n: int, bodies: int) -> Vector:
    """Number of the body of each row, at n times."""
    return np.tile(np.arange(1, bodies + 1, dtype=np.int64), n)


def load_loop(folder: Path, loop: Loop) -> LoopResult | None:
    """The result of this loop, or None where there is none.

    Raises StoreError, one line, for a file that is damaged or whose parts contradict each other,
    and where there is one of other parameters, by other code or of another machine.
    """
    path = loop_path(folder, loop)
    if not path.exists():
        return None

    def wrong(what: str) -> StoreError:
        return StoreError(" ".join(f"{path}: {what}; delete it and run again".split()))

    def check(file: pq.ParquetFile, size: int) -> dict[str, Any]:
        about = _read_about(path, file, wrong)
        check_layout(file, size, COLUMNS, 8 * len(COLUMNS), wrong)
        return about

    about, table = read_parquet(path, check, wrong, metadata_limit=ABOUT_LIMIT)
    for kept, now in ((about["loop"], asdict(loop)), (about["made_by"], made_by(loop))):
        refuse_other(path, kept, now)
    return LoopResult(
        loop=loop,
        verdict=about["verdict"],
        reason=about["reason"],
        reached=about["reached"],
        measures=about["measures"],
        motion=_motion(about, table, wrong) if about["radius"] else None,
    )


def _read_about(path: Path, file: pq.ParquetFile, wrong: Wrong) -> dict[str, Any]:
    """What the file says of itself, once it has the right fields."""
    about = said_of_itself(file, wrong) or {}
    version = about.get("format_version")
    if version != FORMAT_VERSION:
        raise StoreError(
            f"{path}: has format {str(version)[:20]}, this glambda reads {FORMAT_VERSION}; "
            "use an empty folder"
        )
    if {name: type(value) for name, value in about.items()} != ABOUT:
        raise wrong(f"what it says of itself needs the fields {', '.join(ABOUT)}, of their types")
    if about["verdict"] not in VERDICTS:
        raise wrong(f"verdict {about['verdict'][:40]!r} is unknown")
    if not all(_is_number(value) for value in (*about["measures"].values(), *about["radius"])):
        raise wrong("measures or radius: not all of it are numbers")
    if not all(_is_event(entry) for entry in about["events"]):
        raise wrong("events: not all of them are a time, a kind and a text")
    return about


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_event(entry: Any) -> bool:
    if not isinstance(entry, list) or len(entry) != 3:
        return False
    return _is_number(entry[0]) and isinstance(entry[1], str) and isinstance(entry[2], str)


def _motion(about: Mapping[str, Any], table: pa.Table, wrong: Wrong) -> Motion:
    """The motion, once its bodies stand in turn at times that do not go back."""
    bodies, rows = len(about["radius"]), table.num_rows
    columns: dict[str, Vector] = {name: table[name].to_numpy() for name in COLUMNS}
    t = columns["t"][::bodies]
    if rows % bodies or not np.array_equal(columns["body"], _numbers(rows // bodies, bodies)):
        raise wrong(f"column body: is not 1 to {bodies} over and over")
    if not np.array_equal(columns["t"], np.repeat(t, bodies)) or (np.diff(t) < 0).any():
        raise wrong("column t: is not the same for all bodies, or goes back")
    if not np.isfinite(t).all():
        raise wrong("column t: not all of it are finite numbers")
    state = np.stack([columns[name] for name in STATE], axis=1).reshape(-1, bodies, 6)
    return Motion(
        t=t,
        q=state[:, :, :3],
        v=state[:, :, 3:],
        radius=np.array(about["radius"], float),
        events=[Event(*entry) for entry in about["events"]],
    )
