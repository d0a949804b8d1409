"""The reference answer: an active-set method that spares no effort, and is then proved or checked.

The method shares no code with `solvers/`, so that it is a witness and not an accomplice.  Up to
`harness.judging.facts.DENSE_COLUMNS` columns it is a dense one that starts from nothing:

1. x = 0 clipped to the bounds; no row is free.
2. Free the row whose gradient Δ = Aᵀr gains most; stop if none gains more than rounding.
3. Least-squares step on the free columns by a singular value decomposition; go as far as the
   bounds allow; rows that block stop being free.  Repeat until the whole step is taken.
4. Refine x on the free columns in extended precision, with Δ evaluated from the data; go to 2.
5. From there the answer in exact arithmetic is sought (`harness.judging.proof`).  Its A x* is the
   reference, wrong by no more than its own rounding.  An answer that is at hand is tried first:
   exact arithmetic believes nobody, so it does not matter whose it is.
6. Where that takes too much work, the answer of 4 is accepted if the bound that trusts nobody
   (`harness.judging.error_bound`) puts it within `ACCEPTED` of A x*, relative to the scale of the
   QP. Whatever went wrong before shows here.

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
       no trouble: of all corrections about the least is taken (`harness.judging.span`).
    c. Free rows beyond a bound go to it; rows at a bound with the wrong sign beyond rounding are
       freed.  Back to b until there are none.

    d. That need not end.  Where it does not, x is led downhill as in 1 to 4: rows are freed
       together, or one by one where they throw each other back.

It need not be right where it ends.  Steps 5 and 6 tell, in the order 6, 5.  Where neither says
anything, columns may be dependent but for rounding.  The answer is then a reference if it is within
the bound of a QP that differs by no more ("nearby"), and forces that change nothing cannot be added
without end (`Facts.pointed`): a witness, but no proof.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.judging.error_bound import distance, error_bound, upward
from harness.judging.facts import Facts, facts_of
from harness.judging.proof import COLUMNS, MANY_COLUMNS, Proof, prove
from harness.judging.span import SparseSpan
from harness.judging.tolerances import STEP_TOL
from harness.recordings.recording import Reference
from problems.qp import ContactQP, Vector

ACCEPTED = 1e-10
"""Largest error bound, relative to the scale, at which an answer is a reference."""
UNIT_ROUNDOFF = 0.5 * float(np.finfo(np.float64).eps)
ROUNDING = 64 * float(np.finfo(np.longdouble).eps)
"""A gradient Δ_i below this times ‖a_i‖ ‖ |A||x| + |d| ‖ is 0."""
FEW = 3
"""Solves with all columns that are worth it to prove an answer at once, without steps 1 to 4."""
MAX_CHANGES = 50
"""Sets of free rows that the sparse method tries."""
MAX_WALKS = 200
"""Times that rows are freed in step d."""

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
            return _reference(facts, proof.x, proof.Ax, proof.error_bound, "exact")
    found = _settle(facts, start) if facts.sparse else _active_set(facts)
    proof = prove(qp, np.asarray(found, float))
    if proof is None:
        known = _checked(facts, found, "bound")
        if known is None and facts.pointed:
            known = _checked(facts, found, "nearby")
        if known is not None:
            return known
        if COLUMNS < qp.k <= MANY_COLUMNS:
            proof = prove(qp, np.asarray(found, float), columns=MANY_COLUMNS)
    if proof is None:
        return None
    if not _well_posed(facts, proof):
        return _checked(facts, found, "ill-posed")
    return _reference(facts, proof.x, proof.Ax, proof.error_bound, "exact")


def _well_posed(facts: Facts, proof: Proof) -> bool:
    """Whether another rounding of A would have the same A x*, to `ACCEPTED`."""
    pushes = float(np.abs(proof.x) @ facts.norms)
    return UNIT_ROUNDOFF * pushes <= ACCEPTED * facts.scale


def _checked(facts: Facts, found: np.ndarray, proof: str) -> Reference | None:
    """Step 6, of an x in extended precision."""
    Ax = np.asarray(facts.A @ found, float)
    bound = error_bound(facts.qp, found, facts, nearby=proof != "bound")
    off, lost = distance(facts, found, Ax)
    bound = upward(bound + off + lost)
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
        p = np.linalg.lstsq(columns, -r, rcond=STEP_TOL)[0] / facts.units[index]
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
    A, units = facts.A[:, free], facts.units[free]
    _, sigma, Vt = np.linalg.svd(facts.unit_columns[:, free], full_matrices=False)
    kept = sigma > STEP_TOL * sigma[:1]
    sigma, Vt = sigma[kept], Vt[kept]
    for _ in range(3):
        gradient = np.asarray(A.T @ (facts.A @ refined + facts.d) / units, float)
        refined[free] -= (Vt.T @ ((Vt @ gradient) / sigma**2)) / units
    return np.clip(refined, facts.qp.lower, facts.qp.upper)


def _settle(facts: Facts, start: ArrayLike | None) -> np.ndarray:
    """x (k,) in extended precision where the primal-dual active-set method ended."""
    qp, A = facts.qp, facts.A
    lower, upper = qp.lower, qp.upper
    x = np.clip(np.zeros(qp.k) if start is None else np.asarray(start), lower, upper)
    x = x.astype(np.longdouble)
    target = x - A.T @ (A @ x + facts.d) / facts.norms / facts.norms
    low, high = target <= lower, target >= upper
    free = ~(low | high)
    for _ in range(MAX_CHANGES):
        x = np.where(low, lower, np.where(high, upper, x))
        x = _correct(facts, x, free)
        gradient, noise = _gradient(facts, x)
        low = (free & (x < lower)) | (~free & (x <= lower) & (gradient >= -noise))
        high = (free & (x > upper)) | (~free & (x >= upper) & (gradient <= noise))
        low |= lower == upper
        if np.array_equal(free, ~(low | high)):
            return np.clip(x, lower, upper)
        free = ~(low | high)
    return _walk(facts, np.clip(x, lower, upper))


def _gradient(facts: Facts, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Δ, and what of it is rounding."""
    size = facts.absolute
    noise = ROUNDING * (size.T @ (size @ np.abs(x) + np.abs(facts.d)))
    return facts.A.T @ (facts.A @ x + facts.d), noise


