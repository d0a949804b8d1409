"""Bringing a contact QP into the units that a package wants.

The problem is min ½‖A x + d‖², lower ≤ x ≤ upper.  Before any package sees it

1. fixed rows (lower = upper) are eliminated, their force goes into d: interior-point methods need
   bounds with room between them, and SciPy's refuses equal ones;
2. the columns of A are scaled to a length between 1 and 2, and x, d by one number, so that all
   unknowns are forces of size 1.  An error δx̂ of the scaled unknowns is then an error of at most
   √k ‖δx̂‖ in A x / force, whatever the masses and h are, and tolerances mean something.
   All factors are powers of two: nothing is rounded.

The forms in which a package may then be posed it (`solvers.base.Form`) are in `programs`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import (
    FREE,
    ContactQP,
    Vector,
)
from solvers.base import Start

MANY = 30
"""Unknowns beyond which the duality gap of a QP is measured against its objective as well."""


@dataclass(frozen=True, eq=False)
class Posed:
    """A contact QP in units of force, without its fixed rows: n ≤ k unknowns x̂.

    A : (m, n) dense or CSC, columns of length 1 to 2 (or 0)
    d : (m,), lower, upper : (n,)   scaled
    kept : (n,) positions of the unknowns among the k rows of the QP
    unit : (n,)   x[kept] = unit · x̂
    force : d of the QP = force · d, up to the fixed rows
    rest : (k,) x with the fixed rows filled in
    rows : (n,) row ids of the unknowns
    start : (n,) x̂ to start from, or None
    working_set : (n,) int8 that goes with it, or None
    """

    A: Any
    d: Vector
    lower: Vector
    upper: Vector
    kept: NDArray[np.int64]
    unit: Vector
    force: float
    rest: Vector
    rows: NDArray[np.int64]
    start: Vector | None
    working_set: NDArray[np.int8] | None

    @property
    def m(self) -> int:
        """Number of rows of A."""
        return int(self.A.shape[0])

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.A.shape[1])

    @property
    def is_sparse(self) -> bool:
        """Whether A is in CSC."""
        return bool(sp.issparse(self.A))

    @property
    def members(self) -> NDArray[np.int8]:
        """The working set to start from, FREE everywhere without a start.  (n,)"""
        return np.full(self.n, FREE, np.int8) if self.working_set is None else self.working_set

    @cached_property
    def programs(self) -> dict[str, Any]:
        """The QP in the forms of `programs`, as far as they were made."""
        return {}

    @cached_property
    def q(self) -> Vector:
        """Aᵀd, the gradient at x = 0.  (n,)"""
        return np.asarray(self.A.T @ self.d)

    @cached_property
    def P(self) -> Vector:
        """AᵀA, dense and symmetric to the last bit.  (n, n)"""
        P = self.A.T @ self.A
        return P.toarray() if sp.issparse(P) else P

    @cached_property
    def P_sparse(self) -> sp.csc_matrix:
        """AᵀA of a sparse A.  (n, n) CSC"""
        return sp.csc_matrix(self.A.T @ self.A)

    @cached_property
    def P_upper(self) -> sp.csc_matrix:
        """Upper triangle of AᵀA.  (n, n) CSC

        That of a dense A keeps its zeros, so that the pattern is the same at every step.
        """
        if sp.issparse(self.A):
            return sp.csc_matrix(sp.triu(self.A.T @ self.A))
        column, row = np.tril_indices(self.n)
        pointers = np.concatenate([[0], np.cumsum(np.arange(1, self.n + 1))])
        return sp.csc_matrix((self.P[row, column], row, pointers), shape=(self.n, self.n))

    @cached_property
    def dense(self) -> Vector:
        """A as a dense array.  (m, n)"""
        return self.A.toarray() if sp.issparse(self.A) else self.A

    @cached_property
    def sparse(self) -> sp.csc_matrix:
        """A as CSC; a dense A keeps its zeros.  (m, n)"""
        if sp.issparse(self.A):
            return sp.csc_matrix(self.A)
        pointers = np.arange(self.n + 1) * self.m
        indices = np.tile(np.arange(self.m), self.n)
        return sp.csc_matrix((self.A.T.ravel(), indices, pointers), shape=self.A.shape)

    @cached_property
    def range(self) -> tuple[Vector, Vector, Vector]:
        """U (m, rank), σ and Vᵀ (rank, n) with A = U Σ Vᵀ, without the σ that are rounding."""
        U, sigma, Vt = np.linalg.svd(self.dense, full_matrices=False)
        rank = int((sigma > 64 * np.finfo(float).eps * sigma[0]).sum())
        return U[:, :rank], sigma[:rank], Vt[:rank]

    @property
    def reduced(self) -> tuple[Vector, Vector]:
        """UᵀA and Uᵀd, A = U Σ Vᵀ: the same problem in an orthonormal basis of the range of A.

        The condition of A is kept, and d loses what no contact can change.  (rank, n), (rank,)
        """
        U, sigma, Vt = self.range
        return sigma[:, None] * Vt, U.T @ self.d

    @property
    def visible_d(self) -> Vector:
        """The part of d that contacts can change, U Uᵀd; all of d where A is sparse.  (m,)"""
        return self.d if self.is_sparse else self.range[0] @ (self.range[0].T @ self.d)

    def residual_tolerance(self, asked: float, floor: float) -> float:
        """Bound for the largest entry of the KKT residual, in scaled units.

        ‖A δx‖ ≤ √n ‖residual‖∞ / σ, with columns of length 1 and σ the least nonzero singular
        value of A; 0.1 is allowed for it.  The package's rounding sets the `floor`.
        """
        return max(0.1 * asked / self.force / np.sqrt(self.n), floor)

    def gap_tolerance(self, asked: float, floor: float) -> float:
        """Bound for the duality gap, in scaled units: ‖A δx‖² ≤ 2 gap by strong convexity in A x.

        At asked = 1e-9 it is 5e-19, below the rounding of an objective of size 1: the `floor` says
        how near to it a package can go, and a degenerate row then costs √floor.
        """
        return max(0.5 * (asked / self.force) ** 2, floor)

    @property
    def gap_share(self) -> float:
        """Part of the objective that the duality gap may be, where there are `MANY` unknowns.

        Forces add up from body to body, so that the objective of a large QP is 100 or 1000 in
        scaled units.  The gap is a difference of such numbers, and its rounding exceeds any floor
        that serves small QPs: without this PIQP and ProxQP go on for 10 times as long as it takes,
        to the same answer.
        """
        return 1e-15 * self.n if self.n > MANY else 0.0

    def restore(self, x: Vector) -> Vector:
        """x of the QP from the scaled unknowns.  (k,)"""
        full = self.rest.copy()
        full[self.kept] = self.unit * x[: self.n]
        return full


def _power_of_two(size: Any) -> Any:
    """The power of two at or below `size`; 1 for 0."""
    exponent = np.frexp(np.where(size > 0, size, 1.0))[1] - 1
    return np.ldexp(1.0, exponent)


def pose(qp: ContactQP, start: Start | None = None, *, dense: bool = False) -> Posed:
    """Eliminate the fixed rows of `qp` and scale it (steps 1 and 2 above)."""
    A: Any = qp.dense_A if dense else qp.A
    fixed = qp.lower == qp.upper
    kept = np.flatnonzero(~fixed)
    rest = np.where(fixed, qp.lower, 0.0)
    d = qp.d if kept.size == qp.k else qp.d + A @ rest
    if kept.size < qp.k:
        A = A[:, kept]
    if sp.issparse(A):
        lengths = np.sqrt(np.asarray(A.multiply(A).sum(axis=0)).ravel())
    else:
        lengths = np.sqrt(np.einsum("ij,ij->j", A, A))
    lengths = _power_of_two(lengths)
    A = A @ sp.diags_array(1.0 / lengths).tocsc() if sp.issparse(A) else A / lengths
    lower, upper = qp.lower[kept] * lengths, qp.upper[kept] * lengths
    # what acts: the gradient at 0, and bounds that force x away from 0
    acting = [A.T @ d, np.maximum(lower, 0.0), np.maximum(-upper, 0.0)]
    force = float(_power_of_two(max(float(np.abs(part).max(initial=0.0)) for part in acting)))
    unit = force / lengths
    return Posed(
        A=A, d=d / force, lower=lower / force, upper=upper / force, kept=kept, unit=unit,
        force=force, rest=rest, rows=qp.row_id[kept],
        start=None if start is None else start.x[kept] / unit,
        working_set=None if start is None else start.working_set[kept],
    )  # fmt: skip
