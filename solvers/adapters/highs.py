"""HiGHS, its active-set QP solver (Hall, Feldmeier and others).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper.  HiGHS adds ρI to P, by
default 1e-7.  It must: with ρ = 0 and a singular P HiGHS 1.15 returns x = 0 or the like as optimal.
Posed in residual form it would need none, but then calls its own answer wrong ("status-value
error") where A holds entries of 1e-5 among those of 1, as in a box a little tilted.

Accuracy: ρ is a hundredth of what `asked` allows, between 1e-12 and 1e-7: A x is off by some ρ
relative to the force.  The feasibility tolerances are the residual that `asked` allows, not below
HiGHS's least, 1e-10.  HiGHS's QP solver takes no start: `setSolution` and `setBasis` leave its
iterations as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import highspy
import numpy as np
import scipy.sparse as sp

from problems.qp import Status
from solvers.adapters.forms import Built, Native, Outcome, PackageSolver, Posed
from solvers.base import Start

_COLUMNWISE = int(highspy.MatrixFormat.kColwise)
_TRIANGULAR = int(highspy.HessianFormat.kTriangular)
_MINIMISE = int(highspy.ObjSense.kMinimize)


@dataclass(frozen=True)
class HiGHS(PackageSolver):
    """HiGHS: null-space active-set QP solver, one `Highs` object kept, no warm start."""

    max_iterations: int = 100_000

    name: ClassVar[str] = "highs"
    package: ClassVar[str] = "highspy"
    regularisation: ClassVar[str] = "1e-12 to 1e-7 on the diagonal of P, by the accuracy asked"
    statuses: ClassVar[dict[Any, Status]] = {
        "kOptimal": Status.SOLVED,
        "kUnknown": Status.INACCURATE,
        "kInfeasible": Status.INFEASIBLE,
        "kUnbounded": Status.UNBOUNDED,
        "kUnboundedOrInfeasible": Status.INFEASIBLE,
        "kIterationLimit": Status.ITERATION_LIMIT,
        "kTimeLimit": Status.TIME_LIMIT,
    }

    def arrays(self, posed: Posed) -> Any:
        """The arguments of `Highs.passModel`: no rows, and the lower triangle of P by columns."""
        n, none = posed.n, np.zeros(0)
        start, index = np.zeros(n + 1, np.int32), np.zeros(0, np.int32)
        P = sp.csc_matrix(posed.P_upper.T)
        P.sort_indices()
        return (
            n, 0, 0, P.nnz, _COLUMNWISE, _TRIANGULAR, _MINIMISE, 0.0, posed.q, posed.lower,
            posed.upper, none, none, start, index, none, P.indptr, P.indices, P.data, np.zeros(n, np.int32),
        )  # fmt: skip

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Pass the whole model to the `Highs` object of the previous solve, or to a new one."""
        posed, arrays, carried, _ = problem
        model = highspy.Highs() if carried is None else carried.native.object
        options: dict[str, Any] = {"output_flag": False, "threads": 1}
        options["qp_iteration_limit"] = self.max_iterations
        if asked is not None:
            tolerance = posed.residual_tolerance(asked, 1e-10)
            options["primal_feasibility_tolerance"] = tolerance
            options["dual_feasibility_tolerance"] = tolerance
            little = min(max(0.01 * asked / posed.force, 1e-12), 1e-7)
            options["qp_regularization_value"] = little
        for option, value in options.items():
            model.setOptionValue(option, value)
        model.passModel(*arrays)
        return Native(posed, model)

    def run(self, native: Native) -> Any:
        """`Highs.run`."""
        return native.object.run()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """HiGHS's model status and QP iterations."""
        model = native.object
        x = np.array(model.getSolution().col_value)
        iterations = max(model.getInfo().qp_iteration_count, 0)
        return Outcome(x if x.size else None, model.getModelStatus().name, iterations)
