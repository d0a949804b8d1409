"""PIQP, a proximal interior-point method (Schwan et al. 2023).

The problem is posed in normal form with box constraints, or in any other of `programs`, to the
dense backend or, where A is sparse, to the sparse one.  P may be singular; PIQP's proximal terms
vanish as it converges.

Accuracy: `eps_duality_gap_abs` is the gap that `asked` allows and `eps_abs` the residual, neither
below 1e-14 (with 1e-15 a fifth of the scenes' QPs run into the iteration cap); the relative ones
are 0, but for the gap of large QPs (`Posed.gap_share`).  A degenerate row (x and Δ both 0) is met
only as √gap, so 1e-7.  Forces are scaled to 1, where it needs fewer iterations and stops in time.
In a sequence the data are updated in place, which spares the symbolic factorization; no x is
carried over.

Every QP here has a solution, but from version 0.7 on PIQP takes large ones for unbounded, by
`eps_dual_inf`.  Where an accuracy is asked for, it is told not to look.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import piqp
import scipy.sparse as sp

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, change, same_pattern
from solvers.adapters.posed import UNIT, Posed
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

NEVER = 1e-100
"""Tolerance of certificates that there is no solution; 0 is refused."""
_SETTINGS: dict[str, Any] = {"eps_rel": 0.0, "verbose": False}
_SETTINGS |= {
    name: NEVER
    for name in ("eps_primal_inf", "eps_dual_inf")
    if hasattr(piqp.DenseSolver().settings, name)
}


@dataclass(frozen=True)
class PIQP(ProgramSolver):
    """PIQP: proximal interior point, data updated in place."""

    max_iterations: int = 250

    name: ClassVar[str] = "piqp"
    package: ClassVar[str] = "piqp"
    warm_start: ClassVar[str] = "workspace"
    forces: ClassVar[tuple[float, float]] = UNIT
    statuses: ClassVar[dict[Any, Status]] = {
        "PIQP_SOLVED": Status.SOLVED,
        "PIQP_MAX_ITER_REACHED": Status.ITERATION_LIMIT,
        "PIQP_PRIMAL_INFEASIBLE": Status.INFEASIBLE,
        "PIQP_DUAL_INFEASIBLE": Status.UNBOUNDED,
        "PIQP_NUMERICS": Status.INACCURATE,
    }

    def pack(self, program: Program) -> Any:
        """P, q, the bounds of the leading unknowns, and the other rows as far as there are any."""
        sparse, (lower, upper) = program.posed.is_sparse, program.box
        stored: Any = sp.csc_matrix if sparse else np.asfortranarray
        P = program.P(sparse=sparse)
        if not sparse:
            P = P.T  # which is P, stored by columns
        data = {"P": P, "c": program.q, "x_l": lower, "x_u": upper}
        if program.equal:
            data["A"] = stored(program.rows(program.equations, sparse=sparse))
            data["b"] = np.zeros(program.equal)
        if program.lower.size > program.simple + program.equal:
            more = program.others[program.simple :]
            data["G"] = stored(program.rows(more, sparse=sparse))
            data["h_l"], data["h_u"] = program.lower[more], program.upper[more]
        return data

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Iterations and tolerances."""
        settings: dict[str, Any] = {"max_iter": self.max_iterations, "compute_timings": True}
        if asked is not None:
            settings["eps_duality_gap_abs"] = posed.gap_tolerance(asked, 1e-14)
            settings["eps_abs"] = posed.residual_tolerance(asked, 1e-14)
            settings["eps_duality_gap_rel"] = posed.gap_share
            settings |= _SETTINGS
        return settings

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the data in place where their pattern is the same; else set up afresh."""
        posed, arrays, options, carried, *_ = problem
        before = None if carried is None else carried.native
        if before is not None and (
            posed.is_dense_like(before.posed)
            or all(
                same_pattern(before.arrays.get(name), arrays[name])
                for name in ("P", "A", "G")
                if name in arrays
            )
        ):
            solver, fill = before.object, before.object.update
        else:
            solver = piqp.SparseSolver() if posed.is_sparse else piqp.DenseSolver()
            fill, before = solver.setup, None
        change(solver.settings, options, before)
        fill(**arrays)
        return Native(posed, solver, arrays, options)

    def run(self, native: Native) -> Any:
        """`solve`."""
        return native.object.solve()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """PIQP's status, iterations and times."""
        says = native.object.result
        info, program = says.info, self.program(native.posed)
        inside = (info.update_time or info.setup_time) + info.solve_time
        z = says.z_bu[: program.simple] - says.z_bl[: program.simple]
        y = z
        if native.posed.form != "normal":
            y = program.joined(says.y, np.concatenate([z, says.z_u - says.z_l]))
        return Outcome(np.array(says.x), result.name, info.iter, y, inside)
