"""Test sets of qpbenchmark: a Parquet file of problems, and the class that loads it.

A row holds P, G and A row by row, q, h, b, lb, ub and a name; what is left out is null.  A recorded
QP is written as P = AᵀA, q = Aᵀd with its bounds: what squaring costs the condition is in there, as
qpbenchmark knows no other form.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from harness.exchange.foreign import ENTRY_LIMIT, FILE_LIMIT, Foreign
from harness.exchange.npz import Problem, quadratic
from harness.files.whole_files import write_whole
from harness.recordings.recording import Recording

SUFFIXES = (".parquet",)
KEYS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
TEST_SET = '''"""{name}: contact QPs of glambda, for qpbenchmark.

    qpbenchmark --results-path results.csv {name}.py run
"""

from pathlib import Path

import qpbenchmark


class {title}(qpbenchmark.ParquetTestSet):
    description = "min 1/2 |A x + d|^2 within bounds, as P = A'A, q = A'd"
    sparse_only = False
    title = "{name}"

    def __init__(self):
        super().__init__(Path(__file__).parent / "{name}.parquet")
'''


def read(file: BinaryIO) -> list[Problem]:
    """The problems of an open file.  Raises Foreign, naming the column."""
    try:
        opened = pq.ParquetFile(file)
        about = opened.metadata
        unpacked = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        if not 0 <= unpacked <= FILE_LIMIT or not 0 <= about.num_rows <= ENTRY_LIMIT:
            raise Foreign(f"file: unpacks to {unpacked:,} bytes, more than {FILE_LIMIT:,}")
        names = set(opened.schema_arrow.names)
        if not {"P", "q"} <= names:
            raise Foreign("file: has no columns P and q; a test set of qpbenchmark has")
        rows = opened.read(columns=[key for key in KEYS if key in names]).to_pylist()
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        if isinstance(error, Foreign):
            raise
        raise Foreign(f"file: cannot be read as Parquet ({str(error)[:120]})") from None
    return [_problem(row, number) for number, row in enumerate(rows)]


def _problem(row: dict[str, Any], number: int) -> Problem:
    try:
        arrays = {name: np.array(value) for name, value in row.items() if value is not None}
    except ValueError:
        raise Foreign(f"row {number}: holds lists of several lengths") from None
    if not {"P", "q"} <= arrays.keys():
        raise Foreign(f"row {number}: has no P or no q")
    n = arrays["q"].size
    for name in ("P", "G", "A"):
        if name in arrays:
            if n == 0 or arrays[name].size % n:
                raise Foreign(
                    f"row {number}, {name}: {arrays[name].size} entries are no rows of {n}"
                )
            arrays[name] = arrays[name].reshape(-1, n)
    try:
        return quadratic(arrays)
    except Foreign as error:
        raise Foreign(f"row {number}, {error}") from None


def write(folder: Path, recording: Recording) -> list[Path]:
    """Write NAME.parquet and NAME.py into a folder, NAME being the label as Python may call it.

    Returns what is written.
    """
    name = re.sub(r"\W", "_", recording.scene)
    name = name if name.isidentifier() else f"set_{name}"
    title = name.title().replace("_", "")  # as qpbenchmark calls the class of a file
    columns: dict[str, list[Any]] = {key: [] for key in (*KEYS, "name")}
    for number, qp in enumerate(recording.qps):
        A = qp.dense_A
        values = {"P": (A.T @ A).ravel(), "q": A.T @ qp.d, "lb": qp.lower, "ub": qp.upper,
                  "name": f"{name}/{number:06d}"}  # fmt: skip
        for key in columns:
            columns[key].append(values.get(key))
    numbers = pa.list_(pa.float64())
    table = pa.table(
        {key: pa.array(columns[key], pa.string() if key == "name" else numbers) for key in columns}
    )
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    data, source = folder / f"{name}.parquet", folder / f"{name}.py"
    write_whole(data, buffer.getvalue())
    write_whole(source, TEST_SET.format(name=name, title=title).encode())
    return [data, source]
