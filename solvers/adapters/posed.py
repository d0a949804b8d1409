"""Bringing a contact QP into the units that a package wants.

The problem is min ½‖A x + d‖², lower ≤ x ≤ upper.  As a rule it is posed as it is: columns of A
have lengths near 1 where masses do, and forces are of a size that a package can be told its
tolerances for.  Otherwise, before any package sees it,

1. fixed rows (lower = upper) are eliminated, their force goes into d: interior-point methods need
   bounds with room between them, and SciPy's refuses equal ones;
2. where columns are longer than `LONG` or shorter than 1/`LONG`, each is scaled to a length between
   1 and 2;
3. where forces are not within `FORCES`, or what else the package is at ease with, x and d are
   scaled by one number, so that they are of size 1.

An error δx̂ of the unknowns is then an error of at most `LONG` √k ‖δx̂‖ in A x, whatever the masses
and h are, and tolerances mean something.  All factors are powers of two: nothing is rounded.

The forms in which a package may then be posed it (`solvers.base.Form`) are in `programs`.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property, lru_cache
from math import frexp, ldexp, sqrt
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import FREE, ContactQP, Vector

LONG = 8.0
FORCES = 1e-3, 1e6
"""Sizes of what acts, ‖Aᵀd‖ or bounds away from 0, that are left as they are."""
UNIT = 0.5, 2.0
"""As `FORCES`, for packages whose rules of stopping and step lengths mean numbers near 1."""
MANY = 10
"""Unknowns beyond which the duality gap of a QP is measured against its objective as well."""
FEW = 40
"""Numbers that Python compares faster than NumPy."""


class Units(NamedTuple):
    """How the unknowns of a scaled problem are counted.

    kept : (n,) positions of the unknowns among the k rows of the QP
    unit : (n,)   x[kept] = unit · x̂
    force : d of the QP = force · d, up to the fixed rows
    rest : (k,) x with the fixed rows filled in
    """

    kept: NDArray[np.int64]
    unit: Vector
    force: float
    rest: Vector


class Posed:
    """A contact QP as packages are posed it: n ≤ k unknowns x̂.

    A : (m, n) dense or CSC;  d : (m,);  lower, upper : (n,)
    rows : (n,) row ids of the unknowns
    q : (n,) Aᵀd, the gradient at x = 0
    P : (n, n) AᵀA, symmetric to the last bit; None where A is sparse and it was not yet asked for
    force : ‖q‖∞ where it is left as it is, 1 in scaled units: the size of what acts
    units : None where all of it is the QP's own
    form, program : the form in which it is posed, and the QP in it, where there are several
    before : the `Native` of the previous solve, where what it ended with is started from
    start : (n,) x̂ to start from, or None
    working_set : (n,) int8 that goes with it, or None
    """

    before: Any = None
    form = ""
    program: Any = None
    start: Vector | None = None
    working_set: NDArray[np.int8] | None = None

    def __init__(
        self, A: Any, d: Vector, lower: Vector, upper: Vector, rows: NDArray[np.int64],
        q: Vector, P: Vector | None, force: float, units: Units | None = None,
    ) -> None:  # fmt: skip
        self.A, self.d, self.lower, self.upper, self.rows = A, d, lower, upper, rows
        self.q, self._P, self.force, self.units = q, P, force, units
        self.m, self.n = A.shape

    @property
    def is_sparse(self) -> bool:
        """Whether A is in CSC."""
        return type(self.A) is not np.ndarray

    @property
    def one_sided(self) -> bool:
        """Whether all of x ≥ 0 and nothing else is asked."""
        return not self.lower.any() and bool(self.upper.min(initial=np.inf) == np.inf)

    @property
    def members(self) -> NDArray[np.int8]:
        """The working set to start from, FREE everywhere without a start.  (n,)"""
        return np.full(self.n, FREE, np.int8) if self.working_set is None else self.working_set

    def is_like(self, other: Posed) -> bool:
        """Whether the unknowns and their bounds are those of the other, in the same order."""
        return (
            (self.rows is other.rows or self.rows.tobytes() == other.rows.tobytes())
            and self.m == other.m
            and _finite_together(self.lower, other.lower)
            and _finite_together(self.upper, other.upper)
        )

    @property
    def P(self) -> Vector:
        """AᵀA, dense.  (n, n)"""
        if self._P is None:
            self._P = self.P_sparse.toarray() if self.is_sparse else self.A.T @ self.A
        return self._P

    @cached_property
    def P_sparse(self) -> sp.csc_matrix:
        """AᵀA of a sparse A.  (n, n) CSC"""
        return sp.csc_matrix(self.A.T @ self.A)

    @cached_property
    def P_upper(self) -> sp.csc_matrix:
        """Upper triangle of AᵀA.  (n, n) CSC

        That of a dense A keeps its zeros, so that the pattern is the same at every step.
        """
        if self.is_sparse:
            return sp.csc_matrix(sp.triu(self.P_sparse))
        place, pattern = _upper(self.n)
        return _filled(pattern, self.P.ravel().take(place))

    @property
    def P_lower(self) -> sp.csc_matrix:
        """Lower triangle of AᵀA.  (n, n) CSC"""
        if self.is_sparse:
            return sp.csc_matrix(sp.tril(self.P_sparse))
        place, pattern = _lower(self.n)
        return _filled(pattern, self.P.ravel().take(place))

    @cached_property
    def dense(self) -> Vector:
        """A as a dense array.  (m, n)"""
        return self.A.toarray() if self.is_sparse else self.A

    @cached_property
    def sparse(self) -> sp.csc_matrix:
        """A as CSC; a dense A keeps its zeros.  (m, n)"""
        if self.is_sparse:
            return sp.csc_matrix(self.A)
        return _filled(_full(self.m, self.n), self.A.T.ravel())

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

    def allowed(self, asked: float) -> float:
        """`asked` in the units of the unknowns."""
        return asked / self.units.force if self.units else asked

    def residual_tolerance(self, asked: float, floor: float) -> float:
        """Bound for the largest entry of the KKT residual.

        ‖A δx‖ ≤ √n ‖residual‖∞ / σ, with columns of length 1 and σ the least nonzero singular
        value of A; 0.1 is allowed for it.  The package's rounding sets the `floor`, of what acts.
        """
        return max(0.1 * self.allowed(asked) / sqrt(self.n), floor * self.force)

    def gap_tolerance(self, asked: float, floor: float) -> float:
        """Bound for the duality gap: ‖A δx‖² ≤ 2 gap by strong convexity in A x.

        At asked = 1e-9 it is 5e-19, below the rounding of an objective of size 1: the `floor` says
        how near to it a package can go, and a degenerate row then costs √floor.
        """
        return max(0.5 * self.allowed(asked) ** 2, floor * self.force**2)

    @property
    def gap_share(self) -> float:
        """Part of the objective that the duality gap may be, where there are `MANY` unknowns.

        Forces add up from body to body, so that the objective of a large QP is 100 or 1000 times
        what acts on one.  The gap is a difference of such numbers, and its rounding exceeds any
        floor that serves small QPs: without this PIQP and ProxQP go on for 5 to 10 times as long as
        it takes, to the same answer, as on a tower of 15 boxes.
        """
        return 1e-15 * self.n if self.n > MANY else 0.0

    def misses(self, x: Vector, asked: float) -> bool:
        """Whether the KKT residual of x ≥ 0 says that A x may be off by more than `asked`."""
        gradient = self.q + self.A.T @ (self.A @ x)
        worst = np.where(x > 0, np.abs(gradient), -gradient).max(initial=-float(x.min(initial=0.0)))
        return bool(worst > 10.0 * self.residual_tolerance(asked, 1e-13))

    def forget(self) -> None:
        """Once it is answered: the solve before, which knows the one before it, and so on; and the
        program, which knows this problem: of a circle only the garbage collector makes an end."""
        self.before = self.program = None

    def to_posed(self, x: Vector, working_set: NDArray[np.int8]) -> None:
        """Start from this x of the QP, and from this working set."""
        if self.units is None:
            self.start, self.working_set = x, working_set
        else:
            kept, unit, *_ = self.units
            self.start, self.working_set = x[kept] / unit, working_set[kept]

    def restore(self, x: Vector) -> Vector:
        """x of the QP from the unknowns.  (k,)"""
        if self.units is None:
            return x[: self.n]
        full = self.units.rest.copy()
        full[self.units.kept] = self.units.unit * x[: self.n]
        return full


def pose(qp: ContactQP, *, dense: bool = False, forces: tuple[float, float] = FORCES) -> Posed:
    """The QP as it is, or without its fixed rows and in units of its own (steps 1 to 3 above).

    dense : whether a sparse A is made a dense one;  forces : sizes that are left as they are
    """
    A: Any = qp.dense_A if dense else qp.A
    q: Vector = A.T @ qp.d
    if type(A) is np.ndarray:
        P = A.T @ A
        squares = P.diagonal()
    else:
        P, squares = None, _squares(A)
    if q.size <= FEW:
        sizes = squares.tolist()
        least, most = min(sizes, default=1.0), max(sizes, default=1.0)
        force = max(map(abs, q.tolist()), default=0.0)
    else:
        least, most, force = squares.min(), squares.max(), max(float(q.max()), -float(q.min()))
    usual = least >= LONG**-2 and most <= LONG**2
    if not usual or np.count_nonzero(qp.lower == qp.upper):
        return _scaled(qp, A, squares, usual)
    if forces[0] < force < forces[1]:
        return Posed(A, qp.d, qp.lower, qp.upper, qp.row_id, q, P, force)
    k, unit = qp.k, _scale(max(force, _away(qp.lower, qp.upper)))
    units = Units(_first(k), np.full(k, unit), unit, np.zeros(k))
    ends = qp.lower / unit, qp.upper / unit
    return Posed(A, qp.d / unit, *ends, qp.row_id, q / unit, P, 1.0, units)


def _away(lower: Vector, upper: Vector) -> float:
    """How far bounds force x away from 0."""
    if lower.size <= FEW:
        return max(0.0, *lower.tolist(), -min(upper.tolist(), default=0.0))
    return max(0.0, float(lower.max()), -float(upper.min()))


def _scale(size: float) -> float:
    """The power of two at or below `size`; 1 for 0."""
    return ldexp(1.0, frexp(size)[1] - 1) if size > 0 else 1.0


@lru_cache(64)
def _first(k: int) -> NDArray[np.int64]:
    """The first k numbers; not to be written into."""
    return np.arange(k)


def _scaled(qp: ContactQP, A: Any, squares: Vector, usual: bool) -> Posed:
    """The QP without its fixed rows, columns and forces scaled.

    squares : (k,) of the lengths of the columns;  usual : whether those are left as they are
    """
    fixed = qp.lower == qp.upper
    kept = np.flatnonzero(~fixed)
    rest = np.where(fixed, qp.lower, 0.0)
    d, lower, upper = qp.d, qp.lower[kept], qp.upper[kept]
    if kept.size < qp.k:
        A, d = A[:, kept], d + A @ rest
    lengths = np.ones(kept.size)
    if not usual:
        lengths = _power_of_two(np.sqrt(squares[kept]))
        A = A @ sp.diags_array(1.0 / lengths).tocsc() if sp.issparse(A) else A / lengths
        lower, upper = lower * lengths, upper * lengths
    q = A.T @ d
    gradient = max(float(q.max(initial=0.0)), -float(q.min(initial=0.0)))
    force = _scale(max(gradient, _away(lower, upper)))
    units = Units(kept, force / lengths, force, rest)
    ends = lower / force, upper / force
    return Posed(A, d / force, *ends, qp.row_id[kept], q / force, None, 1.0, units)


def _squares(A: Any) -> Vector:
    """Squares of the lengths of the columns of a CSC matrix.  (k,)"""
    column = np.repeat(np.arange(A.shape[1]), np.diff(A.indptr))
    return np.bincount(column, A.data * A.data, A.shape[1]).astype(float)


def _finite_together(one: Vector, other: Vector) -> bool:
    """Whether two vectors of bounds are finite in the same places."""
    return one.tobytes() == other.tobytes() or np.array_equal(np.isinf(one), np.isinf(other))


def _power_of_two(size: Any) -> Any:
    """The power of two at or below `size`; 1 for 0."""
    exponent = np.frexp(np.where(size > 0, size, 1.0))[1] - 1
    return np.ldexp(1.0, exponent)


def _filled(pattern: sp.csc_matrix, data: Vector) -> sp.csc_matrix:
    """A matrix of that pattern."""
    made = copy(pattern)
    made.data = data
    return made


@lru_cache(64)
def _upper(n: int) -> tuple[NDArray[np.int64], sp.csc_matrix]:
    """Where the upper triangle of a dense (n, n) is, column by column, and its pattern."""
    column, row = np.tril_indices(n)
    return _triangle(n, row, column)


@lru_cache(64)
def _lower(n: int) -> tuple[NDArray[np.int64], sp.csc_matrix]:
    """Where the lower triangle is."""
    column, row = np.triu_indices(n)
    return _triangle(n, row, column)


def _triangle(n: int, row: Any, column: Any) -> tuple[NDArray[np.int64], sp.csc_matrix]:
    pointers = np.searchsorted(column, np.arange(n + 1))
    return row * n + column, sp.csc_matrix((np.ones(row.size), row, pointers), shape=(n, n))


@lru_cache(64)
def _full(m: int, n: int) -> sp.csc_matrix:
    """The pattern of a dense (m, n)."""
    indices, pointers = np.tile(np.arange(m), n), np.arange(n + 1) * m
    return sp.csc_matrix((np.ones(m * n), indices, pointers), shape=(m, n))
