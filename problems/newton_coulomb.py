"""Newton–Coulomb impulses: another law than the paper's for what friction does in a collision.

Every contact of the collision obeys, after it,

    0 ≤ Λ_N ⊥ g_Nᵀq̇₊ ≥ 0                                  (Newton's law, without restitution)
    |Λ_F| ≤ μ_I Σ Λ_N,  = −sign(g_Fᵀq̇₊) μ_I Σ Λ_N where g_Fᵀq̇₊ ≠ 0      (Coulomb's, for impulses)

so a contact that goes on sliding stays a contact, while in the paper's model (§4.3) it bounces with
g_Nᵀq̇₊ = μ_I |g_Fᵀq̇₊|.  The paper says that models differ by O(1) and that its own was chosen for
its simplicity.  Where contacts stick, and without friction, both are the same.

It is the fixed point of `problems.friction_passes` with h = α₀ = 1, all contacts bounded by
± μ_I Σ Λ_*, from Λ_* = ∞.  Energy may grow at a contact that reverses its slip (4.12).
"""

from __future__ import annotations

import copy

import numpy as np
import scipy.sparse as sp

from problems.assembly import Assembly, scaled_columns
from problems.friction import coulomb_rows, force_change
from problems.friction_passes import newton_multipliers
from problems.minimum_norm import minimum_norm
from problems.qp import Vector
from problems.sequence import QPSequence, SimulationError

MAX_PASSES = 50
SETTLED = 1e-9
"""Change of q̇₊ by another pass, relative to ‖q̇₋‖_M, at which the passes end."""


def newton_coulomb_impulse(
    qps: QPSequence,
    assembly: Assembly,
    D: Vector,
    mu_I: float,
    v: Vector,
    F: Vector,
    t: float,
    accuracy: float,
) -> tuple[Vector, Vector]:
    """q̇₊ (3n,) and Λ over [normals, frictions] (N + F,) for q̇₋ = v and external impulse F.

    accuracy : of each QP in ‖A δx‖

    Raises SimulationError where the passes do not settle.
    """
    hit = copy.copy(assembly)
    hit.mu = np.full(len(assembly.frictions), mu_I)
    n, f = len(hit.normals), len(hit.frictions)
    every, signs = np.arange(f), np.zeros(f)
    A = scaled_columns(sp.csc_array(sp.hstack([hit.G_N, hit.G_F], format="csc")), D)
    row_id = np.concatenate([hit.normal_ids, hit.friction_ids])
    order = np.arange(n + f)
    size = max(1.0, float(np.linalg.norm(D * v)))
    lam_star = np.full(n, np.inf)
    for _ in range(MAX_PASSES):
        bound = hit.mu * (hit.members @ lam_star)
        qp, solution = qps.solve(
            A=A,
            d=D * v + F / D,
            lower=np.concatenate([np.zeros(n), -bound]),
            upper=np.concatenate([np.full(n, np.inf), bound]),
            row_id=row_id,
            feature=hit.features(every, order),
            D=D,
            kind="impulse",
            t=t,
            eps0=accuracy,
        )
        x = minimum_norm(qps, qp, np.asarray(solution.x), coulomb_rows(hit, every, order))
        after = qp.residual(x) / D
        lam_N, lam_F = x[:n], x[n:]
        change = force_change(hit, signs, lam_F, bound, hit.mu * (hit.members @ lam_N))
        if np.linalg.norm((hit.G_F @ change) / D) <= SETTLED * size:
            return after, x
        lam_star = newton_multipliers(hit, D, signs, lam_star, lam_N, lam_F, after)
    raise SimulationError(
        f"t = {t:.6g}: Newton–Coulomb impulses of {n} contacts did not settle in {MAX_PASSES} "
        'passes; use the paper\'s model, impulses="paper"'
    )
