"""OSQP, an operator-splitting (ADMM) method for sparse QPs (Stellato et al. 2020).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ I x ≤ upper, or in any other of
`programs`.  P may be singular; OSQP's own σ and ρ are part of its iteration and leave its answer as
it is.

Accuracy: `eps_abs` is the residual that `asked` allows, not below 1e-12, and `eps_rel` is 0.  The
duality gap is not looked at: measured by the same eps_abs, it is never reached on a tower of 100
boxes, whose residuals are small enough after 50 iterations.  No QP here is infeasible or unbounded,
but towers of 500 boxes were called so; what OSQP takes for a proof of it is made very small.
OSQP's polishing step is off, as by default: it prints to the console whatever `verbose` says.  In a
sequence the data are updated in place, and x and y start from the previous ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import osqp

from problems.qp import Status
from solvers.adapters.inner_options import NEVER
from solvers.adapters.package import Built, Native, Outcome, same_pattern
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start


@dataclass(frozen=True)
class OSQP(ProgramSolver):
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

    def pack(self, program: Program) -> Any:
        """P (upper triangle), q, R and the bounds of its rows."""
        return program.P_upper, program.q, program.R, program.lower, program.upper

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the data in place where their pattern is the same; else set up afresh."""
        posed, arrays, carried, _, guess = problem
        settings: dict[str, float] = {"max_iter": self.max_iterations}
        if asked is not None:
            settings |= {
                "eps_abs": posed.residual_tolerance(asked, 1e-12),
                "eps_rel": 0.0,
                "check_dualgap": False,
                "eps_prim_inf": NEVER,
                "eps_dual_inf": NEVER,
            }
        P, q, R, lower, upper = arrays
        matters = (0,) if self.posed_form == "normal" else (0, 2)
        if carried is not None and all(
            same_pattern(carried.native.arrays[i], arrays[i]) for i in matters
        ):
            model = carried.native.object
            model.update_settings(**settings)
            # P itself is not handed over again: that would factorize it again
            matrices = {} if P is carried.native.arrays[0] else {"Px": P.data}
            if 2 in matters:
                matrices["Ax"] = R.data
            model.update(**matrices, q=q, l=lower, u=upper)
        else:
            model = osqp.OSQP()
            model.setup(*arrays, verbose=False, **settings)
        if guess is not None:
            model.warm_start(x=guess[0], y=guess[1])
        return Native(posed, model, arrays)

    def run(self, native: Native) -> Any:
        """`osqp.OSQP.solve`."""
        return native.object.solve(raise_error=False)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """OSQP's status and iterations."""
        return Outcome(result.x, result.info.status, result.info.iter, result.y)
