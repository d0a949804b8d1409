"""Conjugate gradients for the descent direction, preconditioned with an old R.

The descent direction of algorithm 2 solves (Lötstedt 1984, (3.19), corrected)

    A_Fᵀ A_F p + A_Fᵀ r = 0,      that is   minimise ‖A_F p + r‖.

A = D⁻ᵀG varies little from step to step, so that R of an earlier QR factorization makes A_F R⁻¹
nearly orthogonal, and conjugate gradients on the least-squares problem in y = R p converge in a few
iterations (Björck and Elfving 1979, p. 156):

1. g = R⁻ᵀ A_Fᵀ s with s = A_F p + r, q the first time −g
2. w = A_F R⁻¹ q, α = ‖g‖²/‖w‖²
3. p += α R⁻¹ q,  s += α w
4. v = A_Fᵀ s; stop if ‖v‖ is small, by (3.20) ‖A_F δp‖ ≤ ‖v‖ ‖R⁻¹‖
5. the new g; q := −g + (‖g‖²/‖g_old‖²) q; back to 2

A_Fᵀ A_F is never formed.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dtrsv

from problems.qp import Vector


class LeastSquares(NamedTuple):
    """Outcome of `conjugate_gradients`.

    p : (f,)  minimiser of ‖A p + b‖, as far as it was found
    s : (m,)  A p + b, by recursion
    iterations : products with A R⁻¹ made
    converged : ‖Aᵀ s‖ came below the tolerance
    """

    p: Vector
    s: Vector
    iterations: int
    converged: bool


def solve_R(R: Vector, b: Vector) -> Vector:
    """R⁻¹ b for upper triangular R (f, f), Fortran order, f > 0."""
    return dtrsv(R, b)


def solve_RT(R: Vector, b: Vector) -> Vector:
    """R⁻ᵀ b for upper triangular R (f, f), Fortran order, f > 0."""
    return dtrsv(R, b, trans=1)


def conjugate_gradients(
    A: Vector, R: Vector | None, b: Vector, tolerance: float, limit: float
) -> LeastSquares:
    """Minimise ‖A p + b‖ from p = 0 until ‖Aᵀ(A p + b)‖ ≤ tolerance, (3.19) and (3.20).

    A : (m, f), f > 0, of full column rank; not modified
    R : (f, f) upper triangular preconditioner in Fortran order, or None for none
    b : (m,); not modified
    limit : give up, `converged` false, when the next iteration would exceed it
    """
    p, s = np.zeros(A.shape[1]), b.copy()
    v = s @ A
    iterations, q, gamma = 0, p, 1.0
    while sqrt(v @ v) > tolerance:
        if iterations + 1 > limit:
            return LeastSquares(p, s, iterations, False)
        g = v if R is None else solve_RT(R, v)
        gamma, before = float(g @ g), gamma
        q = q * (gamma / before) - g
        t = q if R is None else solve_R(R, q)
        w = A @ t
        curvature = float(w @ w)
        if curvature == 0.0:
            return LeastSquares(p, s, iterations, False)
        alpha = gamma / curvature
        p += alpha * t
        s += alpha * w
        v = s @ A
        iterations += 1
    return LeastSquares(p, s, iterations, True)
