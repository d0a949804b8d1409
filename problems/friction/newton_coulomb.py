"""Newton–Coulomb impulses: another law than the paper's for what friction does in a collision.

Every contact of the collision obeys, after it,

    0 ≤ Λ_N ⊥ g_Nᵀq̇₊ ≥ 0                                  (Newton's law, without restitution)
    |Λ_F| ≤ μ_I Σ Λ_N,  = −sign(g_Fᵀq̇₊) μ_I Σ Λ_N where g_Fᵀq̇₊ ≠ 0      (Coulomb's, for impulses)

so a contact that goes on sliding stays a contact, while in the paper's model (§4.3) it bounces with
g_Nᵀq̇₊ = μ_I |g_Fᵀq̇₊|.  The paper says that models differ by O(1) and that its own was chosen for
its simplicity.  Where contacts stick, and without friction, both are the same.

It is the fixed point of `problems.friction.passes` with h = α₀ = 1, all contacts bounded by
± μ_I Σ Λ_*, from Λ_* = ∞.  With redundant contacts there need not be one: the QP's Λ of least norm
may bound friction otherwise than the Λ that explains the motion.  Where the passes do not settle
`problems.friction.coulomb_lcp` is asked, which ends with a Λ that meets both laws.  With its bounds
the QP has the same q̇₊, because this Λ meets the optimality conditions of that QP, and A Λ is
unique; so the collision ends with this QP.  Energy may grow at a contact that reverses its slip
(4.12).
"""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from problems.contacts.active_kernels import Frictions
from problems.contacts.assembly import Assembly, scaled_matrix
from problems.contacts.layout import Layout
from problems.friction.collision import Collision, Impact
from problems.friction.compiled_passes import impulse_passes
from problems.friction.coulomb_lcp import MOST_VARIABLES, coulomb_multipliers
from problems.friction.kernels import force_change
from problems.friction.passes import newton_multipliers
from problems.friction.rules import coulomb_rows
from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.least_norm.minimum_norm import minimum_norm
from problems.qp import Matrix, Vector
from problems.qp_kernel import CompiledMethod
from problems.sequence import QPSequence, SimulationError

run_impulse_passes = Direct(impulse_passes)
MAX_PASSES = 25
"""Passes before the LCP is asked."""
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
    posed = _Posed(
        qps, hit, layout, scaled_matrix(entries, bodies, D), D, D * v + F / D, t, accuracy
    )
    settled = None if method is not None else _by_passes(posed, signs, SETTLED * size)
    return _by_lcp(posed) if settled is None else settled


class _Posed(NamedTuple):
    """What the QPs of one collision have in common."""

    qps: QPSequence
    hit: Assembly
    layout: Layout
    A: Matrix
    D: Vector
    d: Vector
    t: float
    accuracy: float

    def solve(self, bound: Vector, coulomb: sp.csr_array | None) -> tuple[Vector, Vector]:
        """x (k,) with |Λ_F| ≤ bound (F,), of least norm where Coulomb's rows are given, and q̇₊."""
        lower, upper = self.layout.limits(bound)
        qp, solution = self.qps.solve(
            A=self.A,
            d=self.d,
            lower=lower,
            upper=upper,
            row_id=self.layout.row_id,
            feature=self.layout.feature,
            D=self.D,
            kind="impulse",
            t=self.t,
            eps0=self.accuracy,
        )
        x = np.asarray(solution.x)
        if coulomb is not None:
            x = minimum_norm(self.qps, qp, x, coulomb)
        return x, qp.residual(x) / self.D


def _by_passes(posed: _Posed, signs: Vector, tolerance: float) -> tuple[Vector, Vector] | None:
    """q̇₊ and Λ where the passes settle."""
    hit, D, coulomb = posed.hit, posed.D, coulomb_rows(posed.hit, posed.layout)
    lam_star = np.full(len(hit.normals), np.inf)
    for _ in range(MAX_PASSES):
        bound = hit.bound(lam_star)
        x, after = posed.solve(bound, coulomb)
        lam_N, lam_F = posed.layout.split(x, signs.size)
        change = force_change(signs, lam_F, bound, hit.bound(lam_N))
        if np.linalg.norm(hit.friction_force(change) / D) <= tolerance:
            return after, np.concatenate([lam_N, lam_F])
        lam_star = newton_multipliers(hit, D, signs, lam_star, lam_N, lam_F, after)
    return None


def _by_lcp(posed: _Posed) -> tuple[Vector, Vector]:
    """q̇₊ and Λ by the LCP, and the QP with its bounds."""
    both = coulomb_multipliers(posed.hit, posed.D, posed.d)
    if both is None:
        raise SimulationError(
            f"t = {posed.t:.6g}: Newton–Coulomb impulses of {len(posed.hit.normals)} contacts did "
            f"not settle in {MAX_PASSES} passes, and are too many for the LCP, which takes "
            f"{MOST_VARIABLES}, 1 per normal and 3 per friction that are in touch; use "
            'the paper\'s model, impulses="paper"'
        )
    _, after = posed.solve(posed.hit.bound(both[0]), None)
    return after, np.concatenate(both)


def _compiled_impulse(
    solver: Any, method: CompiledMethod, collision: Collision, tolerance: float, accuracy: float
) -> Impact | None:
    """q̇₊ and Λ by `impulse_passes`; None where they do not settle."""
    m, k = collision.D.size, collision.frictions.row_id.size
    room = solver.room(m, k, accuracy, None)
    settled, *impact = run_impulse_passes(
        *(collision, MAX_PASSES, tolerance, Arena.of(m + k)),
        *(method.solve, room.S, room.I, room.eps0, method.mode),
    )
    return Impact(*impact) if settled else None
