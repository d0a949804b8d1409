"""CVXPY, as most people would first write it.

    x = cp.Variable(n)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x + d)), [x >= lower, x <= upper])
    problem.solve(solver=variant)

CVXPY turns the sum of squares into y = A x + d by itself.  The problem is written anew for each QP;
so its `solve` compiles it each time, which is most of what is timed, and starts cold.  The data are
scaled and without fixed rows as for all packages (`solvers.adapters.posed`).

Accuracy: the options of the inner solver, from the residual and the gap that `asked` allows
(`inner_options`); y holds all of d here, whose rounding limits it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import cvxpy as cp
import numpy as np

from problems.qp import Status
from solvers.adapters.inner_options import check_variant, inner_options
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start

_VARIANTS = ("osqp", "clarabel", "scs", "piqp", "proxqp", "daqp", "highs")


@dataclass(frozen=True)
class CVXPY(PackageSolver):
    """CVXPY as first written: sum_squares(A @ x + d), solved by its own default, OSQP.

    variant : the inner solver, one of `_VARIANTS`
    """

    variant: str = "osqp"

    name: ClassVar[str] = "cvxpy"
    package: ClassVar[str] = "cvxpy"
    form: ClassVar[Form] = "residual"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "optimal": Status.SOLVED,
        "optimal_inaccurate": Status.INACCURATE,
        "user_limit": Status.ITERATION_LIMIT,
        "infeasible": Status.INFEASIBLE,
        "infeasible_inaccurate": Status.INFEASIBLE,
        "unbounded": Status.UNBOUNDED,
        "unbounded_inaccurate": Status.UNBOUNDED,
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        check_variant(self.name, self.variant, _VARIANTS)

    def arrays(self, posed: Posed) -> Any:
        """The problem as written."""
        x = cp.Variable(posed.n)
        low, high = np.flatnonzero(posed.lower > -np.inf), np.flatnonzero(posed.upper < np.inf)
        bounds = [x[low] >= posed.lower[low]] if low.size else []
        bounds += [x[high] <= posed.upper[high]] if high.size else []
        return x, cp.Problem(cp.Minimize(0.5 * cp.sum_squares(posed.dense @ x + posed.d)), bounds)

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """The options of the inner solver."""
        posed, (x, written), *_ = problem
        options: dict[str, Any] = {"solver": self.variant.upper(), "verbose": False}
        if asked is not None:
            options |= inner_options(self.variant, posed, asked)
        return Native(posed, written, (x, options))

    def run(self, native: Native) -> Any:
        """`Problem.solve`; an inner solver that gives up raises `SolverError`."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                native.object.solve(**native.arrays[1])
            except cp.SolverError as error:
                return str(error)
        return native.object.status

    def outcome(self, native: Native, result: Any) -> Outcome:
        """CVXPY's status and the inner solver's iterations."""
        stats = native.object.solver_stats
        iterations = getattr(stats, "num_iters", None) if stats is not None else None
        return Outcome(native.arrays[0].value, result, iterations or 0)
