"""SCS, an operator-splitting method for conic problems (O'Donoghue et al. 2016, 2021).

The problem is posed in normal form, min ½ xᵀP x + qᵀx, with one nonnegative row for each finite
bound.  P may be singular; the ρ_x of SCS is part of its iteration.

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
from solvers.adapters.forms import (
    Built,
    Native,
    Outcome,
    PackageSolver,
    Posed,
    bound_rows,
    same_matrix,
)
from solvers.base import Start


@dataclass(frozen=True)
class SCS(PackageSolver):
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

    def arrays(self, posed: Posed) -> Any:
        """P (upper triangle), rows G x + s = h with s ≥ 0, and q, in a dictionary."""
        G, h = bound_rows(posed)
        if h.size == 0:  # SCS wants a row: 0 x + s = 1
            G, h = sp.csc_matrix((1, posed.n)), np.ones(1)
        return {"P": posed.P_upper, "A": G, "b": h, "c": posed.q}

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Update b and c where the rest is the same; else set up afresh."""
        posed, arrays, carried, duals = problem
        settings: dict[str, Any] = {"verbose": False, "max_iters": self.max_iterations}
        if asked is not None:
            settings |= {"eps_abs": posed.residual_tolerance(asked, 1e-12), "eps_rel": 0.0}
        old, used = ({}, None) if carried is None else carried.native.arrays[:2]
        if used == settings and all(same_matrix(old[name], arrays[name]) for name in "PA"):
            solver = carried.native.object  # type: ignore[union-attr]
            solver.update(b=arrays["b"], c=arrays["c"])
        else:
            cone = {"l": arrays["b"].size}
            solver = scs.SCS(arrays, cone, linear_solver="qdldl", **settings)
        guess: Any = (False,)
        if duals is not None:
            y = np.maximum(arrays["A"] @ duals, 0.0)
            guess = (True, posed.start, y, np.maximum(arrays["b"] - arrays["A"] @ posed.start, 0.0))
        return Native(posed, solver, (arrays, settings, guess))

    def run(self, native: Native) -> Any:
        """`SCS.solve`, from x, y and s if there are any."""
        return native.object.solve(*native.arrays[2])

    def outcome(self, native: Native, result: Any) -> Outcome:
        """SCS's status and iterations."""
        duals = native.arrays[0]["A"].T @ result["y"]
        info = result["info"]
        return Outcome(result["x"], info["status"], info["iter"], duals)
