"""ProxQP, a proximal augmented Lagrangian method (proxsuite; Bambade et al. 2022).

The problem is posed in normal form with rows lower ≤ I x ≤ upper, to the dense backend or, where A
is sparse, to the sparse one with its Cholesky factors: left to itself it goes over to an iterative
method between 2,000 and 4,000 unknowns, which is a thousand times slower.  P may be singular.  (The
dense backend's box constraints would be more natural, but a warm start with their multipliers is
refused: it checks them against n_in = 0.)

Accuracy: `eps_abs` is the residual and `eps_duality_gap_abs` the gap that `asked` allows, not below
1e-13 (two of the scenes' QPs never reach 1e-14); the relative ones are 0, but for the gap of large
QPs (`Posed.gap_share`).  Without the gap ProxQP may stop with a wrong complementarity (4e-6 off at
1e-9 asked).  No QP here is infeasible or unbounded, but towers of 500 boxes were called so; what
ProxQP takes for a proof of it is made very small.  In a sequence the workspace is updated in place
and x and z start from the previous ones.  Its last bits depend on where its memory blocks lie: two
solves of the same QP may differ by rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from proxsuite import proxqp

from problems.qp import Status
from solvers.adapters.forms import Built, Native, Outcome, PackageSolver, Posed, same_pattern
from solvers.base import Start

_INFINITY = 1e20  # what proxsuite takes for an absent bound
_NEVER = 1e-14  # bound for certificates of infeasibility: they do not exist here


@dataclass(frozen=True)
class ProxQP(PackageSolver):
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

    def arrays(self, posed: Posed) -> Any:
        """P, q, no equalities, and the bounds as rows of I."""
        sparse = sp.issparse(posed.A)
        P = sp.csc_matrix(posed.A.T @ posed.A) if sparse else posed.P
        rows = sp.csc_matrix(sp.identity(posed.n)) if sparse else np.identity(posed.n)
        lower, upper = np.maximum(posed.lower, -_INFINITY), np.minimum(posed.upper, _INFINITY)
        return P, posed.q, None, None, rows, lower, upper

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the workspace of the previous solve, or make one."""
        posed, arrays, carried, duals = problem
        n, family = posed.n, proxqp.sparse if sp.issparse(posed.A) else proxqp.dense
        if carried is not None and same_pattern(carried.native.arrays[0], arrays[0]):
            solver, fill = carried.native.object, carried.native.object.update
        else:
            solver = family.QP(n, 0, n)
            if family is proxqp.sparse:
                solver.settings.sparse_backend = proxqp.SparseBackend.SparseCholesky
            fill = solver.init
        settings = solver.settings
        settings.max_iter = self.max_iterations
        if asked is not None:
            settings.eps_abs, settings.eps_rel = posed.residual_tolerance(asked, 1e-13), 0.0
            settings.eps_primal_inf = settings.eps_dual_inf = _NEVER
            settings.check_duality_gap, settings.eps_duality_gap_rel = True, posed.gap_share
            settings.eps_duality_gap_abs = posed.gap_tolerance(asked, 1e-13)
        fill(*arrays)
        if duals is not None:
            settings.initial_guess = proxqp.InitialGuess.WARM_START
        return Native(
            posed, solver, (arrays[0], () if duals is None else (posed.start, None, duals))
        )

    def run(self, native: Native) -> Any:
        """`QP.solve`, from x and z if there are any."""
        return native.object.solve(*native.arrays[1])

    def outcome(self, native: Native, result: Any) -> Outcome:
        """ProxQP's status and iterations."""
        says = native.object.results
        return Outcome(np.array(says.x), says.info.status.name, says.info.iter, np.array(says.z))
