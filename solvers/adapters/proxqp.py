"""ProxQP, a proximal augmented Lagrangian method (proxsuite; Bambade et al. 2022).

The problem is posed in normal form with rows lower ≤ I x ≤ upper, or in any other of `programs`, to
the dense backend or, where A is sparse, to the sparse one with its Cholesky factors: left to itself
it goes over to an iterative method between 2,000 and 4,000 unknowns, which is a thousand times
slower.  P may be singular.  (The dense backend's box constraints would be more natural, but a warm
start with their multipliers is refused: it checks them against n_in = 0.)

Accuracy: `eps_abs` is the residual and `eps_duality_gap_abs` the gap that `asked` allows, not below
1e-13 (two of the scenes' QPs never reach 1e-14); the relative ones are 0, but for the gap of large
QPs (`Posed.gap_share`).  Without the gap ProxQP may stop with a wrong complementarity (4e-6 off at
1e-9 asked).  No QP here is infeasible or unbounded, but towers of 500 boxes were called so; what
ProxQP takes for a proof of it is made very small.  In a sequence the workspace is updated in place
and x, y and z start from the previous ones.  Its last bits depend on where its memory blocks lie:
two solves of the same QP may differ by rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from proxsuite import proxqp

from problems.qp import Status
from solvers.adapters.inner_options import NEVER
from solvers.adapters.package import Built, Native, Outcome, same_pattern
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_INFINITY = 1e20  # what proxsuite takes for an absent bound


def _equations(arrays: Any) -> int:
    """How many equations were handed over."""
    return 0 if arrays[3] is None else int(arrays[3].size)


@dataclass(frozen=True)
class ProxQP(ProgramSolver):
    """ProxQP: proximal augmented Lagrangian, updated in place and warm-started."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "proxqp"
    package: ClassVar[str] = "proxsuite"
    warm_start: ClassVar[str] = "x and z"
    statuses: ClassVar[dict[Any, Status]] = {
        "PROXQP_SOLVED": Status.SOLVED,
        "PROXQP_MAX_ITER_REACHED": Status.ITERATION_LIMIT,
        "PROXQP_PRIMAL_INFEASIBLE": Status.INFEASIBLE,
        "PROXQP_DUAL_INFEASIBLE": Status.UNBOUNDED,
    }

    def pack(self, program: Program) -> Any:
        """P, q, the equations if there are any, and the other rows with their bounds."""
        sparse, others = program.posed.is_sparse, program.others
        A = program.rows(program.equations, sparse=sparse) if program.equal else None
        b = np.zeros(program.equal) if program.equal else None
        lower = np.maximum(program.lower[others], -_INFINITY)
        upper = np.minimum(program.upper[others], _INFINITY)
        C = program.rows(others, sparse=sparse)
        return program.P(sparse=sparse), program.q, A, b, C, lower, upper

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the workspace of the previous solve, or make one."""
        posed, arrays, carried, _, guess = problem
        family = proxqp.sparse if posed.is_sparse else proxqp.dense
        equal, old = _equations(arrays), None if carried is None else carried.native.arrays[0]
        if (
            old is not None
            and _equations(old) == equal
            and all(same_pattern(old[i], arrays[i]) for i in (0, 2, 4) if arrays[i] is not None)
        ):
            solver = carried.native.object  # type: ignore[union-attr]
            fill = solver.update
        else:
            solver = family.QP(arrays[1].size, equal, arrays[5].size)
            if family is proxqp.sparse:
                solver.settings.sparse_backend = proxqp.SparseBackend.SparseCholesky
            fill = solver.init
        settings = solver.settings
        settings.max_iter = self.max_iterations
        if asked is not None:
            settings.eps_abs, settings.eps_rel = posed.residual_tolerance(asked, 1e-13), 0.0
            settings.eps_primal_inf = settings.eps_dual_inf = NEVER
            settings.check_duality_gap, settings.eps_duality_gap_rel = True, posed.gap_share
            settings.eps_duality_gap_abs = posed.gap_tolerance(asked, 1e-13)
        fill(*arrays)
        if guess is None:
            return Native(posed, solver, (arrays, ()))
        settings.initial_guess = proxqp.InitialGuess.WARM_START
        program, (z, y) = self.program(posed), guess
        equal_y = y[program.equations] if program.equal else None
        return Native(posed, solver, (arrays, (z, equal_y, y[program.others])))

    def run(self, native: Native) -> Any:
        """`QP.solve`, from x, y and z if there are any."""
        return native.object.solve(*native.arrays[1])

    def outcome(self, native: Native, result: Any) -> Outcome:
        """ProxQP's status and iterations."""
        says = native.object.results
        y = self.program(native.posed).joined(says.y, says.z)
        return Outcome(np.array(says.x), says.info.status.name, says.info.iter, y)
