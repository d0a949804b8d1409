"""A sparse matrix as a dense array, compiled: SciPy takes longer than a small QP does to solve."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from problems.kernels.compiled import Direct, kernel


@kernel
def spread(data, rows, first, A):
    """The entries of sparse columns into A (m, k), which is 0."""
    for j in range(A.shape[1]):
        for e in range(first[j], first[j + 1]):
            A[rows[e], j] = data[e]


SPREAD = {np.dtype(kind): Direct(spread) for kind in (np.int32, np.int64)}
"""By the type of the indices."""


def dense_array(A: Any) -> NDArray[np.float64]:
    """A (m, k), CSC without duplicates, as a read-only C array."""
    dense = np.zeros(A.shape)
    SPREAD[A.indices.dtype](A.data, A.indices, A.indptr, dense)
    dense.setflags(write=False)
    return dense


def compile_spread() -> None:
    """Have it as machine code, of the cache or new, before the first call."""
    for kind in SPREAD:
        data, rows, first = np.ones(1), np.zeros(1, kind), np.array([0, 1], kind)
        for part in (data, rows, first):
            part.setflags(write=False)
        SPREAD[kind](data, rows, first, np.zeros((1, 1)))
