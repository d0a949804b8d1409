"""The span of a set of columns: the least vector that corrects their gradients, and how flat it is.

Of columns C of length 1 (m, f), perhaps dependent, two things are asked: the least v with
Cᵀ v = g, which is v = (Cᵀ)⁺ g, and the least singular value that is not 0.

Few columns are decomposed into singular values.  Many are kept sparse, and go by the Cholesky
factors of CᵀC + δ²I, which exist for dependent columns too:

    v = C (CᵀC + δ²I)⁻¹ g

is short of (Cᵀ)⁺ g by δ²/(σ² + δ²) in the direction of each singular value σ.  Repeated with what
is left of g, it converges to it: by `PASSES` times for σ down to some 1e-5.  Directions below that
converge slowly or, below δ, count as 0: the answer is then less sharp, and whoever uses it sees
what is left of g.

The least singular value follows from the largest eigenvalue of CᵀC (CᵀC + δ²I)⁻², which is
σ²/(σ² + δ²)² at some σ, by Lanczos' method; up to δ it grows with σ, so that null vectors do not
show.
"""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from problems.qp import Matrix, Vector

RANK_TOL = 1e-12
"""A singular value below this fraction of the largest is 0 (few columns)."""
DELTA = 1e-6
"""δ, against columns of length 1 (many columns)."""
LANCZOS_TOL = 0.01
"""Relative accuracy of the largest eigenvalue; it is below the true one."""


class Span(Protocol):
    """What both kinds answer; `passes` corrections, each of what is left of g, are worth it."""

    passes: ClassVar[int]

    def correction(self, gradient: Vector) -> Vector:
        """The least v (m,) with Cᵀ v = `gradient` (f,), or near it."""

    @property
    def least_singular_value(self) -> float:
        """The least one that is not 0; inf where there is none."""


class DenseSpan:
    """By the singular value decomposition of C (m, f)."""

    passes: ClassVar[int] = 3

    def __init__(self, columns: Vector) -> None:
        self.columns = columns

    @cached_property
    def _factors(self) -> tuple[Vector, Vector, Vector]:
        U, sigma, Vt = np.linalg.svd(self.columns, full_matrices=False)
        kept = sigma > RANK_TOL * sigma[0]
        return U[:, kept], sigma[kept], Vt[kept]

    def correction(self, gradient: Vector) -> Vector:
        """The least v (m,) with Cᵀ v = `gradient` (f,)."""
        U, sigma, Vt = self._factors
        return np.asarray(U @ ((Vt @ gradient) / sigma))

    @cached_property
    def least_singular_value(self) -> float:
        """The least one above `RANK_TOL` of the largest; inf where there is none."""
        sigma = np.linalg.svd(self.columns, compute_uv=False)
        kept = sigma[sigma > RANK_TOL * sigma[:1]]
        return float(kept[-1]) if kept.size else np.inf


class SparseSpan:
    """By the Cholesky factors of CᵀC + δ²I, C (m, f) in CSC."""

    passes: ClassVar[int] = 8

    def __init__(self, columns: sp.csc_array) -> None:
        self.columns = columns
        normal = columns.T @ columns + DELTA**2 * sp.eye_array(columns.shape[1])
        # the matrix is symmetric and positive definite: no pivoting, and an order for Cholesky's
        self._factors = splu(
            sp.csc_matrix(normal),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def coefficients(self, gradient: Vector) -> Vector:
        """(CᵀC + δ²I)⁻¹ g, (f,)."""
        return np.asarray(self._factors.solve(gradient))

    def correction(self, gradient: Vector) -> Vector:
        """A v (m,) in the span with Cᵀ v near `gradient` (f,)."""
        return np.asarray(self.columns @ self.coefficients(gradient))

    @cached_property
    def least_singular_value(self) -> float:
        """The least one above δ or so, from below; inf where there is none."""
        count = self.columns.shape[1]
        if count == 0:
            return np.inf

        def apply(z: Vector) -> Vector:
            return self.coefficients(self.columns.T @ self.correction(z))

        if count == 1:
            largest = float(apply(np.ones(1))[0])
        else:
            start = np.random.default_rng(0).standard_normal(count)
            operator = LinearOperator((count, count), matvec=apply, dtype=np.float64)
            found = eigsh(operator, k=1, tol=LANCZOS_TOL, v0=start, return_eigenvectors=False)
            largest = float(found[0])
        if largest <= 0:
            return np.inf
        # the greater root σ of σ²/(σ² + δ²)² = largest; there is one up to 1/(4 δ²), where σ = δ
        share = min(4 * DELTA**2 * largest * (1 + LANCZOS_TOL), 1.0)
        return DELTA * (1 + float(np.sqrt(1 - share))) / float(np.sqrt(share))


def span_of(columns: Matrix) -> Span:
    """The span of columns of length 1 (m, f), dense or in CSC."""
    return SparseSpan(columns) if sp.issparse(columns) else DenseSpan(columns)
