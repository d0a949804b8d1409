"""Rules for when the paper's method factorizes anew, and running them over a recorded sequence.

All but one are options of the solver: a fixed interval, a limit on conjugate gradient iterations
beyond which it factorizes in the middle of a QP, its online rule.  The paper's threshold with the
QP finished first is carried out from outside: the last solution is handed either to the solver that
keeps R or to one that gives it up and keeps all else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.recordings.recording import Recording
from problems.qp import FREE, ContactQP, Solution, WorkCounts
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.active_set.unit_costs import UnitCosts, costs_counted

NEVER = 10**9
"""As an interval of the solver: longer than any recording."""
COUNTS = (
    *("descent_directions", "working_set_changes", "qr_factorizations", "qr_updates"),
    *("cg_iterations", "flops"),
)
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
    options : of `make_solver("lotstedt", …)`
    deferred : whether a QP of too many iterations is finished, and the next one factorized
    interval : of a fixed interval, else None
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    deferred: bool = False
    interval: float | None = None

    @property
    def keeps_R(self) -> bool:
        """Whether (3.19) is solved by conjugate gradients with an R at every size."""
        return self.options.get("variant") in ("old_r", "online")


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
    return Rule(f"interval {interval:g}", _old_R(interval=steps), interval=interval)


def paper() -> Rule:
    """The paper's: at once, when a direction takes more than √(2 C_QR/C_IT) iterations."""
    return Rule("paper", _old_R())


def exact() -> Rule:
    """No R outlives its QP."""
    return Rule("exact QR", {"variant": "exact_qr"})


def paper_deferred() -> Rule:
    """The paper's threshold, but the QP is finished first and the next one is factorized."""
    return Rule("paper deferred", _old_R(interval=NEVER), deferred=True)


def online() -> Rule:
    """When the average cost stops falling: see `solvers.active_set.online_rule`."""
    return Rule("online", {"variant": "online"})


def as_shipped() -> Rule:
    """The solver's default: today's A_F if it is small, else online; x extrapolated if sparse."""
    return Rule("as shipped")


def stopping_at(limit: float, largest: int) -> Rule:
    """The solver's rule with this threshold; one that conjugate gradients never reach is never."""
    if limit > 2 * largest:
        return Rule("fitted", _old_R(interval=NEVER))
    return Rule("fitted", _old_R(cg_limit=ceil(limit)))


def _old_R(**options: float) -> dict[str, Any]:
    return {"variant": "old_r", **options}


def drive(
    links: Sequence[Link], rule: Rule, free: list[NDArray[np.int64]] | None = None
) -> pd.DataFrame:
    """Solve the sequence under a rule; one row per QP.

    free : receives the row_ids of the free columns of each QP

    Columns: place, chain, warm, age (QPs since the factorization), `COUNTS`, those of `UnitCosts`
    and runtime, that of the compiled call [s]: what comes before it is the same under every rule.
    """
    keep = make_solver("lotstedt", **rule.options)
    renew = make_solver("lotstedt", **_old_R(interval=1)) if rule.deferred else keep
    last: Solution | None = None
    age, due = 0, False
    rows = []
    for link in links:
        start = last if link.warm else None
        last = (renew if due else keep).solve(link.qp, start)
        work = last.work
        if work is None:
            raise ValueError("the paper's method returned no work counts")
        m, f = link.qp.m, int(np.count_nonzero(last.working_set == FREE))
        costs = costs_counted(last.memory, m, f)
        factorized = start is None or work.qr_factorizations > 0
        age = 0 if factorized else age + 1
        due = rule.deferred and f > 0 and _too_many(work, costs)
        if free is not None:
            free.append(last.row_id[last.working_set == FREE])
        counts = [getattr(work, name) for name in COUNTS]
        rows.append((link.place, link.chain, link.warm, age, *counts, *costs, last.timing.solve))
    columns = ["place", "chain", "warm", "age", *COUNTS, *UnitCosts._fields, "runtime"]
    steps = pd.DataFrame(rows, columns=columns)
    return steps.astype({"warm": bool, "sparse": bool})


def _too_many(work: WorkCounts, costs: UnitCosts) -> bool:
    """Whether a direction took more than √(2 C_QR/C_IT) iterations, rounded up, on average."""
    limit = ceil(sqrt(2 * costs.C_QR / costs.C_IT))
    return work.cg_iterations > limit * max(1, work.descent_directions)
