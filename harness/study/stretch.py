"""QPs of a recording made as ill-conditioned as one likes: what does squaring the condition cost?

The condition of A in the paper's scenes is 15 at most, which forgives everything.  A stretched QP
keeps the rows, the bounds, the answer x*, the working set and the signs of the gradient of the
original, and has the condition κ:

1. B = A with columns of length 1 = U Σ Vᵀ, without the σ that are rounding.
2. Σ′ falls geometrically from 1 to 1/κ; B′ = U Σ′ Vᵀ and A′ = B′ with the lengths of A.
3. A residual r′ whose gradient A′ᵀr′ is that of the original at x*, but for a factor by which its
   part in the range of A keeps its length.
4. d′ = r′ − A′ x*, so that x* meets the KKT conditions, to rounding of A′ and d′.  The part of d
   that no contact can change, and ε₀, keep their ratio to the part that contacts can.

The references are sought anew, in exact arithmetic, of the data as they are rounded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from harness.judging.facts import DENSE_COLUMNS
from harness.judging.oracle import reference
from harness.names import STRETCHED
from harness.progress import Progress
from harness.recordings.recording import Recording, Reference
from problems.qp import ContactQP, Solution, Status, working_set_of

ROUNDING = 1e-12
"""A σ below this fraction of the largest is 0."""


def stretched(
    recording: Recording, condition: float, progress: Progress | None = None
) -> Recording:
    """The recording with every QP of at least two columns stretched to this condition.

    QPs without a reference, of one column, or of more than `DENSE_COLUMNS` are left out, and so is
    the motion, which is not theirs.

    Raises ValueError for a condition that is not between 1 and 1e9.
    """
    if not 1 <= condition <= 1e9:
        raise ValueError(f"condition = {condition:g}; give a number from 1 to 1e9")
    qps, solutions, references, mu = [], [], [], []
    count = len(recording.qps)
    for i, (qp, known) in enumerate(zip(recording.qps, recording.references, strict=True)):
        if progress is not None and i % 20 == 0:
            progress("stretch", i, count)
        if known is None or not 2 <= qp.k <= DENSE_COLUMNS:
            continue
        made = stretched_qp(qp, known, condition)
        x = known.x.copy()
        qps.append(made)
        solutions.append(Solution(x, made.row_id, Status.SOLVED, working_set_of(made, x)))
        references.append(reference(made, start=x))
        mu.append(recording.mu[i])
    if progress is not None:
        progress("stretch", count, count)
    return recording.without_motion(
        scene=f"{recording.scene}{STRETCHED}{condition:g}",
        parameters={**recording.parameters, "stretched.condition": float(condition)},
        qps=tuple(qps),
        solutions=tuple(solutions),
        references=tuple(references),
        mu=tuple(mu),
    )


def stretched_qp(qp: ContactQP, known: Reference, condition: float) -> ContactQP:
    """The QP at this condition, with the same x*."""
    A = qp.dense_A
    lengths = np.linalg.norm(A, axis=0)
    lengths[lengths == 0] = 1.0
    U, sigma, Vt = np.linalg.svd(A / lengths, full_matrices=False)
    rank = int((sigma > ROUNDING * sigma[0]).sum())
    U, Vt = U[:, :rank], Vt[:rank]
    new_sigma = np.geomspace(1.0, 1.0 / condition, rank) if rank > 1 else np.ones(rank)
    new_A = (U * new_sigma) @ Vt * lengths
    r = known.Ax + qp.d
    gradient = A.T @ r
    gradient[(qp.lower < known.x) & (known.x < qp.upper)] = 0.0
    seen = U.T @ r
    new_seen = (Vt @ (gradient / lengths)) / new_sigma
    size = float(np.linalg.norm(new_seen))
    new_seen *= float(np.linalg.norm(seen)) / size if size > 0 else 0.0
    visible_d = U @ new_seen - new_A @ known.x
    ratio = float(np.linalg.norm(visible_d)) / (float(np.linalg.norm(U.T @ qp.d)) or 1.0) or 1.0
    return replace(qp, A=new_A, d=visible_d + ratio * (r - U @ seen), eps0=ratio * qp.eps0)
