"""The reference answer: a dense active-set method that spares no effort, and is then checked.

It shares no code with `solvers/`, so that it is a witness and not an accomplice.

1. x = 0 clipped to the bounds; no row is free.
2. Least-squares step on the free columns by a singular value decomposition; go as far as the
   bounds allow; rows that block stop being free.  Repeat until the whole step is taken.
3. Free the row whose gradient Δ = Aᵀr gains most, if any gains more than rounding; go to 2.
4. Refine x on the free columns in extended precision, with Δ evaluated from the data.
5. The answer is accepted if the bound that trusts nobody (`harness.error_bound`) puts it within
   `ACCEPTED` of A x*, relative to the scale of the QP.  Whatever went wrong before shows here.

Freed columns are linearly independent of the free ones, so that A may lack rank (Lawson and Hanson
1974, chapter 23; Stark and Parker 1995 for the two-sided bounds).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.error_bound import error_bound
from harness.facts import Facts, facts_of
from harness.recording import Reference
from problems.qp import ContactQP, Vector

ACCEPTED = 1e-10
"""Largest error bound, relative to the scale, at which an answer is a reference."""
ROUNDING = 1e-13
"""A gradient below ‖a_i‖ ‖r‖ times this is 0, as is a singular value relative to the largest."""

Flags = NDArray[np.bool_]


def reference(qp: ContactQP, facts: Facts | None = None) -> Reference | None:
    """A x* and a bound on its error, or None where no answer passes the check."""
    facts = facts or facts_of(qp)
    x, free = _active_set(facts)
    refined = _refine(facts, x, free)
    best = None
    for candidate in (refined, np.asarray(x, np.longdouble)):
        bound = error_bound(qp, candidate, facts)
        if best is None or bound < best[1]:
            best = (candidate, bound)
        if best[1] <= 1e-3 * ACCEPTED * facts.scale:
            break
    assert best is not None
    candidate, bound = best
    exact = facts.A @ candidate
    Ax = np.asarray(exact, float)
    bound += float(np.linalg.norm(exact - Ax))
    if not bound <= ACCEPTED * facts.scale:
        return None
    x = np.clip(np.asarray(candidate, float), qp.lower, qp.upper)
    x.setflags(write=False)
    Ax.setflags(write=False)
    return Reference(x, Ax, bound)


def _active_set(facts: Facts) -> tuple[Vector, Flags]:
    """x and the free rows at which no gradient gains more than rounding."""
    qp, A = facts.qp, facts.qp.dense_A
    lower, upper = qp.lower, qp.upper
    x = np.clip(np.zeros(qp.k), lower, upper)
    free = np.zeros(qp.k, bool)
    tried = np.zeros(qp.k, bool)
    for _ in range(20 * (qp.k + 5)):
        r = A @ x + qp.d
        gradient = A.T @ r
        # A row can gain downhill if there is room on that side.
        gain = np.where(
            ((gradient < 0) & (x < upper)) | ((gradient > 0) & (x > lower)), np.abs(gradient), 0.0
        )
        gain /= facts.norms
        gain[free | tried | (gain <= ROUNDING * np.linalg.norm(r))] = 0.0
        if not gain.any():
            break
        freed = int(np.argmax(gain))
        free[freed] = True
        moved = _descend(facts, x, free)
        # A row that is thrown back at once was freed by rounding: not again before progress.
        tried = np.zeros(qp.k, bool) if moved else tried
        tried[freed] = not moved
    return x, free


def _descend(facts: Facts, x: Vector, free: Flags) -> bool:
    """Minimise over the free rows, dropping those that block; x and free are modified in place.

    Returns whether x moved at all.
    """
    qp, A = facts.qp, facts.qp.dense_A
    lower, upper = qp.lower, qp.upper
    moved = False
    while free.any():
        index = np.flatnonzero(free)
        columns = facts.unit_columns[:, index]
        p = np.linalg.lstsq(columns, -(A @ x + qp.d), rcond=ROUNDING)[0] / facts.norms[index]
        room = np.where(p > 0, upper[index] - x[index], x[index] - lower[index])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(p != 0, room / np.abs(p), np.inf)
        step = min(1.0, float(ratio.min()))
        x[index] = np.clip(x[index] + step * p, lower[index], upper[index])
        moved = moved or (step > 0 and bool(p.any()))
        if step == 1.0:
            break
        blocked = index[ratio <= step]
        x[blocked] = np.where(p[ratio <= step] > 0, upper[blocked], lower[blocked])
        free[blocked] = False
    return moved


def _refine(facts: Facts, x: Vector, free: Flags) -> np.ndarray:
    """Newton's correction on the free rows with r and Δ in extended precision."""
    refined = np.asarray(x, np.longdouble)
    if not free.any():
        return refined
    A, norms = facts.A[:, free], facts.norms[free]
    _, sigma, Vt = np.linalg.svd(facts.unit_columns[:, free], full_matrices=False)
    kept = sigma > ROUNDING * sigma[0]
    sigma, Vt = sigma[kept], Vt[kept]
    for _ in range(4):
        gradient = np.asarray(A.T @ (facts.A @ refined + facts.d), float) / norms
        refined[free] -= (Vt.T @ ((Vt @ gradient) / sigma**2)) / norms
    return np.clip(refined, facts.qp.lower, facts.qp.upper)
