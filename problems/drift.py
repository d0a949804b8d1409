"""What is done about drift: contacts that bear a load, and whose φ is no longer 0.

The constraints of (3.1c) act on velocities, so that φ of a contact that is kept drifts by the local
errors of q, in proportion to ε.  Two remedies, both by the correction u of least ‖u‖_M with

    g_Nᵀ u = −φ  on the active normals,      g_Fᵀ u = 0  on the sticking frictions:

    baumgarte   the paper's proposal (§3.1), after Baumgarte 1972: the constraint becomes
                g_Nᵀ q̇_n ≥ −φ(q_n)/τ, so that φ decays as exp(−t/τ).  The QP is posed for q̇_n − u/τ
    projection  q_n := q_n + u at the end of a step, for the contacts with λ_N > 0, where u is one
                Newton step; velocities, and what the multistep methods remember, stay as they are

Where contacts are redundant their φ may contradict each other, and u meets them in least squares.
Where they almost are, rounding in φ may ask for a u of any length, along which contacts do not stay
straight: directions of small singular values are left out, more and more, until the gaps that u
leaves behind are no larger than those that it was to close.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from problems.assembly import Assembly
from problems.qp import Indices, Matrix, Vector

DriftRule = Literal["none", "baumgarte", "projection"]
DRIFT_RULES: tuple[DriftRule, ...] = ("none", "baumgarte", "projection")
DRIFT_TIME = 0.1
"""τ of Baumgarte's stabilization [s]."""
NO_GAP = 1e-14
"""Gaps up to this are 0 [m]."""


CUTOFFS = (1e-10, 1e-6, 1e-3)
"""Singular values below this fraction of the largest are left out; one after the other is tried."""


def closing_motion(
    assembly: Assembly, A: Matrix, D: Vector, columns: Indices, normals: Indices
) -> Vector:
    """u (3n,) that closes the gaps of these normals of the assembly; 0 where every u widens them.

    A : (3n, k) D⁻ᵀ[G_N, G_F];  columns : of these normals in A;  normals : their numbers
    """
    gaps, wanted = assembly.columns.phi[normals], np.zeros(A.shape[1])
    wanted[columns] = -gaps
    for cutoff in CUTOFFS:
        u = correction(A, D, wanted, cutoff)
        left = assembly.columns_at(assembly.q + u).phi[normals]
        if np.linalg.norm(left) <= np.linalg.norm(gaps):
            return u
    return np.zeros_like(D)


def correction(A: Matrix, D: Vector, wanted: Vector, cutoff: float = CUTOFFS[0]) -> Vector:
    """u (3n,) of least ‖u‖_M with (D A)ᵀ u = wanted, in least squares if need be.

    A : (3n, k) D⁻ᵀ[G_N, G_F];  D : (3n,);  wanted : (k,);  cutoff : see `CUTOFFS`
    """
    if not np.abs(wanted).max(initial=0.0) > NO_GAP:
        return np.zeros_like(D)
    if sp.issparse(A):
        damp = 0.0 if cutoff == CUTOFFS[0] else cutoff * sp.linalg.norm(A)
        w = lsmr(A.T, wanted, damp=damp, atol=1e-13, btol=1e-13, maxiter=10 * A.shape[1])[0]
    else:
        w = sla.lstsq(A.T, wanted, cond=cutoff)[0]
    return np.asarray(w) / D
