"""A claim and the rows that it is judged by: measured unit by unit, stored, and read back.

    RESULTS/<claim>/<unit>.parquet

Whatever is measured on the method goes the same way: a claim names its units of work, each unit
gives rows, and a report makes its verdict of the rows.

1. The rows of a unit are stored as soon as they are there, so that the same call continues after an
   interruption.
2. A file (`harness.files.sealed_parquet`) says of itself which claim and unit it is of, and which
   code and machine it was made by.  Rows of others are refused: they may not be mixed.
3. What is given back is read from the files, never from memory.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from harness.files.folder_lock import sole_writer
from harness.files.sealed_parquet import check_layout, parquet_bytes, read_parquet, said_of_itself
from harness.files.whole_files import write_whole
from harness.machine.machine import machine_label, problems_version, source_hash
from harness.names import METHOD
from harness.processes.introduction import solver_version
from harness.progress import Progress
from harness.results.shard_file import StoreError, refuse_other
from problems.kernels.sources import sources

FORMAT_VERSION = 1
ABOUT_LIMIT = 100_000
"""Longest text that a file says of itself [bytes]."""
TYPES = {"i": pa.int64(), "f": pa.float64(), "b": pa.bool_()}
"""Of columns, by the kind of their numbers; all others hold text."""
LEAST = {pa.int64(): 8, pa.float64(): 8, pa.bool_(): 0, pa.string(): 4}
"""Bytes that a value takes at least, by the type of its column."""

Unit = Mapping[str, Any]
"""What a unit is about: numbers and texts, parameters of the function that makes its rows."""
Row = dict[str, Any]
"""Values of a row, or whole columns, by name."""
Rows = Callable[..., pd.DataFrame | list[Row] | Row]


@dataclass(frozen=True, eq=False)
class Claim:
    """Something that is claimed of the method, and how it is measured.

    name : folder of its rows;  rows : called with what a unit names, gives its rows as pandas takes
        them; what the unit names stands before their columns
    units : in the order of the rows;  solvers : whose versions the rows depend on
    """

    name: str
    rows: Rows
    units: Sequence[Unit]
    solvers: Sequence[str] = (METHOD,)

    @cached_property
    def made_by(self) -> dict[str, str]:
        """Versions and machine.  Raises ImportError for an absent package."""
        rows: Any = self.rows
        while isinstance(rows, partial):
            rows = rows.func
        own = sources([Path(inspect.getfile(inspect.unwrap(rows)))], ["harness"])
        return {
            "problems": problems_version(),
            **{solver: solver_version(solver) for solver in self.solvers},
            "harness": source_hash(own),
            "machine": machine_label(),
        }

    def path(self, folder: Path, unit: Unit) -> Path:
        """Where the rows of a unit are kept."""
        name = "__".join(re.sub(r"[^\w.,=+-]+", "_", str(value)) for value in unit.values())
        return folder / self.name / f"{name}.parquet"

    def store(self, folder: Path, unit: Unit) -> None:
        """Measure a unit and keep its rows, at once or not at all."""
        # numbers beside a part without rows are objects
        found = pd.DataFrame(self.rows(**unit)).infer_objects()
        rows = found.assign(**unit)[[*unit, *found.columns.difference(list(unit), sort=False)]]
        columns = {
            str(name): pa.array(column.to_numpy(), TYPES.get(column.dtype.kind, pa.string()))
            for name, column in rows.items()
        }
        content = parquet_bytes(pa.table(columns), json.dumps(self._about(unit)))
        write_whole(self.path(folder, unit), content)

    def load(self, folder: Path, unit: Unit) -> pd.DataFrame | None:
        """The rows of a unit as they are stored, or None where there are none.

        Raises StoreError, one line, for a damaged file and for rows of another unit, of other code
        or of another machine.
        """
        path, wanted = self.path(folder, unit), self._about(unit)
        if not path.exists():
            return None

        def wrong(what: str) -> StoreError:
            return StoreError(" ".join(f"{path}: {what}; delete it and run again".split()))

        def check(file: pq.ParquetFile, size: int) -> None:
            said = said_of_itself(file, wrong) or {}
            refuse_other(path, said, wanted)
            kinds = dict(zip(file.schema_arrow.names, file.schema_arrow.types, strict=True))
            if not set(kinds.values()) <= set(LEAST):
                raise wrong("has columns of neither numbers nor text")
            check_layout(file, size, kinds, sum(LEAST[kind] for kind in kinds.values()), wrong)

        _, table = read_parquet(path, check, wrong, metadata_limit=ABOUT_LIMIT)
        return table.to_pandas()

    def _about(self, unit: Unit) -> dict[str, Any]:
        """What a file says of itself."""
        return {
            "format_version": FORMAT_VERSION,
            "claim": self.name,
            "unit": dict(unit),
            **self.made_by,
        }


def claim_over(name: str, rows: Rows, **ranges: Iterable[Any]) -> Claim:
    """A claim with a unit for each combination of values, the last name varying fastest."""
    units = [dict(zip(ranges, values, strict=True)) for values in product(*ranges.values())]
    return Claim(name, rows, units)


def measure(
    claims: Sequence[Claim], folder: str | Path, progress: Progress | None = None
) -> dict[str, pd.DataFrame]:
    """Measure what is not in the folder yet; all rows of each claim, by its name.

    Raises StoreError as `Claim.load` does, and Locked where another process writes there.
    """
    folder = Path(folder)
    done, total = 0, sum(len(claim.units) for claim in claims)
    found = {}
    for claim in claims:
        parts = []
        with sole_writer(folder, claim.name):
            for unit in claim.units:
                part = claim.load(folder, unit)
                if part is None:
                    if progress is not None:
                        progress(f"{claim.name}: {next(iter(unit.values()))}", done, total)
                    claim.store(folder, unit)
                    part = claim.load(folder, unit)
                assert part is not None
                parts.append(part)
                done += 1
        # columns alone, where no unit has a row
        whole = [part for part in parts if len(part)] or parts[:1]
        found[claim.name] = pd.concat(whole, ignore_index=True)
    return found
