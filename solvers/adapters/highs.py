"""HiGHS, its active-set QP solver (Hall, Feldmeier and others).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, and an empty row 0 x = 0,
or in any other of `programs`.  Without any row HiGHS 1.15 now and then returns its starting point
as optimal, after 0 iterations: for 2 of 372 random QPs with its default of 1e-7 added to the
diagonal of P, for 99, most of them with a singular P, without.  With the empty row it needs no such
addition, which would set the accuracy, and a singular P is no trouble.

Accuracy: the feasibility tolerances are the residual that `asked` allows, not below HiGHS's least,
1e-10; an active-set method is exact once it has the working set.  HiGHS's QP solver takes no start:
`setSolution` and `setBasis` leave its iterations as they are.  In a sequence its object is kept,
which spares making it.  Forces are scaled to 1: as they are, it calls 5 of fig5's QPs unbounded.
Of a QP with a singular P it may say that it is unbounded; one with x ≥ 0 alone is then posed as
(3.4), which is strictly convex.  On 2 of fig2's 968 QPs it ends with a gradient of 4e-6 of the
force, A x being off by 8e-7; no option was found to change that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import highspy
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome
from solvers.adapters.posed import UNIT, Posed
from solvers.adapters.programs import PROGRAMS, Program, ProgramSolver
from solvers.adapters.quietly import quietly
from solvers.base import Start

with quietly():
    highspy.Highs()  # a process's first one prints a banner
_COLUMNWISE = int(highspy.MatrixFormat.kColwise)
_TRIANGULAR = int(highspy.HessianFormat.kTriangular)
_UNBOUNDED = highspy.HighsModelStatus.kUnbounded
_REFUSED = highspy.HighsStatus.kError
_MINIMISE = int(highspy.ObjSense.kMinimize)
_OPTIONS: dict[str, Any] = {"output_flag": False, "threads": 1}
_ZERO = np.zeros(1)


@dataclass(frozen=True)
class HiGHS(ProgramSolver):
    """HiGHS: null-space active-set QP solver, one `Highs` object kept."""

    max_iterations: int = 100_000

    name: ClassVar[str] = "highs"
    package: ClassVar[str] = "highspy"
    warm_start: ClassVar[str] = "workspace"
    forces: ClassVar[tuple[float, float]] = UNIT
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

    def best_form(self, posed: Posed) -> str:
        """(3.4) where A is sparse and not wide, and x ≥ 0 is all that is asked."""
        tall = posed.is_sparse and posed.n <= posed.m
        return "velocity" if tall and posed.one_sided else "normal"

    def pack(self, program: Program) -> Any:
        """The arguments of `Highs.passModel`, with the lower triangle of P by columns."""
        size, simple, P = program.q.size, program.simple, program.P_lower
        if simple == program.lower.size:
            R, lower, upper = _empty_row(size), _ZERO, _ZERO
        else:
            R = program.rows(slice(simple, None), sparse=True)
            lower, upper = program.lower[simple:], program.upper[simple:]
        return (
            size, lower.size, R.data.size, P.data.size, _COLUMNWISE, _TRIANGULAR, _MINIMISE, 0.0,
            program.q, *program.box, lower, upper,
            R.indptr, R.indices, R.data, P.indptr, P.indices, P.data, _continuous(size),
        )  # fmt: skip

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Iterations and tolerances."""
        options = {**_OPTIONS, "qp_iteration_limit": self.max_iterations}
        if asked is not None:
            tolerance = posed.residual_tolerance(asked, 1e-10 / posed.force)
            options["primal_feasibility_tolerance"] = tolerance
            options["dual_feasibility_tolerance"] = tolerance
            options["qp_regularization_value"] = 0.0
        return options

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Pass the whole model to the `Highs` object of the previous solve, or to a new one."""
        posed, arrays, options, carried, *_ = problem
        old: dict[str, Any] = {}
        if carried is None:
            model = highspy.Highs()
        else:
            model, (old, *_) = carried.native.object, carried.native.arrays
        for option, value in options.items():
            if old.get(option) != value:
                model.setOptionValue(option, value)
        model.passModel(*arrays)
        return Native(posed, model, (options, model.getRunTime(), asked))

    def run(self, native: Native) -> Any:
        """`Highs.run`, and on in the other form where the answer of the one chosen will not do."""
        posed, model, (_, _, asked), *_ = native
        status = _run(model)
        if self.variant or asked is None:
            return status
        if posed.form == "normal":
            lost = posed.one_sided and model.getModelStatus() == _UNBOUNDED
            other = "velocity"
        else:
            found = np.array(model.getSolution().row_dual)
            lost = found.size != posed.n or posed.misses(np.maximum(found, 0.0), asked)
            other = "normal"
        if lost:
            posed.form, posed.program = other, PROGRAMS[other](posed)
            model.passModel(*self.pack(posed.program))
            status = _run(model)
        return status

    def outcome(self, native: Native, result: Any) -> Outcome:
        """HiGHS's model status, QP iterations and time."""
        model = native.object
        found, simple = model.getSolution(), self.program(native.posed).simple
        x = np.array(found.col_value)
        y = -np.concatenate([found.col_dual[:simple], found.row_dual])
        iterations = max(model.getInfo().qp_iteration_count, 0)
        inside = model.getRunTime() - native.arrays[1]
        name = model.getModelStatus().name
        return Outcome(x if x.size else None, name, iterations, y, inside)


def _run(model: Any) -> Any:
    """`Highs.run`; once more where somebody else has chosen the threads of this process.

    HiGHS keeps the number of threads of its first run and refuses another one.
    """
    status = model.run()
    if status == _REFUSED:
        highspy.Highs.resetGlobalScheduler(True)
        status = model.run()
    return status


@lru_cache(64)
def _empty_row(size: int) -> sp.csc_matrix:
    """0 x."""
    return sp.csc_matrix((1, size))


@lru_cache(64)
def _continuous(size: int) -> NDArray[np.int32]:
    """The kind of every unknown."""
    return np.zeros(size, np.int32)
