"""The paper's method: algorithm 2 with the old R, conjugate gradients and the printed rule.

Lötstedt 1984, §3.2, at every size.  R is the previous step's where there is one, updated as columns
come and go (steps 6 and 8), and (3.19) is solved by conjugate gradients that it preconditions
(`conjugate_gradients`), to ‖v‖ ≤ ε₀/‖R⁻¹‖ (3.20).  "A new QR decomposition is computed when the
number of iterations in the cg-algorithm exceeds (2 C_QR/C_IT)^½": after 2.09 the third iteration
calls for one, after 0.79 the first.  The text leaves open when it is computed:

    lotstedt            at once, in place of the iteration that would exceed; the direction is then
                        sought with the new R, and the iterations before are lost
    lotstedt[deferred]  the direction and the QP are finished with the old R, and the next QP
                        factorizes

C_QR and C_IT are counted in floating-point operations for the present size of A_F (`flops`).  The
other variants exchange one part of the idea for another (`VARIANTS`).

This differs from the paper in the points that `method` lists, and in one more: where A is sparse
and wider than `CROSSOVER`, R is a sparse Cholesky factor, F may hold dependent columns, so that
there is no P, and many rows change sides at once (`sparse.loop`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from solvers.active_set.loop import (
    CUSTOM,
    DEFERRED,
    EXTRAPOLATED,
    NO_R,
    ONLINE,
    OWN_SET,
    SCRATCH,
    TODAYS_QR,
)
from solvers.active_set.method import ActiveSet, Modes, check_limit
from solvers.active_set.sparse.workspace import SparseWorkspace
from solvers.active_set.workspace import CG_LIMIT, COUNTS, INTERVAL, REALS, Workspace

VARIANTS = {
    "": "the paper's: the previous R, by the printed rule a new one at once",
    "deferred": "the same, but the QP is finished first and the next one factorizes",
    "online": "our online rule in place of the printed one",
    "extrapolated": "the paper's, begun with x extrapolated from the last two steps",
    "updated_qr": "the previous working set but not its R: one QR at every QP, then updated",
    "exact_qr": "the same, but a QR from scratch for every working set",
    "no_working_set": "the previous x, but F chosen anew at every QP, and its R",
    "plain_cg": "conjugate gradients without R, which only tells ranks and tolerances",
}
"""The parts of the paper's idea, one by one."""
BITS = {
    "": 0,
    "deferred": DEFERRED,
    "online": ONLINE,
    "extrapolated": EXTRAPOLATED,
    "updated_qr": TODAYS_QR,
    "exact_qr": TODAYS_QR | SCRATCH,
    "no_working_set": OWN_SET,
    "plain_cg": NO_R,
}
AT_EVERY_SIZE = -1
"""As a crossover: no QP is small."""


@dataclass(frozen=True)
class Lotstedt(ActiveSet):
    """The paper's algorithm 2: old R, conjugate gradients and the printed rule, at every size.

    iteration_limit : passes of the main loop before giving up; None: 50 + 20 k
    variant : one of `VARIANTS`
    interval : factorize anew every so many QPs, instead of by the rule; 0: by the rule
    cg_limit : a direction whose iterations exceed it calls for a new factorization; None: the
        paper's (2 C_QR/C_IT)^½

    Raises ValueError for an unknown variant or a negative option.
    """

    variant: str = ""
    interval: int = 0
    cg_limit: float | None = None

    name: ClassVar[str] = "lotstedt"
    variants: ClassVar[tuple[str, ...]] = tuple(filter(None, VARIANTS))

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            known = ", ".join(name or '""' for name in VARIANTS)
            raise ValueError(f"lotstedt has no variant {self.variant!r}; it has: {known}")
        if self.interval < 0:
            raise ValueError(f"interval = {self.interval}; give a number of QPs, or 0")
        check_limit("cg_limit", self.cg_limit)
        super().__post_init__()

    def modes(self) -> Modes:
        """The same at every size."""
        mode = BITS[self.variant]
        if self.interval > 0 or self.cg_limit is not None or self.iteration_limit is not None:
            mode |= CUSTOM
        return Modes(mode | TODAYS_QR, mode, mode, *[AT_EVERY_SIZE] * 5)

    def hand_over(self, room: Workspace | SparseWorkspace, t: float) -> None:
        """The options of all, and those about an old R."""
        super().hand_over(room, t)
        room.I[COUNTS, INTERVAL] = self.interval
        room.S[REALS, CG_LIMIT] = -1.0 if self.cg_limit is None else self.cg_limit
