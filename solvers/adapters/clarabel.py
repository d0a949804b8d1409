"""Clarabel, an interior-point method for conic problems with quadratic objectives.

The problem is posed in normal form, min ½ xᵀP x + qᵀx, with one nonnegative row for each finite
bound, or in any other of `programs`.  P may be singular.

Accuracy: `tol_gap_abs` is the gap that `asked` allows, not below 1e-13 (further down Clarabel gives
up now and then and answers worse); `tol_gap_rel` is 0, but for large QPs (`Posed.gap_share`), and
`tol_feas` at least 1e-13.  An interior-point method comes to a degenerate row (x and Δ both 0) only
as √gap, so 3e-7.  Forces are scaled to be 1 to 2: greater ones make Clarabel 0.11 creep along a
bound of 1 of 300 of fig4's QPs for 200 iterations, x of size 30 and A well-conditioned.  Where
x ≥ 0 is all that is asked they are scaled to be 8 to 16: of towers, walls and pyramids of 2 to 225
bodies it then takes 12 or 13 iterations, where it takes 14 or 15 at 1 to 2.  Not so in normal form
where P is singular, and not beyond 16: there it is lost now and then.
In a sequence the data are updated in place where the pattern is the same, which spares the symbolic
factorization; no x is carried over.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import clarabel
import numpy as np

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, same_pattern
from solvers.adapters.posed import UNIT, Posed
from solvers.adapters.programs import Program, ProgramSolver, cones
from solvers.base import Start


@dataclass(frozen=True)
class Clarabel(ProgramSolver):
    """Clarabel: interior point, data updated in place."""

    max_iterations: int = 200

    name: ClassVar[str] = "clarabel"
    package: ClassVar[str] = "clarabel"
    warm_start: ClassVar[str] = "workspace"
    forces: ClassVar[tuple[float, float]] = UNIT
    one_sided_forces: ClassVar[tuple[float, float] | None] = (8.0, 16.0)
    regularisation: ClassVar[str] = "1e-12 in its linear systems, refined away"
    statuses: ClassVar[dict[Any, Status]] = {
        "Solved": Status.SOLVED,
        "AlmostSolved": Status.INACCURATE,
        "InsufficientProgress": Status.INACCURATE,
        "MaxIterations": Status.ITERATION_LIMIT,
        "MaxTime": Status.TIME_LIMIT,
        "PrimalInfeasible": Status.INFEASIBLE,
        "AlmostPrimalInfeasible": Status.INFEASIBLE,
        "DualInfeasible": Status.UNBOUNDED,
        "AlmostDualInfeasible": Status.UNBOUNDED,
    }

    def best_form(self, posed: Posed) -> str:
        """(3.4) where A is sparse and x ≥ 0 is all that is asked."""
        return "velocity" if posed.is_sparse and posed.one_sided else "normal"

    def pack(self, program: Program) -> Any:
        """P (upper triangle), q, and rows G z + s = h, see `Cones`."""
        return program.P_upper, program.q, cones(program)

    def options(self, posed: Posed, asked: float | None) -> Any:
        """Clarabel's settings object."""
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter, settings.max_threads = False, self.max_iterations, 1
        settings.presolve_enable = False  # it forbids updates
        if asked is not None:
            settings.tol_gap_abs = posed.gap_tolerance(asked, 1e-13)
            settings.tol_gap_rel = posed.gap_share
            settings.tol_feas = posed.residual_tolerance(asked, 1e-13)
            settings.static_regularization_constant = 1e-12
        return settings

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the data in place where their pattern is the same; else set up afresh."""
        posed, arrays, settings, carried, *_ = problem
        P, q, rows = arrays
        old = None if carried is None else carried.native.arrays
        if (
            old is not None
            and old[2].equal == rows.equal
            and same_pattern(old[0], P)
            and same_pattern(old[2].G, rows.G)
        ):
            solver = carried.native.object  # type: ignore[union-attr]
            solver.update(P=P.data, q=q, A=rows.G.data, b=rows.h, settings=settings)
        else:
            kinds = [clarabel.ZeroConeT(rows.equal)] if rows.equal else []
            kinds.append(clarabel.NonnegativeConeT(rows.h.size - rows.equal))
            solver = clarabel.DefaultSolver(P, q, rows.G, rows.h, kinds, settings)
        return Native(posed, solver, arrays)

    def run(self, native: Native) -> Any:
        """`DefaultSolver.solve`."""
        return native.object.solve()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """Clarabel's status, iterations and time."""
        y = None
        if native.posed.form != "normal":
            program = self.program(native.posed)
            y = native.arrays[-1].gathered(np.array(result.z), program.lower.size)
        inside = result.solve_time
        return Outcome(np.array(result.x), str(result.status), result.iterations, y, inside)
