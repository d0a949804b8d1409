"""nncg, non-negative conjugate gradients (Schmelzer and Stoll).

A primal-dual active-set loop, each of whose free blocks is solved by an inner solver.  The problem
is posed in normal form with x ≥ 0, min ½ xᵀP x − bᵀx, b = −Aᵀd, by `nncg.ActiveSetSolver` with its
Cholesky factorization for a block (`Exact`), which is its fastest at every size here.  Rows with
another bound are declined, and P has to be definite.

Accuracy: `tol` of its KKT test is the residual that `asked` allows.  In a sequence it begins with
the free set and the x of the previous solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import nncg
import numpy as np
from cvx.linalg import DenseOperator

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Start, Unsupported


@dataclass(frozen=True)
class NNCG(PackageSolver):
    """nncg: non-negative conjugate gradients, its exact blocks; x ≥ 0 and a definite P only."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "nncg"
    package: ClassVar[str] = "nncg"
    warm_start: ClassVar[str] = "x and free set"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        True: Status.SOLVED,
        False: Status.ITERATION_LIMIT,
    }

    def arrays(self, posed: Posed) -> Any:
        """P as an operator, and b."""
        if not posed.one_sided:
            raise Unsupported("nncg takes x ≥ 0 and no other bound")
        if posed.n > posed.m:
            raise Unsupported(
                f"nncg takes a definite AᵀA; A has {posed.m} rows for {posed.n} columns"
            )
        return DenseOperator(posed.P), -posed.q

    def options(self, posed: Posed, asked: float | None) -> Any:
        """Its loop, with the tolerance."""
        if asked is None:
            return nncg.ActiveSetConfig(max_outer=self.max_iterations)
        tolerance = posed.residual_tolerance(asked, 1e-14)
        return nncg.ActiveSetConfig(tol=tolerance, max_outer=self.max_iterations)

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Its solver, and what it begins with."""
        posed, arrays, config, *_ = problem
        warm = None
        if posed.start is not None:
            warm = (posed.start > 0.0, posed.start)
        solver = nncg.ActiveSetSolver(inner=nncg.Exact(check_conditioning=False), config=config)
        return Native(posed, solver, (*arrays, warm))

    def run(self, native: Native) -> Any:
        """`ActiveSetSolver.solve`."""
        operator, b, warm = native.arrays
        try:
            return native.object.solve(operator, b, warm=warm)
        except np.linalg.LinAlgError as error:  # P is singular
            return str(error)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """Whether its KKT test was met, and its outer iterations."""
        if isinstance(result, str):
            return Outcome(None, result)
        return Outcome(result.x, result.converged, result.outer)
