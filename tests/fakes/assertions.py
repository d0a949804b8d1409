"""What every answer to a contact QP must satisfy, whoever gave it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from problems.qp import ContactQP, Vector

ROUNDING = 32 * float(np.finfo(np.float64).eps)


@lru_cache(maxsize=512)
def force_scale(qp: ContactQP) -> float:
    """‖A A⁺ d‖, the part of d that contact forces can change; 1 where it vanishes."""
    if qp.k == 0:
        return 1.0
    U, s, _ = np.linalg.svd(qp.dense_A, full_matrices=False)
    U = U[:, s > 1e-10 * max(s[0], np.finfo(float).tiny)]
    size = float(np.linalg.norm(U.T @ qp.d))
    return size if size > 1e-14 * float(np.linalg.norm(qp.d)) else 1.0


def assert_kkt(qp: ContactQP, x: ArrayLike | None, tol: float) -> None:
    """`x` meets the KKT conditions of the QP to `tol`, relative to ‖A A⁺ d‖ (plus rounding in d).

    With columns scaled to length 1, z = ‖a‖ x and g = Δ/‖a‖, so that both are forces:
    1. bound violation of z;
    2. stationarity, |g| where x is free;
    3. sign, g ≥ 0 where only the lower bound is near and g ≤ 0 where only the upper one is;
    4. complementarity: what is far from a bound has no multiplier of it.
    """
    assert x is not None, "there is no answer"
    x = np.asarray(x, float)
    assert x.shape == (qp.k,)
    assert np.isfinite(x).all(), f"x is not finite: {x}"
    if qp.k == 0:
        return
    norms = np.linalg.norm(qp.dense_A, axis=0)
    moving = norms > 0
    scale = force_scale(qp)
    size = float(np.linalg.norm(qp.d)) + float(np.linalg.norm(norms * x))
    limit = tol * scale + ROUNDING * size
    z, lower, upper = norms * x, norms[moving] * qp.lower[moving], norms[moving] * qp.upper[moving]
    z, g = z[moving], qp.gradient(x)[moving] / norms[moving]
    violation = np.maximum(lower - z, z - upper).max(initial=0.0)
    assert violation <= limit, f"bounds are violated by {violation:.2e} > {limit:.2e}"
    # distance of g from the multipliers that the bounds near z allow
    far_above, far_below = z - lower > limit, upper - z > limit
    wrong = np.maximum(np.where(far_above, g, 0.0), np.where(far_below, -g, 0.0))
    worst = wrong.max(initial=0.0)
    where = np.flatnonzero(moving)[int(np.argmax(wrong))] if wrong.size else -1
    assert worst <= limit, f"Δ of row {where} is off by {worst:.2e} > {limit:.2e}"
    still = x[~moving]
    room = tol * (1 + np.abs(still))  # such a force has no effect, so no unit either
    assert ((still >= qp.lower[~moving] - room) & (still <= qp.upper[~moving] + room)).all()


def force_error(qp: ContactQP, x: ArrayLike, Ax_star: Vector) -> float:
    """‖A x − A x*‖ / ‖A A⁺ d‖."""
    return float(np.linalg.norm(qp.A @ np.asarray(x, float) - Ax_star)) / force_scale(qp)


def assert_same_force(qp: ContactQP, x: ArrayLike | None, Ax_star: Vector, tol: float) -> None:
    """A x, and so Gλ, equals `Ax_star` to `tol` relative to ‖A A⁺ d‖ (1 where it vanishes)."""
    assert x is not None, "there is no answer"
    error = force_error(qp, x, Ax_star)
    assert error <= tol, f"A x is off by {error:.2e} of the force; {tol:.2e} allowed"
