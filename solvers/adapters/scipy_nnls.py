"""Non-negative least squares, Lawson and Hanson's, as in SciPy (1974; compiled since SciPy 1.15).

The problem is posed as it is, min ‖A x + d‖ with x ≥ 0, by `scipy.optimize.nnls`; rows with another
finite bound are counted from it.  A row with two bounds or none cannot be posed and is declined.

Accuracy: an active-set method is exact once it has the working set; SciPy has no tolerance, and
takes no start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import nnls

from problems.qp import ContactQP, Status
from solvers.adapters.normal_form import is_one_sided
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start, Unsupported

_NOTHING = np.zeros(0)


@dataclass(frozen=True)
class ScipyNNLS(PackageSolver):
    """Lawson and Hanson's non-negative least squares, as in SciPy; x ≥ 0 only."""

    max_iterations: int = 0

    name: ClassVar[str] = "scipy_nnls"
    package: ClassVar[str] = "scipy"
    form: ClassVar[Form] = "least_squares"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "Maximum number of iterations reached.": Status.ITERATION_LIMIT,
    }

    def build(self, qp: ContactQP, start: Start | None) -> Built:
        """A and −d as they are, of x ≥ 0: the method asks for no scale, and takes no start."""
        lower, upper = qp.lower, qp.upper
        if not is_one_sided(lower, upper):
            return super().build(qp, None)
        A, d = qp.dense_A, qp.d
        posed = Posed(A, d, lower, upper, qp.row_id, _NOTHING, np.nan, one_sided=True)
        return Built(posed, (A, -d, None, None))

    def arrays(self, posed: Posed) -> Any:
        """A, −d, base and σ of x = base + σ x′, x′ ≥ 0."""
        if posed.one_sided:
            return posed.A, -posed.d, None, None
        below, above = posed.lower > -np.inf, posed.upper < np.inf
        if (below == above).any():
            row = int(np.flatnonzero(below == above)[0])
            bounds = "two bounds" if below[row] else "no bound"
            raise Unsupported(f"nnls takes rows with one bound; row {row} has {bounds}")
        base, sign = np.where(below, posed.lower, posed.upper), np.where(below, 1.0, -1.0)
        return posed.A * sign, -(posed.d + posed.A @ base), base, sign

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing but the limit, SciPy's own being 3 n."""
        posed, arrays, *_ = problem
        return Native(posed, self.max_iterations or 10 * posed.n, arrays)

    def run(self, native: Native) -> Any:
        """`scipy.optimize.nnls`."""
        A, b, *_ = native.arrays
        try:
            return nnls(A, b, maxiter=native.object)[0]
        except RuntimeError as error:  # its only way to say that it gave up
            return str(error)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """x from x′; SciPy counts nothing."""
        if isinstance(result, str):
            return Outcome(None, result)
        *_, base, sign = native.arrays
        return Outcome(result if base is None else base + sign * result, "solved")
