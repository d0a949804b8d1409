"""Bounded-variable least squares, Lawson and Hanson's, as in SciPy (Stark and Parker 1995).

The problem is posed as it is, min ‖A x + d‖ with bounds, by `scipy.optimize.lsq_linear`; only, in
an orthonormal basis U of the range of A, with UᵀA and Uᵀd: SciPy stops at a relative change of
½‖A x + d‖², which the part of d that no contact can change would swamp.  Fixed rows are eliminated,
as SciPy refuses them.

Accuracy: an active-set method is exact once it has the working set.  SciPy has one tolerance, for
the signs of Δ and for the relative change of the cost; it is 1e-18 unless the defaults are asked
for, so that SciPy goes on until the cost stops falling.  There is no warm start.
"""

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
    }

    def arrays(self, posed: Posed) -> Any:
        """UᵀA, −Uᵀd and the bounds, of columns that are not zeros.

        SciPy frees those, too, and may give up for what rounding makes of them.
        """
        A, d = posed.reduced
        some = _pushing(posed)
        return A[:, some], -d, (posed.lower[some], posed.upper[some])

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing but the settings."""
        settings: dict[str, Any] = {"method": "bvls", "max_iter": self.max_iterations}
        if asked is not None:
            settings["tol"] = 1e-18
        return Native(problem.posed, settings, problem.arrays)

    def run(self, native: Native) -> Any:
        """`scipy.optimize.lsq_linear`."""
        return lsq_linear(*native.arrays, **native.object)

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
