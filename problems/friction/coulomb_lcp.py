"""Coulomb's law for all contacts at once, without guessing: a linear complementarity problem.

In the plane, contacts that obey the laws of contact and of Coulomb after a step or an impulse are
the solutions of an LCP (Stewart and Trinkle 1996) in z = (λ_N, λ_F⁺, λ_F⁻, β) ≥ 0, where λ_F is
λ_F⁺ − λ_F⁻:

    0 ≤ λ_N  ⊥  g_Nᵀq̇ ≥ 0
    0 ≤ λ_F± ⊥  β ± g_Fᵀq̇ ≥ 0                β = |g_Fᵀq̇| where a contact slides
    0 ≤ β    ⊥  μ Σ λ_N − λ_F⁺ − λ_F⁻ ≥ 0

Its matrix M is copositive, and qᵀz ≥ 0 for all z ≥ 0 with M z ≥ 0 and zᵀM z = 0, because A λ = 0
for those: so Lemke's method (1965) cannot end on a ray (Cottle, Pang and Stone 1992, §4.4), and
where no two ratios tie it visits no basis twice: it ends with a solution, also with gains ≥ 1,
where fixed-point passes may wander between working sets for ever.

Redundant contacts tie, and a tie that rounding decides is decided anew at every pivot.  So

1.  q is raised by δ > 0, numbers `RAISED` times as large as q, no two alike.  The condition on q
    stays true; ties are decided by δ, which is 10⁶ times rounding;
2.  the basis at the end is solved with q itself, and what comes of it is held to the LCP.  Where it
    fails, other δ are tried.

It works on a dense tableau, for each group of bodies in touch by itself: the last resort for a few
hundred contacts, not the way to step.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import orth
from scipy.sparse.csgraph import connected_components

from problems.contacts.assembly import Assembly
from problems.qp import Indices, Vector

MOST_VARIABLES = 1000
"""Variables of the largest LCP that is tried: seconds."""
PIVOTS = 50
"""Pivots that are made at most, per variable."""
PIVOT_TOL = 1e-9
"""Entries of the tableau that are taken for 0."""
RAISED = 1e-8
"""δ, relative to q."""
TRIALS = 8
"""Choices of δ that are tried."""
SOLVED = 1e-10
"""Largest |min(z_i, w_i)| of an answer, relative to q: columns have length 1, so both are in its
units, whatever the masses; and …"""
ROUNDED = 1e-12
"""… relative to the largest z: where contacts jam, λ is 10⁴ times q, and w = M z + q is rounded in
its units, as is what should be 0 of z."""
GOLDEN = (5**0.5 - 1) / 2
"""Its multiples, modulo 1, are spread evenly and no two of them alike."""


def coulomb_multipliers(assembly: Assembly, D: Vector, d: Vector) -> tuple[Vector, Vector] | None:
    """λ_N (N,) and λ_F (F,) with which all contacts meet both laws, D q̇ = A λ + d up to a factor.

    d : (3n,) of the QP with no friction force in it

    None where there are too many contacts, or rounding has led astray.
    """
    N, F = len(assembly.normals), assembly.mu.size
    columns = sp.csc_array(assembly.scaled(np.arange(N), np.arange(F), D))
    if assembly.bilateral.size:
        columns, d = _without_joints(assembly, columns, D, d)
    lam_N, lam_F = np.zeros(assembly.count), np.zeros(F)
    for normals, frictions in _groups(columns, assembly.friction_of[:N], N):
        found = _group_multipliers(assembly, columns, d, normals, frictions)
        if found is None:
            return None
        lam_N[normals], lam_F[frictions] = found
    return lam_N, lam_F


def _without_joints(
    assembly: Assembly, columns: sp.csc_array, D: Vector, d: Vector
) -> tuple[sp.csc_array, Vector]:
    """A and d where the motion is left that joints allow: both projected, M-orthogonally."""
    joined = assembly.scaled(assembly.bilateral, np.arange(0), D)
    held = orth(sp.csc_array(joined).toarray())
    left = columns.toarray()
    return sp.csc_array(left - held @ (held.T @ left)), d - held @ (held.T @ d)


def _groups(columns: sp.csc_array, friction_of: Indices, N: int) -> list[tuple[Indices, Indices]]:
    """(normals, frictions) of the contacts that push each other, directly or by way of others."""
    touched = (columns != 0).astype(np.int64)
    loads = np.flatnonzero(friction_of >= 0)
    ones, shape = np.ones(loads.size, dtype=np.int64), (columns.shape[1], columns.shape[1])
    bound = sp.csr_array((ones, (loads, N + friction_of[loads])), shape=shape)
    count, label = connected_components(touched.T @ touched + bound, directed=False)
    members = [np.flatnonzero(label == group) for group in range(count)]
    return [(rows[rows < N], rows[rows >= N] - N) for rows in members]


def _group_multipliers(
    assembly: Assembly, columns: sp.csc_array, d: Vector, normals: Indices, frictions: Indices
) -> tuple[Vector, Vector] | None:
    """λ_N and λ_F of these contacts."""
    N, F = normals.size, frictions.size
    if N + 3 * F > MOST_VARIABLES:
        return None
    n_normals = len(assembly.normals)
    normal = columns[:, normals].toarray()
    tangent = columns[:, n_normals + frictions].toarray()
    size, wide = np.linalg.norm(normal, axis=0), np.linalg.norm(tangent, axis=0)
    A = np.hstack([normal / size, tangent / wide, -tangent / wide])
    M = np.zeros((N + 3 * F, N + 3 * F))
    M[: N + 2 * F, : N + 2 * F] = A.T @ A
    each = np.arange(F)
    slip, cone = N + each, N + 2 * F + each
    for side in (slip, slip + F):
        M[side, cone], M[cone, side] = 1.0, -1.0
    place = np.full(assembly.mu.size, -1)
    place[frictions] = each
    loaded = np.flatnonzero(assembly.friction_of[normals] >= 0)
    rubs = assembly.friction_of[normals[loaded]]
    M[cone[place[rubs]], loaded] = assembly.mu[rubs] * wide[place[rubs]] / size[loaded]
    z = lemke(M, np.concatenate([A.T @ d, np.zeros(F)]))
    return None if z is None else (z[:N] / size, (z[N + each] - z[N + F + each]) / wide)


def lemke(M: NDArray[np.float64], q: Vector) -> Vector | None:
    """z ≥ 0 with w = M z + q ≥ 0 and zᵀw = 0, (n,); None where no choice of δ leads to one."""
    n, size = q.size, float(np.abs(q).max(initial=0.0))
    if q.min(initial=0.0) >= 0:
        return np.zeros(n)
    spread = (np.arange(1, n + 1) * GOLDEN) % 1.0
    for trial in range(TRIALS):
        delta = RAISED * size * (1.0 + (spread + trial / TRIALS) % 1.0)
        basis = final_basis(M, q + delta)
        z = None if basis is None else _solution(M, q, basis)
        if z is not None:
            return z
    return None


def final_basis(M: NDArray[np.float64], q: Vector) -> Indices | None:
    """The variables, w_i as i and z_i as n + i, (n,) of the basis that Lemke's method ends with.

    q : (n,), not ≥ 0, for which no two ratios tie

    None where it ends on a ray, or after too many pivots.
    """
    n = q.size
    # w = M z + 1 z₀ + q: rows are basic variables, columns the others and the right-hand side
    T = np.hstack([-M, -np.ones((n, 1)), q[:, None]])
    basic, other = np.arange(n), np.arange(n, 2 * n + 1)
    row, column = int(np.argmin(q)), n
    for _ in range(PIVOTS * n):
        _exchange(T, row, column)
        basic[row], other[column] = other[column], basic[row]
        left = other[column]
        if left == 2 * n:
            return basic
        column = int(np.flatnonzero(other == (left + n) % (2 * n))[0])
        rows = np.flatnonzero(T[:, column] > PIVOT_TOL)
        if rows.size == 0:
            return None
        row = int(rows[np.argmin(T[rows, -1] / T[rows, column])])
    return None


def _exchange(T: NDArray[np.float64], row: int, column: int) -> None:
    """Make the variable of `column` basic instead of that of `row`."""
    pivot, factors = T[row, column], T[:, column].copy()
    factors[row] = 0.0
    T[:, column] = 0.0
    T[row, column] = 1.0
    T[row] /= pivot
    T -= np.outer(factors, T[row])


def _solution(M: NDArray[np.float64], q: Vector, basis: Indices) -> Vector | None:
    """z of the basis, cut off at 0, if it solves the LCP."""
    n, size = q.size, float(np.abs(q).max())
    columns = np.hstack([np.eye(n), -M])[:, basis]
    values = np.zeros(2 * n)
    values[basis] = np.linalg.lstsq(columns, q, rcond=None)[0]
    z = np.maximum(values[n:], 0.0)
    off = np.abs(np.minimum(z, M @ z + q)).max()
    return z if off <= SOLVED * size + ROUNDED * z.max() else None
