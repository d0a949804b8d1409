"""Corrected friction: (2.9) as a fixed point λ_* = λ_N(λ_*) of (4.5), (4.6), by Newton's method.

A pass solves the QP with the sliding forces s μ Σ λ_* and the bounds ± μ Σ λ_* and finds λ_N(λ_*).
Let S be the columns of the free normals and of the frictions strictly inside their bounds, and
F T λ_* the friction forces that are proportional to λ_*: T = σ μ Σ, with σ = s of a sliding contact
and the sign of λ_F of one at its bound.  While the working set stays, A_Sᵀ r = 0 is linear, so that
with E λ_S the normals among λ_S and γ = λ_N − λ_* the fixed point is λ_N + E y,

    A_Sᵀ (A_S + F T E) y = −A_Sᵀ F T γ.

It is λ_* of the next pass, and the passes end when the working set does not change any more, as a
rule after two or three.  Functional iteration, λ_* ← λ_N, needs every gain of the sweep, the
eigenvalues of λ_N'(λ_*), inside the unit circle; towers with friction have larger ones.

There may be no fixed point.  With the signs s given, a gain that passes 1 leaves sliding contacts
without any λ that meets both laws, at whatever h (Painlevé 1895).  With all contacts in J_FO,
bounded in both directions, there always is one, because λ_N(λ_*) is then continuous and bounded:
contacts catch, λ grows as 1/h and q̇ jumps.  Newton's method finds it from λ_* = ∞, where everything
sticks, if it is not believed where it calls for λ < 0: between ∞ and there, contacts may catch.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigs, splu

from problems.contacts.active_kernels import JOINT
from problems.contacts.assembly import Assembly
from problems.friction.kernels import (
    RIDGE,
    forced_signs,
    loaded,
    next_multipliers,
    small_newton_multipliers,
)
from problems.friction.passes import SMALL
from problems.qp import Indices, Matrix, Vector


def newton_multipliers(
    assembly: Assembly,
    D: Vector,
    signs: Vector,
    lam_star: Vector,
    lam_N: Vector,
    lam_F: Vector,
    v: Vector,
    from_above: bool = False,
) -> Vector:
    """λ_* (N,) ≥ 0 of the next pass, from the one used and the λ_N, λ_F and q̇ that came of it.

    from_above : whether the passes began with λ_* = ∞
    """
    sigma = forced_signs(signs, lam_F, assembly.bound(lam_star), assembly.slip_speed(v))
    if lam_N.size + lam_F.size <= SMALL:
        columns = assembly.columns
        return small_newton_multipliers(
            *((columns.normal, columns.bodies), assembly.tangents, 1 / D**2),
            *(assembly.friction_of, assembly.mu, signs, sigma, lam_star, lam_N, from_above),
        )
    free = loaded(lam_N, assembly.friction_of)
    if not free.any() or not sigma.any() or np.isinf(lam_star).any():
        return lam_N
    inside = (signs == 0) & (sigma == 0)
    y, found = _sparse_move(assembly, D, sigma, inside, free, lam_N - lam_star)
    if not found:
        return lam_N
    return next_multipliers(assembly.friction_of, lam_star, lam_N, y, from_above)


def _sparse_move(
    assembly: Assembly,
    D: Vector,
    sigma: Vector,
    inside: NDArray[np.bool_],
    free: NDArray[np.bool_],
    gamma: Vector,
) -> tuple[Vector, bool]:
    """y (N,), and whether there is one, as `newton_move` with sparse matrices."""
    normals, y = np.flatnonzero(free), np.zeros(free.size)
    S = sp.csc_array(assembly.scaled(normals, np.flatnonzero(inside), D))
    moved = assembly.friction_force(sigma * assembly.bound(gamma)) / D
    forced = sp.csc_array(_forced(assembly, sigma, normals, D))
    blank = sp.csc_array((S.shape[0], S.shape[1] - normals.size))
    K = _normal_matrix(S) + S.T @ sp.hstack([forced, blank], format="csc")
    try:
        y[normals] = splu(sp.csc_matrix(K)).solve(-(S.T @ moved))[: normals.size]
    except RuntimeError:  # a gain of exactly 1
        return y, False
    return y, True


def largest_gain(
    assembly: Assembly, D: Vector, sigma: Vector, forced: NDArray[np.bool_], lam_N: Vector
) -> tuple[float, int]:
    """The largest eigenvalue of λ_N'(λ_*), by its real part, and the normal that weighs most in it.

    sigma : (F,) as of `forced_signs`;  forced : (F,) whether a friction slides or is at its bound
    lam_N : (N,); the free normals are those above 0, and rows of joints

    Returns −inf where nothing is free and forced, or where the iteration that large sparse problems
    need does not converge.
    """
    normals = np.flatnonzero((lam_N > 0) | (assembly.friction_of == JOINT))
    if normals.size == 0 or not sigma.any():
        return -np.inf, -1
    S = assembly.scaled(normals, np.flatnonzero(np.logical_not(forced)), D)
    K, moved = _normal_matrix(S), _forced(assembly, sigma, normals, D)
    n = normals.size
    try:
        if sp.issparse(K):
            solve = splu(K).solve
            slope = LinearOperator((n, n), lambda lam: -solve(S.T @ (moved @ lam))[:n])
            values, vectors = eigs(slope, k=1, which="LR", v0=np.ones(n), tol=1e-6)
        else:
            values, vectors = np.linalg.eig(-np.linalg.solve(K, S.T @ moved)[:n])
    except (np.linalg.LinAlgError, RuntimeError):
        return -np.inf, -1
    first = int(np.argmax(values.real))
    weight = np.where(assembly.friction_of[normals] >= 0, np.abs(vectors[:, first]), -1.0)
    return float(values[first].real), int(normals[np.argmax(weight)])


def _forced(assembly: Assembly, sigma: Vector, normals: Indices, D: Vector) -> Matrix:
    """F T E: the friction force that a unit of each of these multipliers brings about."""
    rubs, friction = assembly.friction_of[normals] >= 0, assembly.rubbing[normals]
    share = np.where(rubs, (sigma * assembly.mu)[friction], 0.0)
    columns = assembly.scaled(normals[:0], friction, D)
    return columns @ sp.diags_array(share) if sp.issparse(columns) else columns * share


def _normal_matrix(S: Matrix) -> Matrix:
    """SᵀS with the ridge."""
    K = S.T @ S
    ridge = RIDGE * K.diagonal().max()
    if sp.issparse(K):
        return sp.csc_matrix(K + ridge * sp.eye_array(K.shape[0]))
    K.flat[:: K.shape[0] + 1] += ridge
    return K
