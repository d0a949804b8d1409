"""Solving for the velocity, (3.4), instead of the multipliers.

The problem is the dual of (3.2), strictly convex in r (the velocity is q̇_n = (h/α₀) D⁻¹ r):

    minimise  ½‖r − d‖² − Σ (lᵢ Δᵢ⁺ − uᵢ Δᵢ⁻),   Δ = Aᵀ r.

For l = 0, u = ∞ this is (3.4), ½‖r − d‖² with Aᵀr ≥ 0.  The multipliers of Δ are x, r = A x + d.
The method is the dual one of Goldfarb and Idnani (Math. Programming 27, 1983), for costs with a
kink at Δᵢ = 0 instead of constraints:

1. Each row is either off its kink, with x at a bound, or on it, Δ = 0 and l < x < u.  The columns
   of those on it are independent, A_K = Q R.
2. Of the rows off their kink take p, whose Δ has the wrong sign by most; none: end.
3. Move r by t z, z = ±(I − QQᵀ) a_p, with x_p by ±t and x_K by t s, s = ∓R⁻¹Qᵀ a_p, until
   a. Δ_p = 0: p is put on its kink; go to 2;
   b. x_p meets its other bound: p stays there; go to 2;
   c. some x_j, j in K, meets a bound: j leaves its kink there; go to 3.

Every pass of 2 lowers ½‖A x + d‖², so that no set comes twice.  A column in the span of A_K has
Δ = 0 and is not taken: rank-deficient A needs no special care.

This differs from the source: 1. Δ is computed afresh at step 2, as q + Aᵀ(A x), and x_K is
corrected by it once, so that rounding does not gather.  2. A start puts the rows that were free on
their kinks; where x_K then breaks a bound, its row leaves its kink there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import solve_triangular

from problems.qp import Status, Vector
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start

_ROUNDING = 16 * float(np.finfo(float).eps)
_DEPENDENT = 1e-10  # a column whose part outside the span of A_K is shorter depends on it


class _Kinks:
    """The rows K on their kink and A_K = Q R."""

    def __init__(self, A: Vector, candidates: Any) -> None:
        self.A, self.rows = A, np.zeros(0, np.int64)
        self.Q, self.R = np.zeros((A.shape[0], 0)), np.zeros((0, 0))
        for row in candidates:
            w, z = self.split(A[:, row])
            if np.linalg.norm(z) > _DEPENDENT:
                self.insert(row, w, z)

    def split(self, a: Vector) -> tuple[Vector, Vector]:
        """w, z with a = Q w + z, z orthogonal to Q (orthogonalised twice)."""
        w = self.Q.T @ a
        z = a - self.Q @ w
        again = self.Q.T @ z
        return w + again, z - self.Q @ again

    def insert(self, row: int, w: Vector, z: Vector) -> None:
        """Append `row`, whose column is Q w + z."""
        n, length = self.rows.size, np.linalg.norm(z)
        R = np.zeros((n + 1, n + 1))
        R[:n, :n], R[:n, n], R[n, n] = self.R, w, length
        self.R, self.Q = R, np.column_stack([self.Q, z / length])
        self.rows = np.append(self.rows, row)

    def delete(self, keep: Any) -> None:
        """Keep only the positions `keep`."""
        turn, self.R = np.linalg.qr(self.R[:, keep])
        self.Q, self.rows = self.Q @ turn, self.rows[keep]

    def coefficients(self, w: Vector) -> Vector:
        """R⁻¹ w."""
        return solve_triangular(self.R, w, check_finite=False) if w.size else w


@dataclass(frozen=True)
class Velocity(PackageSolver):
    """The velocity problem (3.4) by the dual active-set method of Goldfarb and Idnani (our own)."""

    max_iterations: int = 10_000

    name: ClassVar[str] = "velocity"
    form: ClassVar[Form] = "velocity"
    warm_start: ClassVar[str] = "working set"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {
        "solved": Status.SOLVED,
        "iteration limit": Status.ITERATION_LIMIT,
    }

    def arrays(self, posed: Posed) -> Any:
        """A, q = Aᵀd, the bounds, and x to start from: old, or at the bounds nearest to 0."""
        x = np.zeros(posed.n) if posed.start is None else posed.start
        return posed.dense, posed.q, posed.lower, posed.upper, np.clip(x, posed.lower, posed.upper)

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """Factorise the columns of the rows on their kink: with l < x < u, and without bounds."""
        A, _, lower, upper, x = problem.arrays
        unbounded = np.isinf(lower) & np.isinf(upper)
        inside = unbounded if start is None else (lower < x) & (x < upper)
        # a cold start has two-sided rows at a bound, as the others
        at = x if start is not None else np.where(unbounded, 0.0, _nearest_bound(x, lower, upper))
        kinks = _Kinks(A, np.flatnonzero(inside))
        return Native(problem.posed, kinks, (*problem.arrays[:4], at))

    def run(self, native: Native) -> Any:
        """Steps 1 to 3."""
        return _solve(native.object, *native.arrays, limit=self.max_iterations)

    def outcome(self, native: Native, result: Any) -> Outcome:
        """Multipliers of the velocity problem."""
        x, iterations, text = result
        return Outcome(x, text, iterations)


def _nearest_bound(x: Vector, lower: Vector, upper: Vector) -> Vector:
    return np.where(x - lower <= upper - x, lower, upper)


def _solve(
    kinks: _Kinks, A: Vector, q: Vector, lower: Vector, upper: Vector, x: Vector, *, limit: int
) -> tuple[Vector, int, str]:
    """x, the number of steps of r, and how it ended."""
    x = x.copy()
    _settle(kinks, q, lower, upper, x)
    barred: list[int] = []
    steps = 0
    while steps < limit:
        Ax = A @ x
        gradient = q + A.T @ Ax
        wrong = np.where(x < upper, -gradient, 0.0).clip(0.0)
        wrong = np.maximum(wrong, np.where(x > lower, gradient, 0.0))
        wrong[kinks.rows] = wrong[barred] = 0.0
        p = int(np.argmax(wrong))
        if wrong[p] <= _ROUNDING * (np.abs(q).max() + np.linalg.norm(Ax)):
            return x, steps, "solved"
        slope = float(gradient[p])
        sign = -1.0 if slope > 0 else 1.0
        while steps < limit:
            steps += 1
            w, z = kinks.split(A[:, p])
            zz = float(z @ z)
            if zz <= _DEPENDENT**2:  # Δ_p is 0 but for rounding
                barred.append(p)
                break
            K = kinks.rows
            s = -sign * kinks.coefficients(w)
            room = np.where(s > 0, upper[K] - x[K], x[K] - lower[K])
            with np.errstate(divide="ignore", invalid="ignore"):
                times = np.where(s != 0, room / np.abs(s), np.inf)
            blocking = int(np.argmin(times)) if K.size else -1
            time = float(times[blocking]) if K.size else np.inf
            own = float(upper[p] - x[p] if sign > 0 else x[p] - lower[p])
            full = abs(slope) / zz
            t = min(full, own, time)
            x[K] += t * s
            if t == full:
                x[p] += sign * t
                kinks.insert(p, w, z)
                break
            if t == own:
                x[p] = upper[p] if sign > 0 else lower[p]
                break
            x[p] += sign * t
            slope += sign * t * zz
            j = K[blocking]
            x[j] = upper[j] if s[blocking] > 0 else lower[j]
            kinks.delete(np.arange(K.size) != blocking)
            barred.clear()
        if _settle(kinks, q, lower, upper, x):
            barred.clear()
    return x, steps, "iteration limit"


def _settle(kinks: _Kinks, q: Vector, lower: Vector, upper: Vector, x: Vector) -> bool:
    """Solve Δ_K = 0 for x_K, in place; rows that would break a bound leave their kinks there.

    Returns whether any did.
    """
    left = False
    while kinks.rows.size:
        K = kinks.rows
        gradient = q[K] + kinks.A[:, K].T @ (kinks.A @ x)
        w = solve_triangular(kinks.R, gradient, trans="T", check_finite=False)
        new = x[K] - kinks.coefficients(w)
        x[K] = np.clip(new, lower[K], upper[K])
        inside = (new > lower[K]) & (new < upper[K])
        if inside.all():
            break
        kinks.delete(inside)
        left = True
    return left
