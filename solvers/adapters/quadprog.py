"""quadprog, the dual active-set method of Goldfarb and Idnani (1983) in C.

It wants a definite Hessian, which AᵀA often is not.  The velocity problem (3.4) is one:

    minimise ½‖r − c‖²   subject to   Bᵀ r ≥ 0,

where x = base + σ x′, x′ ≥ 0 counts from the finite bound (σ = −1 from an upper one), B = A σ and
c = d + A base; rows without bounds are equalities.  x′ are the multipliers.  r is taken in
an orthonormal basis U of the range of A, so that it has no part that no contact can change.

A row with both bounds, 0 ≤ x′ ≤ w, may have Δ′ < 0 at the cost w: a slack s ≥ −Δ′, s ≥ 0, with w s
in the objective.  That slack has no curvature.  It is given ½‖(s − s_j)/ρ‖², ρ = 30, and the
problem is solved again from s_{j+1} = s until s stands still: proximal iterations, each a thousand
times nearer, of which nothing is left.  QPs without such rows are solved once.

Accuracy: an active-set method is exact once it has the working set; quadprog has no tolerance, no
settings and no warm start.  Of rows that depend on each other it may find one violated by rounding
and call the constraints inconsistent: Bᵀr ≥ −1e-14 ‖Uᵀd‖ prevents it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import quadprog

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.adapters.programs import one_sided
from solvers.base import Form, Start

_SLACK = 30.0  # ρ
_ENOUGH = 1e-14  # by which x′ of the rows at w may miss it, relative to the force
_RELAXED = 1e-14
_MAX_PASSES = 20


@dataclass(frozen=True)
class Quadprog(PackageSolver):
    """quadprog: dual active-set method on the velocity problem (3.4), no warm start."""

    name: ClassVar[str] = "quadprog"
    package: ClassVar[str] = "quadprog"
    form: ClassVar[Form] = "velocity"
    regularisation: ClassVar[str] = "none left: proximal iterations on slacks of two-sided rows"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "constraints are inconsistent, no solution": Status.INFEASIBLE,
    }

    def arrays(self, posed: Posed) -> Any:
        """Unknowns (r, s/ρ): a, C, b, the numbers of equations and of r; how x′ is counted."""
        own = one_sided(posed)
        A, d = posed.reduced
        m, n, t = d.size, posed.n, own.two.size
        C = np.zeros((m + t, n + t))
        C[:m, :n] = (A * own.sign)[:, own.order]
        C[m + np.arange(t), own.two] = _SLACK
        C[m + np.arange(t), n + np.arange(t)] = 1.0
        a = np.concatenate([d + A @ own.base, -_SLACK * own.width])
        b = np.zeros(n + t)
        b[own.equations : n] = -_RELAXED * max(1.0, float(np.linalg.norm(d)))
        return a, C, b, own.equations, m, own

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """The Hessian is I, and so is the inverse of its factor."""
        identity = np.identity(problem.arrays[0].size)
        return Native(problem.posed, identity, problem.arrays)

    def run(self, native: Native) -> Any:
        """`quadprog.solve_qp`, again until the slacks have settled."""
        a, C, b, equalities, m, _ = native.arrays
        now, slack, iterations = a, np.zeros(a.size - m), 0
        try:
            for _ in range(_MAX_PASSES):
                r, _, _, counts, multipliers, _ = quadprog.solve_qp(
                    native.object, now, C, b, equalities, True
                )
                iterations += int(counts[0])
                moved = np.abs(r[m:] - slack).max(initial=0.0)
                if moved <= _ENOUGH * _SLACK:
                    break
                slack = r[m:]
                now = np.concatenate([a[:m], a[m:] + slack])
        except ValueError as error:  # quadprog's only way to say that it failed
            return None, 0, str(error)
        return multipliers, iterations, "solved"

    def outcome(self, native: Native, result: Any) -> Outcome:
        """x from the multipliers of the velocity problem."""
        multipliers, iterations, text = result
        if multipliers is None:
            return Outcome(None, text)
        x = native.arrays[-1].x(multipliers[: native.posed.n])
        return Outcome(x, text, iterations)
