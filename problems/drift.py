"""What is done about drift: contacts that bear a load, and whose φ is no longer 0.

The constraints of (3.1c) act on velocities, so that φ of a contact that is kept drifts by the local
errors of q, in proportion to ε.  Two remedies, both by the correction u of least ‖u‖_M with

    g_Nᵀ u = −φ  on the active normals,      g_Fᵀ u = 0  on the sticking frictions:

    baumgarte   the paper's proposal (§3.1), after Baumgarte 1972: the constraint becomes
                g_Nᵀ q̇_n ≥ −φ(q_n)/τ, so that φ decays as exp(−t/τ).  The QP is posed for q̇_n − u/τ
    projection  q_n := q_n + u at the end of a step, for the contacts with λ_N > 0, where u is one
                Newton step; velocities, and what the multistep methods remember, stay as they are

Where contacts are redundant their φ may contradict each other, and u meets them in least squares.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from scipy.sparse.linalg import lsmr

from problems.qp import Matrix, Vector

DriftRule = Literal["none", "baumgarte", "projection"]
DRIFT_RULES: tuple[DriftRule, ...] = ("none", "baumgarte", "projection")
DRIFT_TIME = 0.1
"""τ of Baumgarte's stabilization [s]."""
NO_GAP = 1e-14
"""Gaps up to this are 0 [m]."""


def correction(A: Matrix, D: Vector, wanted: Vector) -> Vector:
    """u (3n,) of least ‖u‖_M with (D A)ᵀ u = wanted, in least squares if need be.

    A : (3n, k) D⁻ᵀ[G_N, G_F];  D : (3n,);  wanted : (k,)
    """
    if not np.abs(wanted).max(initial=0.0) > NO_GAP:
        return np.zeros_like(D)
    if sp.issparse(A):
        w = lsmr(A.T, wanted, atol=1e-13, btol=1e-13, maxiter=10 * A.shape[1])[0]
    else:
        w = sla.lstsq(A.T, wanted, cond=1e-10)[0]
    return np.asarray(w) / D
