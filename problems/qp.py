"""The quadratic program of one time step, and the answer that a solver gives to it.

Every QP of the project has the form (Lötstedt 1984, (3.2), (3.15), (4.6))

    minimise  ½ ‖A x + d‖²   subject to   lower ≤ x ≤ upper

with A = D⁻ᵀG, M = DᵀD, so that x holds the multipliers λ of the contacts.  At the optimum

    residual r = A x + d,     gradient Δ = Aᵀ r,     q̇_n = (h/α₀) D⁻¹ r.

x is not unique where A lacks full column rank; A x is (proposition 3), and with it Gλ and the
motion.  Friction impulses (2.14) are posed by the generators V of their cones, Λ = V c with c ≥ 0:
then the `A` that is stored here is D⁻ᵀG V and `x` is c.

Types in this module are frozen and own read-only arrays; they are safe to share.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, lru_cache
from math import inf, isfinite, nan
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from problems.short import Short

REAL, WHOLE = np.dtype(np.float64), np.dtype(np.int64)
Vector = NDArray[np.float64]
Matrix: TypeAlias = "NDArray[np.float64] | sp.csc_array"
Indices = NDArray[np.int64]

KINDS = ("step", "iteration", "corrector", "impulse", "minimum_norm")
"""What a QP is for: a time step (3.2), (4.6); a pass of the functional iteration (3.9); a pass of
the friction correction; an impulse (2.14); the minimum-norm multipliers (4.8)."""

FEATURE_FIELDS = ("corner_body", "corner", "edge_body", "edge", "direction")
"""Columns of `ContactQP.feature`.  A body of −1 is the ground (or none).  `direction` is 0 for a
normal, 1 for a tangent, 2, 3, … for the generators of a friction impulse; −1 where the row is no
contact of rigid bodies, or nobody has said what it is."""

NORMAL, TANGENT = 0, 1
"""The `direction` of rows of their own; generators of an impulse follow."""

LARGEST = 1e150
"""Greatest size of an entry of A or d: squares and sums of squares are finite."""

AT_LOWER, FREE, AT_UPPER, PASSIVE = -1, 0, 1, 2
"""Members of a working set: X at the lower bound (or fixed), F, X at the upper bound, and P."""


def _refuse_nan(name: str, array: NDArray[np.float64]) -> None:
    if np.isnan(array).any():
        where = np.argwhere(np.isnan(array))[0].tolist()
        raise ValueError(f"{name} holds NaN at index {where}; remove it before posing the QP")


def _refuse_large(name: str, array: NDArray[np.float64]) -> None:
    """Refuse NaN and what is beyond `LARGEST`; a sum of squares tells that there is neither."""
    flat = array.reshape(-1)
    if flat.dot(flat) <= LARGEST:
        return
    _refuse_nan(name, array)
    if not max(array.max(), -array.min()) <= LARGEST:
        raise ValueError(
            f"{name} holds an entry beyond ±{LARGEST:g}, whose square overflows; "
            "scale the problem, and pose infinite forces as a bound"
        )


@lru_cache(maxsize=1024)
def usual(name: str, n: int) -> NDArray[Any]:
    """What stands for a `row_id`, `feature` or `D` that is not given, read-only and shared."""
    array: NDArray[Any]
    if name == "row_id":
        array = np.arange(n)
    elif name == "feature":
        array = np.full((n, len(FEATURE_FIELDS)), -1)
    else:
        array = np.ones(n)
    array.setflags(write=False)
    return array


def _frozen_matrix(value: Any) -> Matrix:
    if not isinstance(value, np.ndarray) and sp.issparse(value):
        A = sp.csc_array(value, dtype=np.float64, copy=True)
        A.sum_duplicates()
        A.sort_indices()
        if np.isnan(A.data).any():
            raise ValueError("A holds NaN; remove it before posing the QP")
        _refuse_large("A", A.data)
        for part in (A.data, A.indices, A.indptr):
            part.setflags(write=False)
        return A
    array: NDArray[np.float64] = _copied(value, REAL)
    if array.ndim != 2:
        raise ValueError(f"A must be a matrix (m, k); got shape {array.shape}")
    _refuse_large("A", array)
    array.setflags(write=False)
    return array


def _copied(value: Any, dtype: Any) -> Any:
    """A copy as an array in C order; what is one already is copied in half the time."""
    if value.__class__ is np.ndarray and value.dtype is dtype:
        return value.copy("C")
    return np.array(value, dtype, order="C")


def _frozen(name: str, value: Any, shape: Any, A: Matrix, dtype: Any = REAL) -> Any:
    """A read-only copy of a field; ValueError where it has another shape."""
    array = _copied(value, dtype)
    if array.shape != shape:
        raise ValueError(f"A has shape {A.shape}, so {name} needs shape {shape}; got {array.shape}")
    array.setflags(False)
    return array


def distinct_ids(value: ArrayLike, A: Matrix) -> Any:
    """`row_id` as a field; ValueError where two are the same."""
    row_id = _frozen("row_id", value, (A.shape[1],), A, WHOLE)
    if not _are_distinct(row_id.tobytes()):
        raise ValueError("row_id holds a number twice; rows of one QP need distinct ids")
    return row_id


@lru_cache(maxsize=64)
def _are_distinct(numbers: bytes) -> bool:
    """Whether no number is there twice; rows are mostly those of the QP before."""
    row_id = np.frombuffer(numbers, WHOLE)
    return bool((row_id[1:] > row_id[:-1]).all()) or np.unique(row_id).size == row_id.size


def _features(value: ArrayLike, A: Matrix) -> Any:
    return _frozen("feature", value, (A.shape[1], len(FEATURE_FIELDS)), A, WHOLE)


def _masses(value: ArrayLike, A: Matrix) -> Any:
    """D as a field; ValueError where it is not positive and finite."""
    D = _frozen("D", value, A.shape[:1], A)
    if not (np.isfinite(D).all() and (D > 0).all()):
        _refuse_nan("D", D)
        raise ValueError("D must be positive and finite")
    return D


def _generators(value: ArrayLike, A: Matrix) -> Any:
    V: Vector = np.array(value, np.float64, order="C")
    if V.ndim != 2 or V.shape[1] != A.shape[1]:
        raise ValueError(f"generators must have shape (l, {A.shape[1]}); got {V.shape}")
    _refuse_nan("generators", V)
    V.setflags(write=False)
    return V


def _number(name: str, value: Any) -> float:
    """A number of a QP; ValueError where it is not finite or, t apart, not positive."""
    value = float(value)
    if not isfinite(value) or (name != "t" and value <= 0):
        raise ValueError(f"{name} = {value:g}; it must be finite and (t apart) positive")
    return value


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ContactQP(Short):
    """minimise ½‖A x + d‖² subject to lower ≤ x ≤ upper, with where it came from.

    A : (m, k) dense or SciPy sparse (kept as CSC)      D⁻ᵀG, or D⁻ᵀG V for an impulse
    d : (m,)                                            D c_n / h_n
    lower, upper : (k,)    ±inf allowed; equal entries are a fixed row
    row_id : (k,) int64    the identity of a row along a sequence; warm starts are looked up by it
    feature : (k, 5) int64 which corner and edge carry the row, see `FEATURE_FIELDS`
    D : (m,)               diagonal of D, M = DᵀD
    generators : (l, k)    V with Λ = V x, or None: x are the multipliers themselves
    kind : one of `KINDS`
    accepted : False if the step that posed it was rejected or cut short by an event
    restart : True for the first QP after a discontinuity, where a warm start means nothing
    t, h, alpha0 : end of the step [s], its length [s] and α₀ of its BDF formula
    eps0 : the accuracy in ‖A δx‖ that the stepper asks for (3.13)

    Raises ValueError, naming the field, for NaN, wrong shapes, lower > upper or an unknown kind.
    """

    A: Matrix
    d: Vector
    lower: Vector
    upper: Vector
    row_id: NDArray[np.int64]
    feature: NDArray[np.int64]
    D: Vector
    generators: Vector | None
    kind: str
    accepted: bool
    restart: bool
    t: float
    h: float
    alpha0: float
    eps0: float

    def __init__(
        self,
        A: ArrayLike | sp.sparray | sp.spmatrix,
        d: ArrayLike,
        lower: ArrayLike,
        upper: ArrayLike,
        row_id: ArrayLike | None = None,
        feature: ArrayLike | None = None,
        D: ArrayLike | None = None,
        generators: ArrayLike | None = None,
        kind: str = "step",
        accepted: bool = True,
        restart: bool = False,
        t: float = 0.0,
        h: float = 1.0,
        alpha0: float = 1.0,
        eps0: float = 1e-9,
    ) -> None:
        # written out: what a dataclass makes takes half as long as the QP of a small scene
        own = _frozen_matrix(A)
        m, k = own.shape
        t, h, alpha0, eps0 = float(t), float(h), float(alpha0), float(eps0)
        self.__dict__.update(
            A=own,
            d=_frozen("d", d, (m,), own),
            lower=_frozen("lower", lower, (k,), own),
            upper=_frozen("upper", upper, (k,), own),
            row_id=usual("row_id", k) if row_id is None else distinct_ids(row_id, own),
            feature=usual("feature", k) if feature is None else _features(feature, own),
            D=usual("D", m) if D is None else _masses(D, own),
            generators=None if generators is None else _generators(generators, own),
            kind=kind,
            accepted=accepted,
            restart=restart,
            t=t,
            h=h,
            alpha0=alpha0,
            eps0=eps0,
        )
        if own.__class__ is np.ndarray:
            self.__dict__["dense_A"] = own
        _refuse_large("d", self.d)
        self._check_bounds()
        if kind not in KINDS:
            raise ValueError(f"kind {kind!r} is unknown; choose one of {', '.join(KINDS)}")
        if not (-inf < t < inf and 0.0 < h < inf and 0.0 < alpha0 < inf and 0.0 < eps0 < inf):
            for name in ("t", "h", "alpha0", "eps0"):
                _number(name, self.__dict__[name])

    def _check_bounds(self) -> None:
        """Refuse NaN, lower = inf, upper = −inf and lower > upper; where lower < upper everywhere
        there is none of these."""
        lower, upper = self.lower, self.upper
        if np.count_nonzero(lower < upper) == lower.size:
            return
        _refuse_nan("lower", lower)
        _refuse_nan("upper", upper)
        if (lower == np.inf).any() or (upper == -np.inf).any():
            raise ValueError("lower may not be +inf and upper may not be -inf")
        if (lower > upper).any():
            i = np.flatnonzero(lower > upper)[0]
            raise ValueError(f"lower[{i}] = {lower[i]:g} exceeds upper[{i}] = {upper[i]:g}")

    @property
    def m(self) -> int:
        """Number of rows of A: coordinates of the bodies."""
        return int(self.A.shape[0])

    @property
    def k(self) -> int:
        """Number of columns of A: unknown multipliers."""
        return int(self.A.shape[1])

    @cached_property
    def dense_A(self) -> Vector:
        """A as a dense, read-only C array."""
        if isinstance(self.A, np.ndarray):
            return self.A
        from problems.kernels.spread import dense_array  # numba, which most of a QP does without

        return dense_array(self.A)

    def residual(self, x: ArrayLike) -> Vector:
        """r = A x + d, so that q̇_n = (h/α₀) D⁻¹ r (3.1b)."""
        return np.asarray(self.A @ np.asarray(x, float) + self.d)

    def gradient(self, x: ArrayLike) -> Vector:
        """Δ = Aᵀ(A x + d), so that G_nᵀ q̇_n = (h/α₀) Δ."""
        return np.asarray(self.A.T @ self.residual(x))

    def objective(self, x: ArrayLike) -> float:
        """½‖A x + d‖²."""
        r = self.residual(x)
        return 0.5 * float(r @ r)

    def multipliers(self, x: ArrayLike) -> Vector:
        """λ (or Λ = V x where the QP is posed by generators)."""
        x = np.asarray(x, float)
        return x.copy() if self.generators is None else self.generators @ x

    @classmethod
    def of_own(cls, **fields: Any) -> ContactQP:
        """A QP of arrays that were made for it, of the right types, shapes and order: neither
        copied nor checked, as the public constructor does, but no longer writable.  All fields but
        generators, which it has none of."""
        qp: ContactQP = object.__new__(cls)
        vars(qp).update(fields, generators=None)
        A = qp.A
        if isinstance(A, np.ndarray):
            assert A.flags.c_contiguous
            A.setflags(write=False)
            vars(qp)["dense_A"] = A
        else:
            for part in (A.data, A.indices, A.indptr):
                part.setflags(write=False)
        for array in (qp.d, qp.lower, qp.upper, qp.row_id, qp.feature, qp.D):
            array.setflags(write=False)
        return qp

    def _title(self) -> str:
        return self.kind

    def _sizes(self) -> dict[str, Any]:
        return {"rows": self.m, "columns": self.k, "t": f"{self.t:.6g} s", "eps0": self.eps0}

    def as_accepted(self) -> ContactQP:
        """The same QP, of a step that was accepted."""
        return self._with(accepted=True)

    def with_accuracy(self, eps0: float) -> ContactQP:
        """The same QP, to be solved to ‖A δx‖ ≤ eps0."""
        return self._with(eps0=_number("eps0", eps0))

    def _with(self, **fields: Any) -> ContactQP:
        """The same QP but for fields that are right."""
        made: ContactQP = object.__new__(type(self))
        vars(made).update(vars(self), **fields)
        return made


class Status(Enum):
    """How a solve ended, by the solver's own word.  The value says what to do about it."""

    SOLVED = "solved"
    INACCURATE = "stopped short of the accuracy asked; allow more iterations or ask for less"
    ITERATION_LIMIT = "the iteration cap was reached; raise it"
    TIME_LIMIT = "the time limit was reached; raise it"
    INFEASIBLE = "claims that no x meets the bounds, which is never so here; distrust the scaling"
    UNBOUNDED = "claims an unbounded objective, which is never so here; distrust the scaling"
    FAILED = "the solver gave up; its own words are kept in status_text"


