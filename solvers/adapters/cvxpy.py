"""CVXPY, with parameters.

    x, A, d = cp.Variable(n), cp.Parameter((m, n)), cp.Parameter(m)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x + d)), [x >= lower, x <= upper])
    A.value, d.value = …
    problem.solve(solver=variant, warm_start=False)

CVXPY turns the sum of squares into y = A x + d by itself.  It compiles the problem at the first
solve of a shape, which takes as long as ten or twenty more; then numbers alone are put in.  Beyond
`_MANY` entries of A the compiled form of so many parameters costs more than it saves, and the
problem is written anew, with a sparse A.  Every solve starts cold.

Accuracy: the options of the inner solver, from the residual and the gap that `asked` allows
(`inner_options`); y holds all of d here, whose rounding limits it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from problems.qp import Status
from solvers.adapters.inner_options import check_variant, inner_options
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start

_MANY = 5_000


@dataclass(frozen=True)
class CVXPY(PackageSolver):
    """CVXPY with parameters: sum_squares(A @ x + d), solved by its own default, OSQP.

    variant : the inner solver, one of `variants`
    """

    variant: str = "osqp"

    name: ClassVar[str] = "cvxpy"
    package: ClassVar[str] = "cvxpy"
    form: ClassVar[Form] = "residual"
    variants: ClassVar[tuple[str, ...]] = (
        "osqp", "clarabel", "scs", "piqp", "proxqp", "daqp", "highs",
    )  # fmt: skip
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
        check_variant(self.name, self.variant, self.variants)

    def arrays(self, posed: Posed) -> Any:
        """The problem with today's numbers in its parameters, or written anew where they are many.

        Its canonical form is made once for each shape and pattern of finite bounds.
        """
        low, high = np.flatnonzero(posed.lower > -np.inf), np.flatnonzero(posed.upper < np.inf)
        if posed.m * posed.n > _MANY:
            A, d = sp.csc_array(posed.A), posed.d
            return _written(A, d, low, high, posed.lower[low], posed.upper[high])
        made = _parametrized(posed.m, posed.n, low.tobytes(), high.tobytes(), self.variant)
        made.A.value, made.d.value = posed.dense, posed.d
        if made.lower is not None:
            made.lower.value = posed.lower[low]
        if made.upper is not None:
            made.upper.value = posed.upper[high]
        return made.x, made.problem

    def options(self, posed: Posed, asked: float | None) -> dict[str, Any]:
        """Those of the inner solver."""
        options: dict[str, Any] = {
            "solver": self.variant.upper(), "verbose": False, "warm_start": False,
        }  # fmt: skip
        return options if asked is None else options | inner_options(self.variant, posed, asked)

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Nothing: all of it is one call."""
        posed, (x, written), options, *_ = problem
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
        """CVXPY's status, and the inner solver's iterations and time."""
        stats = native.object.solver_stats
        iterations, inside = (getattr(stats, name, None) for name in ("num_iters", "solve_time"))
        return Outcome(native.arrays[0].value, result, iterations or 0, inside=inside or np.nan)


class _Parametrized(NamedTuple):
    """A problem and its parameters; no bound, none."""

    problem: Any
    x: Any
    A: Any
    d: Any
    lower: Any
    upper: Any


@lru_cache(32)
def _parametrized(m: int, n: int, low: bytes, high: bytes, variant: str) -> _Parametrized:
    """The problem for A (m, n) and finite bounds there; each inner solver has its own."""
    below, above = (np.frombuffer(rows, np.int64) for rows in (low, high))
    A, d = cp.Parameter((m, n)), cp.Parameter(m)
    lower, upper = (cp.Parameter(rows.size) if rows.size else None for rows in (below, above))
    x, problem = _written(A, d, below, above, lower, upper)
    return _Parametrized(problem, x, A, d, lower, upper)


def _written(A: Any, d: Any, low: Any, high: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """x and the problem."""
    x = cp.Variable(A.shape[1])
    bounds = [x[low] >= lower] if low.size else []
    bounds += [x[high] <= upper] if high.size else []
    return x, cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x + d)), bounds)
