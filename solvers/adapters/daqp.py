"""DAQP, a dual active-set method for small dense QPs (Arnström, Bemporad and Axehill 2022).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, with the bounds as simple
bounds, or in any other of `programs`, by one call of `daqp.solve`.  In a sequence the working set
of the previous solve is handed over.  (A `daqp.Model` that is kept and updated is a tenth faster at
best, at 100 columns with a singular P, and takes twice as long at 80 with a definite one.)

DAQP wants a definite P; where it is singular it adds proximal iterations of its own,
x_{j+1} = argmin of the QP + ½ε‖x − x_j‖², which end at a solution of the QP itself.

Accuracy: `primal_tol` and `dual_tol` are the residual that `asked` allows, and the proximal
iterations end at a step of `eta_prox` / ε, which is a residual of `eta_prox`; none is below
`last_step`.  With DAQP's own `eta_prox` A x is 1e-8 off where P is singular; so small a last step
costs a few per cent more iterations, and gives four more digits.  Where x is large even that is
below the rounding of P x.  DAQP then goes on until its limit, or takes a step that is rounding
alone for a direction without a bottom ("unbounded", which no QP here is).  Where many contacts tie
it may come back to a working set and end there ("cycle").  So `run` asks once more with the last
step of that x, and at last with DAQP's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import daqp
import numpy as np

from problems.qp import AT_LOWER, AT_UPPER, Status
from solvers.adapters.inner_options import last_step
from solvers.adapters.package import Built, Native, Outcome
from solvers.adapters.posed import Posed
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_ACTIVE, _LOWER, _EQUATION = 1, 2, 5  # bits of DAQP's `sense`
_STALLED = (-2, -3, -4)  # a cycle, unbounded, out of iterations


@dataclass(frozen=True)
class DAQP(ProgramSolver):
    """DAQP: dual active-set method, one call from the last working set."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "daqp"
    package: ClassVar[str] = "daqp"
    warm_start: ClassVar[str] = "working set"
    takes_duals: ClassVar[bool] = False
    regularisation: ClassVar[str] = "proximal iterations of its own where P is singular"
    statuses: ClassVar[dict[Any, Status]] = {
        1: Status.SOLVED,
        2: Status.SOLVED,
        -1: Status.INFEASIBLE,
        -3: Status.UNBOUNDED,
        -4: Status.ITERATION_LIMIT,
        -7: Status.TIME_LIMIT,
    }

    def pack(self, program: Program) -> Any:
        """P, q, the rows after the simple bounds, and `sense`, which marks the active ones."""
        posed = program.posed
        if posed.before is not None and posed.before.posed.form == posed.form:
            sense = posed.before.arrays[-1]
        else:
            sense = np.zeros(program.lower.size, np.int32)
        if program.equal or posed.working_set is not None:
            members = program.members()
            sense[members == AT_UPPER] = _ACTIVE
            sense[members == AT_LOWER] = _ACTIVE | _LOWER
            sense[program.equations] = _EQUATION
        rows = program.rows(slice(program.simple, None), sparse=False)
        lower, upper = program.lower.copy(), program.upper.copy()  # it wants to be able to write
        return program.P(sparse=False), program.q, rows, upper, lower, sense

    def options(self, posed: Posed, asked: float | None) -> dict[str, float]:
        """Tolerances, and a limit within which it has done or stalled."""
        if asked is None:
            return {"iter_limit": self.max_iterations}
        step = last_step(posed.n)
        tolerance = posed.residual_tolerance(asked, step)
        return {
            "primal_tol": tolerance,
            "dual_tol": tolerance,
            "eta_prox": step * posed.force,
            "iter_limit": min(self.max_iterations, 100 + 10 * posed.n),
        }

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing: all of it is one call."""
        return Native(problem.posed, problem.options, problem.arrays)

    def run(self, native: Native) -> Any:
        """`daqp.solve`, and once more where its steps are rounding."""
        result = daqp.solve(*native.arrays, **native.object)
        if result[2] in _STALLED and "eta_prox" in native.object:
            result = self._again(native)
        return result

    def _again(self, native: Native) -> Any:
        """By a model that goes on from where it stalled, with a last step that rounding allows."""
        posed, settings, arrays, *_ = native
        model = daqp.Model()
        model.settings = settings
        model.setup(*arrays)
        x, value, flag, info = model.solve()
        iterations = info["iterations"]
        size = float(np.abs(x).max()) / posed.force
        for step in ({"eta_prox": last_step(posed.n, size) * posed.force}, {}):
            model.settings = {"iter_limit": max(self.max_iterations - iterations, 1), **step}
            x, value, flag, info = model.solve()
            iterations += info["iterations"]
            if flag not in _STALLED:
                break
        return x, value, flag, {**info, "iterations": iterations}

    def outcome(self, native: Native, result: Any) -> Outcome:
        """DAQP's exit flag, iterations and times."""
        x, _, flag, info = result
        lam = np.asarray(info["lam"])
        if flag > 0:  # the next solve begins with what is active now
            sense = native.arrays[-1]
            sense &= _EQUATION & ~_ACTIVE
            sense |= _ACTIVE * (lam > 0) + (_ACTIVE | _LOWER) * (lam < 0)
        inside = info["setup_time"] + info["solve_time"]
        return Outcome(x if flag > 0 else None, flag, info["iterations"], lam, inside)
