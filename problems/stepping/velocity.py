"""Step 2 of algorithm 1: q̇_n and λ_n at a given q_n, by (3.1b), (3.1c) or (4.5), (4.6).

One pass poses the QP with the forces at the last guess and solves it; its λ_n satisfies (3.1c), or
(4.7) with friction.  Passes are repeated

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
from problems.qp import LARGEST, Indices, Matrix, Vector
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


class Interval(NamedTuple):
    """The step that is taken: from q_{n−1} (3n,) to the time t, over h [s]."""

    q: Vector
    t: float
    h: float


class _Posed(NamedTuple):
    """What the QPs of all passes of one step have in common.

    entries, bodies : the columns of A (m, k), as they are laid out;  b, alpha0 : of BDF-r
    signs : (F,) s;  eps0 : accuracy of a QP
    correct, iterate : whether λ_* is corrected, whether there is more than one pass
    stuck : whether λ_* is ∞ at first;  redundant : whether A may lack full column rank
    lean : u/τ (3n,) that Baumgarte's rule adds to q̇, or None
    """

    assembly: Assembly
    layout: Layout
    entries: NDArray[np.float64]
    bodies: Indices
    A: Matrix
    b: Vector
    alpha0: float
    interval: Interval
    signs: Vector
    eps0: float
    correct: bool
    iterate: bool
    stuck: bool
    redundant: bool
    lean: Vector | None


class _Found(NamedTuple):
    """What one pass found.

    d : (3n,) of its QP;  bound : (F,) μ Σ λ_*;  lam_F : (F,) of the sticking contacts
    """

    step: VelocityStep
    d: Vector
    bound: Vector
    lam_F: Vector


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
        interval: Interval,
        signs: Vector,
        known: int,
    ) -> VelocityStep:
        """q̇_n and λ_n of a step, at the position of the assembly.

        signs : (F,) s of the contacts in J_FW, 0 of those in J_FO
        known : time points with λ since the last jump in q̇ (0: (4.4), 1: (4.3), 2: (4.2));
            `STUCK`: the passes begin with λ_* = ∞
        """
        posed = self._pose(assembly, history, interval, signs, known == STUCK)
        guess = history.predict(interval.h) if self.velocity_dependent else history.v
        lam_star = NOTHING
        if signs.size > 0:
            lam_star = self._first_guess(assembly, history, interval, signs, known)
        before = np.inf
        for number in range(1, (STUCK_PASSES if posed.stuck else MAX_PASSES) + 1):
            found = self._one_pass(qps, posed, guess, lam_star, number)
            if not posed.iterate:
                return found.step
            behind, ahead, loose = self._change(posed, found, guess)
            change = behind + ahead
            rate = change / before if number > 1 and before > 0 else FIRST_RATE
            if self._settles(posed, rate, behind, ahead) and not loose:
                return found.step
            if number > 2 and rate >= 1 and not posed.correct:
                break  # without friction the fixed point is a contraction, or the step too long
            guess, before = found.step.v, change
            if posed.correct:
                lam_star = self._next_guess(posed, found, lam_star)
        return found.step._replace(settled=False)

    def _pose(
        self, assembly: Assembly, history: History, interval: Interval, signs: Vector, stuck: bool
    ) -> _Posed:
        """The QP of the step but for its forces and bounds."""
        rubs = signs.size > 0
        correct = rubs and self.friction == "corrected"
        iterate = correct or self.velocity_dependent
        alpha0, b = history.bdf(interval.h)
        layout = assembly.active.layout(signs)
        entries, bodies = assembly.laid_out(layout)
        A = scaled_matrix(entries, bodies, self.D)
        lean: Vector | None = None
        if self.drift_time < np.inf:
            # the QP is posed for q̇ − u/τ
            lean = self._lean(A, assembly, layout)
            b = b - alpha0 * lean
        return _Posed(
            *(assembly, layout, entries, bodies, A, b, alpha0, interval, signs),
            eps0=asked_accuracy(self.eps, iterate),
            correct=correct,
            iterate=iterate,
            stuck=stuck,
            redundant=rubs and not self._independent(A, entries, bodies, layout),
            lean=lean,
        )

    def _independent(
        self, A: Matrix, entries: NDArray[np.float64], bodies: Indices, layout: Layout
    ) -> bool:
        """Whether the columns of A are independent beyond doubt."""
        if sp.issparse(A):
            return peels(entries, bodies, self.D) or layout.proof.holds(A)
        return surely_independent(A)

    def _one_pass(
        self, qps: QPSequence, posed: _Posed, guess: Vector, lam_star: Vector, number: int
    ) -> _Found:
        """Pose the QP with the forces at the guess and λ_*, and solve it."""
        assembly, layout, h, signs = posed.assembly, posed.layout, posed.interval.h, posed.signs
        rubs, bound, driven = signs.size > 0, NOTHING, NOTHING
        pushed = self.forces(assembly.q, guess, posed.interval.t)
        if rubs:
            bound = assembly.bound(lam_star)
            driven = driven_forces(signs, bound)
            pushed = pushed + assembly.friction_force(driven)
        d, own = momentum(posed.b, pushed, self.D, h, LARGEST)
        lower, upper = layout.limits(bound[layout.sticking])
        qp, solution = qps.solve(
            own=own,
            A=posed.A,
            d=d,
            lower=lower,
            upper=upper,
            row_id=layout.row_id,
            feature=layout.feature,
            D=self.D,
            kind=_kind(number, self.velocity_dependent),
            t=posed.interval.t,
            h=h,
            alpha0=posed.alpha0,
            eps0=posed.eps0,
        )
        x = np.asarray(solution.x)
        v, a = outcome(posed.entries, posed.bodies, x, posed.b, d, self.D, h, posed.alpha0)
        gap_speed = assembly.gap_speed(v)
        if posed.lean is not None:
            v = v + posed.lean
        if posed.redundant:
            x = least_norm(qps, qp, x, coulomb_rows(assembly, layout) if posed.correct else None)
        lam_N, lam_F = layout.split(x, signs.size)
        slip = assembly.slip_speed(v) if rubs else NOTHING
        step = VelocityStep(
            t=posed.interval.t,
            h=h,
            q=assembly.q,
            v=v,
            a=a,
            lam_N=lam_N,
            lam_F=lam_F + driven,
            gap_speed=gap_speed,
            slip_speed=slip,
            at_bound=forced_signs(signs, lam_F, bound, slip) != 0,
            assembly=assembly,
            passes=number,
        )
        return _Found(step, d, bound, lam_F)

    def _change(self, posed: _Posed, found: _Found, guess: Vector) -> tuple[float, float, bool]:
        """‖·‖_M by which q̇_n has moved, will move with the next λ_*, and whether that is loose.

        Loose are friction forces that are still on their way down from λ_* = ∞.
        """
        step, assembly, mass = found.step, posed.assembly, self.D**2
        behind = self.norm(step.v - guess) if self.velocity_dependent else 0.0
        if not posed.correct:
            return behind, 0.0, False
        bound = assembly.bound(step.lam_N)
        moved = force_change(posed.signs, found.lam_F, found.bound, bound)
        off = self.norm(assembly.friction_force(moved) / mass)
        loose = False
        if posed.stuck:
            rubbing = self.norm(assembly.friction_force(step.lam_F) / mass)
            loose = off > STUCK_TOL * rubbing
        return behind, step.h / posed.alpha0 * off, loose

    def _settles(self, posed: _Posed, rate: float, behind: float, ahead: float) -> bool:
        """(3.14): whether further passes would change q̇_n by no more than a tenth of ε."""
        rounding = posed.interval.h / posed.alpha0 * posed.eps0
        return rate < 1 and iteration_error(rate, behind, ahead, rounding) <= 0.1 * self.eps

    def _next_guess(self, posed: _Posed, found: _Found, lam_star: Vector) -> Vector:
        """λ_* (N,) of the next pass; that of the LCP where passes from ∞ take too long."""
        step = found.step
        if posed.stuck and step.passes == MAX_PASSES:
            both = coulomb_multipliers(posed.assembly, self.D, found.d)
            if both is not None:
                return both[0]
        return newton_multipliers(
            *(posed.assembly, self.D, posed.signs, lam_star),
            *(step.lam_N, found.lam_F, step.v, posed.stuck),
        )

    def _lean(self, A: Matrix, assembly: Assembly, layout: Layout) -> Vector:
        """u/τ (3n,): the velocity that closes the gaps of active contacts within τ."""
        every = np.arange(len(assembly.normals))
        u = closing_motion(assembly, A, self.D, layout.normal_column, every)
        return u / self.drift_time

    def _first_guess(
        self, assembly: Assembly, history: History, interval: Interval, signs: Vector, known: int
    ) -> Vector:
        """λ_* (N,) of the first pass, as `known` says."""
        correct, h = self.friction == "corrected", interval.h
        if known == STUCK or (correct and known == 0 and not signs.any()):
            return np.full(len(assembly.normals), np.inf)
        if known == 0:
            # a force may jump where the step begins: it is the one after
            f_before = self.forces(interval.q, history.v, interval.t)
            mass = self.D**2
            return spring_multipliers(assembly, 1 / mass, interval.q, history.v, f_before, h)
        w = h / history.h if history.h else 1.0
        return extrapolated_multipliers(*assembly.active.lam, known, w)


def _kind(number: int, velocity_dependent: bool) -> str:
    if number == 1:
        return "step"
    return "iteration" if velocity_dependent else "corrector"
