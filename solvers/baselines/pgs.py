"""Projected Gauss-Seidel with warm start, what game engines do ("sequential impulses").

    1. x from the previous step, by row; r = A x + d
    2. for each row in turn: x_i := x_i − Δ_i/‖a_i‖², Δ_i = a_iᵀr, clipped to its bounds;
       r := r + a_i δx_i
    3. until a sweep changes A x by little enough, or the sweeps are used up

It converges linearly; along a tower the error falls by a factor close to 1 a sweep, the closer the
more boxes there are.  Engines stop after 4 to 50 sweeps whatever is left: so do the default
settings here, after 50.

Accuracy: a sweep is the last one when its step ‖A δx‖ and the contraction q of the last sweeps, the
greatest of three ratios of successive steps, leave ‖A δx‖ q/(1 − q) ≤ asked.  The rows of P = AᵀA
are worked with instead of r, which is the same in exact arithmetic: k products for each row
instead of 2 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from problems.qp import Status
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Start


@dataclass(frozen=True)
class ProjectedGaussSeidel(PackageSolver):
    """Projected Gauss-Seidel with warm start, as in game engines (our own).

    max_sweeps : cap on the sweeps where an accuracy is asked for
    default_sweeps : sweeps with accuracy="default"
    """

    max_sweeps: int = 2_000
    default_sweeps: int = 50

    name: ClassVar[str] = "pgs"
    warm_start: ClassVar[str] = "x"
    statuses: ClassVar[dict[Any, Status]] = {
        "converged": Status.SOLVED,
        "fixed number of sweeps": Status.SOLVED,
        "sweep limit": Status.ITERATION_LIMIT,
    }

    def arrays(self, posed: Posed) -> Any:
        """P by rows, q, its diagonal and the bounds as lists, and x to start from."""
        x = np.zeros(posed.n) if posed.start is None else posed.start
        diagonal = np.diag(posed.P).tolist()
        return posed.P, diagonal, posed.lower.tolist(), posed.upper.tolist(), x

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """x within its bounds and its gradient."""
        posed = problem.posed
        P, diagonal, lower, upper, x = problem.arrays
        x = np.clip(x, posed.lower, posed.upper)
        tolerance = None if asked is None else posed.allowed(asked)
        return Native(posed, (x.tolist(), posed.q + P @ x, tolerance), (P, diagonal, lower, upper))

    def run(self, native: Native) -> Any:
        """Steps 2 and 3: x, the number of sweeps and how they ended."""
        P, diagonal, lower, upper = native.arrays
        x, gradient, tolerance = native.object
        rows = [i for i, size in enumerate(diagonal) if size > 0.0]
        sweeps = self.default_sweeps if tolerance is None else self.max_sweeps
        last, ratios = 0.0, [np.inf] * 3
        for sweep in range(1, sweeps + 1):
            before = gradient.copy()
            moves = np.zeros(len(x))
            for i in rows:
                new = x[i] - gradient[i] / diagonal[i]
                new = lower[i] if new < lower[i] else upper[i] if new > upper[i] else new
                move = new - x[i]
                if move != 0.0:
                    x[i], moves[i] = new, move
                    gradient += move * P[i]
            # ‖A δx‖² = δxᵀ P δx
            step = float(max(moves @ (gradient - before), 0.0)) ** 0.5
            ratios[sweep % 3] = step / last if last > 0.0 else (np.inf if step > 0.0 else 0.0)
            ratio = max(ratios)
            if tolerance is not None and step * ratio <= tolerance * (1.0 - ratio):
                return np.array(x), sweep, "converged"
            last = step
        return np.array(x), sweeps, "fixed number of sweeps" if tolerance is None else "sweep limit"

    def outcome(self, native: Native, result: Any) -> Outcome:
        """x and the number of sweeps."""
        x, sweeps, text = result
        return Outcome(x, text, sweeps)
