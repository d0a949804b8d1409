"""The QPs of a recording put otherwise, or slightly wrong: does a backend mind?

    permuted      contacts and bodies numbered in another order
    scaled        every multiplier in a unit of its own, from 1e-2 to 1e2, and half of them with the
                  other sign, so that lower bounds become upper ones
    duplicated    half of the contacts twice, each with half of the bounds
    1e-9, …       noise: every entry of A and of d that is not 0 changed by so much of itself

The first three pose the same problem: A x* is that of the original, in another order of bodies.
What is drawn belongs to a row's identity, or to a body, and not to a QP, so that a disturbed
sequence is as continuous as its original; noise is drawn anew for each QP.  All is seeded.  The
references are sought anew, in exact arithmetic, of the data as they are rounded.

QP i of a disturbed recording is QP i of its original.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from harness.judging.oracle import reference
from harness.names import DISTURBED
from harness.progress import Progress
from harness.recordings.recording import Recording, Reference
from problems.qp import ContactQP, Solution, Status, Vector, working_set_of

SEED = 1984
DECADES = 2.0
"""Scales are between 10 to the power of minus and plus this."""
COORDINATES = 3
"""Rows of A that are moved together: a body in the plane, its place or its attitude in space."""
NOISE = (1e-12, 1e-9, 1e-6)
LARGEST_NOISE = 1e-3


class Draws:
    """Random numbers by the identity of a row, or of a body; the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def of_rows(self, ids: NDArray[np.int64]) -> Vector:
        """(k, 3) uniform in [0, 1)."""
        drawn = [np.random.default_rng([self.seed, abs(int(i)), int(i < 0)]).random(3) for i in ids]
        return np.array(drawn).reshape(-1, 3)

    def order_of_coordinates(self, m: int) -> NDArray[np.int64]:
        """Rows of A in the new order; bodies stay whole where there are bodies."""
        block = COORDINATES if m % COORDINATES == 0 else 1
        bodies = np.random.default_rng([self.seed, m]).permutation(m // block)
        return (block * bodies[:, None] + np.arange(block)).ravel()


Disturbed = tuple[ContactQP, Vector, Vector]
"""A QP, the μ of its rows and an x of it."""
Disturbance = Callable[[ContactQP, Vector, Vector, Draws, int], Disturbed]
"""Takes such three, what is drawn and the number of the QP."""


def permuted(qp: ContactQP, mu: Vector, x: Vector, draws: Draws, number: int) -> Disturbed:
    """Columns by a random key of their row, coordinates by one of their body."""
    columns = np.argsort(draws.of_rows(qp.row_id)[:, 0], kind="stable")
    rows = draws.order_of_coordinates(qp.m)
    made = _columns(qp, columns)
    return replace(made, A=made.A[rows], d=qp.d[rows], D=qp.D[rows]), mu[columns], x[columns]


def scaled(qp: ContactQP, mu: Vector, x: Vector, draws: Draws, number: int) -> Disturbed:
    """x′ = s x with s = ±10^u."""
    u, sign, _ = draws.of_rows(qp.row_id).T
    s = np.where(sign < 0.5, -1.0, 1.0) * 10.0 ** (DECADES * (2.0 * u - 1.0))
    ends = np.sort([s * qp.lower, s * qp.upper], axis=0) + 0.0
    V = qp.generators
    made = replace(
        qp,
        A=_times(qp.A, 1.0 / s),
        lower=ends[0],
        upper=ends[1],
        generators=None if V is None else V / s,
    )
    return made, mu, np.clip(s * x, made.lower, made.upper)


def duplicated(qp: ContactQP, mu: Vector, x: Vector, draws: Draws, number: int) -> Disturbed:
    """Chosen columns twice; the copy of row i is row −1 − i, and both have half of the bounds."""
    twice = np.flatnonzero(draws.of_rows(qp.row_id)[:, 0] < 0.5)
    columns = np.concatenate([np.arange(qp.k), twice])
    half = np.ones(columns.size)
    half[twice] = half[qp.k :] = 0.5
    made = _columns(qp, columns, ids=np.concatenate([qp.row_id, -1 - qp.row_id[twice]]))
    made = replace(made, lower=half * made.lower, upper=half * made.upper)
    return made, mu[columns], half * x[columns]


def noisy(size: float) -> Disturbance:
    """A and d with relative noise of this size."""

    def disturb(qp: ContactQP, mu: Vector, x: Vector, draws: Draws, number: int) -> Disturbed:
        rng = np.random.default_rng([draws.seed, number])
        A: Any = qp.A
        if sp.issparse(A):
            A = A.copy()
            A.data = A.data * (1.0 + size * rng.standard_normal(A.data.size))
        else:
            A = A * (1.0 + size * rng.standard_normal(A.shape))
        return replace(qp, A=A, d=qp.d * (1.0 + size * rng.standard_normal(qp.m))), mu, x

    return disturb


KINDS: dict[str, Disturbance] = {"permuted": permuted, "scaled": scaled, "duplicated": duplicated}
EVERY_KIND = (*KINDS, *(f"{size:g}" for size in NOISE))


def disturbance(kind: str) -> Disturbance:
    """The disturbance of this name, or noise of this size.

    Raises ValueError for an unknown name, and for noise that is not between 0 and 1e-3.
    """
    if kind in KINDS:
        return KINDS[kind]
    try:
        size = float(kind)
    except ValueError:
        size = -1.0
    if not 0 < size <= LARGEST_NOISE:
        known = ", ".join(KINDS)
        raise ValueError(
            f"disturbance {kind!r} is unknown; choose from {known}, "
            f"or give the size of noise, up to {LARGEST_NOISE:g}"
        )
    return noisy(size)


def disturbed(
    recording: Recording, kind: str, seed: int = SEED, progress: Progress | None = None
) -> Recording:
    """The recording with every QP disturbed; the motion, which is not theirs, is left out.

    Raises ValueError as `disturbance` does.
    """
    disturb, draws = disturbance(kind), Draws(seed)
    qps, solutions, references, mu = [], [], [], []
    count = len(recording.qps)
    for i, qp in enumerate(recording.qps):
        if progress is not None and i % 20 == 0:
            progress("disturb", i, count)
        made, mu_of_rows, x = disturb(qp, recording.mu[i], _known(recording, i), draws, i)
        qps.append(made)
        mu.append(mu_of_rows)
        solutions.append(Solution(x, made.row_id, Status.SOLVED, working_set_of(made, x)))
        references.append(_reference(made, recording.references[i], x))
    if progress is not None:
        progress("disturb", count, count)
    return recording.without_motion(
        scene=f"{recording.scene}{DISTURBED}{kind}",
        parameters={
            **recording.parameters,
            "disturbed.kind": kind,
            "disturbed.seed": seed,
        },
        qps=tuple(qps),
        solutions=tuple(solutions),
        references=tuple(references),
        mu=tuple(mu),
    )


def _known(recording: Recording, i: int) -> Vector:
    """x* of QP i where it is known, else the stepper's x."""
    known, solution = recording.references[i], recording.solutions[i]
    x = known.x if known is not None else solution.x
    return np.zeros(recording.qps[i].k) if x is None else np.array(x)


def _reference(qp: ContactQP, before: Reference | None, x: Vector) -> Reference | None:
    """A proved reference, where the original had one."""
    return None if before is None else reference(qp, start=x)


def _columns(qp: ContactQP, columns: NDArray[np.int64], ids: Any = None) -> ContactQP:
    """The QP with these columns."""
    V = qp.generators
    return replace(
        qp,
        A=qp.A[:, columns],
        lower=qp.lower[columns],
        upper=qp.upper[columns],
        row_id=qp.row_id[columns] if ids is None else ids,
        feature=qp.feature[columns],
        generators=None if V is None else V[:, columns],
    )


def _times(A: Any, s: Vector) -> Any:
    """A diag(s)."""
    return A @ sp.diags_array(s) if sp.issparse(A) else A * s
