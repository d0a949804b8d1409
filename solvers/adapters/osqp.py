"""OSQP, an operator-splitting (ADMM) method for sparse QPs (Stellato et al. 2020).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ I x ≤ upper.  P may be singular;
OSQP's own σ and ρ are part of its iteration and leave its answer as it is.

Accuracy: `eps_abs` is the residual that `asked` allows, not below 1e-12, and `eps_rel` is 0.  The
duality gap is not looked at: measured by the same eps_abs, it is never reached on a tower of 100
boxes, whose residuals are small enough after 50 iterations.  No QP here is infeasible or unbounded,
but towers of 500 boxes were called so; what OSQP takes for a proof of it is made very small.
OSQP's polishing step is off, as by default: it prints to the console whatever `verbose` says.  In a
sequence P, q and the bounds are updated in place, and x and y start from the previous ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import osqp
import scipy.sparse as sp

from problems.qp import Status
from solvers.adapters.forms import Built, Native, Outcome, PackageSolver, Posed, same_pattern
from solvers.base import Start

_NEVER = 1e-14  # bound for certificates of infeasibility: they do not exist here


@dataclass(frozen=True)
class OSQP(PackageSolver):
    """OSQP: operator splitting, updated in place and warm-started along the sequence."""

    max_iterations: int = 20_000

    name: ClassVar[str] = "osqp"
    package: ClassVar[str] = "osqp"
    warm_start: ClassVar[str] = "x and y"
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "solved inaccurate": Status.INACCURATE,
        "maximum iterations reached": Status.ITERATION_LIMIT,
        "run time limit reached": Status.TIME_LIMIT,
        "primal infeasible": Status.INFEASIBLE,
        "primal infeasible inaccurate": Status.INFEASIBLE,
        "dual infeasible": Status.UNBOUNDED,
        "dual infeasible inaccurate": Status.UNBOUNDED,
    }

    def arrays(self, posed: Posed) -> Any:
        """P (upper triangle), q, I and the bounds."""
        return posed.P_upper, posed.q, sp.csc_matrix(sp.identity(posed.n)), posed.lower, posed.upper

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update P, q and the bounds in place where the pattern is the same; else set up afresh."""
        posed, arrays, carried, duals = problem
        settings: dict[str, float] = {"max_iter": self.max_iterations}
        if asked is not None:
            settings |= {
                "eps_abs": posed.residual_tolerance(asked, 1e-12),
                "eps_rel": 0.0,
                "check_dualgap": False,
                "eps_prim_inf": _NEVER,
                "eps_dual_inf": _NEVER,
            }
        P, q, _, lower, upper = arrays
        if carried is not None and same_pattern(carried.native.arrays[0], P):
            model = carried.native.object
            model.update_settings(**settings)
            # P itself is not handed over again: that would factorize it again
            matrix = {} if P is carried.native.arrays[0] else {"Px": P.data}
            model.update(**matrix, q=q, l=lower, u=upper)
        else:
            model = osqp.OSQP()
            model.setup(*arrays, verbose=False, **settings)
        if duals is not None:
            model.warm_start(x=posed.start, y=duals)
        return Native(posed, model, arrays)

    def run(self, native: Native) -> Any:
        """`osqp.OSQP.solve`."""
        return native.object.solve(raise_error=False)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """OSQP's status and iterations."""
        return Outcome(result.x, result.info.status, result.info.iter, result.y)
