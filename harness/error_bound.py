"""The bound that trusts nobody: how far A x can be from A x*, from x alone.

For x̄ within its bounds, r = A x̄ + d, and any v such that Δ' = Aᵀ(r + v) has Δ'ᵢ ≥ 0 where
uᵢ = ∞ and Δ'ᵢ ≤ 0 where lᵢ = −∞,

    ‖A(x̄ − x*)‖ ≤ ½(‖v‖ + √(‖v‖² + 4g)),   g = Σ Δ'⁺(x̄ − l) + Δ'⁻(u − x̄),  0·∞ = 0.

Proof.  With e = A(x̄ − x*): optimality of x* gives r*ᵀe ≥ 0, and (r + v)ᵀe = Δ'ᵀ(x̄ − x*) ≤ g.  So
‖e‖² = (r − r*)ᵀe ≤ rᵀe ≤ g − vᵀe ≤ g + ‖v‖‖e‖.

Every x̄ and every admissible v give a bound; the least one found is kept.

1. x̄ is x clipped to its bounds, as it is and with entries snapped to a bound: those that a
   gradient step would carry over it, and those that are tiny.  ‖A(x − x̄)‖ is added.
2. S is a set of rows: none, or those that are free.
3. v = −(A_Sᵀ)⁺Δ_S, the least v that makes Δ' vanish on S.
4. Rows on which Δ' has a sign that is not admissible join S, until there are none; where S began
   with the free rows, so do rows at a bound with the wrong sign, so that g = 0.
5. v = −r is always admissible and needs no S: the bound is then ‖r‖.

r and Δ' are evaluated in `numpy.longdouble`, and what rounding can do to them is added to ‖v‖: for
r as it is, for Δ' by the v that would undo it, ‖δ‖/σ_min(A_S).  `SLACK` covers the rest.

So it holds for the recorded data as they are, unless columns are dependent or nearly so.  Singular
values below 1e-12 of the largest (1e-6 where A has many columns, `harness.span`) count as 0, and
the bound is then of a QP whose A differs from the recorded one by as little.  That is as much as
arithmetic of 64 bits can say: with σ = 1e-13 kept, ‖δ‖/σ_min is no longer small.  In exact
arithmetic more can be said (`harness.proof`); `Facts.independent` tells which QPs need it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from harness.facts import Facts, facts_of
from harness.span import Span, span_of
from problems.qp import ContactQP

UNIT = float(np.finfo(np.longdouble).eps)
TINY = 1e-7
"""Entries within this fraction of max |x| of a bound are snapped to it, in one of the trials."""

SLACK = 1e-6
"""Relative error of σ_min(A_S), of ‖a_j‖ and of the norms taken, by which they are enlarged."""
ROUND_UP = 1 + 1e-12
"""Makes up for the rounding of the last sums."""
MAX_GROWTH = 100
"""Times that a set of rows may grow before the trial is given up; each takes a factorization."""

Flags = NDArray[np.bool_]


class _Spans:
    """Spans of sets of columns of one QP; the last one is kept, for it is asked for again."""

    def __init__(self, facts: Facts) -> None:
        self.columns = facts.unit_columns
        self._last: tuple[Flags, Span] | None = None

    def __call__(self, S: Flags) -> Span:
        if self._last is None or not np.array_equal(self._last[0], S):
            self._last = S.copy(), span_of(self.columns[:, S])
        return self._last[1]


def error_bound(qp: ContactQP, x: np.ndarray, facts: Facts | None = None) -> float:
    """Bound on ‖A(x − x*)‖; inf for an x that is not finite.

    x : (k,) float64, or longdouble where more digits are known
    facts : of this QP, if they are at hand
    """
    facts = facts or facts_of(qp)
    x = np.asarray(x)
    if x.shape != (qp.k,) or not np.isfinite(x).all():
        return float("inf")
    best, spans = np.inf, _Spans(facts)
    for inside in _candidates(facts, x):
        way = x - inside
        moved = float(np.linalg.norm(facts.A @ way))
        moved += float(np.linalg.norm(_rounding(facts, np.abs(way))))
        if moved < best:
            best = min(best, moved + _bound_at(facts, spans, inside, best - moved))
    return best * ROUND_UP


def _rounding(facts: Facts, x: np.ndarray, d: np.ndarray | float = 0.0) -> np.ndarray:
    """What rounding can do to A x + d, of |x| and |d|.  (m,)"""
    return (facts.row_terms + 2) * UNIT * (facts.absolute @ x + d)


def _candidates(facts: Facts, x: np.ndarray) -> Iterator[np.ndarray]:
    """Points within the bounds, near x (list of the module, item 1)."""
    lower, upper = facts.qp.lower, facts.qp.upper
    inside = np.clip(x.astype(np.longdouble), lower, upper)
    yield inside
    gradient = facts.A.T @ (facts.A @ inside + facts.d)
    target = inside - gradient / facts.norms**2
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


def _bound_at(facts: Facts, spans: _Spans, x: np.ndarray, enough: float) -> float:
    """Least bound over a few S at one x within its bounds.

    enough : do not go on once the bound cannot improve on this
    """
    qp, A = facts.qp, facts.A
    r = A @ x + facts.d
    lost = float(np.linalg.norm(_rounding(facts, np.abs(x), np.abs(facts.d))))
    best = float(np.linalg.norm(r)) + lost
    free = (x > qp.lower) & (x < qp.upper)
    for S, all_signs in ((free, True), (np.zeros_like(free), False)):
        bound = lost + _bound_on(facts, spans, x, r, S, all_signs)
        best = min(best, bound)
        if best <= 1e-3 * enough:
            break
    return best


def _bound_on(
    facts: Facts, spans: _Spans, x: np.ndarray, r: np.ndarray, S: Flags, all_signs: bool
) -> float:
    """Bound with v = −(A_Sᵀ)⁺Δ_S, S enlarged until v is admissible; inf if it never is.

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
        return float("inf")
    return _evaluate(facts, spans, x, v, A.T @ (r + v), margin)


