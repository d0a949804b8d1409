"""Whether the columns of a dense matrix are independent beyond doubt, compiled.

See `problems.least_norm.minimum_norm.surely_independent`.
"""

from __future__ import annotations

from math import sqrt

from problems.kernels.arena import zeros
from problems.kernels.compiled import in_rows, kernel

RANK_TOL = 1e-10
"""Diagonal entries of R below this fraction of the first count as 0."""
ACCURACY = 1e-12
"""Accuracy asked of the least-squares residual, whose last entry is at least ½."""
SAFE_FRACTION = 1e-6
"""Singular values above this fraction of ‖A‖_F leave no doubt about the rank."""


@kernel
def far_from_dependent(A, fraction, arena=None):
    """Whether AᵀA − τ²I of A (m, k) has Cholesky factors, τ = `fraction` ‖A‖_F."""
    m, k = A.shape
    if k > m:
        return False
    L = in_rows(zeros(arena, k * k), k, k)
    for e in range(m):
        for i in range(k):
            if A[e, i] != 0.0:
                for j in range(i + 1):
                    L[i, j] += A[e, i] * A[e, j]
    trace = 0.0
    for i in range(k):
        trace += L[i, i]
    for i in range(k):
        for j in range(i):
            value = L[i, j]
            for e in range(j):
                value -= L[i, e] * L[j, e]
            L[i, j] = value / L[j, j]
        value = L[i, i] - fraction**2 * trace
        for e in range(i):
            value -= L[i, e] ** 2
        if not value > 0.0:
            return False
        L[i, i] = sqrt(value)
    return True
