"""The bound that trusts nobody: how far A x can be from A x*, from x alone.

For x̄ within its bounds, r = A x̄ + d, and any v such that Δ' = Aᵀ(r + v) has Δ'ᵢ ≥ 0 where
uᵢ = ∞ and Δ'ᵢ ≤ 0 where lᵢ = −∞,

    ‖A(x̄ − x*)‖ ≤ ½(‖v‖ + √(‖v‖² + 4g)),   g = Σ Δ'⁺(x̄ − l) + Δ'⁻(u − x̄),  0·∞ = 0.

Proof.  With e = A(x̄ − x*): optimality of x* gives r*ᵀe ≥ 0, and (r + v)ᵀe = Δ'ᵀ(x̄ − x*) ≤ g.  So
‖e‖² = (r − r*)ᵀe ≤ rᵀe ≤ g − vᵀe ≤ g + ‖v‖‖e‖.

Every x̄ and every admissible v give a bound; the least one found is kept.

1. x̄ is x clipped to its bounds, as it is and with entries snapped to a bound: those that a
   gradient step would carry over it, and those that are tiny.  ‖A(x − x̄)‖ is added.
2. S is a set of rows: none, or those that are free; and where that comes to much more than their v,
   these and all whose gradient is quiet, 0 or little more.  Of a heap hundreds are, and making them
   0 as they come, by the list of `_evaluate`, moves others without end.
3. v = −(A_Sᵀ)⁺Δ_S, the least v that makes Δ' vanish on S.
4. Rows on which Δ' has a sign that is not admissible join S, until there are none; where S began
   with the free rows, so do rows at a bound with the wrong sign, so that g = 0.
5. v = −r is always admissible and needs no S: the bound is then ‖r‖.

r and Δ' are evaluated in `numpy.longdouble`, and what rounding can do to them is added to ‖v‖: for
r as it is, for Δ' by the v that would undo it.  What is left of Δ' on S is not taken for 0 but
undone alike: Δ'_S = A_Sᵀ(r + v) is made 0 by a vector no longer than ‖Δ'_B‖/σ_min(A_B), B being
columns of S that are proved to be independent and to span the others
(`harness.judging.span.Basis`).  So the bound holds for the recorded data as they are, whatever
their condition; where no such B is proved, S is given up.  `SLACK` covers the rest.

Columns may be dependent but for rounding: independent as they are recorded, with singular values
of 1e-16.  No v is then known to be short, in arithmetic of 64 bits.  Two things can be done:

6. The answer in exact arithmetic is sought (`harness.judging.proof`), where it is had for little
   work; the distance from it is the bound.
7. With `nearby`, the bound is of another QP, in which singular values of A_S that are `NEARBY` at
   most are 0.  That proves nothing of the recorded one; the oracle says so.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from harness.judging.facts import Facts, facts_of
from harness.judging.proof import Proof
from harness.judging.span import Basis, Span
from harness.recordings.recording import Reference
from problems.qp import ContactQP, Vector

UNIT = float(np.finfo(np.longdouble).eps)
TINY = 1e-7
"""Entries within this fraction of max |x| of a bound are snapped to it, in one of the trials."""

QUIET = 1e-15, 1e-13, 1e-11
"""Gradients below one of these times ‖a_j‖‖r‖ are quiet."""
MUCH = 100.0
"""Times ‖v‖ of the free rows beyond which most of a bound is rounding that has been undone."""
SLACK = 1e-6
"""Relative error of σ_min(A_S), of ‖a_j‖ and of the norms taken, by which they are enlarged."""
ROUND_UP = 1 + 1e-12
"""Makes up for the rounding of the last sums."""
NEARBY = 1e-12
"""What may be taken from each of the columns, of length 1, where `nearby` is asked for."""
MANY_SETS = 100
"""Of which a QP keeps what is proved."""
MAX_GROWTH = 100
"""Times that a set of rows may grow before the trial is given up; each takes a factorization."""

Flags = NDArray[np.bool_]


class _Spans:
    """Spans of sets of columns of one QP; the last one is kept, for it is asked for again.

    nearby : whether columns near the span of others may count as in it
    gave_up : whether there was a set of which nothing is proved
    """

    def __init__(self, facts: Facts, nearby: bool) -> None:
        self.facts, self.nearby = facts, nearby
        self.gave_up = False
        self._last: tuple[Flags, Span] | None = None

    def __call__(self, S: Flags) -> Span:
        if self._last is None or not np.array_equal(self._last[0], S):
            self._last = S.copy(), self.facts.span(S)
        return self._last[1]

    def _basis(self, S: Flags) -> Basis | None:
        """As proved of S; answers to one QP have few sets between them."""
        known, key = self.facts.bases, S.tobytes()
        if key not in known and len(known) < MANY_SETS:
            known[key] = self(S).basis
        return known[key] if key in known else self(S).basis

    def undoing(self, S: Flags, slack: np.ndarray) -> np.longdouble:
        """‖w‖ at most, of a w with |A_Sᵀ w| ≤ `slack` (k,) where that has one; inf if unknown."""
        S = S & self.facts.pushes
        B, flatness = np.ones(S.sum(), bool), 0.0
        if self.nearby:
            nearby = self(S).nearby
            if nearby.gap <= NEARBY * np.sqrt(S.sum()):
                flatness = nearby.flatness
        elif (basis := self._basis(S)) is not None:
            B, flatness = basis.columns, basis.flatness
        if flatness == 0.0:
            self.gave_up = True
            return np.longdouble(np.inf)
        inside = slack[S][B] / self.facts.units[S][B]
        return np.linalg.norm(inside) / flatness * (1 + SLACK)

    def moved(self, S: Flags, x: np.ndarray) -> float:
        """‖E x‖ of what is taken from columns so that they may count as in the span of others."""
        S = S & self.facts.pushes
        return self(S).taken(np.asarray(self.facts.units * x, float)[S]) if self.nearby else 0.0


def error_bound(
    qp: ContactQP,
    x: np.ndarray,
    facts: Facts | None = None,
    *,
    nearby: bool = False,
    known: Reference | Proof | None = None,
) -> float:
    """Bound on ‖A(x − x*)‖; inf for an x that is not finite.

    x : (k,) float64, or longdouble where more digits are known
    facts : of this QP, if they are at hand
    nearby : be content with a QP that differs by rounding (list of the module, 7)
    known : the exact answer, if it is at hand (list of the module, 6)
    """
    facts = facts or facts_of(qp)
    x = np.asarray(x)
    if x.shape != (qp.k,) or not np.isfinite(x).all():
        return float("inf")
    best, spans = np.longdouble(np.inf), _Spans(facts, nearby)
    for inside in _candidates(facts, x):
        way = x - inside
        moved = np.linalg.norm(facts.A @ way) + np.linalg.norm(_rounding(facts, np.abs(way)))
        if moved < best:
            best = min(best, moved + _bound_at(facts, spans, inside, best - moved))
    if spans.gave_up and not nearby:
        exact = known or facts.proof
        if exact is not None:
            off, lost = distance(facts, x, exact.Ax)
            best = min(best, off + lost + np.longdouble(exact.error_bound))
    return upward(best)


def upward(bound: np.longdouble) -> float:
    """A float64 that is no less than a sum of few terms; inf where it is no number."""
    enlarged = float(bound * ROUND_UP)
    # what is below the least float64 must not become 0
    return np.inf if np.isnan(enlarged) else float(np.nextafter(enlarged, np.inf)) * (bound > 0)


def distance(facts: Facts, x: np.ndarray, Ax: Vector) -> tuple[np.longdouble, np.longdouble]:
    """‖A x − Ax‖ in extended precision, and what rounding can have done to it."""
    off = facts.A @ x - Ax
    lost = _rounding(facts, np.abs(x), np.abs(Ax))
    return np.linalg.norm(off), np.linalg.norm(lost)


def _rounding(facts: Facts, x: np.ndarray, d: np.ndarray | float = 0.0) -> np.ndarray:
    """What rounding can do to A x + d, of |x| and |d|.  (m,)"""
    return (facts.row_terms + 2) * UNIT * (facts.absolute @ x + d)


def rounding_of(facts: Facts, x: np.ndarray) -> np.ndarray:
    """What rounding can do to A x + d, (m,)."""
    return _rounding(facts, np.abs(x), np.abs(facts.d))


def _candidates(facts: Facts, x: np.ndarray) -> Iterator[np.ndarray]:
    """Points within the bounds, near x (list of the module, item 1)."""
    lower, upper = facts.qp.lower, facts.qp.upper
    inside = np.clip(x.astype(np.longdouble), lower, upper)
    yield inside
    gradient = facts.A.T @ (facts.A @ inside + facts.d)
    target = inside - gradient / facts.norms / facts.norms
    tiny = TINY * np.abs(inside).max(initial=0.0)
    seen = [inside]
    for low, high in (
        (target <= lower, target >= upper),
        (inside - lower <= tiny, upper - inside <= tiny),
    ):
        snapped = np.where(low, lower, np.where(high, upper, inside))
        if not any(np.array_equal(snapped, other) for other in seen):
            seen.append(snapped)
            yield snapped


def _bound_at(facts: Facts, spans: _Spans, x: np.ndarray, enough: np.longdouble) -> np.longdouble:
    """Least bound over a few S at one x within its bounds.

    enough : do not go on once the bound cannot improve on this
    """
    qp, A = facts.qp, facts.A
    r = A @ x + facts.d
    lost = np.linalg.norm(rounding_of(facts, x))
    best = np.linalg.norm(r) + lost
    free = (x > qp.lower) & (x < qp.upper) & facts.pushes
    bound, least = _bound_on(facts, spans, x, r, free, True)
    best = min(best, lost + bound)
    if best > 1e-3 * enough:
        best = min(best, lost + _bound_on(facts, spans, x, r, np.zeros_like(free), False)[0])
    others = _with_quiet(facts, r, free)
    while best > MUCH * (lost + least) and (S := next(others, None)) is not None:
        best = min(best, lost + _bound_on(facts, spans, x, r, S, True)[0])
    return best


def _with_quiet(facts: Facts, r: np.ndarray, free: Flags) -> Iterator[Flags]:
    """The free rows and the quiet ones, by each of `QUIET` that adds any."""
    slopes, last = np.abs(facts.A.T @ r) / facts.norms / np.linalg.norm(r), free
    for quiet in QUIET:
        S = free | ((slopes <= quiet) & facts.pushes)
        if not np.array_equal(S, last):
            yield S
        last = S


def _bound_on(
    facts: Facts, spans: _Spans, x: np.ndarray, r: np.ndarray, S: Flags, all_signs: bool
) -> tuple[np.longdouble, np.longdouble]:
    """Bound with v = −(A_Sᵀ)⁺Δ_S, S enlarged until v is admissible, and ‖v‖; inf, 0 if it never is.

    all_signs : enlarge S further until every row at a bound has its sign, which makes g = 0
    """
    qp, A = facts.qp, facts.A
    no_upper, no_lower = np.isinf(qp.upper), np.isinf(qp.lower)
    up_is_wrong, down_is_wrong = no_lower, no_upper
    if all_signs:
        fixed = qp.lower == qp.upper
        up_is_wrong = no_lower | ((x >= qp.upper) & ~fixed)
        down_is_wrong = no_upper | ((x <= qp.lower) & ~fixed)
    for _ in range(min(qp.k + 1, MAX_GROWTH)):
        v = _least_correction(facts, spans, r, S)
        gradient = A.T @ (r + v)
        margin = (facts.column_terms + 2) * UNIT * (facts.absolute.T @ (np.abs(r) + np.abs(v)))
        # Rows of S vanish but for rounding, which is undone below.
        gradient[S] = 0.0
        bad = (down_is_wrong & (gradient < -margin)) | (up_is_wrong & (gradient > margin))
        if not bad.any():
            break
        S = S | bad
    else:
        return np.longdouble(np.inf), np.longdouble(0.0)
    gradient = A.T @ (r + v)
    bound, grew = _evaluate(facts, spans, x, v, S, gradient, margin, True)
    if grew:
        bound = min(bound, _evaluate(facts, spans, x, v, S, gradient, margin, False)[0])
    return bound, np.linalg.norm(v)


def _evaluate(
    facts: Facts,
    spans: _Spans,
    x: np.ndarray,
    v: np.ndarray,
    S: Flags,
    gradient: np.ndarray,
    margin: np.ndarray,
    all_unsure: bool,
) -> tuple[np.longdouble, bool]:
    """½(‖v‖ + √(‖v‖² + 4g)) with the rounding of Δ' on either side of its sign.

    Gradients that are 0 but for rounding, and what is left of those of S, are made 0 by a small
    addition w to v: on an unbounded side their sign must hold, on a bounded one √g would blow 1e-16
    up to 1e-8.  It moves the other gradients by up to ‖a_j‖‖w‖, which may make more of them
    uncertain, and so on without end.

    all_unsure : make all of them 0, and not only those of S and of unbounded sides; also returns
        whether that made a difference
    """
    qp, norms = facts.qp, facts.norms
    no_upper, no_lower = np.isinf(qp.upper), np.isinf(qp.lower)
    unsure = np.zeros(qp.k, bool)
    undo, most = np.longdouble(0.0), np.linalg.norm(v) + np.linalg.norm(facts.A @ x + facts.d)
    grew = False
    for _ in range(min(qp.k + 1, MAX_GROWTH)):
        reach = margin + norms * undo
        more = S | (no_upper & (gradient < reach)) | (no_lower & (gradient > -reach))
        if all_unsure:
            some = np.abs(gradient) <= reach
            grew |= bool((some & ~more).any())
            more |= some
        if not (more & ~unsure).any():
            break
        unsure |= more
        undo = spans.undoing(unsure, np.abs(gradient) + margin)
        if not undo < most:
            return np.longdouble(np.inf), grew
    else:
        return np.longdouble(np.inf), grew
    below = np.where(no_lower, 0.0, x - np.where(no_lower, 0.0, qp.lower))
    above = np.where(no_upper, 0.0, np.where(no_upper, 0.0, qp.upper) - x)
    # An uncertain row adds nothing to g: its gradient is 0 once w is added.
    down = np.where(unsure, 0.0, np.maximum(gradient + reach, 0.0)) @ below
    up = np.where(unsure, 0.0, np.maximum(reach - gradient, 0.0)) @ above
    size, g = np.linalg.norm(v) + undo, down + up
    size += 2 * spans.moved(unsure, x)
    return 0.5 * (size + np.hypot(size, 2 * np.sqrt(g))), grew


def _least_correction(facts: Facts, spans: _Spans, r: np.ndarray, S: Flags) -> np.ndarray:
    """v = −(A_Sᵀ)⁺ A_Sᵀ r, refined in extended precision."""
    v = np.zeros_like(r)
    if not S.any():
        return v
    span = spans(S)
    A_S, units = facts.A[:, S], facts.units[S]
    for _ in range(span.passes):
        gradient = np.asarray((A_S.T @ (r + v)) / units, float)
        v = v - span.correction(gradient)
    return v
