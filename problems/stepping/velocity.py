"""Step 2 of algorithm 1: q̇_n and λ_n at a given q_n, by (3.1b, c) or (4.5, 4.6).

One pass poses the QP with the forces at the last guess and solves it.  Passes are repeated

    - (3.9) while f depends on q̇: functional iteration from a predicted q̇_n⁽⁰⁾;
    - with corrected friction, until λ_* agrees with the λ_N that it gives;

both in one loop, stopped by (3.14): with ρ the observed rate and δ the change that another pass
would make in ‖q̇_n‖_M, when (ρ δ + (h/α₀) ε₀)/(1 − ρ) ≤ 0.1 ε.  A rate ρ ≥ 1 or the cap of passes
rejects the step.

This differs from the paper: ε₀ in (3.14) is multiplied by h/α₀, as its derivation gives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from problems.contacts.assembly import Assembly, scaled_matrix
from problems.contacts.layout import Layout
from problems.formulas.multistep import FIRST_RATE, History, asked_accuracy, iteration_error
from problems.formulas.step_kernels import momentum, outcome, weighted_norm
from problems.friction.coulomb_lcp import coulomb_multipliers
from problems.friction.kernels import (
    driven_forces,
    extrapolated_multipliers,
    force_change,
    forced_signs,
)
from problems.friction.passes import newton_multipliers
from problems.friction.rules import (
    FrictionRule,
    coulomb_rows,
    spring_multipliers,
)
from problems.least_norm.independence import surely_independent
from problems.least_norm.minimum_norm import least_norm
from problems.least_norm.peeling import peels
from problems.qp import LARGEST, Matrix, Vector
from problems.sequence import QPSequence
from problems.stepping.drift import closing_motion

MAX_PASSES = 12
STUCK_PASSES = 60
"""Passes from λ_* = ∞: where contacts catch they come down to it by halves.  After `MAX_PASSES` of
them the LCP is asked, where it is not too large."""
STUCK_TOL = 1e-3
"""… and the relative change of the friction forces at which they end: short steps forgive any λ."""
NOTHING = np.zeros(0)
STUCK = -1
"""For `known`: λ_* = ∞, as if every contact in J_FO stuck whatever its load."""


class VelocityStep(NamedTuple):
    """What a step of length h to t found: q, q̇, q̈ (3n,), λ_N (N,), λ_F (F,), its `Assembly`.

    gap_speed (N,), slip_speed (F,) : G_Nᵀq̇, without what closes gaps (`drift`), and G_Fᵀq̇
    at_bound : (F,) whether a friction force is proportional to λ_*
    settled : whether the passes came to an end by (3.14); else this is the last one
    """

    t: float
    h: float
    q: Vector
    v: Vector
    a: Vector
    lam_N: Vector
    lam_F: Vector
    gap_speed: Vector
    slip_speed: Vector
    at_bound: NDArray[np.bool_]
    assembly: Assembly
    passes: int
    settled: bool = True


@dataclass(frozen=True, eq=False)
class VelocityEquations:
    """The system that is stepped: D with M = DᵀD, the forces f(q, q̇, t), the tolerances.

    eps : ε of (3.5);  friction : see `problems.friction.rules`
    drift_time : τ of Baumgarte's stabilization [s], ∞ without it, see `problems.stepping.drift`
    """

    D: Vector
    forces: Callable[[Vector, Vector, float], Vector]
    velocity_dependent: bool
    eps: float
    friction: FrictionRule
    drift_time: float = np.inf

    def norm(self, v: Vector) -> float:
        """‖v‖_M (2.19)."""
        return float(weighted_norm(self.D, v))

    def solve(
        self,
        qps: QPSequence,
        assembly: Assembly,
        history: History,
        q_before: Vector,
        t: float,
        h: float,
        signs: Vector,
        known: int,
    ) -> VelocityStep:
        """q̇_n and λ_n of the step of length h that ends at t, at the position of the assembly.

        signs : (F,) s of the contacts in J_FW, 0 of those in J_FO
        known : time points with λ since the last jump in q̇ (0: (4.4), 1: (4.3), 2: (4.2));
            `STUCK`: the passes begin with λ_* = ∞
        """
        q, D = assembly.q, self.D
        alpha0, b = history.bdf(h)
        rubs = signs.size > 0
        correct = rubs and self.friction == "corrected"
        iterate = correct or self.velocity_dependent
        eps0 = asked_accuracy(self.eps, iterate)
        guess = history.predict(h) if self.velocity_dependent else history.v
        layout = assembly.active.layout(signs)
        entries, bodies = assembly.laid_out(layout)
        A = scaled_matrix(entries, bodies, D)
        lam_star = bound = driven = NOTHING
        if rubs:
            lam_star = self._first_guess(assembly, history, q_before, t, h, signs, known)
        redundant = rubs and not (
            peels(entries, bodies, D) or layout.proof.holds(A)
            if sp.issparse(A)
            else surely_independent(A)
        )
        lean: Vector | None = None
        if self.drift_time < np.inf:
            # the QP is posed for q̇ − u/τ
            lean = self._lean(A, assembly, layout)
            b = b - alpha0 * lean
        change_before = np.inf
        stuck, loose = known == STUCK, False
        for number in range(1, (STUCK_PASSES if stuck else MAX_PASSES) + 1):
            pushed = self.forces(q, guess, t)
            if rubs:
                bound = assembly.bound(lam_star)
                driven = driven_forces(signs, bound)
                pushed = pushed + assembly.friction_force(driven)
            d, own = momentum(b, pushed, D, h, LARGEST)
            lower, upper = layout.limits(bound[layout.sticking])
            qp, solution = qps.solve(
                own=own,
                A=A,
                d=d,
                lower=lower,
                upper=upper,
                row_id=layout.row_id,
                feature=layout.feature,
                D=D,
                kind=_kind(number, self.velocity_dependent),
                t=t,
                h=h,
                alpha0=alpha0,
                eps0=eps0,
            )
            x = np.asarray(solution.x)
            v, a = outcome(entries, bodies, x, b, d, D, h, alpha0)
            gap_speed = assembly.gap_speed(v)
            if lean is not None:
                v = v + lean
            if redundant:
                coulomb = coulomb_rows(assembly, layout) if correct else None
                x = least_norm(qps, qp, x, coulomb)
            lam_N, lam_F = layout.split(x, signs.size)
            slip = assembly.slip_speed(v) if rubs else NOTHING
            at_bound = forced_signs(signs, lam_F, bound, slip) != 0
            step = VelocityStep(
                t=t,
                h=h,
                q=q,
                v=v,
                a=a,
                lam_N=lam_N,
                lam_F=lam_F + driven,
                gap_speed=gap_speed,
                slip_speed=slip,
                at_bound=at_bound,
                assembly=assembly,
                passes=number,
            )
            if not iterate:
                return step
            behind = self.norm(v - guess) if self.velocity_dependent else 0.0
            ahead = 0.0
            if correct:
                new_bound = assembly.bound(lam_N)
                moved = force_change(signs, lam_F, bound, new_bound)
                off = self.norm(assembly.friction_force(moved) / D**2)
                ahead = h / alpha0 * off
                if stuck:
                    rubbing = self.norm(assembly.friction_force(step.lam_F) / D**2)
                    loose = off > STUCK_TOL * rubbing
            change = behind + ahead
            rate = change / change_before if number > 1 and change_before > 0 else FIRST_RATE
            # without friction the fixed point is a contraction or the step is too long
            rounding = h / alpha0 * eps0
            close = rate < 1 and iteration_error(rate, behind, ahead, rounding) <= 0.1 * self.eps
            if close and not loose:
                return step
            if number > 2 and rate >= 1 and not correct:
                break
            guess, change_before = v, change
            if correct:
                both = None
                if stuck and number == MAX_PASSES:
                    both = coulomb_multipliers(assembly, D, d)
                if both is not None:
                    lam_star = both[0]
                    continue
                lam_star = newton_multipliers(assembly, D, signs, lam_star, lam_N, lam_F, v, stuck)
        return step._replace(settled=False)

    def _lean(self, A: Matrix, assembly: Assembly, layout: Layout) -> Vector:
        """u/τ (3n,): the velocity that closes the gaps of active contacts within τ."""
        every = np.arange(len(assembly.normals))
        u = closing_motion(assembly, A, self.D, layout.normal_column, every)
        return u / self.drift_time

    def _first_guess(
        self,
        assembly: Assembly,
        history: History,
        q_before: Vector,
        t: float,
        h: float,
        signs: Vector,
        known: int,
    ) -> Vector:
        """λ_* (N,) of the first pass, as `known` says."""
        correct = self.friction == "corrected"
        if known == STUCK or (correct and known == 0 and not signs.any()):
            return np.full(len(assembly.normals), np.inf)
        if known == 0:
            # a force may jump where the step begins: it is the one after
            f_before = self.forces(q_before, history.v, t)
            mass = self.D**2
            return spring_multipliers(assembly, 1 / mass, q_before, history.v, f_before, h)
        w = h / history.h if history.h else 1.0
        return extrapolated_multipliers(*assembly.active.lam, known, w)


def _kind(number: int, velocity_dependent: bool) -> str:
    if number == 1:
        return "step"
    return "iteration" if velocity_dependent else "corrector"