def _evaluate(
    facts: Facts,
    spans: _Spans,
    x: np.ndarray,
    v: np.ndarray,
    gradient: np.ndarray,
    margin: np.ndarray,
) -> float:
    """½(‖v‖ + √(‖v‖² + 4g)) with the rounding of Δ' on either side of its sign.

    Gradients that are 0 but for rounding are made 0 by a small addition w to v: on an unbounded
    side their sign must hold, on a bounded one √g would blow 1e-16 up to 1e-8.  It moves the other
    gradients by up to ‖a_j‖‖w‖, which may make more of them uncertain.
    """
    qp, norms = facts.qp, facts.norms
    no_upper, no_lower = np.isinf(qp.upper), np.isinf(qp.lower)
    unsure = np.zeros(qp.k, bool)
    undo = 0.0
    for _ in range(min(qp.k + 1, MAX_GROWTH)):
        reach = margin + norms * undo
        more = (
            (np.abs(gradient) <= reach)
            | (no_upper & (gradient < reach))
            | (no_lower & (gradient > -reach))
        )
        if not (more & ~unsure).any():
            break
        unsure |= more
        slack = (np.abs(gradient) + margin)[unsure]
        # the least ‖w‖ with A_Sᵀ w = −slack, which is known to be consistent
        undo = float(np.linalg.norm(slack / norms[unsure])) / spans(unsure).least_singular_value
        undo *= 1 + SLACK
    else:
        return float("inf")
    below = np.where(no_lower, 0.0, x - np.where(no_lower, 0.0, qp.lower))
    above = np.where(no_upper, 0.0, np.where(no_upper, 0.0, qp.upper) - x)
    # An uncertain row adds nothing to g: its gradient is 0 once w is added.
    down = np.where(unsure, 0.0, np.maximum(gradient + reach, 0.0)) @ below
    up = np.where(unsure, 0.0, np.maximum(reach - gradient, 0.0)) @ above
    size, g = float(np.linalg.norm(v)) + undo, float(down + up)
    return 0.5 * (size + float(np.sqrt(size * size + 4.0 * g)))


def _least_correction(facts: Facts, spans: _Spans, r: np.ndarray, S: Flags) -> np.ndarray:
    """v = −(A_Sᵀ)⁺ A_Sᵀ r, refined in extended precision."""
    v = np.zeros_like(r)
    if not S.any():
        return v
    span = spans(S)
    A_S, norms = facts.A[:, S], facts.norms[S]
    for _ in range(span.passes):
        gradient = np.asarray((A_S.T @ (r + v)) / norms, float)
        v = v - span.correction(gradient)
    return v
