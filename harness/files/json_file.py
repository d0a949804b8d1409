"""Small JSON documents on disk, and how a stranger's are read: bounded, and checked for types.

A document that is a result is sealed (`harness.files.seal`), under the name `SEALED`.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.files.plain_files import Unreadable, open_plain
from harness.files.seal import SEAL, UNSEALED, intact, sealed

LIMIT = 10_000_000
"""Largest document that is read [bytes]."""
SEALED = "seal"
"""Name of the seal in a sealed document."""


def sealed_json(values: Mapping[str, Any]) -> bytes:
    """The content of a sealed document."""
    seal = (SEAL + UNSEALED).decode()
    return sealed(json.dumps({**values, SEALED: seal}, indent=1).encode())


def read_json(path: Path, *, must_be_sealed: bool = False) -> dict[str, Any]:
    """The names and values of a document, without its seal.

    Raises Unreadable for what is no such document or was damaged, OSError where there is none.
    """
    with open_plain(path, LIMIT) as file:
        content = file.read(LIMIT)
    if must_be_sealed and not intact(io.BytesIO(content)):
        raise Unreadable("its seal is missing or wrong: it was damaged or altered")
    values = parsed(content)
    if not isinstance(values, dict):
        raise Unreadable("is no JSON object of names and values")
    if must_be_sealed:
        del values[SEALED]
    return values


def parsed(text: bytes | str) -> Any:
    """The value that a JSON document holds; raises Unreadable where it is none."""
    try:
        return json.loads(text)
    except RecursionError:
        raise Unreadable("is no JSON: it is nested too deep") from None
    except ValueError as error:
        raise Unreadable(f"is no JSON ({' '.join(str(error).split())[:100]})") from None
