"""NumPy archives: (A, b, lb, ub) or (P, q, lb, ub), one problem or a sequence, both ways.

    A, b, lb, ub [, row_id]            min ½‖A x − b‖² within bounds: ours, d = −b
    P, q, G, h, A, b, lb, ub           min ½ xᵀP x + qᵀx, G x ≤ h, A x = b, of `qpsolvers`
    G, g, mus                          Delassus matrix, free velocity, μ; the normal comes last

What is left out or None is no bound or no row.  A sequence is a stack, one axis more in front of A
or P (bounds may do without), or numbered names, A_0, b_0, A_1, …, which is how it is written here.

A file is looked at before it is read: sizes in its headers are held against what is there and what
is allowed, and no object is ever unpickled.
"""

from __future__ import annotations

import io
import pickletools
import re
import zipfile
from collections import defaultdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.sparse as sp

from harness.exchange.coulomb import Contacts
from harness.exchange.foreign import ENTRY_LIMIT, FILE_LIMIT, Foreign, matrix, vector
from harness.exchange.quadratic import LeastSquares, Quadratic
from harness.files.whole_files import write_whole
from harness.recordings.recording import Recording

SUFFIXES = (".npz",)
LEAST_SQUARES = {"A", "b", "lb", "ub", "row_id"}
QUADRATIC = {"P", "q", "G", "h", "A", "b", "lb", "ub"}
DELASSUS = {"G", "g", "mus"}
Problem = LeastSquares | Quadratic | Contacts


def read(file: BinaryIO) -> list[Problem]:
    """The problems of an open file.  Raises Foreign, naming the array."""
    try:
        with zipfile.ZipFile(file) as archive:
            arrays = _arrays(archive)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise Foreign(f"file: is no NumPy archive ({error})") from None
    return [_problem(named) for named in _one_by_one(arrays)]


def write(folder: Path, recording: Recording) -> list[Path]:
    """Write LABEL.npz with numbered A, b, lb, ub and row_id, A dense.  Returns what is written.

    Raises ValueError where matrices have too many entries for that.
    """
    path = folder / f"{recording.scene}.npz"
    if sum(qp.m * qp.k for qp in recording.qps) > ENTRY_LIMIT:
        raise ValueError(f"{path}: the matrices have more than {ENTRY_LIMIT:,} entries when dense; "
                         "record a shorter motion")  # fmt: skip
    arrays: dict[str, np.ndarray] = {}
    for i, qp in enumerate(recording.qps):
        arrays |= {
            f"A_{i}": qp.dense_A,
            f"b_{i}": -qp.d,
            f"lb_{i}": qp.lower,
            f"ub_{i}": qp.upper,
            f"row_id_{i}": qp.row_id,
        }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    write_whole(path, buffer.getvalue())
    return [path]


