"""Newton–Coulomb impulses: another law than the paper's for what friction does in a collision.

Every contact of the collision obeys, after it,

    0 ≤ Λ_N ⊥ g_Nᵀq̇₊ ≥ 0                                  (Newton's law, without restitution)
    |Λ_F| ≤ μ_I Σ Λ_N,  = −sign(g_Fᵀq̇₊) μ_I Σ Λ_N where g_Fᵀq̇₊ ≠ 0      (Coulomb's, for impulses)

so a contact that goes on sliding stays a contact, while in the paper's model (§4.3) it bounces with
g_Nᵀq̇₊ = μ_I |g_Fᵀq̇₊|.  The paper says that models differ by O(1) and that its own was chosen for
its simplicity.  Where contacts stick, and without friction, both are the same.

It is the fixed point of `problems.friction.passes` with h = α₀ = 1, all contacts bounded by
± μ_I Σ Λ_*, from Λ_* = ∞.  With redundant contacts there need not be one: the QP's Λ of least norm
may bound friction otherwise than the Λ that explains the motion, and where contacts jam, a q̇₊ that
no pass changes any more may slip a little under a Λ that is 10⁴ times what stops the bodies.
Where the passes do not settle, or friction then lacks work, `problems.friction.coulomb_lcp` is
asked, which ends with a Λ that meets both laws.  With its bounds the QP has the same q̇₊, because
this Λ meets the optimality conditions of that QP, and A Λ is unique; so the collision ends with
this QP.  Energy may grow at a contact that reverses its slip (4.12).
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from problems.contacts.active_kernels import Frictions
from problems.contacts.assembly import Assembly
from problems.contacts.geometry_kernels import dense_columns
from problems.friction.coulomb_lcp import MOST_VARIABLES, coulomb_multipliers
from problems.friction.passes import ANSWER, GUESS, SETTLED, Passes, fixed_point
from problems.friction.posed import PosedPasses, start
from problems.kernels.arena import Arena
from problems.kernels.compiled import Direct
from problems.qp import Vector
from problems.qp_kernel import NO_METHOD, CompiledMethod
from problems.sequence import QPSequence, SimulationError

run_fixed_point = Direct(fixed_point)
MAX_PASSES = 25
"""Passes before the LCP is asked."""
SETTLED_BY = 1e-9
"""Change of q̇₊ by another pass, relative to ‖q̇₋‖_M, at which the passes end."""
LACKING = 1e-9
"""Work that the friction of one contact may lack, over ‖q̇₋‖²_M."""


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
    tolerance = SETTLED_BY * max(1.0, float(np.linalg.norm(D * v)))
    collision = _Collision(qps, hit, D, v, F, t, accuracy)
    method = qps.compiled(collision.layout.k)
    settled = collision.settles(tolerance, method)
    if settled and collision.lacking() <= LACKING * max(1.0, float((D * v) @ (D * v))):
        return collision.outcome()
    both = coulomb_multipliers(hit, D, D * v + F / D)
    if both is None and settled:
        return collision.outcome()
    if both is None:
        raise SimulationError(
            f"t = {t:.6g}: Newton–Coulomb impulses of {len(hit.normals)} contacts did not settle "
            f"in {MAX_PASSES} passes, and are too many for the LCP, which takes {MOST_VARIABLES}, "
            "1 per normal and 3 per friction that are in touch; use the paper's model, "
            'impulses="paper"'
        )
    after, _ = collision.with_load(both[0])
    return after, np.concatenate(both)


class _Collision:
    """The passes of one collision."""

    def __init__(
        self,
        qps: QPSequence,
        hit: Assembly,
        D: Vector,
        v: Vector,
        F: Vector,
        t: float,
        accuracy: float,
    ) -> None:
        signs = np.zeros(len(hit.frictions))
        self.qps, self.hit, self.D, self.v, self.F = qps, hit, D, v, F
        self.t, self.accuracy = t, accuracy
        self.layout = hit.active.layout(signs)
        rubs = hit.friction_of, hit.active.first, hit.mu, signs
        self.frictions = Frictions(*rubs, *self.layout.columns)

    def settles(self, tolerance: float, method: CompiledMethod | None) -> bool:
        """Whether the passes from Λ_* = ∞ do, by the method or, where there is none, any solver."""
        self._begin(np.inf, method is None, tolerance=tolerance, most=MAX_PASSES, corrects=1)
        if method is None:
            return self._ask() == SETTLED
        m, k = self.D.size, self.layout.k
        solver: Any = self.qps.solver
        room = solver.room(m, k, self.accuracy, None)
        where = room.S, room.I, room.eps0, method.mode
        ended, _ = run_fixed_point(self.passes, method.solve, *where)
        if ended == SETTLED:
            self.qps.count += int(self.passes.now[0]["solves"])
        return bool(ended == SETTLED)

    def with_load(self, lam_N: Vector) -> tuple[Vector, Vector]:
        """The outcome of one pass with these bounds."""
        self._begin(lam_N, True, most=1)
        self._ask()
        return self.outcome()

    def lacking(self) -> float:
        """The most by which friction does not work with all that Λ_N allows, of any contact [J]."""
        hit, (after, lam) = self.hit, self.outcome()
        N, F = len(hit.normals), len(hit.frictions)
        if F == 0:
            return 0.0
        slip = hit.scaled(np.arange(0), np.arange(F), self.D).T @ (self.D * after)
        rubs = hit.friction_of[:N]
        load = np.bincount(rubs[rubs >= 0], weights=lam[:N][rubs >= 0], minlength=F)
        return float(np.abs(hit.mu * load * np.abs(slip) + lam[N:] * slip).max())

    def outcome(self) -> tuple[Vector, Vector]:
        """q̇₊ and Λ of the last pass."""
        passes = self.passes
        return passes.v, np.concatenate([passes.lam_N, passes.lam_F])

    def _begin(self, lam_star: float | Vector, asks: bool, **now: float) -> None:
        hit, arena = self.hit, Arena.of(self.D.size + self.layout.k)
        passes = Passes.of(self.frictions, self.D, asks, arena)
        columns, layout = hit.columns, hit.laid_out(self.layout)
        joined = self.layout.normal_column[len(hit.normals) :]
        passes.lower[joined], passes.upper[joined] = hit.rows.impulse_bounds()
        self.passes = passes = passes._replace(
            normals=(columns.normal, columns.bodies), columns=layout, tangents=hit.tangents
        )
        passes.b[:], passes.forces[:], passes.lam_star[:] = self.v, self.F, lam_star
        if not asks:
            dense_columns(*layout, self.D, passes.A)
        start(passes, h=1.0, alpha0=1.0, eps0=self.accuracy, next_only=1, asks=asks, **now)

    def _ask(self) -> int:
        """How the passes end, with any solver."""
        posed = PosedPasses(self.qps, self.passes, self.layout, own=False, t=self.t)
        while True:
            ended: int = run_fixed_point(self.passes, *NO_METHOD)[0]
            if ended == ANSWER:
                posed.answer("impulse")
            elif ended == GUESS:
                posed.guess(self.hit)
            else:
                return ended
