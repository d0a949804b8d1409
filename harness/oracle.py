"""The reference answer: an active-set method that spares no effort, and is then proved or checked.

The method shares no code with `solvers/`, so that it is a witness and not an accomplice.  Up to
`harness.facts.DENSE_COLUMNS` columns it is a dense one that starts from nothing:

1. x = 0 clipped to the bounds; no row is free.
2. Free the row whose gradient Δ = Aᵀr gains most; stop if none gains more than rounding.
3. Least-squares step on the free columns by a singular value decomposition; go as far as the
   bounds allow; rows that block stop being free.  Repeat until the whole step is taken.
4. Refine x on the free columns in extended precision, with Δ evaluated from the data; go to 2.
5. From there the answer in exact arithmetic is sought (`harness.proof`).  Its A x* is the
   reference, wrong by no more than its own rounding.  An answer that is at hand is tried first:
   exact arithmetic believes nobody, so it does not matter whose it is.
6. Where that takes too much work, the answer of 4 is accepted if the bound that trusts nobody
   (`harness.error_bound`) puts it within `ACCEPTED` of A x*, relative to the scale of the QP.
   Whatever went wrong before shows here.

The exact answer is no reference either where x* is so large that A x* would change by more than
`ACCEPTED` with the last bit of A: where columns are opposite but for rounding, and could push
against each other for ever.  Such a QP is ill-posed: that of a minimum norm may be, where the
inequalities have no room.  Nobody's answer in float64 is near the exact one; 6 says what is asked.

Freed columns are linearly independent of the free ones, so that A may lack rank (Lawson and Hanson
1974, chapter 23; Stark and Parker 1995 for the two-sided bounds).

Beyond, steps 1 to 4 are a primal-dual active-set method (Hintermüller, Ito and Kunisch 2002) with
sparse factors, which starts from an answer that is to be proved or, without one, from x = 0:

    a. Free are the rows that a gradient step leaves between their bounds; the others are set to
       the bound where it ends.
    b. Newton's corrections on the free rows, with Δ in extended precision.  Dependent columns are
       no trouble: of all corrections about the least is taken (`harness.span`).
    c. Free rows beyond a bound go to it; rows at a bound with the wrong sign beyond rounding are
       freed.  Back to b until there are none.

It need not end, nor be right where it does.  Steps 5 and 6 tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.error_bound import error_bound
from harness.facts import Facts, facts_of
from harness.proof import Proof, prove
from harness.recording import Reference
from harness.span import SparseSpan
from problems.qp import ContactQP, Vector

ACCEPTED = 1e-10
"""Largest error bound, relative to the scale, at which an answer is a reference."""
UNIT_ROUNDOFF = 0.5 * float(np.finfo(np.float64).eps)
ROUNDING = 64 * float(np.finfo(np.longdouble).eps)
"""A gradient Δ_i below this times ‖a_i‖ ‖ |A||x| + |d| ‖ is 0."""
RANK_TOL = 1e-13
"""A singular value below this fraction of the largest is 0."""
FEW = 3
"""Solves with all columns that are worth it to prove an answer at once, without steps 1 to 4."""
MAX_CHANGES = 50
"""Sets of free rows that the sparse method tries."""

Flags = NDArray[np.bool_]


def reference(
    qp: ContactQP, facts: Facts | None = None, start: ArrayLike | None = None
) -> Reference | None:
    """A x* and a bound on its error, or None where there is no answer that passes 5 or 6.

    facts : of this QP, if they are at hand
    start : (k,) an answer that may be right; where it is, steps 1 to 4 are spared
    """
    facts = facts or facts_of(qp)
    if start is not None:
        proof = prove(qp, start, FEW * qp.k**3)
        if proof is not None and _well_posed(facts, proof):
            return _reference(facts, proof.x, proof.Ax, proof.radius, "exact")
    found = _settle(facts, start) if facts.sparse else _active_set(facts)
    proof = prove(qp, np.asarray(found, float))
    if proof is None:
        return _checked(facts, found, "bound")
    if not _well_posed(facts, proof):
        return _checked(facts, found, "ill-posed")
    return _reference(facts, proof.x, proof.Ax, proof.radius, "exact")


def _well_posed(facts: Facts, proof: Proof) -> bool:
    """Whether another rounding of A would have the same A x*, to `ACCEPTED`."""
    pushes = float(np.abs(proof.x) @ facts.norms)
    return UNIT_ROUNDOFF * pushes <= ACCEPTED * facts.scale


def _checked(facts: Facts, found: np.ndarray, proof: str) -> Reference | None:
    """Step 6, of an x in extended precision."""
    Ax = np.asarray(facts.A @ found, float)
    rounded = float(np.linalg.norm(facts.A @ found - Ax))
    bound = error_bound(facts.qp, found, facts) + rounded
    if not bound <= ACCEPTED * facts.scale:
        return None
    return _reference(facts, np.asarray(found, float), Ax, bound, proof)


def _reference(facts: Facts, x: Vector, Ax: Vector, radius: float, proof: str) -> Reference:
    x = np.clip(x, facts.qp.lower, facts.qp.upper)
    x.setflags(write=False)
    Ax.setflags(write=False)
    return Reference(x, Ax, radius, proof)


def _active_set(facts: Facts) -> np.ndarray:
    """x (k,) in extended precision at which no gradient gains more than rounding."""
    qp, A = facts.qp, facts.A
    lower, upper = qp.lower, qp.upper
    x = np.clip(np.zeros(qp.k, np.longdouble), lower, upper)
    free = np.zeros(qp.k, bool)
    tried = np.zeros(qp.k, bool)
    for _ in range(4 * (qp.k + 5)):
        r = A @ x + facts.d
        gradient = A.T @ r
        noise = ROUNDING * (facts.absolute @ np.abs(x) + np.abs(facts.d))
        # A row can gain downhill if there is room on that side.
        gain = np.where(
            ((gradient < 0) & (x < upper)) | ((gradient > 0) & (x > lower)), np.abs(gradient), 0.0
        )
        gain /= facts.norms
        gain[free | tried | (gain <= np.linalg.norm(noise))] = 0.0
        if not gain.any():
            break
        freed = int(np.argmax(gain))
        free[freed] = True
        moved = _descend(facts, x, free)
        # A row that is thrown back at once was freed by rounding: not again before progress.
        tried = np.zeros(qp.k, bool) if moved else tried
        tried[freed] = not moved
        x = _refine(facts, x, free)
    return x


def _descend(facts: Facts, x: np.ndarray, free: Flags) -> bool:
    """Minimise over the free rows, dropping those that block; x and free are modified in place.

    Returns whether x moved at all.
    """
    lower, upper = facts.qp.lower, facts.qp.upper
    moved = False
    while free.any():
        index = np.flatnonzero(free)
        columns = facts.unit_columns[:, index]
        r = np.asarray(facts.A @ x + facts.d, float)
        p = np.linalg.lstsq(columns, -r, rcond=RANK_TOL)[0] / facts.norms[index]
        room = np.where(p > 0, upper[index] - x[index], x[index] - lower[index])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(p != 0, room / np.abs(p), np.inf)
        # in extended precision, or rounding might leave the row that blocks just short of its bound
        step = min(np.longdouble(1.0), ratio.min())
        x[index] = np.clip(x[index] + step * p, lower[index], upper[index])
        moved = moved or (step > 0 and bool(p.any()))
        if step == 1.0:
            break
        blocked = index[ratio <= step]
        x[blocked] = np.where(p[ratio <= step] > 0, upper[blocked], lower[blocked])
        free[blocked] = False
    return moved


def _refine(facts: Facts, x: np.ndarray, free: Flags) -> np.ndarray:
    """Newton's correction on the free rows with r and Δ in extended precision."""
    if not free.any():
        return x
    refined = x.copy()
    A, norms = facts.A[:, free], facts.norms[free]
    _, sigma, Vt = np.linalg.svd(facts.unit_columns[:, free], full_matrices=False)
    kept = sigma > RANK_TOL * sigma[0]
    sigma, Vt = sigma[kept], Vt[kept]
    for _ in range(3):
        gradient = np.asarray(A.T @ (facts.A @ refined + facts.d), float) / norms
        refined[free] -= (Vt.T @ ((Vt @ gradient) / sigma**2)) / norms
    return np.clip(refined, facts.qp.lower, facts.qp.upper)


