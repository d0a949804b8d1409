"""Whether the columns of a dense matrix are independent beyond doubt, compiled.

See `problems.least_norm.minimum_norm.surely_independent`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
import scipy.sparse as sp
from numpy.linalg import norm
from scipy.sparse.linalg import splu

from problems.kernels.arena import zeros
from problems.kernels.compiled import kernel
from problems.kernels.numba_internals import in_rows
from problems.qp import Matrix, Vector

SPARSE_SAFE_FRACTION = 3e-7
"""`SAFE_FRACTION` for a sparse A, as a fraction of its longest column."""

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


class IndependenceProof:
    """`surely_independent` of sparse matrices of one pattern, one after the other.

    Where no singular value of A is below 2τ, none of another matrix is below 2τ − ‖their
    difference‖_F (Weyl), so that what hardly moves need not be factorized again.
    """

    def __init__(self) -> None:
        self._entries: Vector | None = None
        self._room = 0.0

    def holds(self, A: sp.csc_array) -> bool:
        """Whether the columns of A are independent beyond doubt."""
        # τ of today's A may be larger than that of the proof by its share of the difference
        if self._entries is not None and 2 * norm(A.data - self._entries) <= self._room:
            return True
        self._entries = None
        if surely_independent(A, 2.0):
            columns = np.add.reduceat(A.data**2, A.indptr[:-1])
            self._entries = A.data
            self._room = SPARSE_SAFE_FRACTION * float(np.sqrt(columns.max()))
            return True
        return surely_independent(A)


def surely_independent(A: Matrix, multiple: float = 1.0) -> bool:
    """Whether the columns of A (m, k) are independent beyond doubt; False proves nothing.

    With τ = `SAFE_FRACTION` ‖A‖_F, AᵀA − τ²I has Cholesky factors only if every singular value
    exceeds τ: far above rounding, which is some k u ‖A‖² in AᵀA, and far above `RANK_TOL`.  An
    entry of a sparse AᵀA is a sum of a few products, and a long chain of contacts has singular
    values of 1/n², so that τ is smaller there.

    multiple : of τ that is asked for
    """
    m, k = A.shape
    if k == 0 or k > m:
        return k == 0
    if not sp.issparse(A):
        return bool(far_from_dependent(A, multiple * SAFE_FRACTION))
    normal = A.T @ A
    shift = (multiple * SPARSE_SAFE_FRACTION) ** 2 * normal.diagonal().max()
    try:
        factors = splu(
            sp.csc_matrix(normal - shift * sp.eye_array(k)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:  # a pivot of 0
        return False
    symmetric = np.array_equal(factors.perm_r, factors.perm_c)
    return symmetric and bool((factors.U.diagonal() > 0).all())
