"""What the plain version counts, and a formula that only it needs."""

from __future__ import annotations

from dataclasses import dataclass

from problems.qp import WorkCounts
from solvers.active_set.flops import qr_flops


def delete_many_flops(m: int, f: int, first: int, n_deleted: int, keep_Q: bool) -> int:
    """Remove several columns, the first at `first`: Householder QR of what is right below it."""
    rows, columns = f - first, f - first - n_deleted
    form_Q = keep_Q and columns > 0
    return qr_flops(rows, columns, form_Q) + (2 * m * rows * columns if form_Q else 0)


@dataclass
class Tally:
    """Running totals of one solve; `counts` freezes them."""

    descent_directions: int = 0
    working_set_changes: int = 0
    qr_factorizations: int = 0
    qr_updates: int = 0
    cg_iterations: int = 0
    flops: int = 0

    def counts(self) -> WorkCounts:
        return WorkCounts(**vars(self))
