"""Whether (3.20) gives what it promises: ‖A δx‖ ≤ ε₀ at setting `paper`.

(3.20) bounds the error of one descent direction, ‖A_F δp‖ ≤ ‖R⁻¹‖ ‖v‖, with R of today's A_F.  What
it leaves open is an R that is older, an estimate of ‖R⁻¹‖, and several descent directions in one QP
("if the loop in algorithm 2 is repeated only once").  So each QP of a recording is solved to its
own ε₀ and its A x compared with the reference, by

    glambda     our method: up to some tens of columns A_F is factorized at every QP
    lotstedt    the paper's: R is kept at every size
    never       the same, never factorized anew while the old R can be carried on

from five starts: cold; warm, from the last QP and dropped at restarts, as a replay does; from the
solutions 5 and 20 QPs ago, across restarts, whose working set and R are stale; and shaken: warm,
but to the d of every QP a random vector in the range of A is added, as long as the part of d that
forces can change.  The last three are there to provoke what scenes rarely do, several descent
directions on an old R.  A shaken QP has no reference in the recording; the oracle gives one to
`SHAKEN` of them, evenly spread.

All divide ε₀ by `SAFETY` where the paper does not, so that everything is solved once more
with ε₀ · `SAFETY` asked: that is the tolerance as printed (conjugate gradients, once begun, aim at
half of it).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from harness.criterion.factor_rules import NEVER
from harness.judging.facts import facts_of
from harness.judging.oracle import reference
from harness.names import METHOD, PAPER
from harness.recordings.recording import Recording, Reference
from problems.qp import ContactQP, Solution, Vector
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.base import Solver

SOLVERS: Mapping[str, Solver] = {
    METHOD: make_solver(METHOD),
    PAPER: make_solver(PAPER),
    "never": make_solver(PAPER, interval=NEVER),
}
"""Who solves the QPs, by name."""
STARTS = {"cold": 0, "warm": 1, "5 back": 5, "20 back": 20, "shaken": 1}
"""How many QPs ago the start was solved; 0: no start."""
SHAKEN, LARGEST = 300, 64
"""Shaken QPs of a recording that get a reference, and the most columns that they may have."""
SAFETY = 10.0
"""Part of ε₀ that (3.20) and ε₁ are given by all of them, as a divisor."""
BUDGET = 1e11
"""Operations that all runs may take; of a longer recording the first part is used."""

_TINY = 1e-300

COLUMNS = ("solver", "start", "asked", "place", "kind", "directions", "age", "ratio")


class _Past(NamedTuple):
    """A solution, and when the R that it carries was factorized (counted in warm QPs)."""

    solution: Solution
    factorized: int


def accuracy_of(recording: Recording) -> pd.DataFrame:
    """‖A δx‖/ε₀ of every QP with a reference, by solver, start and tolerance.

    Columns: solver, start, asked (1: ε₀, `SAFETY`: the tolerance as printed), place, kind,
    directions, age (QPs since R was factorized) and ratio.  Where `glambda` factorizes at every
    QP, its age means nothing.
    """
    part = _affordable(recording)
    shaken = shake(recording, part)
    exact = [qp.dense_A.astype(np.longdouble) for qp in recording.qps[:part]]
    frames = []
    for asked in (1.0, SAFETY):
        asking = [
            [qp.with_accuracy(asked * qp.eps0) for qp in each.qps[:part]]
            for each in (recording, shaken)
        ]
        for name, solver in SOLVERS.items():
            for start, back in STARTS.items():
                of, qps = (shaken, asking[1]) if start == "shaken" else (recording, asking[0])
                rows = _run(solver, qps, of.references, exact, back)
                rows["ratio"] *= asked  # of the QP's own ε₀
                frames.append(rows.assign(solver=name, start=start, asked=asked))
    return pd.concat(frames, ignore_index=True)[list(COLUMNS)]


def shake(recording: Recording, part: int) -> Recording:
    """The same recording with d of its first `part` QPs shaken, and references to some of them."""
    rng = np.random.default_rng(len(recording.qps))
    qps = list(recording.qps)
    for i, qp in enumerate(qps[:part]):
        push = qp.A @ (rng.standard_normal(qp.k) / np.maximum(_lengths(qp), _TINY))
        size = float(np.linalg.norm(push))
        if size > 0.0:
            qps[i] = replace(qp, d=qp.d + facts_of(qp).scale / size * push)
    references: list[Reference | None] = [None] * len(qps)
    small = [i for i, qp in enumerate(qps[:part]) if 0 < qp.k <= LARGEST]
    for i in {small[j] for j in np.linspace(0, len(small) - 1, SHAKEN).astype(int) if small}:
        references[i] = reference(qps[i])
    return replace(recording, qps=qps, references=references)


def _run(
    solver: Solver,
    qps: Sequence[ContactQP],
    references: Sequence[Reference | None],
    exact: Sequence[Any],
    back: int,
) -> pd.DataFrame:
    """Solve the QPs in order, each from the solution of `back` QPs ago; one row per reference.

    A solution serves one successor, so that these are `back` interleaved sequences.
    exact : A of each in extended precision
    """
    past: deque[_Past] = deque(maxlen=max(back, 1))
    rows, solved = [], 0
    for place, (qp, known, A) in enumerate(zip(qps, references, exact, strict=False)):
        follows = qp.kind in WARM_KINDS
        if follows and qp.restart and back == 1:
            past.clear()
        start = past[0] if follows and back and len(past) == back else None
        solution = solver.solve(qp, start and start.solution)
        work = solution.work
        if work is None or solution.x is None:
            raise ValueError(f"{solver.name} returned no answer, or no work counts")
        kept = start is not None and work.qr_factorizations == 0
        factorized = start.factorized if start is not None and kept else solved
        if known is not None:
            error = float(np.linalg.norm(A @ solution.x - known.Ax))
            age = solved - factorized
            rows.append((place, qp.kind, work.descent_directions, age, error / qp.eps0))
        if follows:
            past.append(_Past(solution, factorized))
            solved += 1
    return pd.DataFrame(rows, columns=["place", "kind", "directions", "age", "ratio"])


def _lengths(qp: ContactQP) -> Vector:
    return np.linalg.norm(qp.dense_A, axis=0)


def _affordable(recording: Recording) -> int:
    """How many QPs from the first on fit into `BUDGET`; 0 where none has a reference."""
    if not any(reference is not None for reference in recording.references):
        return 0
    runs = 2 * len(SOLVERS) * len(STARTS)
    spent = np.cumsum([runs * 4.0 * qp.m * qp.k**2 for qp in recording.qps])
    return int(np.searchsorted(spent, BUDGET, side="right"))
