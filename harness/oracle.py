"""The reference answer: a dense active-set method that spares no effort, and is then checked.

It shares no code with `solvers/`, so that it is a witness and not an accomplice.

1. x = 0 clipped to the bounds; no row is free.
2. Free the row whose gradient Δ = Aᵀr gains most; stop if none gains more than rounding.
3. Least-squares step on the free columns by a singular value decomposition; go as far as the
   bounds allow; rows that block stop being free.  Repeat until the whole step is taken.
4. Refine x on the free columns in extended precision, with Δ evaluated from the data; go to 2.
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
from problems.qp import ContactQP

ACCEPTED = 1e-10
"""Largest error bound, relative to the scale, at which an answer is a reference."""
ROUNDING = 64 * float(np.finfo(np.longdouble).eps)
"""A gradient Δ_i below this times ‖a_i‖ ‖ |A||x| + |d| ‖ is 0."""
RANK_TOL = 1e-13
"""A singular value below this fraction of the largest is 0."""

Flags = NDArray[np.bool_]


def reference(qp: ContactQP, facts: Facts | None = None) -> Reference | None:
    """A x* and a bound on its error, or None where the answer does not pass the check."""
    facts = facts or facts_of(qp)
    exact = _active_set(facts)
    Ax = np.asarray(facts.A @ exact, float)
    rounded = float(np.linalg.norm(facts.A @ exact - Ax))
    bound = error_bound(qp, exact, facts) + rounded
    if not bound <= ACCEPTED * facts.scale:
        return None
    x = np.clip(np.asarray(exact, float), qp.lower, qp.upper)
    x.setflags(write=False)
    Ax.setflags(write=False)
    return Reference(x, Ax, bound)


def _active_set(facts: Facts) -> np.ndarray:
    """x (k,) in extended precision at which no gradient gains more than rounding."""
    qp, A = facts.qp, facts.A
    lower, upper = qp.lower, qp.upper
    x = np.clip(np.zeros(qp.k, np.longdouble), lower, upper)
    free = np.zeros(qp.k, bool)
    tried = np.zeros(qp.k, bool)
    for _ in range(20 * (qp.k + 5)):
        r = A @ x + facts.d
        gradient = A.T @ r
        noise = ROUNDING * (np.abs(A) @ np.abs(x) + np.abs(facts.d))
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
        step = min(1.0, float(ratio.min()))
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
