"""Frictional contact problems of others, u = W r + q: as QPs along a fixed point on the bounds.

Coulomb's law is no QP, but its friction bounds may be lagged (the paper's (4.6); Haslinger's fixed
point for Tresca friction):

1. without friction, min ½ r_NᵀW_NN r_N + q_Nᵀr_N, r_N ≥ 0;
2. `PASSES` times with |r_T| ≤ μ r_N of the pass before, in each direction of the tangent plane.

In the plane a fixed point obeys Coulomb's law; in space the disc |r_T| ≤ μ r_N is replaced by the
square around it.  Nobody's own solution is taken along: files are known to hold zeros there.

Rows know their contact and have the `direction` of generators: 2 the normal, 3, 4 the tangents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from harness.exchange.factors import Factor, factor
from harness.exchange.foreign import Foreign
from harness.judging.facts import facts_of
from harness.names import METHOD
from problems.qp import ContactQP, Matrix, Vector
from solvers import make_solver

PASSES = 4
NORMAL = 2
"""`direction` of a normal."""
ACCURACY = 1e-9
"""Of the solves that give the bounds, over the scale of the QP."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """W (n, n), q (n,), mu (contacts,), rows by contact, the normal first;  dim : 2 or 3

    made : A, d of W and q, where they are known otherwise
    free : further rows at the end that are equalities
    """

    W: Matrix | None
    q: Vector
    mu: Vector
    dim: int
    made: Factor | None = None
    free: int = 0

    def __post_init__(self) -> None:
        if self.dim not in (2, 3):
            raise Foreign(f"dimension: is {self.dim}, and should be 2 or 3")
        if (self.mu < 0).any():
            raise Foreign(f"mu: is {self.mu.min():g} somewhere, and should not be negative")
        rows = self.dim * self.mu.size + self.free
        if self.q.size != rows:
            raise Foreign(
                f"q: has {self.q.size} entries, and {self.mu.size} contacts in {self.dim} "
                f"dimensions need {rows}"
            )

    def qps(self, tolerance: float) -> tuple[list[ContactQP], dict[str, Any]]:
        """QPs of all passes, and what is to be said of them.  Raises Foreign as `factor` does."""
        made = self.made
        if made is None:
            assert self.W is not None
            made = factor(self.W, self.q, tolerance, "W")
        notes = {
            "import.form": "lagged friction" if self.mu.any() else "without friction",
            "import.dimensions": self.dim,
            "import.contacts": int(self.mu.size),
            **made.notes(),
        }
        A = sp.csc_array(made.A) if sp.issparse(made.A) else made.A
        pushed = np.zeros(self.mu.size)
        qps: list[ContactQP] = []
        for turn in range(1 + PASSES * bool(self.mu.any())):
            qp = self._pose(A, made.d, pushed, turn)
            qps.append(qp)
            if turn == PASSES:
                break
            asked = qp.with_accuracy(ACCURACY * facts_of(qp).scale)
            x = make_solver(METHOD).solve(asked).x
            if x is None or not np.isfinite(x).all():
                break
            full = np.zeros(self.q.size)
            full[qp.row_id] = x
            pushed = full[: self.dim * self.mu.size : self.dim]
        return qps, {**notes, "import.passes": len(qps)}

    def _pose(self, A: Matrix, d: Vector, pushed: Vector, turn: int) -> ContactQP:
        """The QP of a pass with the normal forces of the last one; the first has none."""
        contacts, n = self.mu.size, self.q.size
        direction = np.r_[np.tile(np.arange(self.dim), contacts), np.full(self.free, -1)]
        contact = np.r_[np.repeat(np.arange(contacts), self.dim), np.full(self.free, -1)]
        limit = np.full(n, np.inf)
        tangent = direction > 0
        limit[tangent] = (self.mu * pushed)[contact[tangent]]
        lower = np.where(direction == 0, 0.0, -limit)
        rows = np.flatnonzero((direction < 1) if turn == 0 else np.ones(n, bool))
        feature = np.full((n, 5), -1, np.int64)
        feature[:, 1] = contact
        feature[:, 4] = NORMAL + np.maximum(direction, 0)
        return ContactQP(
            A[:, rows],
            d,
            lower[rows],
            limit[rows],
            row_id=rows,
            feature=feature[rows],
            kind="iteration" if turn else "step",
        )
