"""Tables of results as Parquet files with a seal, and how a stranger's are read.

They are written without compression and in one block of rows, with columns of numbers in plain, so
that a row takes no less than a known number of bytes.  A reader trusts nothing:

1. The seal, before the Parquet library sees a byte: a flipped bit can make that abort the process.
2. Before any column is read: what the file says about itself (JSON under `METADATA`), the columns'
   names and types, one block of rows, no compression, and no more rows than the file has room for.
   So what is read takes memory in proportion to the size of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from harness.files.json_file import parsed
from harness.files.plain_files import Unreadable, open_plain
from harness.files.seal import SEAL, UNSEALED, intact, sealed

METADATA = b"glambda"
"""Name under which a file says what it is."""
FILE_LIMIT = 1_000_000_000
"""Largest file that is read [bytes]."""

Wrong = Callable[[str], ValueError]
"""Makes the error for what is wrong with a file."""
About = TypeVar("About")


def parquet_bytes(table: pa.Table, about: str, packed: Iterable[str] = ()) -> bytes:
    """The content of a file, sealed.

    about : JSON;  packed : columns of which each value is stored once
    """
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink,
        table.schema,
        compression="none",
        use_dictionary=list(packed),
        write_statistics=False,
        store_schema=False,
    ) as writer:
        writer.write_table(table, row_group_size=max(1, table.num_rows))
        writer.add_key_value_metadata({METADATA: about, "seal": SEAL + UNSEALED})
    return sealed(bytes(sink.getvalue()))


def read_parquet(
    path: Path,
    check: Callable[[pq.ParquetFile, int], About],
    wrong: Wrong,
    *,
    texts: Iterable[str] = (),
    metadata_limit: int,
) -> tuple[About, pa.Table]:
    """What a file says of itself, and its table.

    check : looks at the file, of so many bytes, before any column is read, and returns the former
    texts : columns that stay packed;  metadata_limit : longest name, text and list [bytes, entries]

    Raises what `wrong` makes, for a file that is damaged or cannot be read, and what `check` does.
    """
    try:
        with open_plain(path, FILE_LIMIT) as file:
            if not intact(file):
                raise Unreadable(
                    "its seal is missing or wrong: it is damaged, foreign or of another version"
                )
            content = file.read()
    except OSError as error:
        raise wrong(f"cannot be read ({error.strerror or error})") from None
    except Unreadable as error:
        raise wrong(str(error)) from None
    limits = {
        "thrift_string_size_limit": metadata_limit,
        "thrift_container_size_limit": metadata_limit,
    }
    try:
        with pq.ParquetFile(pa.BufferReader(content), **limits) as opened:
            about = check(opened, len(content))
        with pq.ParquetFile(
            pa.BufferReader(content), read_dictionary=list(texts), **limits
        ) as opened:
            table = opened.read(use_threads=False)
            table.validate(full=True)
    except type(wrong("")):
        raise
    # The bytes are foreign: pyarrow raises any of these on a damaged file.
    except (OSError, ValueError, LookupError, TypeError, MemoryError, pa.ArrowException) as error:
        raise wrong(f"cannot be read ({str(error)[:200]})") from None
    return about, table


def said_of_itself(file: pq.ParquetFile, wrong: Wrong) -> dict[str, Any] | None:
    """The JSON object under `METADATA`; None where there is nothing."""
    text = (file.metadata.metadata or {}).get(METADATA)
    if text is None:
        return None
    try:
        said = parsed(text)
    except Unreadable as error:
        raise wrong(f"what it says of itself {error}") from None
    if not isinstance(said, dict):
        raise wrong("what it says of itself is no JSON object")
    return said


def check_layout(
    file: pq.ParquetFile,
    size: int,
    kinds: Mapping[str, pa.DataType],
    row_bytes: int,
    wrong: Wrong,
) -> None:
    """Look at names, types and sizes before any column is read.

    size : of the file [bytes];  row_bytes : that a row takes at least
    """
    about, schema = file.metadata, file.schema_arrow
    if schema.names != list(kinds):
        raise wrong("has other columns than this version")
    for name, kind in zip(schema.names, schema.types, strict=True):
        if kind != kinds[name]:
            raise wrong(f"column {name} has type {kind} instead of {kinds[name]}")
    if about.num_rows * row_bytes > size:
        raise wrong(f"claims {about.num_rows} rows, more than its {size} bytes can hold")
    if about.num_row_groups > 1:
        raise wrong(f"has {about.num_row_groups} blocks of rows instead of one")
    for group in range(about.num_row_groups):
        for column in range(about.num_columns):
            if about.row_group(group).column(column).compression != "UNCOMPRESSED":
                raise wrong(f"column {schema.names[column]} is compressed")
