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
from solvers.adapters.posed import Posed
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_SETTINGS = {"eps_rel": 0.0, "check_dualgap": False, "eps_prim_inf": NEVER, "eps_dual_inf": NEVER}


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

    def options(self, posed: Posed, asked: float | None) -> dict[str, float]:
        """Tolerances, and certificates that are never met."""
        settings: dict[str, float] = {"max_iter": self.max_iterations}
        if asked is not None:
            settings["eps_abs"] = posed.residual_tolerance(asked, 1e-12)
            settings |= _SETTINGS
        return settings

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the data in place where their pattern is the same; else set up afresh."""
        posed, arrays, settings, carried, _, guess = problem
        P, q, R, lower, upper = arrays
        old = None if carried is None else carried.native.arrays
        if old is not None and same_pattern(old[0], P) and same_pattern(old[2], R):
            model = carried.native.object  # type: ignore[union-attr]
            model.update_settings(**settings)
            # P itself is not handed over again: that would factorize it again
            matrices = {} if P is old[0] else {"Px": P.data}
            if R is not old[2]:
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
        """OSQP's status, iterations and time."""
        info = result.info
        return Outcome(result.x, info.status, info.iter, result.y, info.run_time)
