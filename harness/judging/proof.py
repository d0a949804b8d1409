"""The answer of a QP in exact arithmetic: a proof, not an estimate.

float64 data are rational numbers.  So are the x of a set of free rows, the gradients that it leaves
and every sign on which optimality hangs: nothing is undecidable, however degenerate or deficient
in rank.

1. A = 2ᵃ Â, d = 2ᵇ d̂ with integers Â, d̂, and x = 2ᵇ⁻ᵃ y, so that A x + d = 2ᵇ (Â y + d̂).
2. Free are the rows that the candidate has strictly between their bounds.
3. B is a largest independent subset of the free columns.  It is found modulo a prime: columns that
   are independent there are independent.  The other free rows stay where they are.
4. Solve Â_BᵀÂ_B z = −Â_Bᵀ(Â y + d̂ without B) and go from y_B towards z as far as the bounds allow.
   Rows that block stop being free; then back to 3.
5. At z, if a row can gain downhill, free the one that gains most and go to 3.  If none can, the KKT
   conditions hold exactly, and A x is A x*, which is unique (proposition 3).

This is the method of Lawson and Hanson (1974, chapter 23) with two-sided bounds (Stark and Parker
1995).  In exact arithmetic every freed row lowers the objective, so it ends; from a good candidate
it ends at once.  The systems are solved by FLINT (p-adic lifting, Dixon 1982), at the price of ball
arithmetic: 0.3 ms at k = 12, 0.4 s at k = 200.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from flint import fmpq, fmpq_mat, fmpz, fmpz_mat, nmod_mat
from numpy.typing import ArrayLike

from problems.qp import ContactQP, Matrix, Vector

COLUMNS = 200
"""QPs of more columns are not tried, unless asked for."""
MANY_COLUMNS = 600
"""QPs of more columns are not tried at all: their integers alone take seconds."""
WORK = 20_000_000
"""Sum of |B|³ over all solves beyond which the proof is given up; some 0.5 s."""
BITS = 256
"""Entries of ÂᵀÂ of n times as many bits, of data spread over many decades, cost n² the work."""
PRIME = 2**64 - 59
"""The largest prime of 64 bits."""


@dataclass(frozen=True, eq=False)
class Proof:
    """An answer in exact arithmetic, rounded.

    x : (k,) within its bounds;  Ax : (m,);  error_bound : ‖Ax − A x*‖ is at most this, by rounding
    exchanges : rows that became or stopped being free on the way from the candidate
    """

    x: Vector
    Ax: Vector
    error_bound: float
    exchanges: int


def prove(
    qp: ContactQP, candidate: ArrayLike, work: float = WORK, columns: int | None = None
) -> Proof | None:
    """The exact answer, sought from a `candidate` (k,); None where it takes too much work.

    Also None for more than `columns` columns, by default `COLUMNS`, and where numbers overflow
    float64.
    """
    if qp.k > (COLUMNS if columns is None else columns):
        return None
    exact = _Exact(qp, np.clip(np.asarray(candidate, float), qp.lower, qp.upper))
    try:
        return exact.proof() if exact.settle(work) else None
    except OverflowError:
        return None


def exact_answer(
    qp: ContactQP, candidate: ArrayLike, work: float = WORK, columns: int | None = None
) -> tuple[list[int], int] | None:
    """x of the exact answer, numerators (k) over one denominator > 0; None where `prove` gives it.

    Of a QP whose A lacks rank it is one of many.
    """
    if qp.k > (COLUMNS if columns is None else columns):
        return None
    exact = _Exact(qp, np.clip(np.asarray(candidate, float), qp.lower, qp.upper))
    if not exact.settle(work):
        return None
    numerators, one = _joint([y * exact.unit for y in exact.y])
    return [int(entry) for entry in numerators.entries()], int(one)


class _Exact:
    """The QP in integers, with the y that is under way (list of the module)."""

    def __init__(self, qp: ContactQP, x: Vector) -> None:
        A = qp.dense_A
        self.qp, self.a, self.b = qp, _exponent(A), _exponent(qp.d)
        self.unit = unit = fmpq(2) ** (self.b - self.a)
        self.A = fmpz_mat(qp.m, qp.k, [_integer(v, self.a) for v in A.ravel().tolist()])
        self.gram = self.A.transpose() * self.A
        self.rows = self.gram.table()
        longest = max((int(row[j]).bit_length() for j, row in enumerate(self.rows)), default=0)
        self.price = max(1, longest // BITS) ** 2
        d = fmpz_mat(qp.m, 1, [_integer(v, self.b) for v in qp.d.tolist()])
        self.slope = self.A.transpose() * d
        self.lower = [None if v == -np.inf else _rational(v) / unit for v in qp.lower.tolist()]
        self.upper = [None if v == np.inf else _rational(v) / unit for v in qp.upper.tolist()]
        self.y = [_rational(v) / unit for v in x.tolist()]
        self.free = {j for j in range(qp.k) if self._above(j) and self._below(j)}
        self.exchanges = 0

    def _above(self, j: int) -> bool:
        """Whether y_j may go down."""
        lower = self.lower[j]
        return lower is None or self.y[j] > lower

    def _below(self, j: int) -> bool:
        """Whether y_j may go up."""
        upper = self.upper[j]
        return upper is None or self.y[j] < upper

    def settle(self, work: float) -> bool:
        """Steps 3 to 5; whether they came to their end."""
        while True:
            while basis := self._basis():
                work -= self.price * len(basis) ** 3
                if work < 0:
                    return False
                if self._advance(basis):
                    break
            gain = self._gains()
            if not gain:
                return True
            best = max(gain, key=gain.__getitem__)
            if best in self.free:  # the prime has hidden that its column is independent
                return False
            self.free.add(best)
            self.exchanges += 1

    def _basis(self) -> list[int]:
        """B: free rows with independent columns."""
        free = sorted(self.free)
        if not free:
            return free
        echelon, rank = nmod_mat(self._gram(free), PRIME).rref()
        if rank == len(free):
            return free
        return [free[next(j for j in range(len(free)) if echelon[i, j] != 0)] for i in range(rank)]

    def _gram(self, B: list[int]) -> fmpz_mat:
        return fmpz_mat([[self.rows[i][j] for j in B] for i in B])

    def _advance(self, B: list[int]) -> bool:
        """Step 4; whether y_B has reached z."""
        y = self.y
        inside = set(B)
        still, one = _joint([fmpq(0) if j in inside else v for j, v in enumerate(y)])
        slope = self.gram * still + self.slope * one
        z = self._gram(B).solve(fmpz_mat([[-slope[j, 0]] for j in B])).table()
        target = [entry[0] / one for entry in z]
        step = fmpq(1)
        blocking: dict[int, fmpq] = {}
        for j, to in zip(B, target, strict=True):
            lower, upper = self.lower[j], self.upper[j]
            if lower is not None and to < lower:
                bound = lower
            elif upper is not None and to > upper:
                bound = upper
            else:
                continue
            share = (bound - y[j]) / (to - y[j])
            if share < step:
                step, blocking = share, {}
            if share == step:
                blocking[j] = bound
        for j, to in zip(B, target, strict=True):
            y[j] += step * (to - y[j])
        for j, bound in blocking.items():
            y[j] = bound
        self.free -= blocking.keys()
        self.exchanges += len(blocking)
        return not blocking

    def _gains(self) -> dict[int, fmpq]:
        """Δ_j²/‖a_j‖² of the rows that can gain downhill, in some unit; empty at an answer."""
        y, one = _joint(self.y)
        gradient = (self.gram * y + self.slope * one).entries()
        return {
            j: fmpq(slope * slope, self.rows[j][j])
            for j, slope in enumerate(gradient)
            if (slope > 0 and self._above(j)) or (slope < 0 and self._below(j))
        }

    def proof(self) -> Proof:
        """The answer, rounded."""
        y, one = _joint(self.y)
        rounded = [_rounded(entry, one, self.b) for entry in (self.A * y).entries()]
        Ax, errors = np.array(rounded, float).reshape(-1, 2).T
        x = np.array([_rounded(entry, one, self.b - self.a)[0] for entry in y.entries()], float)
        return Proof(
            x=np.clip(x, self.qp.lower, self.qp.upper),
            Ax=Ax.copy(),
            # each error was rounded once, and its square may be below the least float64
            error_bound=float(np.linalg.norm(errors)) * (1 + 1e-12) + 1e-160 * bool(errors.any()),
            exchanges=self.exchanges,
        )


def exact_rank(A: Matrix) -> int:
    """The rank of A (m, f), dense or sparse, in exact arithmetic."""
    dense: Vector = sp.csc_array(A).toarray() if sp.issparse(A) else np.asarray(A)
    exponents = [_exponent(column) for column in dense.T]
    entries = [
        _integer(value, e)
        for column, e in zip(dense.T.tolist(), exponents, strict=True)
        for value in column
    ]
    return int(fmpz_mat(dense.shape[1], dense.shape[0], entries).rank())


def _exponent(values: Vector) -> int:
    """The greatest e for which all values are integers times 2ᵉ; 0 where all are 0."""
    nonzero = values[values != 0]
    if nonzero.size == 0:
        return 0
    fraction, exponent = np.frexp(nonzero)
    mantissa = np.abs(fraction * 2.0**53).astype(np.int64)
    trailing = np.log2(mantissa & -mantissa).astype(np.int64)
    return int((exponent - 53 + trailing).min())


def _integer(value: float, e: int) -> int:
    """value/2ᵉ, which is an integer."""
    numerator, denominator = value.as_integer_ratio()
    shift = denominator.bit_length() - 1 + e
    return numerator >> shift if shift >= 0 else numerator << -shift


def _rational(value: float) -> fmpq:
    return fmpq(*value.as_integer_ratio())


def _rounded(numerator: fmpz, denominator: fmpz, e: int) -> tuple[float, float]:
    """The float64 nearest to 2ᵉ numerator/denominator, and how far it is.

    Raises OverflowError where there is none.
    """
    above, below = int(numerator) << max(e, 0), int(denominator) << max(-e, 0)
    nearest = above / below
    p, q = nearest.as_integer_ratio()
    return nearest, abs(above * q - p * below) / (below * q)


def _joint(values: list[fmpq]) -> tuple[fmpz_mat, fmpz]:
    """Numerators (k, 1) over one denominator."""
    numerators, denominator = fmpq_mat(len(values), 1, values).numer_denom()
    return numerators, denominator
