"""Minimum-norm multipliers (4.8) of thousands of contacts: the same λ from sparse QPs.

The QR decomposition of `problems.minimum_norm` is dense.  Here (4.8) is posed as a ridge,

    minimise ½‖A λ − f_j‖² + ½ δ² ‖λ‖²   within the bounds of λ,      f₀ = A x,

a `ContactQP` with the matrix [A; δ I], whose columns touch two bodies and themselves.  Its λ is the
least-norm λ of the force A λ, which is off by O(δ²); the error is added to the force asked for,
f_{j+1} = f_j + (A x − A λ_j), until A λ = A x: the method of multipliers (Hestenes 1969), whose
error falls by δ²/(σ² + δ²) each time, σ the least singular value of A that is not 0.  As a rule the
second λ is it.

Where this λ breaks Coulomb's law, it is replaced by one from the cone |λ_F| ≤ μ Σ λ_N, by the
generators V of the cone: λ = V c, c ≥ 0, with the matrix [A V; δ V], as impulses are posed.  Where
the cone holds no λ of the same force, Coulomb's law is left out, and where A λ = A x is not met, x
is kept.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from problems.qp import ContactQP, Indices, Matrix, Vector
from problems.sequence import QPSequence

SAME_FORCE = 1e-9
"""Change of A λ, relative, beyond which a minimum-norm λ is not taken."""
RIDGE = 1e-5
"""δ as a fraction of the longest column of A."""
ACCURACY = 1e-13
"""Accuracy asked of each QP, relative to its force."""
MAX_SOLVES = 4
"""QPs of one minimum-norm λ."""
CONE_TOL = 1e-9
"""How far, relative to ‖λ‖, λ may be outside the cone of friction."""


def ridge_minimum_norm(
    qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None
) -> Vector:
    """Least-norm multipliers with the same A x as `x` within the bounds of `qp`.  (k,)

    coulomb : rows C with C λ ≥ 0 to be kept as well, of `problems.friction.coulomb_rows`, or None
    """
    x = np.clip(x, qp.lower, qp.upper)
    movable = np.flatnonzero(qp.lower < qp.upper)  # a fixed row has nothing to choose
    size = float(np.linalg.norm(x[movable]))
    if size == 0.0:
        return x
    identity = sp.eye_array(qp.k, format="csc")[:, movable]
    bounded = _least(qps, qp, x, size, identity, qp.lower[movable], qp.upper[movable])
    if coulomb is None or (bounded is not None and _in_cone(coulomb, bounded)):
        return x if bounded is None else bounded
    V = friction_cone(coulomb, movable)
    lower, upper = np.zeros(V.shape[1]), np.full(V.shape[1], np.inf)
    coned = _least(qps, qp, x, size, V, lower, upper)
    return next((lam for lam in (coned, bounded) if lam is not None), x)


def friction_cone(coulomb: sp.csr_array, movable: Indices) -> sp.csc_array:
    """Generators V (k, p) of the cone of `coulomb`, and of λ_N ≥ 0 where no friction is movable.

    movable : the columns of the QP that may be chosen
    """
    rows = coulomb[: coulomb.shape[0] // 2].tocoo()  # μ Σ λ_N − λ_F ≥ 0
    k = coulomb.shape[1]
    may_move = np.isin(np.arange(k), movable)
    of_row = np.empty(rows.shape[0], dtype=np.int64)
    of_row[rows.row[rows.data < 0]] = rows.col[rows.data < 0]
    normal, mu = rows.col[rows.data > 0], rows.data[rows.data > 0]
    friction = of_row[rows.row[rows.data > 0]]
    rubs = may_move[friction] & may_move[normal]
    normal, friction, mu = normal[rubs], friction[rubs], mu[rubs]
    plain = np.setdiff1d(movable, np.concatenate([normal, of_row]))
    count = normal.size
    columns = np.concatenate([np.arange(2 * count), np.arange(2 * count)])
    values = np.concatenate([np.ones(2 * count), mu, -mu])
    V = sp.csc_array(
        (values, (np.concatenate([normal, normal, friction, friction]), columns)),
        shape=(k, 2 * count),
    )
    return sp.hstack([V, sp.eye_array(k, format="csc")[:, plain]], format="csc")


def _in_cone(coulomb: sp.csr_array, lam: Vector) -> bool:
    return bool((coulomb @ lam >= -CONE_TOL * np.linalg.norm(lam)).all())


def _least(
    qps: QPSequence,
    qp: ContactQP,
    x: Vector,
    size: float,
    V: sp.csc_array,
    lower: Vector,
    upper: Vector,
) -> Vector | None:
    """λ = V c of least norm, beside the fixed rows, with A λ = A x; None where there is none."""
    chosen = np.zeros(qp.k, dtype=bool)
    chosen[V.indices] = True
    fixed = np.where(chosen, 0.0, x)
    AV: Matrix = sp.csc_array(qp.A @ V)
    delta = RIDGE * float(np.sqrt((AV * AV).sum(axis=0).max()))
    force = qp.A @ (x - fixed) / size
    tolerance = SAME_FORCE * float(np.linalg.norm(qp.A @ x)) / size
    asked = force
    for _ in range(MAX_SOLVES):
        _, solution = qps.solve(
            A=sp.vstack([AV, delta * V], format="csc"),
            d=np.concatenate([-asked, np.zeros(qp.k)]),
            lower=lower / size,
            upper=upper / size,
            kind="minimum_norm",
            t=qp.t,
            h=qp.h,
            alpha0=qp.alpha0,
            eps0=ACCURACY * max(1.0, float(np.linalg.norm(force))),
        )
        c = np.clip(np.asarray(solution.x), lower / size, upper / size)
        missing = force - AV @ c
        if np.linalg.norm(missing) <= tolerance:
            return fixed + size * (V @ c)
        asked = asked + missing
    return None
