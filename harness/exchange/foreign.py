"""Numbers of strangers: checked before anything is made of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.qp import LARGEST, Matrix, Vector

INFINITE = 1e20
"""From this size on a bound is none: QPLIB, MPS and their heirs write 1e20 for ∞."""
FILE_LIMIT = 1_000_000_000
"""Largest foreign file that is read [bytes]."""
ENTRY_LIMIT = 100_000_000
"""Most numbers of one array."""


class Foreign(ValueError):
    """Data of others that cannot be taken: which field, what is wrong, what helps."""


def vector(name: str, value: Any, size: int | None = None, *, bound: bool = False) -> Vector:
    """(size,) float64 of an array of shape (size,), (size, 1) or (1, size).

    bound : whether entries may be infinite, and are from `INFINITE` on

    Raises Foreign, naming the field.
    """
    array = _numbers(name, value)
    if array.ndim > 2 or (array.ndim == 2 and 1 not in array.shape):
        raise Foreign(f"{name}: has shape {array.shape}, and should be a vector")
    array = array.reshape(-1)
    if size is not None and array.size != size:
        raise Foreign(f"{name}: has {array.size} entries, and should have {size}")
    if not bound:
        return _finite(name, array)
    if np.isnan(array).any():
        raise Foreign(f"{name}: holds NaN at index {int(np.argmax(np.isnan(array)))}")
    return endless(array)


def endless(bounds: Vector) -> Vector:
    """Bounds, infinite from `INFINITE` on."""
    return np.where(np.abs(bounds) >= INFINITE, np.copysign(np.inf, bounds), bounds)


def matrix(name: str, value: Any, shape: tuple[int | None, int | None] = (None, None)) -> Matrix:
    """(m, n) float64, sparse where it is sparse.  Raises Foreign, naming the field."""
    if sp.issparse(value):
        made = sp.csc_array(value, dtype=np.float64)
        _finite(name, made.data)
    else:
        made = _finite(name, _numbers(name, value))
    if made.ndim != 2 or any(w not in (None, s) for w, s in zip(shape, made.shape, strict=True)):
        wanted = " × ".join("?" if w is None else str(w) for w in shape)
        raise Foreign(f"{name}: has shape {made.shape}, and should be a matrix {wanted}")
    return made


def bounds(lower: Any, upper: Any, size: int) -> tuple[Vector, Vector]:
    """Lower and upper bounds (size,); None: none.  Raises Foreign where they cross."""
    low = np.full(size, -np.inf) if lower is None else vector("lb", lower, size, bound=True)
    high = np.full(size, np.inf) if upper is None else vector("ub", upper, size, bound=True)
    return in_order("lb", low, "ub", high)


def in_order(name: str, low: Vector, other: str, high: Vector) -> tuple[Vector, Vector]:
    """Both, where low ≤ high and neither asks for the impossible; else raises Foreign."""
    crossed = np.flatnonzero((low > high) | (low == np.inf) | (high == -np.inf))
    if crossed.size:
        i = int(crossed[0])
        raise Foreign(f"{name}: is {low[i]:g} at index {i}, where {other} is {high[i]:g}")
    return low, high


def _numbers(name: str, value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise Foreign(f"{name}: holds {array.dtype}, and should hold numbers")
    if array.size > ENTRY_LIMIT:
        raise Foreign(f"{name}: has {array.size:,} entries, more than {ENTRY_LIMIT:,}")
    return array.astype(np.float64)


def _finite(name: str, array: np.ndarray) -> np.ndarray:
    bad = ~(np.abs(array) <= LARGEST)
    if bad.any():
        where = np.argwhere(bad)[0].tolist()
        raise Foreign(f"{name}: holds {array[tuple(where)]:g} at index {where}")
    return array
