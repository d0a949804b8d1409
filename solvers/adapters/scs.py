"""SCS, an operator-splitting method for conic problems (O'Donoghue et al. 2016, 2021).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, with one nonnegative row for each finite
bound, or in any other of `programs`.  P may be singular; the ρ_x of SCS is part of its iteration.

Accuracy: `eps_abs` is the residual that `asked` allows, not below 1e-12, and `eps_rel` is 0.  In a
sequence the workspace is kept and b, c are updated where P and the finite bounds are the same ones,
as in the functional iteration (3.9); SCS cannot update P.  Either way x, y and s start from the
previous ones.  The linear solver is QDLDL: the default may be MKL with several threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import scs

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, same_matrix
from solvers.adapters.posed import Posed
from solvers.adapters.programs import Cones, Program, ProgramSolver, cones
from solvers.base import Start

_MANY = 150


@dataclass(frozen=True)
class SCS(ProgramSolver):
    """SCS: operator splitting on the homogeneous embedding, warm-started."""

    max_iterations: int = 20_000

    name: ClassVar[str] = "scs"
    package: ClassVar[str] = "scs"
    warm_start: ClassVar[str] = "x, y and s"
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "infeasible": Status.INFEASIBLE,
        "unbounded": Status.UNBOUNDED,
        "solved (inaccurate - reached max_iters)": Status.ITERATION_LIMIT,
        "solved (inaccurate - reached time_limit_secs)": Status.TIME_LIMIT,
    }

    def best_form(self, posed: Posed) -> str:
        """With y = A x as rows where there are many, which the normal form does not converge on."""
        return "residual" if posed.is_sparse and posed.n > _MANY else "normal"

    def pack(self, program: Program) -> Any:
        """P (upper triangle), rows G z + s = h, and q, in a dictionary; and the `Cones`."""
        rows = cones(program)
        if rows.h.size == 0:  # SCS wants a row: 0 x + s = 1
            empty = sp.csc_matrix((1, program.q.size))
            rows = Cones(empty, np.ones(1), 0, np.zeros(1, np.int64), np.zeros(1))
        return {"P": program.P_upper, "A": rows.G, "b": rows.h, "c": program.q}, rows

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Iterations and tolerances."""
        settings: dict[str, Any] = {"verbose": False, "max_iters": self.max_iterations}
        if asked is not None:
            settings |= {"eps_abs": posed.residual_tolerance(asked, 1e-12), "eps_rel": 0.0}
        return settings

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update b and c where the rest is the same; else set up afresh."""
        posed, (arrays, rows), settings, carried, _, guess = problem
        old, used = ({}, None) if carried is None else carried.native.arrays[:2]
        if used == settings and all(same_matrix(old[name], arrays[name]) for name in "PA"):
            solver = carried.native.object  # type: ignore[union-attr]
            solver.update(b=arrays["b"], c=arrays["c"])
        else:
            cone = {"z": rows.equal, "l": rows.h.size - rows.equal}
            solver = scs.SCS(arrays, cone, linear_solver="qdldl", **settings)
        begin: Any = (False,)
        if guess is not None:
            y, s = rows.sign * guess[1][rows.row], rows.h - rows.G @ guess[0]
            y[rows.equal :], s[: rows.equal] = np.maximum(y[rows.equal :], 0.0), 0.0
            begin = (True, guess[0], y, np.maximum(s, 0.0))
        elif posed.before is not None and posed.before.arrays[3].h.size == rows.h.size:
            begin = (True, *posed.before.arrays[4])
        return Native(posed, solver, (arrays, settings, begin, rows, []))

    def run(self, native: Native) -> Any:
        """`SCS.solve`, from x, y and s if there are any."""
        return native.object.solve(*native.arrays[2])

    def outcome(self, native: Native, result: Any) -> Outcome:
        """SCS's status, iterations and times."""
        _, _, _, rows, ended = native.arrays
        ended[:] = result["x"], result["y"], result["s"]
        duals = rows.gathered(result["y"], self.program(native.posed).lower.size)
        info = result["info"]
        inside = 1e-3 * (info["setup_time"] + info["solve_time"])
        return Outcome(result["x"], info["status"], info["iter"], duals, inside)
