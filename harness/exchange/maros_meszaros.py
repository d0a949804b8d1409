"""The Maros–Mészáros problems as MATLAB files: P, q, r and l ≤ A x ≤ u, the bounds on x among its
rows.  Reading only.

Integers of one byte in them are numbers like others; 1e20 is ∞.
"""

from __future__ import annotations

import zlib
from typing import Any, BinaryIO

from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from harness.exchange.foreign import FILE_LIMIT, Foreign
from harness.exchange.quadratic import Quadratic

SUFFIXES = (".mat",)
NAMES = ("P", "q", "A", "l", "u")


def read(file: BinaryIO) -> list[Quadratic]:
    """The problem of an open file.  Raises Foreign, naming the variable."""
    _check_unpacked(file)
    try:
        found: dict[str, Any] = loadmat(file, variable_names=NAMES, mat_dtype=True)
    except MemoryError:
        raise Foreign("file: asks for more memory than there is") from None
    # the bytes are foreign: SciPy raises any of these on what it cannot make sense of
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError, NotImplementedError,
            OverflowError, ArithmeticError, AttributeError, zlib.error) as error:  # fmt: skip
        raise Foreign(f"file: cannot be read as MATLAB 5 ({str(error)[:120]})") from None
    absent = [name for name in NAMES if name not in found]
    if absent:
        raise Foreign(f"{absent[0]}: is missing; a file of the set has {', '.join(NAMES)}")
    return [Quadratic.of(found["P"], found["q"], [("A", found["A"], found["l"], found["u"])])]


def _check_unpacked(file: BinaryIO) -> None:
    """Refuse what unpacks to too much: elements of type 15 are packed by zlib."""
    content = file.read()
    order = "big" if content[126:128] == b"MI" else "little"
    at, total = 128, 0
    while at + 8 <= len(content):
        kind = int.from_bytes(content[at : at + 4], order)  # type: ignore[arg-type]
        size = int.from_bytes(content[at + 4 : at + 8], order)  # type: ignore[arg-type]
        if kind == 15:
            unpacker = zlib.decompressobj()
            try:
                total += len(unpacker.decompress(content[at + 8 : at + 8 + size], FILE_LIMIT + 1))
            except zlib.error as error:
                raise Foreign(f"file: is damaged ({error})") from None
        if total > FILE_LIMIT:
            raise Foreign(f"file: unpacks to more than {FILE_LIMIT:,} bytes")
        at += 8 + size
    file.seek(0)
