"""The Maros–Mészáros problems as MATLAB files: P, q, r and l ≤ A x ≤ u, the bounds on x among its
rows.  Reading only.

Integers of one byte in them are numbers like others; 1e20 is ∞.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp
from scipy.io import loadmat

from harness.exchange.apart import arrays_apart
from harness.exchange.foreign import FILE_LIMIT, Foreign
from harness.exchange.quadratic import Quadratic

SUFFIXES = (".mat",)
NAMES = ("P", "q", "A", "l", "u")


def read(file: BinaryIO) -> list[Quadratic]:
    """The problem of an open file.  Raises Foreign, naming the variable."""
    _check_unpacked(file)
    found = arrays_apart(_extract, file)
    P, A = (_matrix(name, found) for name in ("P", "A"))
    return [Quadratic.of(P, found["q"], [("A", A, found["l"], found["u"])])]


def _extract(file: BinaryIO) -> dict[str, np.ndarray]:
    """The variables, sparse ones in their parts."""
    try:
        found: dict[str, Any] = loadmat(file, variable_names=NAMES, mat_dtype=True)
    except MemoryError:
        raise Foreign("file: asks for more memory than there is") from None
    except Exception as error:  # the bytes are foreign: SciPy raises whatever it comes upon
        raise Foreign(f"file: cannot be read as MATLAB 5 ({str(error)[:120]})") from None
    out: dict[str, np.ndarray] = {}
    for name in NAMES:
        if name not in found:
            raise Foreign(f"{name}: is missing; a file of the set has {', '.join(NAMES)}")
        value = found[name]
        if value.dtype.kind == "b":  # by its flag: numbers would become 1
            raise Foreign(f"{name}: holds logical values, and should hold numbers")
        if sp.issparse(value):
            parts = sp.coo_array(value)
            out |= {f"{name}/rows": parts.coords[0], f"{name}/columns": parts.coords[1],
                    f"{name}/values": parts.data,
                    f"{name}/shape": np.array(parts.shape)}  # fmt: skip
        elif np.asarray(value).dtype.hasobject:
            raise Foreign(f"{name}: holds no numbers")
        else:
            out[name] = value
    for name in ("q", "l", "u"):
        if name not in out:
            raise Foreign(f"{name}: is sparse, and should be a vector")
    return out


def _matrix(name: str, found: Mapping[str, np.ndarray]) -> Any:
    if name in found:
        return found[name]
    rows, columns, values, shape = (
        found[f"{name}/{part}"] for part in ("rows", "columns", "values", "shape")
    )
    m, n = shape.tolist()
    if rows.size and not (
        0 <= rows.min() <= rows.max() < m and 0 <= columns.min() <= columns.max() < n
    ):
        raise Foreign(f"{name}: has entries outside its shape {(m, n)}")
    return sp.csc_array((values, (rows, columns)), shape=(m, n))


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
