"""HiGHS, its active-set QP solver (Hall, Feldmeier and others).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, and an empty row 0 x = 0,
or in any other of `programs`.  Without any row HiGHS 1.15 now and then returns its starting point
as optimal, after 0 iterations: for 2 of 372 random QPs with its default of 1e-7 added to the
diagonal of P, for 99, most of them with a singular P, without.  With the empty row it needs no such
addition, which would set the accuracy, and a singular P is no trouble.

Accuracy: the feasibility tolerances are the residual that `asked` allows, not below HiGHS's least,
1e-10; an active-set method is exact once it has the working set.  HiGHS's QP solver takes no start:
`setSolution` and `setBasis` leave its iterations as they are.  In a sequence its object is kept,
which spares making it.  On 2 of fig2's 968 QPs it ends with a gradient of 4e-6 of the force, A x
being off by 8e-7; no option was found to change that.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import Any, ClassVar

import highspy
import numpy as np
import scipy.sparse as sp

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start


def _greet() -> None:
    """Make a process's first `Highs` object, at which HiGHS prints a banner, with stdout closed."""
    sys.stdout.flush()
    stdout, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        highspy.Highs()
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)
        os.close(nowhere)


_greet()
_COLUMNWISE = int(highspy.MatrixFormat.kColwise)
_TRIANGULAR = int(highspy.HessianFormat.kTriangular)
_REFUSED = highspy.HighsStatus.kError
_MINIMISE = int(highspy.ObjSense.kMinimize)


@dataclass(frozen=True)
class HiGHS(ProgramSolver):
    """HiGHS: null-space active-set QP solver, one `Highs` object kept."""

    max_iterations: int = 100_000

    name: ClassVar[str] = "highs"
    package: ClassVar[str] = "highspy"
    warm_start: ClassVar[str] = "workspace"
    regularisation: ClassVar[str] = "none (1e-7 on the diagonal of P with its default settings)"
    statuses: ClassVar[dict[Any, Status]] = {
        "kOptimal": Status.SOLVED,
        "kUnknown": Status.INACCURATE,
        "kInfeasible": Status.INFEASIBLE,
        "kUnbounded": Status.UNBOUNDED,
        "kUnboundedOrInfeasible": Status.INFEASIBLE,
        "kIterationLimit": Status.ITERATION_LIMIT,
        "kTimeLimit": Status.TIME_LIMIT,
    }

    def pack(self, program: Program) -> Any:
        """The arguments of `Highs.passModel`, with the lower triangle of P by columns."""
        size, simple, P = program.q.size, program.simple, sp.csc_matrix(program.P_upper.T)
        P.sort_indices()
        R, ends = program.rows(slice(simple, None), sparse=True), (program.lower, program.upper)
        lower, upper = (end[simple:] for end in ends)
        if lower.size == 0:
            R, lower, upper = sp.csc_matrix((1, size)), np.zeros(1), np.zeros(1)
        return (
            size, lower.size, R.nnz, P.nnz, _COLUMNWISE, _TRIANGULAR, _MINIMISE, 0.0,
            program.q, *program.box, lower, upper,
            R.indptr, R.indices, R.data, P.indptr, P.indices, P.data, np.zeros(size, np.int32),
        )  # fmt: skip

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Pass the whole model to the `Highs` object of the previous solve, or to a new one."""
        posed, arrays, carried, *_ = problem
        model = highspy.Highs() if carried is None else carried.native.object
        options: dict[str, Any] = {"output_flag": False, "threads": 1}
        options["qp_iteration_limit"] = self.max_iterations
        if asked is not None:
            tolerance = posed.residual_tolerance(asked, 1e-10)
            options["primal_feasibility_tolerance"] = tolerance
            options["dual_feasibility_tolerance"] = tolerance
            options["qp_regularization_value"] = 0.0
        for option, value in options.items():
            model.setOptionValue(option, value)
        model.passModel(*arrays)
        return Native(posed, model)

    def run(self, native: Native) -> Any:
        """`Highs.run`; once more where somebody else has chosen the threads of this process.

        HiGHS keeps the number of threads of its first run and refuses another one.
        """
        status = native.object.run()
        if status == _REFUSED:
            highspy.Highs.resetGlobalScheduler(True)
            status = native.object.run()
        return status

    def outcome(self, native: Native, result: Any) -> Outcome:
        """HiGHS's model status and QP iterations."""
        model = native.object
        found, simple = model.getSolution(), self.program(native.posed).simple
        x = np.array(found.col_value)
        y = -np.concatenate([found.col_dual[:simple], found.row_dual])
        iterations = max(model.getInfo().qp_iteration_count, 0)
        return Outcome(x if x.size else None, model.getModelStatus().name, iterations, y)
