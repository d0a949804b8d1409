"""A contact QP as a quadratic program in one of three forms, for packages that take any.

    minimise ½ zᵀP z + qᵀz   subject to   lower ≤ R z ≤ upper

R begins with rows of I, the bounds of the leading unknowns; then come rows R z = 0, then R z ≥ 0.
With x, A, d scaled and without fixed rows (`forms.Posed`) and Δ = Aᵀ(A x + d):

    normal    z = x, P = AᵀA, q = Aᵀd.  The condition of A is squared.
    residual  z = (x, y), P = diag(0, I), q = (Aᵀd, 0), A x − y = 0: ½‖y‖², y = A x + d, without
              its constant and the part of d that no contact can change.  Nothing is squared.
    velocity  (3.4).  z = (s, r), P = diag(0, I), q = (w, −c).  x = base + σ x′ with x′ ≥ 0 counted
              from a finite bound (σ = −1 from an upper one), B = A σ, c = d + A base, and

                  minimise ½‖r − c‖² + wᵀs   subject to   Bᵀr + s ≥ 0,  s ≥ 0,

              s only in rows with two bounds, whose distance is w; rows without bounds are
              equations.  x′ are the multipliers of the rows.  Of d only its part in the range of A
              is taken, where A is dense.

Multipliers y of the rows have the sign of P z + q + Rᵀy = 0.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import AT_LOWER, AT_UPPER, FREE, Vector
from solvers.adapters.inner_options import check_variant
from solvers.adapters.normal_form import csc
from solvers.adapters.package import Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed

Members = NDArray[np.int8]
_ALL = slice(0, None)


class OneSided(NamedTuple):
    """x = base + sign · x′ with x′ ≥ 0, rows without bounds apart.

    order : (n,) the rows as they are numbered in the velocity problem, those without bounds first
    equations : how many those are;  two : (t,) numbers, in that order, of rows with two bounds
    width : (t,) their distance
    """

    base: Vector
    sign: Vector
    order: NDArray[np.int64]
    equations: int
    two: NDArray[np.int64]
    width: Vector

    def x(self, multipliers: Vector) -> Vector:
        """x from x′ in `order`.  (n,)"""
        x = self.base.copy()
        x[self.order] += self.sign[self.order] * multipliers
        return x

    def multipliers(self, x: Vector) -> Vector:
        """x′ in `order`.  (n,)"""
        return np.asarray((self.sign * (x - self.base))[self.order])


def one_sided(posed: Posed) -> OneSided:
    """Count every row from a finite bound, the lower one if it has both."""
    if posed.one_sided:
        return _as_it_is(posed.n)
    below, above = np.isfinite(posed.lower), np.isfinite(posed.upper)
    order = np.argsort(below | above, kind="stable")
    two = np.flatnonzero((below & above)[order])
    return OneSided(
        base=np.where(below, posed.lower, np.where(above, posed.upper, 0.0)),
        sign=np.where(above & ~below, -1.0, 1.0),
        order=order,
        equations=posed.n - int((below | above).sum()),
        two=two,
        width=(posed.upper - posed.lower)[order][two],
    )


@lru_cache(64)
def _as_it_is(n: int) -> OneSided:
    """x = x′ ≥ 0."""
    none = np.zeros(n), np.ones(n), np.arange(n)
    return OneSided(*none, 0, np.zeros(0, np.int64), np.zeros(0))


class Program(abc.ABC):
    """One form of a posed QP: N unknowns z, M rows.

    q : (N,);  R : (M, N) CSC;  lower, upper : (M,)
    simple : leading rows that are rows of I;  equal : rows after them that are equations
    """

    q: Vector
    lower: Vector
    upper: Vector
    simple: int
    equal: int

    def __init__(self, posed: Posed) -> None:
        self.posed = posed

    @property
    @abc.abstractmethod
    def R(self) -> sp.csc_matrix:
        """All rows."""

    @property
    def equations(self) -> slice:
        """The rows R z = 0."""
        return slice(self.simple, self.simple + self.equal)

    @cached_property
    def others(self) -> NDArray[np.int64]:
        """Positions of all other rows."""
        return np.delete(np.arange(self.lower.size), self.equations)

    @property
    def box(self) -> tuple[Vector, Vector]:
        """Bounds of all unknowns, infinite beyond the leading ones.  (N,), (N,)"""
        free = np.full(self.q.size - self.simple, np.inf)
        lower, upper = self.lower[: self.simple], self.upper[: self.simple]
        return np.concatenate([lower, -free]), np.concatenate([upper, free])

    @property
    def P_upper(self) -> sp.csc_matrix:
        """Upper triangle of P, here diag(0, I).  (N, N) CSC"""
        return _last_ones(self.q.size, self.posed.m)

    @property
    def P_lower(self) -> sp.csc_matrix:
        """Lower triangle of P, the same diagonal.  (N, N) CSC"""
        return self.P_upper

    def P(self, *, sparse: bool) -> Any:
        """P, dense or CSC.  (N, N)"""
        return self.P_upper if sparse else self.P_upper.toarray()

    def rows(self, chosen: Any, *, sparse: bool) -> Any:
        """Rows of R, dense or CSC."""
        whole = type(chosen) is slice and chosen == _ALL
        part = self.R if whole else self.R[chosen]
        return sp.csc_matrix(part) if sparse else part.toarray()

    def joined(self, equations: Vector, others: Vector) -> Vector:
        """y from its parts.  (M,)"""
        y = np.empty(self.lower.size)
        y[self.equations], y[self.others] = equations, others
        return y

    @abc.abstractmethod
    def guess(self, duals: Vector) -> tuple[Vector, Vector]:
        """z and y that belong to the start; `duals` are its multipliers of the bounds of x."""

    @abc.abstractmethod
    def members(self) -> Members:
        """Working set of the rows, FREE where they are no equations and there is no start.  (M,)"""

    def answer(self, z: Vector, y: Vector | None) -> tuple[Vector, Vector | None]:
        """x and the multipliers of its bounds, if they are to be carried on."""
        n = self.posed.n
        return z[:n], None if y is None else y[:n]


class Normal(Program):
    """z = x, P = AᵀA: the bounds are all there is."""

    equal = 0

    def __init__(self, posed: Posed) -> None:
        self.posed, self.q, self.simple = posed, posed.q, posed.n
        self.lower, self.upper = posed.lower, posed.upper

    @property
    def R(self) -> sp.csc_matrix:
        return identity(self.simple)

    @property
    def box(self) -> tuple[Vector, Vector]:
        return self.lower, self.upper

    @property
    def P_upper(self) -> sp.csc_matrix:
        return self.posed.P_upper

    @property
    def P_lower(self) -> sp.csc_matrix:
        return self.posed.P_lower

    def P(self, *, sparse: bool) -> Any:
        return self.posed.P_sparse if sparse else self.posed.P

    def rows(self, chosen: Any, *, sparse: bool) -> Any:
        """Rows of I; none after the bounds."""
        if type(chosen) is slice and chosen.start == self.simple:
            return _NO_ROWS[sparse](self.simple)
        return super().rows(chosen, sparse=sparse)

    def guess(self, duals: Vector) -> tuple[Vector, Vector]:
        assert self.posed.start is not None
        return self.posed.start, duals

    def members(self) -> Members:
        return self.posed.members


class Residual(Program):
    """z = (x, y), y = A x as rows."""

    def __init__(self, posed: Posed) -> None:
        super().__init__(posed)
        none = np.zeros(posed.m)
        self.q = np.concatenate([posed.q, none])
        self.lower, self.upper = (
            np.concatenate([bound, none]) for bound in (posed.lower, posed.upper)
        )
        self.simple, self.equal = posed.n, posed.m

    @cached_property
    def R(self) -> sp.csc_matrix:
        bounds, minus = identity(self.simple), -identity(self.equal)
        return sp.csc_matrix(sp.block_array([[bounds, None], [self.posed.sparse, minus]]))

    def rows(self, chosen: Any, *, sparse: bool) -> Any:
        if not sparse:
            return super().rows(chosen, sparse=sparse)
        if type(chosen) is slice:
            A, minus = self.posed.sparse, _minus(self.equal)
            return csc(
                (self.equal, self.q.size),
                np.concatenate([A.data, minus.data]),
                np.concatenate([A.indices, minus.indices]),
                np.concatenate([A.indptr, A.nnz + minus.indptr[1:]]),
            )
        return _bound_rows(self.simple, self.equal)

    def guess(self, duals: Vector) -> tuple[Vector, Vector]:
        x = self.posed.start
        assert x is not None
        y = self.posed.A @ x
        return np.concatenate([x, y]), np.concatenate([duals, y])

    def members(self) -> Members:
        return np.concatenate([self.posed.members, np.full(self.equal, AT_LOWER, np.int8)])


class Velocity(Program):
    """(3.4); z = (s, r)."""

    def __init__(self, posed: Posed) -> None:
        super().__init__(posed)
        own = self.own = one_sided(posed)
        n, t = posed.n, own.two.size
        c = posed.visible_d
        if own.base.any():
            c = c + posed.A @ own.base
        self.q = np.concatenate([own.width, -c]) if t else -c
        self.lower, self.upper = np.zeros(t + n), np.full(t + n, np.inf)
        self.upper[t : t + own.equations] = 0.0
        self.simple, self.equal = t, own.equations

    @cached_property
    def R(self) -> sp.csc_matrix:
        own, n, t = self.own, self.posed.n, self.simple
        if self.posed.one_sided and self.posed.is_sparse:
            return self.posed.At
        B = self.posed.sparse
        if (own.sign != 1.0).any():
            B = scaled(B, own.sign, axis=1)
        if own.equations:
            B = B[:, own.order]
        if not t:
            return sp.csc_matrix(B.T)
        S = sp.csc_matrix((np.ones(t), (own.two, np.arange(t))), shape=(n, t))
        return sp.csc_matrix(sp.block_array([[identity(t), None], [S, B.T]]))

    def guess(self, duals: Vector) -> tuple[Vector, Vector]:
        posed, own = self.posed, self.own
        x = posed.start
        assert x is not None
        primed = own.multipliers(x)
        r = posed.A @ (x - own.base) - self.q[self.simple :]
        slack = np.maximum(-(self.R[self.simple :, self.simple :] @ r)[own.two], 0.0)
        y = np.concatenate([primed[own.two] - own.width, -primed])
        return np.concatenate([slack, r]), y

    def members(self) -> Members:
        own, members = self.own, np.full(self.lower.size, FREE, np.int8)
        if self.posed.start is not None:  # a row is active where x′ > 0, a slack where x′ < w
            x_set = (own.sign * self.posed.members).astype(np.int8)[own.order]
            members[self.simple :][x_set != AT_LOWER] = AT_LOWER
            members[: self.simple][x_set[own.two] != AT_UPPER] = AT_LOWER
        members[self.equations] = AT_LOWER
        return members

    def answer(self, z: Vector, y: Vector | None) -> tuple[Vector, Vector | None]:
        assert y is not None
        return self.own.x(-y[self.simple :]), None


def scaled(matrix: sp.csc_matrix, by: Vector, axis: int) -> sp.csc_matrix:
    """Rows (axis 0) or columns (1) times `by`; stored zeros stay, so that patterns do."""
    made = sp.csc_matrix(matrix)
    made.sort_indices()
    place = made.indices if axis == 0 else np.repeat(np.arange(by.size), np.diff(made.indptr))
    return sp.csc_matrix((made.data * by[place], made.indices, made.indptr), shape=made.shape)


@lru_cache(64)
def _no_rows(size: int) -> Vector:
    return np.zeros((0, size))


@lru_cache(64)
def _no_sparse_rows(size: int) -> sp.csc_matrix:
    return sp.csc_matrix((0, size))


_NO_ROWS = (_no_rows, _no_sparse_rows)


@lru_cache(64)
def _bound_rows(n: int, m: int) -> sp.csc_matrix:
    """(I, 0).  (n, n + m) CSC"""
    return sp.csc_matrix(sp.identity(n + m, format="csr")[:n])


@lru_cache(64)
def _last_ones(size: int, ones: int) -> sp.csc_matrix:
    """diag(0, I).  (size, size) CSC"""
    place = np.arange(size - ones, size)
    pointers = np.concatenate([np.zeros(size - ones, np.int64), np.arange(ones + 1)])
    return sp.csc_matrix((np.ones(ones), place, pointers), shape=(size, size))


@lru_cache(64)
def _minus(size: int) -> sp.csc_matrix:
    """−I.  (size, size) CSC"""
    return -identity(size)


@lru_cache(64)
def identity(size: int) -> sp.csc_matrix:
    """I.  (size, size) CSC"""
    return sp.csc_matrix(sp.identity(size))


PROGRAMS: dict[str, type[Program]] = {
    "normal": Normal,
    "residual": Residual,
    "velocity": Velocity,
}


class Cones(NamedTuple):
    """The rows as G z + s = h with s = 0 in the first `equal` rows and s ≥ 0 in the others.

    row, sign : G = sign · R[row], so that y of R gathers sign times the multipliers of G
    """

    G: sp.csc_matrix
    h: Vector
    equal: int
    row: NDArray[np.int64]
    sign: Vector

    def gathered(self, multipliers: Vector, rows: int) -> Vector:
        """y of R from the multipliers of G.  (rows,)"""
        return np.bincount(self.row, self.sign * multipliers, rows).astype(float)


def cones(program: Program) -> Cones:
    """R z = 0, then −R z ≤ −lower, then R z ≤ upper, where they are finite."""
    lower, upper = program.lower, program.upper
    if isinstance(program, Normal):
        ends = _finite_ends((lower > -np.inf).tobytes(), (upper < np.inf).tobytes())
        h = np.concatenate([-lower[ends.below], upper[ends.above]])
        return Cones(ends.G, h, 0, ends.row, ends.sign)
    equal = lower == upper
    same = np.flatnonzero(equal)
    below = np.flatnonzero((lower > -np.inf) & ~equal)
    above = np.flatnonzero((upper < np.inf) & ~equal)
    row = np.concatenate([same, below, above])
    sign = np.ones(row.size)
    sign[same.size : same.size + below.size] = -1.0
    h = np.concatenate([lower[same], -lower[below], upper[above]])
    if row.size == below.size == lower.size:
        R = program.R
        G = csc(R.shape, -R.data, R.indices, R.indptr)
    else:
        G = scaled(program.R[row], sign, axis=0)
    return Cones(G, h, same.size, row, sign)


class _Ends(NamedTuple):
    """Finite bounds as rows G of ±I; positions of the lower and of the upper ones."""

    G: sp.csc_matrix
    below: NDArray[np.int64]
    above: NDArray[np.int64]
    row: NDArray[np.int64]
    sign: Vector


@lru_cache(64)
def _finite_ends(has_lower: bytes, has_upper: bytes) -> _Ends:
    """Of rows with these bounds, one byte for each."""
    below, above = (np.flatnonzero(np.frombuffer(ends, bool)) for ends in (has_lower, has_upper))
    row = np.concatenate([below, above])
    sign = np.repeat([-1.0, 1.0], [below.size, above.size])
    G = sp.csc_matrix((sign, (np.arange(row.size), row)), shape=(row.size, len(has_lower)))
    return _Ends(G, below, above, row, sign)


@dataclass(frozen=True)
class ProgramSolver(PackageSolver):
    """A package that takes any quadratic program, so each of the three forms.

    variant : the form that it is posed, one of `PROGRAMS`; "" is what `best_form` says

    Derived classes write `pack` instead of `arrays`.  The z and y that a solve starts from are
    `Built.guess`; `outcome` gives z and y, which are turned into x here.
    """

    variant: str = ""

    forms: ClassVar[tuple[str, ...]] = tuple(PROGRAMS)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.variant:
            check_variant(self.name, self.variant, self.forms)

    def best_form(self, posed: Posed) -> str:
        """The form in which the package is fastest, measured on towers of 7, 40, 150 and 700 boxes
        and walls of 11, 30 and 150 bricks; `glambda replay --solvers forms` shows it."""
        return self.form

    def program(self, posed: Posed) -> Program:
        """The QP in the solver's form; made once."""
        if posed.program is None:
            posed.form = self.variant or self.best_form(posed)
            posed.program = PROGRAMS[posed.form](posed)
        made: Program = posed.program
        return made

    @abc.abstractmethod
    def pack(self, program: Program) -> Any:
        """The program in the package's own arrays."""

    def arrays(self, posed: Posed) -> Any:
        """The package's arrays of the QP in the solver's form."""
        return self.pack(self.program(posed))

    def guess(self, posed: Posed, duals: Vector) -> tuple[Vector, Vector]:
        """z and y."""
        return self.program(posed).guess(duals)

    def in_x(self, native: Native, says: Outcome) -> Outcome:
        """x from z and y."""
        if says.x is None or native.posed.form == "normal":
            return says
        x, duals = self.program(native.posed).answer(says.x, says.duals)
        return says._replace(x=x, duals=duals)
