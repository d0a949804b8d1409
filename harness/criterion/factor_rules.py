"""Rules for when the paper's method factorizes anew, and running them over a recorded sequence.

All but one are the paper's method with options: the printed rule in its two readings, a fixed
interval, another limit on conjugate gradient iterations, the online rule.  The one is our own
method, which keeps no R of small QPs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.names import METHOD, PAPER
from harness.recordings.recording import Recording
from problems.qp import FREE, ContactQP, Solution, WorkCounts
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.active_set.unit_costs import UnitCosts, costs_counted

DEFERRED, ONLINE = f"{PAPER}[deferred]", f"{PAPER}[online]"
NEVER = 10**9
"""As an interval of the solver: longer than any recording."""
COUNTS = tuple(WorkCounts.__dataclass_fields__)
"""Work counts that are kept of each QP."""


class Link(NamedTuple):
    """A QP of the sequence: its place in the recording, and the restart that it follows."""

    place: int
    qp: ContactQP
    chain: int
    warm: bool


@dataclass(frozen=True)
class Rule:
    """When to factorize.

    name : how it is called in tables
    solver, options : of `make_solver`
    interval : of a fixed interval, else None
    """

    name: str
    solver: str = PAPER
    options: Mapping[str, Any] = field(default_factory=dict)
    interval: float | None = None

    @property
    def keeps_R(self) -> bool:
        """Whether (3.19) is solved by conjugate gradients with an R at every size."""
        return self.solver in (PAPER, DEFERRED, ONLINE)


def sequence(recording: Recording) -> list[Link]:
    """The QPs that a warm start can serve, in order, with the restarts between them."""
    links: list[Link] = []
    chain = -1
    for place, qp in enumerate(recording.qps):
        if qp.kind not in WARM_KINDS:
            continue
        warm = bool(links) and not qp.restart
        chain += not warm
        links.append(Link(place, qp, chain, warm))
    return links


def fixed(interval: float) -> Rule:
    """Factorize every so many QPs; inf: never."""
    steps = NEVER if interval == inf else int(interval)
    return Rule(f"interval {interval:g}", options={"interval": steps}, interval=interval)


def paper() -> Rule:
    """The printed rule, at once: in place of the iteration that would exceed √(2 C_QR/C_IT)."""
    return Rule("paper")


def paper_deferred() -> Rule:
    """The printed rule, but the QP is finished first and the next one is factorized."""
    return Rule("paper deferred", DEFERRED)


def exact() -> Rule:
    """No R outlives its QP."""
    return Rule("exact QR", f"{PAPER}[exact_qr]")


def online() -> Rule:
    """When the average cost stops falling: see `solvers.active_set.online_rule`."""
    return Rule("online", ONLINE)


def as_shipped() -> Rule:
    """Our default: today's A_F if it is small, else online; x extrapolated if sparse."""
    return Rule("as shipped", METHOD)


def stopping_at(limit: float, largest: int) -> Rule:
    """The printed rule with this limit; one that conjugate gradients never reach is never."""
    if limit > 2 * largest:
        return Rule("fitted", options={"interval": NEVER})
    return Rule("fitted", options={"cg_limit": limit})


def drive(
    links: Sequence[Link], rule: Rule, free: list[NDArray[np.int64]] | None = None
) -> pd.DataFrame:
    """Solve the sequence under a rule; one row per QP.

    free : receives the row_ids of the free columns of each QP

    Columns: place, chain, warm, age (QPs since the factorization), `COUNTS`, those of `UnitCosts`
    and runtime, that of the compiled call [s]: what comes before it is the same under every rule.
    """
    solver = make_solver(rule.solver, **rule.options)
    last: Solution | None = None
    age = 0
    rows = []
    for link in links:
        start = last if link.warm else None
        last = solver.solve(link.qp, start)
        work = last.work
        if work is None:
            raise ValueError(f"{rule.solver} returned no work counts")
        m, f = link.qp.m, int(np.count_nonzero(last.working_set == FREE))
        costs = costs_counted(last.memory, m, f)
        factorized = start is None or work.qr_factorizations > 0
        age = 0 if factorized else age + 1
        if free is not None:
            free.append(last.row_id[last.working_set == FREE])
        counts = [getattr(work, name) for name in COUNTS]
        rows.append((link.place, link.chain, link.warm, age, *counts, *costs, last.timing.solve))
    columns = ["place", "chain", "warm", "age", *COUNTS, *UnitCosts._fields, "runtime"]
    steps = pd.DataFrame(rows, columns=columns)
    return steps.astype({"warm": bool, "sparse": bool})
