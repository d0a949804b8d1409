"""What is done about drift: contacts that bear a load, and whose φ is no longer 0.

The constraints of (3.1c) act on velocities, so that φ of a contact that is kept drifts by the local
errors of q, in proportion to ε.  Two remedies, both by the correction u of least ‖u‖_M with

    g_Nᵀ u = −φ  on the active normals,      g_Fᵀ u = 0  on the sticking frictions:

    baumgarte   the paper's proposal (§3.1), after Baumgarte 1972: the constraint becomes
                g_Nᵀ q̇_n ≥ −φ(q_n)/τ, so that φ decays as exp(−t/τ).  The QP is posed for q̇_n − u/τ
    projection  q_n := q_n + u at the end of a step, for the contacts with λ_N > 0, where u is one
                Newton step; velocities, and what the multistep methods remember, stay as they are

Where contacts are redundant their φ may contradict each other, and u meets them in least squares.
Where they almost are, a rounding error in φ may ask for a u of any length: such directions are left
out, and a u that widens gaps, since columns turn on the way, is not taken.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from problems.contacts.assembly import Assembly
from problems.qp import Indices, Matrix, Vector

DriftRule = Literal["none", "baumgarte", "projection"]
DRIFT_RULES: tuple[DriftRule, ...] = ("none", "baumgarte", "projection")
DRIFT_TIME = 0.1
"""τ of Baumgarte's stabilization [s]."""
NO_GAP = 1e-14
"""Gaps up to this are 0 [m]."""


CUTOFF = 1e-4
"""Singular values below this fraction of the largest are left out.  Those of sound contacts were
above 2e-3 (a tower of 20), those that tore bodies apart below 1e-6."""
DAMPINGS = 2
"""Damped solves of a sparse A, each for what the last has left."""


def closing_motion(
    assembly: Assembly, A: Matrix, D: Vector, columns: Indices, normals: Indices
) -> Vector:
    """u (3n,) that closes the gaps of these normals of the assembly; 0 where it would widen them.

    A : (3n, k) D⁻ᵀ[G_N, G_F];  columns : of these normals in A;  normals : their numbers
    """
    gaps, wanted = assembly.columns.phi[normals], np.zeros(A.shape[1])
    wanted[columns] = -gaps
    u = correction(A, D, wanted)
    left = assembly.columns_at(assembly.q + u).phi[normals]
    return u if np.linalg.norm(left) <= np.linalg.norm(gaps) else np.zeros_like(D)


def correction(A: Matrix, D: Vector, wanted: Vector) -> Vector:
    """u (3n,) of least ‖u‖_M with (D A)ᵀ u = wanted, in least squares if need be.

    A : (3n, k) D⁻ᵀ[G_N, G_F];  D : (3n,);  wanted : (k,)
    """
    if not np.abs(wanted).max(initial=0.0) > NO_GAP:
        return np.zeros_like(D)
    if not sp.issparse(A):
        return np.asarray(sla.lstsq(A.T, wanted, cond=CUTOFF)[0]) / D
    w, damp = np.zeros_like(D), CUTOFF * sp.linalg.norm(A, axis=0).max()
    for _ in range(DAMPINGS):
        left, most = wanted - A.T @ w, 10 * A.shape[1]
        w += lsmr(A.T, left, damp=damp, atol=1e-13, btol=1e-13, maxiter=most)[0]
    return w / D
