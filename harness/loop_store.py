"""A finished closed loop as a file: whole or absent, never mixed with another code's.

    RESULTS/loops/<scene>__<solver>__<setting>__<eps>.parquet

holds the motion, one row per accepted time and body (t, body, x, y, phi, vx, vy, omega), and in its
metadata what was run (`Loop`), by what (versions, machine), what came of it and all events.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness import in_loop, run_physics
from harness.in_loop import METHOD
from harness.loop import Loop, LoopResult
from harness.machine import machine_label, problems_version, solver_version, source_hash
from harness.motion_error import Motion
from harness.store import METADATA, StoreError
from harness.whole_files import write_whole
from problems.qp import Vector
from problems.run import Event

FORMAT_VERSION = 1
STATE = ("x", "y", "phi", "vx", "vy", "omega")


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
        "reached": result.reached,
        "measures": dict(result.measures),
        "radius": [] if motion is None else motion.radius.tolist(),
        "events": [] if motion is None else [list(event) for event in motion.events],
    }
    table = pa.table(_columns(motion)).replace_schema_metadata({METADATA: json.dumps(about)})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    write_whole(loop_path(folder, result.loop), bytes(sink.getvalue()))


def _columns(motion: Motion | None) -> dict[str, Any]:
    t, q, v = (
        (np.empty(0), np.empty((0, 0, 3)), np.empty((0, 0, 3)))
        if motion is None
        else (motion.t, motion.q, motion.v)
    )
    n, bodies, _ = q.shape
    state = np.concatenate([q, v], axis=2).reshape(n * bodies, 6)
    numbers = np.tile(np.arange(1, bodies + 1), n)
    columns = {name: state[:, i] for i, name in enumerate(STATE)}
    return {"t": np.repeat(t, bodies), "body": numbers.astype(np.int64), **columns}


def load_loop(folder: Path, loop: Loop) -> LoopResult | None:
    """The result of this loop, or None where there is none.

    Raises StoreError where there is one of other parameters, by other code or of another machine.
    """
    path = loop_path(folder, loop)
    if not path.exists():
        return None
    table, about = _read(path)
    for kept, now in ((about["loop"], asdict(loop)), (about["made_by"], made_by(loop))):
        for name, value in now.items():
            if kept.get(name) != value:
                raise StoreError(
                    f"{path}: made with {name} {kept.get(name)!r}, now {value!r}; "
                    "results may not be mixed: use another results folder, or delete this file"
                )
    return _result(loop, table, about)


def _read(path: Path) -> tuple[pa.Table, dict[str, Any]]:
    try:
        table = pq.ParquetFile(path).read()
        about = json.loads(table.schema.metadata[METADATA])
        version = about["format_version"]
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        line = " ".join(str(error).split())[:200]
        raise StoreError(f"{path}: cannot be read ({line}); delete it and run again") from None
    if version != FORMAT_VERSION:
        raise StoreError(
            f"{path}: has format {version}, this glambda reads {FORMAT_VERSION}; "
            "use an empty folder"
        )
    return table, about


def _result(loop: Loop, table: pa.Table, about: dict[str, Any]) -> LoopResult:
    motion = None
    if about["radius"]:
        bodies = len(about["radius"])
        columns: list[Vector] = [table[name].to_numpy() for name in STATE]
        state = np.stack(columns, axis=1).reshape(-1, bodies, 6)
        motion = Motion(
            t=table["t"].to_numpy()[::bodies],
            q=state[:, :, :3],
            v=state[:, :, 3:],
            radius=np.array(about["radius"]),
            events=[Event(*entry) for entry in about["events"]],
        )
    return LoopResult(
        loop, about["verdict"], about["reason"], about["reached"], about["measures"], motion
    )
