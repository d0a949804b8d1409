"""Minimum-norm multipliers (4.8) of thousands of contacts: the same λ from sparse QPs.

The QR decomposition of `problems.least_norm.minimum_norm` is dense.  Here (4.8) is posed as a
ridge,

    minimise ½‖A λ − f_j‖² + ½ δ² ‖λ‖²   within the bounds of λ,      f₀ = A x,

a `ContactQP` with the matrix [A; δ I], whose columns touch two bodies and themselves.  Its λ is the
least-norm λ of the force A λ, which is off by O(δ²); the error is added to the force asked for,
f_{j+1} = f_j + (A x − A λ_j), until A λ = A x: the method of multipliers (Hestenes 1969), whose
error falls by δ²/(σ² + δ²) each time, σ the least singular value of A that is not 0.  As a rule the
second λ is it.  Each QP starts from the last one of the same kind, be it of another step.

Where the first λ breaks Coulomb's law, the others are from the cones |λ_F| ≤ μ Σ λ_N, by their
generators: λ = V c, c ≥ 0, with the matrix [A V; δ V], as impulses are posed.  Where the cones hold
no λ of the same force, Coulomb's law is left out, and where A λ = A x is not met, x is kept.
"""

from __future__ import annotations

import operator

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.qp import ContactQP, Indices, Vector
from problems.sequence import QPSequence

SAME_FORCE = 1e-9
"""Change of A λ, relative, beyond which a minimum-norm λ is not taken."""
RIDGE = 1e-5
"""δ as a fraction of the longest column of A."""
ACCURACY = 1e-13
"""Accuracy asked of each QP, relative to its force."""
MAX_SOLVES = 6
"""QPs of one minimum-norm λ."""
CONE_TOL = 1e-9
"""How far, relative to ‖λ‖, λ may be outside the cone of friction."""


def ridge_minimum_norm(
    qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array | None
) -> Vector:
    """Least-norm multipliers with the same A x as `x` within the bounds of `qp`.  (k,)

    coulomb : rows C with C λ ≥ 0 to be kept as well, of `problems.friction.rules.coulomb_rows`, or
        None
    """
    x = np.clip(x, qp.lower, qp.upper)
    if not np.any(x[qp.lower < qp.upper]):  # fixed rows have nothing to choose
        return x
    found = None if coulomb is None else _least(qps, qp, x, coulomb)
    if found is None:
        found = _least(qps, qp, x, sp.csr_array((0, qp.k)))
    return x if found is None else found


def _least(qps: QPSequence, qp: ContactQP, x: Vector, coulomb: sp.csr_array) -> Vector | None:
    """λ of least norm with A λ = A x, or None where that was not met."""
    movable = qp.lower < qp.upper
    fixed = np.where(movable, 0.0, x)
    size = float(np.linalg.norm(x[movable]))
    delta = RIDGE * float(np.sqrt((qp.A * qp.A).sum(axis=0).max()))
    force = qp.A @ (x - fixed) / size
    tolerance = SAME_FORCE * float(np.linalg.norm(qp.A @ x)) / size
    rows = coulomb[:0]
    asked, posed, before = force, None, np.inf
    for left in reversed(range(MAX_SOLVES)):
        if posed is None:
            V, lower, upper, row_id = generators(
                rows, movable, qp.lower / size, qp.upper / size, qp.row_id
            )
            posed = ridge(qp.A, V, delta)
        _, solution = qps.solve(
            A=posed,
            d=np.concatenate([-asked, np.zeros(qp.k)]),
            lower=lower,
            upper=upper,
            row_id=row_id,
            kind="minimum_norm",
            chain="cones" if rows.shape[0] else "bounds",
            t=qp.t,
            h=qp.h,
            alpha0=qp.alpha0,
            eps0=ACCURACY * max(1.0, float(np.linalg.norm(force))),
        )
        lam = V @ np.clip(np.asarray(solution.x), lower, upper)
        missing = force - qp.A @ lam
        if rows.shape[0] == 0 and (coulomb @ (lam + fixed / size) < -CONE_TOL).any():
            rows, posed = coulomb[: coulomb.shape[0] // 2], None
            continue
        error = float(np.linalg.norm(missing))
        if error <= tolerance:
            return fixed + size * lam
        if error * (error / before) ** left > tolerance:  # at this rate it will not be met
            return None
        asked, before = asked + missing, error
    return None


def ridge(A: sp.csc_array, V: sp.csc_array, delta: float) -> sp.csc_array:
    """[A V; δ V], whose pattern is that of A and V, also where entries of A V happen to be 0."""
    product, low = (A @ V).tocoo(), V.tocoo()
    ones = (sp.csc_array((np.ones(M.nnz), M.indices, M.indptr), shape=M.shape) for M in (A, V))
    every = operator.matmul(*ones).tocoo()
    entries = np.concatenate([product.data, np.zeros(every.nnz), delta * low.data])
    row = np.concatenate([product.row, every.row, A.shape[0] + low.row])
    column = np.concatenate([product.col, every.col, low.col])
    shape = (A.shape[0] + V.shape[0], V.shape[1])
    return sp.csc_array((entries, (row, column)), shape=shape)


def generators(
    rows: sp.csr_array,
    movable: NDArray[np.bool_],
    lower: Vector,
    upper: Vector,
    row_id: Indices,
) -> tuple[sp.csc_array, Vector, Vector, Indices]:
    """V (k, p) and bounds of c, λ = V c: the cones of `rows`, else the multipliers themselves.

    rows : (r, k) of μ Σ λ_N − λ_F;  movable : (k,) which multipliers may be chosen;  row_id : (k,)

    Returns V, lower, upper and a row_id for each c.
    """
    k = movable.size
    entries = rows.tocoo()
    of_row = np.empty(rows.shape[0], dtype=np.int64)
    of_row[entries.row[entries.data < 0]] = entries.col[entries.data < 0]
    loaded = entries.data > 0
    normal, mu = entries.col[loaded], entries.data[loaded]
    friction = of_row[entries.row[loaded]]
    pairs = movable[normal] & movable[friction]
    normal, friction, mu = normal[pairs], friction[pairs], mu[pairs]
    alone = movable.copy()
    alone[normal] = alone[of_row] = False
    plain = np.flatnonzero(alone)
    count = normal.size
    columns = np.arange(2 * count)
    where = np.concatenate([normal, normal, friction, friction, plain])
    V = sp.csc_array(
        (
            np.concatenate([np.ones(2 * count), mu, -mu, np.ones(plain.size)]),
            (where, np.concatenate([columns, columns, 2 * count + np.arange(plain.size)])),
        ),
        shape=(k, 2 * count + plain.size),
    )
    free = np.full(2 * count, np.inf)
    one_each = np.unique(normal).size == count  # in space a normal bears two frictions
    cone = row_id[normal if one_each else friction]
    names = np.concatenate([4 * cone + 1, 4 * cone + 2, 4 * row_id[plain]])
    bounds = np.append(np.zeros(2 * count), lower[plain]), np.append(free, upper[plain])
    return V, *bounds, names