def _walk(facts: Facts, x: np.ndarray) -> np.ndarray:
    """x (k,), within its bounds, led downhill until no row can gain (list of the module, d)."""
    lower, upper = facts.qp.lower, facts.qp.upper
    free, several = (x > lower) & (x < upper), True
    for _ in range(MAX_WALKS):
        x, moved = _downhill(facts, x, free)
        gradient, noise = _gradient(facts, x)
        free = (x > lower) & (x < upper)
        gain = ((gradient < -noise) & (x < upper)) | ((gradient > noise) & (x > lower))
        gain &= ~free
        if not gain.any():
            break
        several = moved  # rows that are freed together may throw each other back
        if not several:
            gain = np.arange(x.size) == np.argmax(np.where(gain, np.abs(gradient), 0) / facts.norms)
        free |= gain
    return x


def _downhill(facts: Facts, x: np.ndarray, free: Flags) -> tuple[np.ndarray, bool]:
    """The least objective on free rows, less those that block on the way; whether x moved."""
    lower, upper, moved = facts.qp.lower, facts.qp.upper, False
    free = free.copy()
    while free.any():
        p = _correct(facts, x, free) - x
        room = np.where(p > 0, upper - x, x - lower)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(p != 0, room / np.abs(p), np.inf)
        step = min(np.longdouble(1.0), ratio.min())
        # a longer step that is bent at the bounds may go further down, and drops many rows at once
        ends = [np.clip(x + share * p, lower, upper) for share in (1.0, 0.3, step)]
        best = min(ends, key=lambda end: float(np.linalg.norm(facts.A @ end + facts.d)))
        moved = moved or not np.array_equal(best, x)
        blocked = free & ((best <= lower) | (best >= upper)) & (ratio <= 1.0)
        x = best
        if step == 1.0:
            break
        free &= ~(blocked | (ratio <= step))
    return x, moved


def _correct(facts: Facts, x: np.ndarray, free: Flags) -> np.ndarray:
    """Newton's corrections on the free rows until Δ no longer shrinks."""
    if not free.any():
        return x
    x, A, units = x.copy(), facts.A[:, free], facts.units[free]
    span = SparseSpan(facts.unit_columns[:, free])
    before = np.inf
    for _ in range(span.passes):
        gradient = np.asarray(A.T @ (facts.A @ x + facts.d) / units, float)
        largest = float(np.abs(gradient).max())
        if not largest < 0.5 * before:
            break
        before = largest
        x[free] -= span.coefficients(gradient) / units
    return x
