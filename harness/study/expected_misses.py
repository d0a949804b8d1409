"""Which backends are expected to miss A x*, on which QPs, how often, by how much, and why.

A miss is a row of `glambda verify` that is neither verified nor skipped: the error in A x exceeds
ten times the accuracy asked.  How often a package misses depends on its version and on how the
processor rounds, so that what is expected is a range: of the kind of QP, of the share of all QPs,
and of the error of what is called solved.  The error follows from the reason that is given; the
share is at least twice what was measured, on whichever scene and type of processor it was largest.
An answer that its solver calls unfinished counts like none, however far off it is: where a method
stands when it gives up follows from no reason, but from rounding.
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np
import pandas as pd

from problems.qp import KINDS, Status
from problems.scenes.labels import PAPER_SCENES

ACCURATE_CLASS = (
    *("glambda", "lotstedt", "velocity", "enumeration", "scipy_bvls", "daqp", "quadprog"),
)
"""Never to miss once, on any recording."""

IN_SPACE = ("space_tower", "space_tower,mu=0.0", "space_pyramid,mu=0.0")
"""Cubes at rest on four corners each, so that every QP is redundant.

The ranges are for these and the paper's scenes; on others only the accurate class is held to
anything.
"""


class Expected(NamedTuple):
    """What a backend may miss on one scene at one setting, and why.

    kinds : of QP on which it may miss
    share : of all QPs that it may miss, rounded up
    error : ‖A(x − x*)‖ of a miss that is called solved, at most, relative to the scale of the QP
        (`harness.judging.facts`)
    claims : whether a miss that is called solved may be proved wrong
    """

    kinds: tuple[str, ...]
    share: float
    error: float
    claims: bool
    reason: str

    def count(self, solves: int) -> int:
        """How many misses that is."""
        return ceil(self.share * solves)

    def beyond(self, missed: pd.DataFrame) -> int:
        """How many of these rows are of another kind, or off by more, than is expected."""
        unfinished = missed["status"] != Status.SOLVED.name
        within = missed["kind"].isin(self.kinds)
        within &= unfinished | ~(missed["glambda_error"] > self.error)
        if not self.claims:
            within &= missed["verdict"] != "claimed_wrong"
        return int(np.count_nonzero(~within))


NONE = Expected((), 0.0, 0.0, False, "")
"""Of the accurate class."""

ROUNDING = Expected(
    KINDS, 0.005, 1e-6, False, "a stopping rule that rounding meets a little earlier or later"
)
"""Of every backend that is not listed."""

_DEGENERATE = (
    "interior point: with a gap of 1e-12, the least that rounding allows, only √gap = 1e-6 close "
    "on degenerate rows (x = Δ = 0), which impulses and minimum-norm problems have"
)
_TOO_MANY = "20,000 iterations do not reach the accuracy, and its status says so"
_SWEEPS = Expected(
    KINDS,
    1.0,
    1.0,
    False,
    "2,000 sweeps carry the weight from cube to cube too slowly where friction couples them, and "
    "its status says so",
)
"""Of projected Gauss-Seidel in space."""

EXPECTED: dict[str, Expected] = {
    "clarabel": Expected(("impulse", "minimum_norm"), 0.08, 1e-6, True, _DEGENERATE),
    "piqp": Expected(("impulse", "minimum_norm"), 0.08, 1e-6, True, _DEGENERATE),
    "highs": Expected(
        KINDS,
        0.02,
        1e-5,
        True,
        "reports optimal with a free gradient at 1e-6 of the scale, or unbounded where no x of a "
        "minimum-norm problem could be; no option helps",
    ),
    "osqp": Expected(KINDS, 0.02, 1e-4, False, _TOO_MANY),
    "scs": Expected(KINDS, 0.02, 1e-4, False, _TOO_MANY),
    "qrqp": Expected(
        KINDS,
        0.1,
        np.inf,
        True,
        "an active-set method without a rule for degenerate rows: it stops where they cycle, and "
        "now and then says that it is done",
    ),
}
"""By the name of the backend."""


def expected_of(solver: str, scene: str) -> Expected | None:
    """What is expected of a backend, or variant of one, on a scene; None: nothing is."""
    if solver.partition("[")[0] in ACCURATE_CLASS:
        return NONE
    if scene in IN_SPACE and solver == "pgs":
        return _SWEEPS
    return EXPECTED.get(solver, ROUNDING) if scene in (*PAPER_SCENES, *IN_SPACE) else None