def _arrays(archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    """Array by name; those that are None are left out."""
    members = archive.infolist()
    if sum(member.file_size for member in members) > FILE_LIMIT:
        raise Foreign(f"file: unpacks to more than {FILE_LIMIT:,} bytes")
    arrays = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        array = _array(name, archive.read(member))
        if array is not None:
            arrays[name] = array
    return arrays


def _array(name: str, content: bytes) -> np.ndarray | None:
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        header = {(1, 0): np.lib.format.read_array_header_1_0,
                  (2, 0): np.lib.format.read_array_header_2_0}[version]  # fmt: skip
        shape, by_column, dtype = header(stream)
    except (ValueError, KeyError, TypeError, SyntaxError, MemoryError, RecursionError) as error:
        raise Foreign(f"{name}: is no NumPy array ({str(error)[:80]})") from None
    there = content[stream.tell() :]
    if dtype.hasobject:
        if shape == () and _is_none(there):
            return None
        raise Foreign(f"{name}: holds Python objects, which are not unpickled; store numbers")
    count = 1
    for size in shape:
        if size < 0:
            raise Foreign(f"{name}: has shape {shape}")
        count *= size
    if count * dtype.itemsize != len(there) or dtype.itemsize == 0:
        raise Foreign(f"{name}: has {len(there)} bytes, and shape {shape} of {dtype} needs others")
    return np.frombuffer(there, dtype).reshape(shape, order="F" if by_column else "C")


def _is_none(pickled: bytes) -> bool:
    """Whether an array of objects without axes holds None; nothing of it is executed."""
    try:
        steps = [op.name for op, _, _ in pickletools.genops(pickled) if "PUT" not in op.name]
    except Exception:  # the bytes are foreign: genops raises whatever it comes upon
        return False
    steps = [step for step in steps if step != "MEMOIZE"]
    lists = [i for i, step in enumerate(steps) if "LIST" in step]
    return len(lists) == 1 and steps[lists[0] + 1 : lists[0] + 3] == ["NONE", "APPEND"]


def _one_by_one(arrays: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """The arrays of each problem."""
    numbered: dict[int, dict[str, np.ndarray]] = defaultdict(dict)
    for name, array in arrays.items():
        split = re.fullmatch(r"(\w+?)_(\d{1,9})", name)
        if split and split[1] in LEAST_SQUARES | QUADRATIC:
            numbered[int(split[2])][split[1]] = array
    if numbered:
        strange = len(arrays) - sum(map(len, numbered.values()))
        if strange or sorted(numbered) != list(range(len(numbered))):
            raise Foreign("file: numbered names must be A_0, b_0, …, without gaps or other names")
        return [numbered[i] for i in range(len(numbered))]
    lead = next((name for name in ("P", "A") if name in arrays), None)
    if lead is None or arrays[lead].ndim != 3:
        return [arrays]
    count, axes = len(arrays[lead]), {"P": 3, "A": 3, "G": 3}
    stacks = {n: a for n, a in arrays.items() if a.ndim == axes.get(n, 2)}
    for name, stack in stacks.items():
        if len(stack) != count:
            raise Foreign(f"{name}: has {len(stack)} problems, where {lead} has {count}")
    single = arrays.keys() - stacks.keys() - {"lb", "ub", "row_id"}
    if single:
        raise Foreign(f"{min(single)}: has no axis for the {count} problems of {lead}")
    return [{n: a[i] if n in stacks else a for n, a in arrays.items()} for i in range(count)]


def _problem(arrays: dict[str, np.ndarray]) -> Problem:
    names = set(arrays)
    if {"P", "q"} <= names <= QUADRATIC:
        return quadratic(arrays)
    if {"A", "b"} <= names <= LEAST_SQUARES:
        return LeastSquares.of(*(arrays.get(n) for n in ("A", "b", "lb", "ub", "row_id")))
    if names == DELASSUS:
        return _delassus(arrays)
    raise Foreign(
        f"file: holds {', '.join(sorted(names)[:12]) or 'nothing'}; known are A, b, lb, ub or P, "
        "q, G, h, A, b, lb, ub or G, g, mus"
    )


def quadratic(arrays: dict[str, Any]) -> Quadratic:
    """A problem in the words of `qpsolvers`, from arrays by name."""
    rows = []
    for name, right, equal in (("G", "h", False), ("A", "b", True)):
        if (name in arrays) != (right in arrays):
            raise Foreign(f"{name}, {right}: one is there without the other")
        if name in arrays:
            rows.append((name, arrays[name], arrays[right] if equal else None, arrays[right]))
    return Quadratic.of(arrays["P"], arrays["q"], rows, arrays.get("lb"), arrays.get("ub"))


def _delassus(arrays: dict[str, np.ndarray]) -> Contacts:
    mu = vector("mus", arrays["mus"])
    n = 3 * mu.size
    order = np.arange(n).reshape(-1, 3)[:, [2, 0, 1]].ravel()  # the normal first
    W = matrix("G", arrays["G"], (n, n))
    assert not sp.issparse(W)
    return Contacts(W[np.ix_(order, order)], vector("g", arrays["g"], n)[order], mu, 3)
