"""Rules for when the paper's method factorizes anew, and running them over a recorded sequence.

Two kinds of rule are told apart:

1. The solver's own: a fixed interval, or a limit on conjugate gradient iterations beyond which it
   factorizes in the middle of a QP.  They are options of the solver.
2. A decision after each QP whether the next one shall begin with a factorization.  It is carried
   out from outside: the solver's last solution is handed either to the solver that keeps R or to
   one that gives it up and keeps all else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.online_rule import Cycle, average_stopped_falling, one_more
from harness.recording import Recording
from problems.qp import FREE, ContactQP, Solution
from problems.sequence import WARM_KINDS
from solvers import make_solver
from solvers.active_set.flops import cg_iteration_flops, qr_flops
from solvers.base import Solver

NEVER = 10**9
"""As an interval of the solver: longer than any recording."""
COUNTS = (
    *("descent_directions", "working_set_changes", "qr_factorizations", "qr_updates"),
    *("cg_iterations", "flops"),
)
"""Work counts that are kept of each QP."""

Decision = Callable[[Cycle, float, float], bool]
"""(the cycle so far, C_QR, C_IT) → factorize at the next QP?"""


class Link(NamedTuple):
    """A QP of the sequence: its place in the recording, and the restart that it follows."""

    place: int
    qp: ContactQP
    chain: int
    warm: bool


@dataclass(frozen=True)
class Rule:
    """When to factorize: by the solver's own settings, or by a decision after each QP.

    name : how it is called in tables
    options : of `make_solver("lotstedt", …)`
    decide : None for the solver's own rule
    interval : of a fixed interval, else None
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    decide: Decision | None = None
    interval: float | None = None


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
    return Rule(f"interval {interval:g}", {"interval": steps}, None, interval)


def paper() -> Rule:
    """The paper's: at once, when a direction takes more than √(2 C_QR/C_IT) iterations."""
    return Rule("paper", {"variant": "old_r"})


def exact() -> Rule:
    """No R outlives its QP, and conjugate gradients are not needed."""
    return Rule("exact QR", {"variant": "exact_qr"})


def paper_deferred() -> Rule:
    """The paper's threshold, but the QP is finished first and the next one is factorized."""
    return Rule("paper deferred", decide=beyond_threshold)


def beyond_threshold(cycle: Cycle, C_QR: float, C_IT: float) -> bool:
    """The last QP took more than √(2 C_QR/C_IT) iterations, rounded up as the solver does."""
    return cycle.last > ceil(sqrt(2 * C_QR / C_IT)) * C_IT


def online(price: float = 1.0) -> Rule:
    """Factorize when the average cost since the last factorization stops falling.

    price : of a factorization, in units of what its operations are worth beside those of an
        iteration: 1 for operations, (t_QR/t_IT)/(C_QR/C_IT) for time
    """

    def decide(cycle: Cycle, C_QR: float, C_IT: float) -> bool:
        return average_stopped_falling(cycle, price * C_QR)

    return Rule("online" if price == 1.0 else "online timed", decide=decide)


def stopping_at(limit: float, largest: int) -> Rule:
    """The solver's rule with this threshold; one that conjugate gradients never reach is never."""
    if limit > 2 * largest:
        return Rule("fitted", {"interval": NEVER})
    return Rule("fitted", {"cg_limit": ceil(limit)})


def drive(
    links: Sequence[Link], rule: Rule, free: list[NDArray[np.int64]] | None = None
) -> pd.DataFrame:
    """Solve the sequence under a rule; one row per QP.

    free : receives the row_ids of the free columns of each QP

    Columns: place, chain, warm, age (QPs since the factorization), `COUNTS`, m, f and runtime, the
    solver's setup and solve [s].
    """
    keep: Solver = make_solver("lotstedt", **rule.options)
    renew = keep
    if rule.decide is not None:
        keep = make_solver("lotstedt", interval=NEVER)
        renew = make_solver("lotstedt", interval=1)
    # Every rule is charged the same bookkeeping, which takes its toll of the processor's caches.
    decide = rule.decide or (lambda *_: False)
    last: Solution | None = None
    cycle, age, due = Cycle(), 0, False
    rows = []
    for link in links:
        start = last if link.warm else None
        last = (renew if due else keep).solve(link.qp, start)
        work, timing = last.work, last.timing
        if work is None:
            raise ValueError("the paper's method returned no work counts")
        m, f = link.qp.m, int(np.count_nonzero(last.working_set == FREE))
        factorized = start is None or work.qr_factorizations > 0
        age = 0 if factorized else age + 1
        due = False
        if f:
            C_QR, C_IT = qr_flops(m, f), cg_iteration_flops(m, f)
            cycle = one_more(cycle, factorized, work.cg_iterations, work.descent_directions, C_IT)
            due = decide(cycle, C_QR, C_IT)
        if free is not None:
            free.append(last.row_id[last.working_set == FREE])
        counts = [getattr(work, name) for name in COUNTS]
        rows.append(
            (link.place, link.chain, link.warm, age, *counts, m, f, timing.setup + timing.solve)
        )
    columns = ["place", "chain", "warm", "age", *COUNTS, "m", "f", "runtime"]
    steps = pd.DataFrame(rows, columns=columns)
    return steps.astype({"warm": bool})
