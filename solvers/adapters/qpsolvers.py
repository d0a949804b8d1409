"""qpsolvers, one call for many packages, as most people would first write it.

    x = solve_qp(P, q, lb=lower, ub=upper, solver=variant, initvals=x_before)

with P = AᵀA, q = Aᵀd.  It sets the inner solver up for each QP.  `solve_problem` is the same call
with a status.  The data are scaled and without fixed rows as for all packages
(`solvers.adapters.posed`).

Accuracy: the options of the inner solver, from the residual and the gap that `asked` allows
(`inner_options`).  quadprog has none and refuses a singular P.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import qpsolvers

from problems.qp import Status
from solvers.adapters.inner_options import check_variant, inner_options
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Start


@dataclass(frozen=True)
class QPSolvers(PackageSolver):
    """qpsolvers as first written: solve_qp(P, q, lb, ub), by the ProxQP of its own example.

    variant : the inner solver, one of `variants`
    """

    variant: str = "proxqp"

    name: ClassVar[str] = "qpsolvers"
    package: ClassVar[str] = "qpsolvers"
    variants: ClassVar[tuple[str, ...]] = (
        "proxqp", "clarabel", "osqp", "scs", "piqp", "daqp", "highs", "quadprog",
    )  # fmt: skip
    warm_start: ClassVar[str] = "x, where the inner solver takes it"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {"found": Status.SOLVED, "not found": Status.FAILED}

    def __post_init__(self) -> None:
        super().__post_init__()
        check_variant(self.name, self.variant, self.variants)

    def arrays(self, posed: Posed) -> Any:
        """P, q and the bounds as a `qpsolvers.Problem`."""
        return qpsolvers.Problem(posed.P, posed.q, lb=posed.lower, ub=posed.upper)

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Those of the inner solver."""
        return {} if asked is None else inner_options(self.variant, posed, asked)

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing: all of it is one call."""
        posed, arrays, options, *_ = problem
        options = {"solver": self.variant, "initvals": posed.start, **options}
        return Native(posed, options, arrays)

    def run(self, native: Native) -> Any:
        """`qpsolvers.solve_problem`."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return qpsolvers.solve_problem(native.arrays, **native.object)
            except qpsolvers.exceptions.QPError as error:
                return error

    def outcome(self, native: Native, result: Any) -> Outcome:
        """Whether it was found."""
        if isinstance(result, qpsolvers.exceptions.QPError):
            return Outcome(None, str(result))
        x = None if result.x is None else np.asarray(result.x, float)
        return Outcome(x, "found" if result.found else "not found")
