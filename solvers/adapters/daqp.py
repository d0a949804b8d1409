"""DAQP, a dual active-set method for small dense QPs (Arnström, Bemporad and Axehill 2022).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, lower ≤ x ≤ upper, with the bounds as simple
bounds, or in any other of `programs`.  DAQP wants a definite P; where it is singular it adds
proximal iterations of its own, x_{j+1} = argmin of the QP + ½ε‖x − x_j‖², which end at a solution
of the QP itself.

Accuracy: `primal_tol` and `dual_tol` are the residual that `asked` allows, and the proximal
iterations end at a step of `eta_prox` / ε, which is a residual of `eta_prox`; none is below
`last_step`.  So small a last step costs a few per cent more iterations than a loose one, and gives
four more digits.  Where x is large even that is below the rounding of P x.  DAQP then goes on for
ever, or takes a step that is rounding alone for a direction without a bottom ("unbounded", which no
QP here is); so `run` goes on from there with the last step of that x, which as a rule takes one
iteration.

In a sequence one `daqp.Model` is updated in place and keeps its working set; where rows came or
went a new one is given the old working set.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import daqp
import numpy as np

from problems.qp import AT_LOWER, AT_UPPER, ContactQP, Status
from solvers.adapters.inner_options import last_step
from solvers.adapters.package import Built, Native, Outcome
from solvers.adapters.programs import Program, ProgramSolver
from solvers.base import Start

_ACTIVE, _LOWER, _EQUATION = 1, 2, 5  # bits of DAQP's `sense`
_STALLED = (-3, -4)  # unbounded, out of iterations


class _Held(NamedTuple):
    """What a model was set up with.

    kind : the shape of its rows and which bounds are finite; of another kind it is made anew
    flag : DAQP's, negative where it refused
    """

    kind: tuple[tuple[int, ...], bytes, bytes]
    flag: int


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
            n, step = built.posed.n, last_step(built.posed.n)
            tolerance = built.posed.residual_tolerance(asked, step)
            settings |= {"primal_tol": tolerance, "dual_tol": tolerance, "eta_prox": step}
            settings["iter_limit"] = min(self.max_iterations, 100 + 10 * n)
        return built._replace(arrays=(settings, built.arrays))

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update the model of the previous solve, or make one that knows its working set."""
        posed, (settings, arrays), carried, _, _ = problem
        P, q, rows, upper, lower, sense = arrays
        kind = rows.shape, np.isfinite(posed.lower).tobytes(), np.isfinite(posed.upper).tobytes()
        if carried is None or carried.native.arrays.kind != kind:
            model = daqp.Model()
            model.settings = settings
            flag, _ = model.setup(*arrays)
            return Native(posed, model, _Held(kind, flag))
        model = carried.native.object
        model.settings = settings
        more = {"A": rows} if rows.size else {}
        if carried.duals is None:  # the model's working set is another than the start's
            more["sense"] = sense
        flag = model.update(H=P, f=q, bupper=upper, blower=lower, **more)
        return Native(posed, model, _Held(kind, flag))

    def run(self, native: Native) -> Any:
        """`daqp.Model.solve`, and on from where its steps are rounding."""
        model = native.object
        if native.arrays.flag < 0:
            return None, np.nan, native.arrays.flag, {"iterations": 0, "lam": None}
        x, value, flag, info = model.solve()
        left = self.max_iterations - info["iterations"]
        if flag in _STALLED and left > 0 and model.settings["eta_prox"] > 0:
            step = last_step(native.posed.n, float(np.abs(x).max()))
            model.settings = {"iter_limit": left, "eta_prox": step}
            x, value, flag, more = model.solve()
            info = {**more, "iterations": info["iterations"] + more["iterations"]}
        return x, value, flag, info

    def outcome(self, native: Native, result: Any) -> Outcome:
        """DAQP's exit flag and iterations."""
        x, _, flag, info = result
        return Outcome(x if flag > 0 else None, flag, info["iterations"], info["lam"])
