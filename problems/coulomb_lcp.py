"""Coulomb's law for all contacts at once, without guessing: a linear complementarity problem.

In the plane, contacts that obey the laws of contact and of Coulomb after a step or an impulse are
the solutions of an LCP (Stewart and Trinkle 1996) in z = (λ_N, λ_F⁺, λ_F⁻, β) ≥ 0, where λ_F is
λ_F⁺ − λ_F⁻:

    0 ≤ λ_N  ⊥  g_Nᵀq̇ ≥ 0
    0 ≤ λ_F± ⊥  β ± g_Fᵀq̇ ≥ 0                β = |g_Fᵀq̇| where a contact slides
    0 ≤ β    ⊥  μ Σ λ_N − λ_F⁺ − λ_F⁻ ≥ 0

Its matrix is copositive, and Lemke's method (1965) ends with a solution, also with gains ≥ 1, where
fixed-point passes may wander between working sets for ever.  Ties are broken by the lexicographic
rule, so that it does not cycle.  It works on a dense tableau: the last resort for a hundred
contacts, not the way to step.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.assembly import Assembly
from problems.qp import Indices, Vector

MOST_VARIABLES = 400
"""Variables of the largest LCP that is tried; a pivot is 0.5 ms there."""
PIVOTS = 50
"""Pivots that are made at most, per variable."""
PIVOT_TOL = 1e-11
"""Entries of the scaled tableau that are taken for 0."""


def coulomb_multipliers(assembly: Assembly, D: Vector, d: Vector) -> tuple[Vector, Vector] | None:
    """λ_N (N,) and λ_F (F,) with which all contacts meet both laws, D q̇ = A λ + d up to a factor.

    d : (3n,) of the QP with no friction force in it

    None where there are too many contacts, or rounding has led astray.
    """
    friction_of, mu = assembly.friction_of, assembly.mu
    N, F = friction_of.size, mu.size
    if N + 3 * F > MOST_VARIABLES:
        return None
    columns = sp.csc_array(assembly.scaled(np.arange(N), np.arange(F), D)).toarray()
    normal, tangent = columns[:, :N], columns[:, N:]
    size = np.linalg.norm(normal, axis=0)
    A = np.hstack([normal / size, tangent, -tangent])
    M = np.zeros((N + 3 * F, N + 3 * F))
    M[: N + 2 * F, : N + 2 * F] = A.T @ A
    each = np.arange(F)
    slip, cone = N + each, N + 2 * F + each
    for side in (slip, slip + F):
        M[side, cone], M[cone, side] = 1.0, -1.0
    loaded = np.flatnonzero(friction_of >= 0)
    M[cone[friction_of[loaded]], loaded] = mu[friction_of[loaded]] / size[loaded]
    q = np.concatenate([A.T @ d, np.zeros(F)])
    z = lemke(M, q)
    return None if z is None else (z[:N] / size, z[N + each] - z[N + F + each])


def lemke(M: NDArray[np.float64], q: Vector) -> Vector | None:
    """z ≥ 0 with w = M z + q ≥ 0 and zᵀw = 0, (n,); None on a ray or after too many pivots."""
    n = q.size
    if q.min(initial=0.0) >= 0:
        return np.zeros(n)
    # w − M z − 1 z₀ = q: columns of w, z, z₀ and the right-hand side
    T = np.hstack([np.eye(n), -M, -np.ones((n, 1)), q[:, None]])
    basis = np.arange(n)
    row, entering = _least(T, np.arange(n), n), 2 * n
    for _ in range(PIVOTS * n):
        leaving = basis[row]
        _pivot(T, row, entering)
        basis[row] = entering
        if leaving == 2 * n:
            z = np.zeros(2 * n + 1)
            z[basis] = np.maximum(T[:, -1], 0.0)
            return z[n : 2 * n]
        entering = (leaving + n) % (2 * n)
        rows = np.flatnonzero(T[:, entering] > PIVOT_TOL)
        if rows.size == 0:
            return None
        row = _least(T[rows] / T[rows, entering, None], rows, n)
    return None


def _pivot(T: NDArray[np.float64], row: int, column: int) -> None:
    T[row] /= T[row, column]
    factors = T[:, column].copy()
    factors[row] = 0.0
    T -= np.outer(factors, T[row])


def _least(T: NDArray[np.float64], rows: Indices, n: int) -> int:
    """Which of `rows` has lexicographically the least (right-hand side, columns of w) in T."""
    candidates = np.arange(rows.size)
    for column in (-1, *range(n)):
        values = T[candidates, column]
        candidates = candidates[values <= values.min() + PIVOT_TOL * max(1.0, abs(values.min()))]
        if candidates.size == 1:
            break
    return int(rows[candidates[0]])
