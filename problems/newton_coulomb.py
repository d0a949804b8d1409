"""Newton–Coulomb impulses: another law than the paper's for what friction does in a collision.

Every contact of the collision obeys, after it,

    0 ≤ Λ_N ⊥ g_Nᵀq̇₊ ≥ 0                                  (Newton's law, without restitution)
    |Λ_F| ≤ μ_I Σ Λ_N,  = −sign(g_Fᵀq̇₊) μ_I Σ Λ_N where g_Fᵀq̇₊ ≠ 0      (Coulomb's, for impulses)

so a contact that goes on sliding stays a contact, while in the paper's model (§4.3) it bounces with
g_Nᵀq̇₊ = μ_I |g_Fᵀq̇₊|.  The paper says that models differ by O(1) and that its own was chosen for
its simplicity.  Where contacts stick, and without friction, both are the same.

It is the fixed point of `problems.friction_passes` with h = α₀ = 1, all contacts bounded by
± μ_I Σ Λ_*, from Λ_* = ∞.  Where the passes cycle `problems.coulomb_lcp` is asked, and believed if
the QP with its bounds has the same q̇₊: with redundant contacts its Λ need not be that of least
norm, whose bounds are others.  Energy may grow at a contact that reverses its slip (4.12).
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from problems.active_kernels import Frictions
from problems.arena import Arena
from problems.assembly import Assembly, scaled_matrix
from problems.collision import Collision, Impact
from problems.compiled import Direct
from problems.compiled_passes import impulse_passes
from problems.coulomb_lcp import coulomb_multipliers
from problems.friction import coulomb_rows
from problems.friction_kernels import force_change
from problems.friction_passes import newton_multipliers
from problems.minimum_norm import minimum_norm
from problems.qp import Vector
from problems.qp_kernel import CompiledMethod
from problems.sequence import QPSequence, SimulationError

run_impulse_passes = Direct(impulse_passes)
MAX_PASSES = 25
"""Passes before the LCP is asked, and after it."""
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

    Where QPs are not kept, compiled with the method of the solver, if it has one.

    Raises SimulationError where the passes do not settle.
    """
    hit = copy.copy(assembly)
    hit.mu = np.full(len(assembly.frictions), mu_I)
    signs = np.zeros(len(assembly.frictions))
    layout = hit.active.layout(signs)
    entries, bodies = hit.laid_out(layout)
    size = max(1.0, float(np.linalg.norm(D * v)))
    ask_lcp = MAX_PASSES
    method = qps.compiled(layout.row_id.size)
    if method is not None:
        rubs = hit.active.friction_of, hit.active.first, hit.mu, signs
        frictions = Frictions(*rubs, *layout.columns)
        columns = hit.columns.normal, hit.columns.bodies
        collision = Collision(frictions, D, v, F, columns, (entries, bodies), hit.tangents)
        impact = _compiled_impulse(qps.solver, method, collision, SETTLED * size, accuracy)
        if impact is not None:
            qps.count += impact.solves
            return impact.v, np.concatenate([impact.lam_N, impact.lam_F])
        ask_lcp = 1
    A, coulomb = scaled_matrix(entries, bodies, D), coulomb_rows(hit, layout)
    lam_star = np.full(len(hit.normals), np.inf)
    d = D * v + F / D
    both, momentum = None, d
    for number in range(1, 2 * MAX_PASSES + 1):
        bound = hit.bound(lam_star)
        lower, upper = layout.limits(bound)
        qp, solution = qps.solve(
            A=A,
            d=d,
            lower=lower,
            upper=upper,
            row_id=layout.row_id,
            feature=layout.feature,
            D=D,
            kind="impulse",
            t=t,
            eps0=accuracy,
        )
        x = minimum_norm(qps, qp, np.asarray(solution.x), coulomb)
        after = qp.residual(x) / D
        if both is not None and np.linalg.norm(D * after - momentum) <= SETTLED * size:
            return after, np.concatenate(both)
        lam_N, lam_F = layout.split(x, signs.size)
        change = force_change(signs, lam_F, bound, hit.bound(lam_N))
        if np.linalg.norm(hit.friction_force(change) / D) <= SETTLED * size:
            return after, np.concatenate([lam_N, lam_F])
        both = coulomb_multipliers(hit, D, d) if number == ask_lcp else None
        if both is not None:
            lam_star = both[0]
            momentum = d + (hit.G_N @ both[0] + hit.G_F @ both[1]) / D
        else:
            lam_star = newton_multipliers(hit, D, signs, lam_star, lam_N, lam_F, after)
    raise SimulationError(
        f"t = {t:.6g}: Newton–Coulomb impulses of {len(hit.normals)} contacts did not settle "
        f'in {2 * MAX_PASSES} passes; use the paper\'s model, impulses="paper"'
    )


def _compiled_impulse(
    solver: Any, method: CompiledMethod, collision: Collision, tolerance: float, accuracy: float
) -> Impact | None:
    """q̇₊ and Λ by `impulse_passes`; None where they do not settle."""
    m, k = collision.D.size, collision.frictions.row_id.size
    room = solver.room(m, k, accuracy, None)
    settled, *impact = run_impulse_passes(
        *(*collision, MAX_PASSES, tolerance, Arena.of(m + k)),
        *(method.solve, room.S, room.I, room.eps0, method.mode),
    )
    return Impact(*impact) if settled else None