@dataclass(frozen=True)
class WorkCounts:
    """Exact, deterministic counts of the work of one solve by algorithm 2."""

    descent_directions: int = 0
    working_set_changes: int = 0
    qr_factorizations: int = 0
    qr_updates: int = 0
    cg_iterations: int = 0
    flops: int = 0


@dataclass(frozen=True)
class Timing:
    """Seconds spent building the package's form, setting it up or updating it, and solving.

    inside : what the package's own clock says of setup and solve, NaN where it has none; of a
        method of ours, `solve`
    """

    build: float = 0.0
    setup: float = 0.0
    solve: float = 0.0
    inside: float = nan


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Short):
    """Answer to a `ContactQP`.

    x : (k,) float64 or None when there is no answer at all
    working_set : (k,) int8 in {AT_LOWER, FREE, AT_UPPER, PASSIVE}
    row_id : (k,) int64, of the QP that was solved
    status, status_text : the solver's claim, and the package's own words
    iterations : the solver's own count
    work : `WorkCounts` where the solver keeps them, else None
    timing : `Timing`
    memory : whatever the solver wants back at the next solve; serves one successor, never stored
    """

    x: Vector | None
    row_id: NDArray[np.int64]
    status: Status
    working_set: NDArray[np.int8]
    iterations: int = 0
    status_text: str = ""
    work: WorkCounts | None = None
    timing: Timing = field(default_factory=Timing)
    memory: Any = None

    def __post_init__(self) -> None:
        for array in (self.x, self.row_id, self.working_set):
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    def _title(self) -> str:
        return self.status.name.lower()

    def _sizes(self) -> dict[str, Any]:
        free = int(np.count_nonzero(self.working_set == FREE))
        return {"multipliers": self.row_id.size, "free": free, "iterations": self.iterations}

    def without_memory(self) -> Solution:
        """The answer alone."""
        made: Solution = object.__new__(type(self))
        vars(made).update(vars(self), memory=None)
        return made

    @property
    def found(self) -> bool:
        """Whether the solver claims success."""
        return self.status is Status.SOLVED


def working_set_of(qp: ContactQP, x: ArrayLike, tolerance: float = 0.0) -> NDArray[np.int8]:
    """Working set read off x: at a bound within `tolerance`, else free.  (k,) int8."""
    x = np.asarray(x, float)
    if tolerance:
        low, high = x <= qp.lower + tolerance, x >= qp.upper - tolerance
    else:
        low, high = x <= qp.lower, x >= qp.upper
    members: NDArray[np.int8] = (high > low).view(np.int8) - low.view(np.int8)
    return members


def positions_of(row_id: ArrayLike, previous: ArrayLike) -> NDArray[np.int64]:
    """For each entry of `row_id` its position in `previous`, or −1 where it is new.  (k,) int64."""
    row_id, previous = np.asarray(row_id, np.int64), np.asarray(previous, np.int64)
    if previous.size == 0:
        return np.full(row_id.size, -1, dtype=np.int64)
    order = np.argsort(previous, kind="stable")
    place = np.minimum(np.searchsorted(previous, row_id, sorter=order), previous.size - 1)
    found = order[place]
    return np.where(previous[found] == row_id, found, -1).astype(np.int64)
