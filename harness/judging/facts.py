"""What can be said of a QP before anyone solves it: rank, scale, and the accuracies asked of it.

`scale` = ‖A A⁺ d‖ is the part of d that contact forces can change.  ‖d‖ itself flatters: it holds
the whole momentum over h and is 10 to 40,000 times larger in moving scenes.  Where the contacts
can change nothing (A A⁺ d is rounding of d), the scale is ‖d‖, and 1 if that is 0 as well.

Up to `DENSE_COLUMNS` columns all of it comes from singular value decompositions.  Beyond, A is kept
sparse and the scale comes from sparse factors (`harness.judging.span`).  The rank still takes
singular values where sparse factors do not show it to be full; beyond `RANK_COLUMNS` columns, where
they would take many seconds, it is not determined.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from harness.judging.contact_rows import ContactRows, contact_rows
from harness.judging.proof import Proof, prove
from harness.judging.span import Basis, Flags, Span, SparseSpan, span_of
from harness.judging.tolerances import RANK_TOL
from problems.least_norm.independence import surely_independent
from problems.qp import ContactQP, Matrix, Vector

NOISE = 1e-12
"""‖A A⁺ d‖ below this fraction of ‖d‖ is rounding."""
ASKED_RELATIVE = {"high": 1e-9, "default": 1e-6}
"""Settings that ask for a fraction of `scale`; `paper` asks for each QP's own eps0.  A number in
place of a name, such as 1e-6, is a fraction of `scale` too."""
SETTINGS = ("paper", *ASKED_RELATIVE)
"""The one that headlines are drawn from first."""
DENSE_COLUMNS = 60
"""QPs of more columns are treated as sparse, here, by the error bound and by the oracle."""
RANK_COLUMNS = 1000
"""The rank of QPs of more columns is not determined."""
MODEST = 2_000_000
"""Work (`harness.judging.proof`) that is not asked whether it is worth it."""
POINTED = 1e-6
"""Least t of `Facts.pointed`, far above rounding."""
UNKNOWN = -1
"""Rank of a QP whose rank is not determined."""


@dataclass(frozen=True, eq=False)
class Facts:
    """Rank and scale of one QP, and A once more in extended precision for the error bound.

    rank : singular values above `RANK_TOL` of the largest, or `UNKNOWN`
    scale : ‖A A⁺ d‖, unit of `glambda_error`
    A, d : in `numpy.longdouble`, which holds float64 exactly
    norms : (k,) lengths of the columns, 1 for a column of zeros
    units : (k,) powers of two, from once to twice as long
    unit_columns : A over `units`, so that rank is not a matter of units, nor of rounding
    row_terms, column_terms : the most products that an entry of A x, of Aᵀ r is a sum of

    A and unit_columns are dense up to `DENSE_COLUMNS` columns, else in CSC.
    """

    qp: ContactQP
    rank: int
    scale: float
    A: np.ndarray
    d: np.ndarray
    norms: Vector
    units: Vector
    unit_columns: Matrix
    row_terms: int
    column_terms: int

    @property
    def sparse(self) -> bool:
        """Whether A and unit_columns are in CSC."""
        return sp.issparse(self.A)

    @cached_property
    def contact_rows(self) -> ContactRows:
        """Which rows are normals and tangents."""
        return contact_rows(self.qp)

    @cached_property
    def absolute(self) -> np.ndarray:
        """|A|, entry by entry."""
        return abs(self.A)

    def span(self, S: Flags) -> Span:
        """The span of the columns S (k,), over their units."""
        rows = np.flatnonzero(S)
        return span_of(self.unit_columns[:, rows], lambda some: self.qp.A[:, rows[some]])

    @cached_property
    def pushes(self) -> Flags:
        """(k,) which columns are not zeros."""
        return np.asarray(self.absolute.sum(axis=0) > 0).ravel()

    @cached_property
    def bases(self) -> dict[bytes, Basis | None]:
        """What has been proved of sets of columns, by their flags."""
        return {}

    @cached_property
    def proof(self) -> Proof | None:
        """The exact answer, where it can be had for little work."""
        return prove(self.qp, np.zeros(self.qp.k), MODEST) if self.qp.k <= DENSE_COLUMNS else None

    @cached_property
    def independent(self) -> bool:
        """Whether the columns of A are independent by far more than rounding."""
        return surely_independent(self.unit_columns)

    @cached_property
    def pointed(self) -> bool:
        """Whether no forces that change nothing can be added to others without end.

        It holds if some y has a_jᵀy > 0 for x_j that are bounded from below only and < 0 for those
        bounded from above only, and 0 for those unbounded, whose columns are independent: then
        A z = 0 and yᵀA z = 0 leave no such z but 0.
        """
        no_lower, no_upper = np.isinf(self.qp.lower), np.isinf(self.qp.upper)
        both = no_lower & no_upper
        basis = self.span(both).basis
        if both.any() and (basis is None or not basis.columns.all()):
            return False
        side = np.where(no_upper, 1.0, 0.0) - np.where(no_lower, 1.0, 0.0)
        one, C = np.flatnonzero(side), sp.csc_array(self.unit_columns)
        # the largest t ≤ 1 with ±a_jᵀy ≥ t, |y| ≤ 1
        rows = sp.hstack([-(C[:, one] * side[one]).T, np.ones((one.size, 1))], format="csr")
        still = sp.hstack([C[:, np.flatnonzero(both)].T, np.zeros((both.sum(), 1))], format="csr")
        m = self.qp.m
        found = linprog(
            np.append(np.zeros(m), -1.0),
            A_ub=rows if one.size else None,
            b_ub=np.zeros(one.size) if one.size else None,
            A_eq=still if both.any() else None,
            b_eq=np.zeros(int(both.sum())) if both.any() else None,
            bounds=[(-1.0, 1.0)] * m + [(0.0, 1.0)],
            method="highs",
        )
        return bool(found.status == 0 and found.x[-1] > POINTED)

    def asked(self, setting: str) -> float:
        """Accuracy in ‖A δx‖ that a setting asks for, or that `default` is judged by.

        Raises ValueError for an unknown setting.
        """
        if setting == "paper":
            return self.qp.eps0
        relative = ASKED_RELATIVE.get(setting)
        return (float(setting_name(setting)) if relative is None else relative) * self.scale


def setting_name(setting: str) -> str:
    """A setting as it is stored: a name of `SETTINGS`, or a number written in one way, as 2.5e-4.

    Raises ValueError for anything else.
    """
    if setting in SETTINGS:
        return setting
    try:
        relative = float(setting)
    except ValueError:
        relative = np.nan
    if not 0 < relative < 1:
        raise ValueError(
            f"setting {setting!r} is unknown; choose from {', '.join(SETTINGS)}, or give a number "
            "between 0 and 1, such as 1e-6: the accuracy relative to the scale of the QP"
        )
    digits, exponent = f"{relative:e}".split("e")
    return f"{float(digits):g}e{int(exponent)}"


def setting_names(settings: Iterable[str]) -> list[str]:
    """Each of them as it is stored, once.  Raises ValueError like `setting_name`."""
    return list(dict.fromkeys(map(setting_name, settings)))


def facts_of(qp: ContactQP) -> Facts:
    """Rank and scale of `qp`."""
    return _dense_facts(qp) if qp.k <= DENSE_COLUMNS else _sparse_facts(qp)


def rank_of(qp: ContactQP) -> int:
    """Singular values of A above `RANK_TOL` of the largest, or `UNKNOWN` of many columns."""
    if qp.k > RANK_COLUMNS:
        return UNKNOWN
    if qp.k > DENSE_COLUMNS and surely_independent(sp.csc_array(qp.A)):
        return qp.k
    return _rank(np.linalg.svd(qp.dense_A, compute_uv=False))


def _dense_facts(qp: ContactQP) -> Facts:
    A = qp.dense_A
    largest = np.abs(A).max(axis=0, initial=0.0)
    norms, units = _lengths(largest, np.linalg.norm(A / _powers(largest), axis=0))
    unit_columns = A / units
    basis, sigma, _ = np.linalg.svd(unit_columns, full_matrices=False)
    size, direction = _split(qp.d)
    return Facts(
        qp=qp,
        rank=rank_of(qp),
        scale=_scale(size, float(np.linalg.norm(basis[:, : _rank(sigma)].T @ direction))),
        A=A.astype(np.longdouble),
        d=qp.d.astype(np.longdouble),
        norms=norms,
        units=units,
        unit_columns=unit_columns,
        row_terms=qp.k,
        column_terms=qp.m,
    )


def _sparse_facts(qp: ContactQP) -> Facts:
    A = sp.csc_array(qp.A)
    largest = abs(A).max(axis=0).toarray().ravel()
    norms, units = _lengths(largest, sp.linalg.norm(sp.csc_array(A / _powers(largest)), axis=0))
    unit_columns = sp.csc_array(A / units)
    size, direction = _split(qp.d)
    span = SparseSpan(unit_columns)
    moved = np.zeros(qp.m)
    for _ in range(span.passes):
        moved += span.correction(unit_columns.T @ (direction - moved))
    return Facts(
        qp=qp,
        rank=rank_of(qp),
        scale=_scale(size, float(np.linalg.norm(moved))),
        A=A.astype(np.longdouble),
        d=qp.d.astype(np.longdouble),
        norms=norms,
        units=units,
        unit_columns=unit_columns,
        row_terms=int(np.diff(A.tocsr().indptr).max(initial=0)),
        column_terms=int(np.diff(A.indptr).max(initial=0)),
    )


def _powers(values: Vector) -> Vector:
    """The powers of two next above `values` > 0; 1 for a 0."""
    return np.where(values > 0, np.ldexp(1.0, np.frexp(values)[1]), 1.0)


def _lengths(largest: Vector, relative: Vector) -> tuple[Vector, Vector]:
    """Lengths and units of columns, of their largest entries and of lengths over `_powers` of it.

    No square is taken of a number that is far from 1, so that none underflows.
    """
    norms = np.where(relative > 0, relative * _powers(largest), 1.0)
    return norms, _powers(norms)


def _split(d: Vector) -> tuple[float, Vector]:
    """‖d‖, and d over it; 0 and d where it is 0."""
    power = float(_powers(np.abs(d).max(initial=0.0, keepdims=True))[0])
    size = float(np.linalg.norm(d / power))
    return size * power, d / power / (size or 1.0)


def _scale(size: float, moved: float) -> float:
    """‖d‖ = `size` times `moved` = ‖A A⁺ d‖/‖d‖, unless that is rounding."""
    return (size or 1.0) if moved <= NOISE or size * moved == 0.0 else size * moved


def _rank(sigma: np.ndarray) -> int:
    return int((sigma > RANK_TOL * sigma[0]).sum()) if sigma.size else 0
