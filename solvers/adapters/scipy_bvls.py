"""Bounded-variable least squares, Lawson and Hanson's, as in SciPy (Stark and Parker 1995).

The problem is posed as it is, min ‖A x + d‖ with bounds, by `scipy.optimize.lsq_linear`; only, in
an orthonormal basis U of the range of A, with UᵀA and Uᵀd: SciPy stops at a relative change of
½‖A x + d‖², which the part of d that no contact can change would swamp.  Fixed rows are eliminated,
as SciPy refuses them.

Accuracy: an active-set method is exact once it has the working set.  SciPy has one tolerance, for
the signs of Δ and for the relative change of the cost; it is 1e-18 unless the defaults are asked
for, so that SciPy goes on until the cost stops falling.  The cost also stands still where the row
that SciPy frees is blocked at once, and SciPy calls that the end, with other rows off by 1e-3 of
the force.  Its own `optimality` tells; then it is asked again with the columns in another order,
which starts it elsewhere.  There is no warm start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start

_ORDERS = 8
_OPTIMAL = 1e-12
"""Largest wrong Δ of an answer, per unknown, relative to what acts."""
_STUCK = -1


@dataclass(frozen=True)
class ScipyBVLS(PackageSolver):
    """Lawson and Hanson's bounded-variable least squares, as in SciPy."""

    max_iterations: int = 1_000

    name: ClassVar[str] = "scipy_bvls"
    package: ClassVar[str] = "scipy"
    form: ClassVar[Form] = "least_squares"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        1: Status.SOLVED,
        2: Status.SOLVED,
        3: Status.SOLVED,
        0: Status.ITERATION_LIMIT,
        _STUCK: Status.INACCURATE,
    }

    def arrays(self, posed: Posed) -> Any:
        """UᵀA, −Uᵀd and the bounds, of columns that are not zeros.

        SciPy frees those, too, and may give up for what rounding makes of them.
        """
        A, d = posed.reduced
        some = _pushing(posed)
        return A[:, some], -d, (posed.lower[some], posed.upper[some])

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Method, iterations and tolerance."""
        settings: dict[str, Any] = {"method": "bvls", "max_iter": self.max_iterations}
        return settings if asked is None else {**settings, "tol": 1e-18}

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing but the settings."""
        return Native(problem.posed, problem.options, problem.arrays)

    def run(self, native: Native) -> Any:
        """`scipy.optimize.lsq_linear`, in other orders of the columns until it is optimal."""
        posed, settings, (A, b, (lower, upper)), *_ = native
        result = lsq_linear(A, b, (lower, upper), **settings)
        if "tol" not in settings:
            return result
        allowed = _OPTIMAL * posed.n * posed.force
        for turn in range(1, _ORDERS):
            if result.optimality <= allowed:
                return result
            order = np.random.default_rng(turn).permutation(lower.size)
            again = lsq_linear(A[:, order], b, (lower[order], upper[order]), **settings)
            if again.optimality < result.optimality:
                x = np.empty_like(again.x)
                x[order] = again.x
                again.x, result = x, again
        if result.optimality > allowed:
            result.status = _STUCK
        return result

    def outcome(self, native: Native, result: Any) -> Outcome:
        """SciPy's status and iterations."""
        posed = native.posed
        x = np.clip(0.0, posed.lower, posed.upper)
        x[_pushing(posed)] = result.x
        return Outcome(x, result.status, result.nit)


def _pushing(posed: Posed) -> NDArray[np.bool_]:
    """(n,) which columns of A are not zeros; all where none is."""
    some = np.asarray(abs(posed.A).sum(axis=0) > 0).ravel()
    return some if some.any() else np.ones(posed.n, bool)