def _settle(facts: Facts, start: ArrayLike | None) -> np.ndarray:
    """x (k,) in extended precision where the primal-dual active-set method ended."""
    qp, A = facts.qp, facts.A
    lower, upper, size = qp.lower, qp.upper, facts.absolute
    x = np.clip(np.zeros(qp.k) if start is None else np.asarray(start), lower, upper)
    x = x.astype(np.longdouble)
    target = x - A.T @ (A @ x + facts.d) / facts.norms**2
    low, high = target <= lower, target >= upper
    free = ~(low | high)
    for _ in range(MAX_CHANGES):
        x = np.where(low, lower, np.where(high, upper, x))
        x = _correct(facts, x, free)
        r = A @ x + facts.d
        gradient = A.T @ r
        noise = ROUNDING * (size.T @ (size @ np.abs(x) + np.abs(facts.d)))
        low = (free & (x < lower)) | (~free & (x <= lower) & (gradient >= -noise))
        high = (free & (x > upper)) | (~free & (x >= upper) & (gradient <= noise))
        low |= lower == upper
        if np.array_equal(free, ~(low | high)):
            break
        free = ~(low | high)
    return np.clip(x, lower, upper)


def _correct(facts: Facts, x: np.ndarray, free: Flags) -> np.ndarray:
    """Newton's corrections on the free rows until Δ no longer shrinks."""
    if not free.any():
        return x
    x, A, norms = x.copy(), facts.A[:, free], facts.norms[free]
    span = SparseSpan(facts.unit_columns[:, free])
    before = np.inf
    for _ in range(span.passes):
        gradient = np.asarray(A.T @ (facts.A @ x + facts.d), float) / norms
        largest = float(np.abs(gradient).max())
        if not largest < 0.5 * before:
            break
        before = largest
        x[free] -= span.coefficients(gradient) / norms
    return x
