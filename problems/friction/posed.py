"""What passes ask for, given by any solver: x of their QPs, and λ_* where it is not compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from problems.contacts.assembly import Assembly, scaled_matrix
from problems.contacts.layout import Layout
from problems.friction.coulomb_lcp import coulomb_multipliers
from problems.friction.newton import newton_multipliers
from problems.friction.passes import GO_ON, MAX_PASSES, POSE, Passes
from problems.friction.rules import coulomb_rows
from problems.least_norm.independence import surely_independent
from problems.least_norm.minimum_norm import least_norm
from problems.least_norm.peeling import peels
from problems.qp import Matrix
from problems.sequence import QPSequence


class PosedPasses:
    """The passes of one step or impulse, their columns laid out, whose QPs are asked for.

    about : the fields of `ContactQP` that tell what they are of
    """

    def __init__(
        self, qps: QPSequence, passes: Passes, layout: Layout, own: bool, **about: Any
    ) -> None:
        self.qps, self.passes, self.layout, self.own = qps, passes, layout, own
        self._about = about
        self.A = scaled_matrix(*passes.columns, passes.D)
        self._redundant = passes.bound.size > 0 and not self._independent()

    def _independent(self) -> bool:
        """Whether the columns of A are independent beyond doubt."""
        A: Matrix = self.A
        if sp.issparse(A):
            return peels(*self.passes.columns, self.passes.D) or self.layout.proof.holds(A)
        return surely_independent(A)

    def answer(self, kind: str) -> None:
        """Have the QP solved, and give x and λ."""
        passes, layout, now = self.passes, self.layout, self.passes.now[0]
        qp, solution = self.qps.solve(
            own=self.own and bool(now["within"]),
            A=self.A,
            d=passes.d.copy(),
            lower=passes.lower.copy(),
            upper=passes.upper.copy(),
            row_id=layout.row_id,
            feature=layout.feature,
            D=passes.D,
            kind=kind,
            eps0=float(now["eps0"]),
            **self._about,
        )
        x = passes.least[:] = passes.x[:] = np.asarray(solution.x)
        if self._redundant:
            coulomb = coulomb_rows(passes.frictions) if now["corrects"] else None
            passes.least[:] = least_norm(self.qps, qp, x, coulomb)

    def guess(self, assembly: Assembly) -> None:
        """Give λ_* of the next pass; that of the LCP where passes from ∞ take too long."""
        passes, now = self.passes, self.passes.now[0]
        found = None
        if now["stuck"] and now["number"] == MAX_PASSES:
            found = coulomb_multipliers(assembly, passes.D, passes.d)
        if found is not None:
            passes.lam_star[:] = found[0]
        else:
            passes.lam_star[:] = newton_multipliers(
                *(assembly, passes.D, passes.frictions.signs, passes.lam_star),
                *(passes.lam_N, passes.lam_F, passes.v, bool(now["stuck"])),
            )
        now["supplied"], now["stage"] = 1, GO_ON


def start(passes: Passes, **now: float) -> None:
    """Begin anew: (1,) `NOW` with these fields, the others 0."""
    passes.now[:] = 0
    for name, value in now.items():
        passes.now[0][name] = value
    passes.now[0]["stage"] = POSE
