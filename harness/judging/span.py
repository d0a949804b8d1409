"""The span of a set of columns: the least vector that corrects their gradients, and how flat it is.

Of columns C (m, f) about 1 long, perhaps dependent, two things are asked:

1. The least v with Cᵀ v = g, v = (Cᵀ)⁺ g, as near as it comes: whoever uses it sees what is left
   of g.  A few columns are decomposed into singular values.  Many are kept sparse, and go by the
   Cholesky factors of CᵀC + δ²I, which exist for dependent columns too:

       v = C (CᵀC + δ²I)⁻¹ g

   is short of (Cᵀ)⁺ g by δ²/(σ² + δ²) in the direction of each singular value σ.  Repeated with
   what is left of g, it converges to it: by `passes` times for σ down to some 1e-5.
2. Some v, and how long at most, with Cᵀ v = Cᵀ w exactly, for a w of which only Cᵀ w is known:
   `Basis`.  Nothing is estimated here.  B are columns whose least singular value is certified,
   which takes a bound on what rounding did to it; v with B's gradients has ‖v‖ ≤ ‖B's‖/σ_min(B).
   The others, N, follow if their columns are combinations of B's: in exact arithmetic, by rank.

Columns whose N are no combinations are independent as they are recorded and dependent but for
rounding: no v of a useful length may exist.  `Nearby` tells how near they are to a set that lacks
rank, and how flat that one is; these are estimates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from harness.judging.proof import exact_rank
from harness.judging.tolerances import SPAN_TOL
from problems.qp import Matrix, Vector

UNIT = float(np.finfo(np.float64).eps)
SVD_ERROR = 10.0
"""Singular values are this times max(m, f) u σ_max off at most."""
DELTA = 1e-6
"""δ, against columns of length 1 (many columns)."""
DEPENDENT = (0.0, 1e-10, 1e-9, 1e-8, 1e-6)
"""Pivots of CᵀC + δ²I up to which a column is one of N, tried in turn.  That of a combination c of
others is δ²(1 + ‖c‖²), that of any other column its squared distance from those before it."""
INVERSE_STEPS = 8
"""Of the inverse iteration that guesses σ_min before it is certified."""
HOPELESS = 3e-7
"""A guess that rounding of CᵀC would not let be certified."""
SHARES = (0.5, 0.1, 0.01)
"""Of the guess that are tried."""
PROBES = 3
POWER_STEPS = 30
"""Of what is only estimated: random combinations, steps of the power iteration."""
CIRCUIT = 40
"""Columns of which another one may be a combination, for that to be looked at exactly."""
CIRCUITS = 200
"""Columns that are looked at so."""

Flags = NDArray[np.bool_]
Columns = Callable[[Flags], Matrix]
"""The columns of the recorded A that are flagged among those of C."""


@dataclass(frozen=True)
class Basis:
    """Independent columns of C that stand for all (list of the module, 2).

    columns : (f,) which are B;  flatness : at most σ_min(B), inf where B is empty
    """

    columns: Flags
    flatness: float


@dataclass(frozen=True)
class Nearby:
    """C with its least singular values taken for 0.

    flatness : about the least that is kept, inf where none is
    gap : about the root of the sum of squares of those that are not
    """

    flatness: float
    gap: float


class Span(Protocol):
    """What both kinds answer; `passes` corrections, each of what is left of g, are worth it."""

    passes: ClassVar[int]

    def correction(self, gradient: Vector) -> Vector:
        """The least v (m,) with Cᵀ v = `gradient` (f,), or near it."""

    @property
    def basis(self) -> Basis | None:
        """Columns that are proved to stand for all; None where that is not proved."""

    @property
    def nearby(self) -> Nearby:
        """Of what lacks rank but for rounding."""

    def taken(self, x: Vector) -> float:
        """‖E x‖, x (f,), E being the part of C that belongs to singular values taken for 0."""


class DenseSpan:
    """By the singular value decomposition of C (m, f).

    recorded : the columns of A that C are, up to powers of two; C itself where left out
    """

    passes: ClassVar[int] = 3

    def __init__(self, columns: Vector, recorded: Columns | None = None) -> None:
        self.columns, self.recorded = columns, recorded or (lambda some: columns[:, some])

    @cached_property
    def _factors(self) -> tuple[Vector, Vector, Vector]:
        U, sigma, Vt = np.linalg.svd(self.columns, full_matrices=False)
        kept = sigma > SPAN_TOL * sigma[:1]
        return U[:, kept], sigma[kept], Vt[kept]

    def correction(self, gradient: Vector) -> Vector:
        """The least v (m,) with Cᵀ v = `gradient` (f,)."""
        U, sigma, Vt = self._factors
        return np.asarray(U @ ((Vt @ gradient) / sigma))

    @cached_property
    def basis(self) -> Basis | None:
        """All columns where that can be proved, else those that QR with pivots takes."""
        m, count = self.columns.shape
        everything = np.ones(count, bool)
        flatness = _least_singular_value(self.columns)
        if flatness > 0:
            return Basis(everything, flatness)
        R, order = sla.qr(self.columns, mode="r", pivoting=True)[:2]
        diagonal = np.abs(R.diagonal())
        rank = int((diagonal > SPAN_TOL * diagonal[:1]).sum())
        B = np.zeros(count, bool)
        B[order[:rank]] = True
        flatness = _least_singular_value(self.columns[:, B])
        if flatness > 0 and (rank == m or exact_rank(self.recorded(everything)) == rank):
            return Basis(B, flatness)
        return None

    @cached_property
    def nearby(self) -> Nearby:
        """By `SPAN_TOL`."""
        sigma = np.linalg.svd(self.columns, compute_uv=False)
        kept = sigma > SPAN_TOL * sigma[:1]
        return Nearby(sigma[kept].min(initial=np.inf), float(np.linalg.norm(sigma[~kept])))

    def taken(self, x: Vector) -> float:
        """‖E x‖, x (f,)."""
        _, _, Vt = self._factors
        return float(np.linalg.norm(self.columns @ (x - Vt.T @ (Vt @ x))))


def _least_singular_value(C: Vector) -> float:
    """σ_min(C) (m, f) from below, 0 if it may be 0; inf where there are no columns."""
    m, count = C.shape
    if count == 0:
        return np.inf
    if count > m:
        return 0.0
    sigma = np.linalg.svd(C, compute_uv=False)
    return max(0.0, float(sigma[-1] - SVD_ERROR * max(m, count) * UNIT * sigma[0]))


class SparseSpan:
    """By the Cholesky factors of CᵀC + δ²I, C (m, f) in CSC.

    recorded : the columns of A that C are, up to powers of two; C itself where left out
    """

    passes: ClassVar[int] = 8

    def __init__(self, columns: sp.csc_array, recorded: Columns | None = None) -> None:
        self.columns = columns
        self.recorded = recorded or (lambda some: columns[:, np.flatnonzero(some)])
        self._gram = sp.csc_array(columns.T @ columns)
        self._factors = _factors(self._gram + DELTA**2 * sp.eye_array(columns.shape[1]))

    def coefficients(self, gradient: Vector) -> Vector:
        """(CᵀC + δ²I)⁻¹ g, (f,)."""
        return np.asarray(self._factors.solve(gradient))

    def correction(self, gradient: Vector) -> Vector:
        """A v (m,) in the span with Cᵀ v near `gradient` (f,)."""
        return np.asarray(self.columns @ self.coefficients(gradient))

    @cached_property
    def basis(self) -> Basis | None:
        """Columns that are far from those before them in the order of elimination."""
        count = self.columns.shape[1]
        if count == 0:
            return Basis(np.zeros(0, bool), np.inf)
        pivots = self._factors.U.diagonal()[self._factors.perm_c]
        for least in DEPENDENT:
            B = pivots > least
            inner = self if B.all() else self._among(B)
            if inner._flatness > 0:
                spanned = inner is self or self._spanned_by(B, inner)
                return Basis(B, inner._flatness) if spanned else None
        return None

    @cached_property
    def nearby(self) -> Nearby:
        """By δ; what is kept is found by power iteration, what is not by random combinations.

        The greatest eigenvalue of CᵀC (CᵀC + δ²I)⁻² is σ²/(σ² + δ²)² of some σ; up to δ it grows
        with σ, so that null vectors do not show.
        """
        C, rng = self.columns, np.random.default_rng(0)
        gap = max(self.taken(z) for z in rng.standard_normal((PROBES, C.shape[1])))
        z = rng.standard_normal(C.shape[1])
        largest = 0.0
        for _ in range(POWER_STEPS if C.count_nonzero() else 0):
            z /= np.linalg.norm(z)
            z = self.coefficients(C.T @ (C @ self.coefficients(z)))
            largest = float(np.linalg.norm(z))
        if largest == 0.0:
            return Nearby(np.inf, gap)
        # the greater root σ of σ²/(σ² + δ²)² = largest; there is one up to 1/(4 δ²), where σ = δ
        share = min(4 * DELTA**2 * largest, 1.0)
        flatness = DELTA * (1 + float(np.sqrt(1 - share))) / float(np.sqrt(share))
        return Nearby(0.5 * flatness, gap)

    def taken(self, x: Vector) -> float:
        """‖E x‖, x (f,)."""
        C = self.columns
        for _ in range(self.passes if x.size else 0):
            x = x - self.coefficients(C.T @ (C @ x))
        return float(np.linalg.norm(C @ x))

    def _among(self, B: Flags) -> SparseSpan:
        """The span of the columns B alone."""
        place = np.flatnonzero(B)

        def recorded(some: Flags) -> Matrix:
            flags = np.zeros(B.size, bool)
            flags[place[some]] = True
            return self.recorded(flags)

        return SparseSpan(self.columns[:, place], recorded)

    @cached_property
    def _flatness(self) -> float:
        """σ_min(C) from below; 0 where it cannot be told from 0.

        L D Lᵀ with D > 0 is positive definite whatever L and D are.  If CᵀC − τ²I differs from it
        by no more than ε, no eigenvalue of CᵀC is below τ² − ε (Weyl; Rump 2006).
        """
        if self.columns.shape[1] == 0:
            return np.inf
        guess = self._guess()
        for share in SHARES if guess > HOPELESS else ():
            shift = (share * guess) ** 2
            certified = shift - self._distance_from_definite(shift)
            if certified > 0:
                return float(np.sqrt(certified)) * (1 - 1e-12)
        return 0.0

    def _distance_from_definite(self, shift: float) -> float:
        """‖CᵀC − τ²I − L D Lᵀ‖ from above, D > 0, τ² = `shift`; inf where there are none such."""
        count = self.columns.shape[1]
        shifted = self._gram - shift * sp.eye_array(count)
        try:
            factors = _factors(shifted)
        except RuntimeError:  # a pivot of 0
            return np.inf
        order, D = factors.perm_c, factors.U.diagonal()
        if not (D > 0).all() or not np.array_equal(factors.perm_r, order):
            return np.inf
        L = sp.csc_array(factors.L)[order]
        left = sp.csc_array(L @ sp.diags_array(D) @ L.T - shifted)
        found = float(np.linalg.norm(left.data))
        rounding = _largest_sum(abs(L), D) + _largest_sum(abs(self.columns.T), 1.0)
        return (found + rounding + UNIT * float(self._gram.diagonal().max())) * (1 + 1e-6)

    def _guess(self) -> float:
        """About σ_min(C), by inverse iteration."""
        z = np.random.default_rng(0).standard_normal(self.columns.shape[1])
        for _ in range(INVERSE_STEPS):
            z = self.coefficients(z / np.linalg.norm(z))
        return float(np.linalg.norm(self.columns @ z) / np.linalg.norm(z))

    def _spanned_by(self, B: Flags, inner: SparseSpan) -> bool:
        """Whether the columns N are combinations of B in exact arithmetic, of few of B each."""
        N, place = np.flatnonzero(~B), np.flatnonzero(B)
        if N.size > CIRCUITS:
            return False
        for j in N.tolist():
            coefficients = np.abs(inner._combination(self.columns[:, [j]].toarray().ravel()))
            circuit = coefficients > SPAN_TOL * coefficients.max(initial=0.0)
            if circuit.sum() > CIRCUIT:
                return False
            some = np.zeros(B.size, bool)
            some[place[circuit]] = some[j] = True
            if exact_rank(self.recorded(some)) > circuit.sum():
                return False
        return True

    def _combination(self, b: Vector) -> Vector:
        """C⁺ b, of independent columns."""
        x = np.zeros(self.columns.shape[1])
        for _ in range(self.passes if x.size else 0):
            more = self.coefficients(self.columns.T @ (b - self.columns @ x))
            x += more
            if np.linalg.norm(more) <= UNIT * np.linalg.norm(x):
                break
        return x


def _factors(normal: sp.csc_array) -> SuperLU:
    """L U of a symmetric matrix without pivoting, in an order for Cholesky's."""
    return splu(
        sp.csc_matrix(normal),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _largest_sum(B: sp.csc_array, D: Vector | float) -> float:
    """What rounding can do to B D Bᵀ, in the norm, of entries ≥ 0."""
    terms = int(np.diff(B.tocsr().indptr).max(initial=0)) + 3
    sums = B @ (D * (B.T @ np.ones(B.shape[0])))
    return terms * UNIT * float(sums.max(initial=0.0))


def span_of(columns: Matrix, recorded: Columns) -> Span:
    """The span of columns about 1 long (m, f), dense or in CSC; recorded : those of A."""
    kind = SparseSpan if sp.issparse(columns) else DenseSpan
    return kind(columns, recorded)
