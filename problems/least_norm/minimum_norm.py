"""Minimum-norm multipliers (4.8): of all λ with the same Gλ, the one with the least λᵀλ.

Where G lacks full column rank the multipliers of (4.6) are not unique, and with them neither are
the friction bounds and sliding forces of the next step.  With the QR decomposition of Aᵀ and Q₂
spanning N(A) = N(G), λ = λ_R + Q₂ z, the problem is the least-distance problem

    minimise ½ zᵀz   subject to   E z ≥ e                                                  (4.8)

over the rows of (4.6) and, as a remedy, Coulomb's |λ_F| ≤ μ Σ λ_N.  Lawson and Hanson ([25,
p. 159]) turn it into a non-negative least-squares problem, a `ContactQP` like every other:

    minimise ½‖B u − e_last‖², u ≥ 0,   B = [Eᵀ; eᵀ];   z = −r_head / r_last,  r = B u − e_last

Its stages are compiled, `problems.least_norm.least_distance`.  Large sparse QPs go another way to
the same λ, `problems.least_norm.sparse_minimum_norm`.

This differs from the paper: 1. the Coulomb rows; against lagged bounds alone, (4.8) shrinks λ_N
while |λ_F| stays below an old bound, so the next bound is too small and a resting contact slips, is
caught and slips again for ever.  They are left out where they are not feasible.  2. z is scaled by
‖λ‖, so that r_last ≥ ½ and no digits are lost.  3. The QR decomposition is not made where Cholesky
factors of AᵀA, which are cheaper and stay sparse, prove that A has full column rank.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from problems.least_norm.independence import ACCURACY, surely_independent
from problems.least_norm.least_distance import (
    least_distance,
    least_distance_point,
    non_negative_form,
    of_least_norm,
)
from problems.least_norm.sparse_minimum_norm import ridge_minimum_norm
from problems.qp import FEATURE_FIELDS, LARGEST, ContactQP, Vector
from problems.sequence import QPSequence

MANY_COLUMNS = 400
"""From this many columns on the sparse way is the faster one."""


def minimum_norm(qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None) -> Vector:
    """Least-norm multipliers with the same A x as `x` within the bounds of `qp`.  (k,)

    coulomb : (p, k) sparse rows C with C λ ≥ 0 to be kept as well, or None.
    """
    return x if surely_independent(qp.A) else least_norm(qps, qp, x, coulomb)


def least_norm(qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None) -> Vector:
    """`minimum_norm` of an A that is not `surely_independent`."""
    if sp.issparse(qp.A) and qp.k >= MANY_COLUMNS:
        return ridge_minimum_norm(qps, qp, x, coulomb)
    C = np.zeros((0, qp.k)) if coulomb is None else coulomb.toarray()
    problem = least_distance(qp.dense_A, qp.lower, qp.upper, x, C)
    if problem.size == 0.0:
        return problem.x
    E, e, bounds = problem.E, problem.e, problem.bounds
    z = _least_distance(qps, qp, E, e)
    if z is None and e.size > bounds:
        z = _least_distance(qps, qp, E[:bounds], e[:bounds])
    return problem.x if z is None else of_least_norm(problem, qp.dense_A, qp.lower, qp.upper, z)


def _least_distance(qps: QPSequence, qp: ContactQP, E: Vector, e: Vector) -> Vector | None:
    """z (l,) of least norm with E z ≥ e, or None."""
    A, d, row_id = non_negative_form(E, e)
    if row_id.size == 0:
        return np.zeros(E.shape[1])
    _, solution = qps.solve(
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
    z, found = least_distance_point(A, np.asarray(solution.x))
    return z if found else None
