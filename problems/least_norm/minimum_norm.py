"""Minimum-norm multipliers (4.8): of all λ with the same Gλ, the one with the least λᵀλ.

Where G lacks full column rank the multipliers of (4.6) are not unique, and with them neither are
the friction bounds and sliding forces of the next step.  With the QR decomposition of Aᵀ and Q₂
spanning N(A) = N(G), λ = λ_R + Q₂ z, the problem is the least-distance problem

    minimise ½ zᵀz   subject to   E z ≥ e                                                  (4.8)

over the rows of (4.6) and, as a remedy, Coulomb's |λ_F| ≤ μ Σ λ_N.  Lawson and Hanson ([25,
p. 159]) turn it into a non-negative least-squares problem, a `ContactQP` like every other:

    minimise ½‖B u − e_last‖², u ≥ 0,   B = [Eᵀ; eᵀ];   z = −r_head / r_last,  r = B u − e_last

Large sparse QPs go another way to the same λ, `problems.least_norm.sparse_minimum_norm`.

This differs from the paper: 1. the Coulomb rows; against lagged bounds alone, (4.8) shrinks λ_N
while |λ_F| stays below an old bound, so the next bound is too small and a resting contact slips, is
caught and slips again for ever.  They are left out where they are not feasible.  2. z is scaled by
‖λ‖, so that r_last ≥ ½ and no digits are lost.  3. The QR decomposition is not made where Cholesky
factors of AᵀA, which are cheaper and stay sparse, prove that A has full column rank.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgeqp3, dorgqr

from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.least_norm.compiled import least_norm as compiled_least_norm
from problems.least_norm.independence import (
    ACCURACY,
    RANK_TOL,
    surely_independent,
)
from problems.least_norm.sparse_minimum_norm import SAME_FORCE, ridge_minimum_norm
from problems.qp import FEATURE_FIELDS, LARGEST, ContactQP, Vector
from problems.sequence import QPSequence

run_least_norm = Direct(compiled_least_norm)
MANY_COLUMNS = 400
"""From this many columns on the sparse way is the faster one."""


def null_space(A: ArrayLike) -> Vector:
    """Orthonormal basis Q₂ (k, k − rank) of N(A), from the pivoted QR decomposition of Aᵀ."""
    columns = np.array(np.asarray(A).T, order="F")
    k, count = columns.shape[0], min(columns.shape)
    if count == 0:
        return np.eye(k)
    factors, _, tau, _, _ = dgeqp3(columns, overwrite_a=True)
    diagonal = np.abs(np.diagonal(factors))
    rank = int((diagonal > RANK_TOL * diagonal[0]).sum())
    reflections = np.zeros((k, k), order="F")
    reflections[:, :count] = factors[:, :count]
    return dorgqr(reflections, tau, overwrite_a=True)[0][:, rank:]


def least_distance_qp(E: Vector, e: Vector) -> tuple[Vector, Vector]:
    """A and d of the non-negative least-squares form of: minimise ‖z‖ subject to E z ≥ e.

    E : (p, l), e : (p,)  →  A : (l + 1, p), d : (l + 1,)
    """
    d = np.zeros(E.shape[1] + 1)
    d[-1] = -1.0
    return np.ascontiguousarray(np.vstack([E.T, e])), d


def least_distance_point(residual: Vector) -> Vector | None:
    """z (l,) from the residual r of the form above; None where E z ≥ e has no solution."""
    if residual[-1] >= -RANK_TOL:
        return None
    return -residual[:-1] / residual[-1]


def minimum_norm(qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None) -> Vector:
    """Least-norm multipliers with the same A x as `x` within the bounds of `qp`.  (k,)

    coulomb : (p, k) sparse rows C with C λ ≥ 0 to be kept as well, or None.
    """
    return x if surely_independent(qp.A) else least_norm(qps, qp, x, coulomb)


def least_norm(qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None) -> Vector:
    """`minimum_norm` of an A that is not `surely_independent`.

    Where QPs are not kept, compiled with the method of the solver, if it has one.
    """
    method = qps.compiled(qp.k)
    if method is not None:
        C = np.zeros((0, qp.k)) if coulomb is None else coulomb.toarray()
        own = qp.dense_A.copy(), qp.lower.copy(), qp.upper.copy(), x.copy()
        arena = Arena.of(qp.k + C.shape[0])
        least, solves = run_least_norm(*own, C, arena, *method)
        qps.count += solves
        return least
    if sp.issparse(qp.A) and qp.k >= MANY_COLUMNS:
        return ridge_minimum_norm(qps, qp, x, coulomb)
    movable = qp.lower < qp.upper  # fixed rows would be two opposite inequalities
    x = np.clip(x, qp.lower, qp.upper)
    Q2 = null_space(qp.dense_A[:, movable])
    size = float(np.linalg.norm(x[movable]))
    if Q2.shape[1] == 0 or size == 0.0:
        return x
    lower, upper = qp.lower[movable], qp.upper[movable]
    particular = x[movable] - Q2 @ (Q2.T @ x[movable])
    below, above = np.isfinite(lower), np.isfinite(upper)
    E = np.concatenate([Q2[below], -Q2[above]])
    e = np.concatenate([lower[below] - particular[below], particular[above] - upper[above]])
    z = None
    if coulomb is not None and coulomb.shape[0]:
        C = coulomb.toarray() if sp.issparse(coulomb) else coulomb
        fixed = C[:, ~movable] @ x[~movable] if not movable.all() else 0.0
        C = C[:, movable]
        both, values = np.concatenate([E, C @ Q2]), np.append(e, -fixed - C @ particular)
        z = _least_distance(qps, qp, both, values / size)
    if z is None:
        z = _least_distance(qps, qp, E, e / size)
    if z is None:
        return x
    least = x.copy()
    least[movable] = np.clip(particular + Q2 @ (size * z), lower, upper)
    # where the inequalities have almost no room, z is a quotient of small numbers
    moved = float(np.linalg.norm(qp.A @ (least - x)))
    return least if moved <= SAME_FORCE * float(np.linalg.norm(qp.A @ x)) else x


def _least_distance(qps: QPSequence, qp: ContactQP, E: Vector, e: Vector) -> Vector | None:
    """z (l,) of least norm with E z ≥ e, or None."""
    acts = np.abs(E).max(axis=1) > RANK_TOL
    if (e[acts] <= 0).all():
        return np.zeros(E.shape[1])
    A, d = least_distance_qp(E[acts], e[acts])
    row_id = np.flatnonzero(acts)
    posed, solution = qps.solve(
        own=bool(np.abs(A).max() <= LARGEST),
        A=A,
        d=d,
        lower=np.zeros(row_id.size),
        upper=np.full(row_id.size, np.inf),
        row_id=row_id,
        feature=np.full((row_id.size, len(FEATURE_FIELDS)), -1),
        D=np.ones(d.size),
        kind="minimum_norm",
        t=qp.t,
        h=qp.h,
        alpha0=qp.alpha0,
        eps0=ACCURACY,
    )
    return least_distance_point(posed.residual(np.asarray(solution.x)))
