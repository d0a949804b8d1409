"""DAQP, a dual active-set method for small dense QPs (Arnström, Bemporad and Axehill 2022).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, with the bounds as simple
bounds, or in any other of `programs`.  DAQP wants a definite P; where it is singular it adds
proximal iterations of its own, x_{j+1} = argmin of the QP + ½ε‖x − x_j‖², which end at a solution
of the QP itself.

Accuracy: `primal_tol` and `dual_tol` are the residual that `asked` allows, not below 1e-14.  The
proximal iterations end at a step of 1e-14, `eta_prox`: a few per cent more iterations than with a
loose one, for four more digits.  Beyond 30 unknowns that is below the rounding of x, and now and
then they went on for ever; 1e-13 n is enough there.  In a sequence one `daqp.Model` is updated in
place and keeps its working set; where rows came or went a new one is given the old working set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import daqp
import numpy as np

from problems.qp import AT_LOWER, AT_UPPER, ContactQP, Status
from solvers.adapters.forms import Built, Native, Outcome
from solvers.adapters.inner_options import last_step
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_ACTIVE, _LOWER, _EQUATION = 1, 2, 5  # bits of DAQP's `sense`


@dataclass(frozen=True)
class DAQP(ProgramSolver):
    """DAQP: dual active-set method, one `daqp.Model` updated along the sequence."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "daqp"
    package: ClassVar[str] = "daqp"
    warm_start: ClassVar[str] = "working set"
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
        members = program.members()
        sense = np.zeros(members.size, dtype=np.int32)
        sense[members == AT_UPPER] = _ACTIVE
        sense[members == AT_LOWER] = _ACTIVE | _LOWER
        sense[program.equations] = _EQUATION
        rows = program.rows(slice(program.simple, None), sparse=False)
        return program.P(sparse=False), program.q, rows, program.upper, program.lower, sense

    def build(self, qp: ContactQP, start: Start | None) -> Built:
        """As every package's, and DAQP's settings: those are ours to find, not the package's."""
        built, asked = super().build(qp, start), self.asked(qp)
        settings: dict[str, float] = {"iter_limit": self.max_iterations}
        if asked is not None:
            tolerance = built.posed.residual_tolerance(asked, 1e-14)
            step = last_step(built.posed)
            settings |= {"primal_tol": tolerance, "dual_tol": tolerance, "eta_prox": step}
        return built._replace(arrays=(settings, built.arrays))

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the model of the previous solve, or make one that knows its working set."""
        posed, (settings, arrays), carried, _, _ = problem
        P, q, rows, upper, lower, sense = arrays
        if carried is None or carried.native.arrays != rows.shape:
            model = daqp.Model()
            model.settings = settings
            model.setup(*arrays)
            return Native(posed, model, rows.shape)
        model = carried.native.object
        model.settings = settings
        more = {"A": rows} if rows.size else {}
        if carried.duals is None:  # the model's working set is another than the start's
            more["sense"] = sense
        model.update(H=P, f=q, bupper=upper, blower=lower, **more)
        return Native(posed, model, rows.shape)

    def run(self, native: Native) -> Any:
        """`daqp.Model.solve`."""
        return native.object.solve()

    def outcome(self, native: Native, result: Any) -> Outcome:
        """DAQP's exit flag and iterations."""
        x, _, flag, info = result
        return Outcome(x if flag > 0 else None, flag, info["iterations"], info["lam"])
