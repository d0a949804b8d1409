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
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from problems.assembly import Assembly
from problems.friction import (
    FrictionRule,
    coulomb_rows,
    force_change,
    predicted_multipliers,
    spring_multipliers,
)
from problems.friction_passes import forced_signs, newton_multipliers
from problems.minimum_norm import minimum_norm, surely_independent
from problems.multistep import History
from problems.qp import Vector
from problems.sequence import QPSequence

MAX_PASSES = 12
FIRST_RATE = 0.5
"""ρ assumed until two passes have shown it."""
STUCK = -1
"""For `known`: λ_* = ∞, as if every contact in J_FO stuck whatever its load."""


@dataclass(frozen=True, eq=False)
class VelocityStep:
    """What a step of length h found: q, q̇, q̈ (3n,), λ_N (N,), λ_F (F,) and its `Assembly`.

    settled : whether the passes came to an end by (3.14); else this is the last one
    """

    h: float
    q: Vector
    v: Vector
    a: Vector
    lam_N: Vector
    lam_F: Vector
    at_bound: Vector
    assembly: Assembly
    passes: int
    settled: bool = True

    @property
    def slip_speed(self) -> Vector:
        """g_Fᵀq̇_n (F,)."""
        return self.assembly.slip_speed(self.v)


@dataclass(frozen=True, eq=False)
class VelocityEquations:
    """The system that is stepped: D with M = DᵀD, the forces f(q, q̇, t), the tolerances.

    eps : ε of (3.5);  friction : see `problems.friction`
    """

    D: Vector
    forces: Callable[[Vector, Vector, float], Vector]
    velocity_dependent: bool
    eps: float
    friction: FrictionRule

    def norm(self, v: Vector) -> float:
        """‖v‖_M (2.19)."""
        return float(np.linalg.norm(self.D * v))

    def solve(
        self,
        qps: QPSequence,
        assembly: Assembly,
        history: History,
        q_before: Vector,
        q: Vector,
        t: float,
        h: float,
        signs: Vector,
        known: int,
    ) -> VelocityStep:
        """q̇_n and λ_n of the step of length h that ends at (q, t).

        signs : (F,) s of the contacts in J_FW, 0 of those in J_FO
        known : time points with λ since the last jump in q̇ (0: (4.4), 1: (4.3), 2: (4.2));
            `STUCK`: the passes begin with λ_* = ∞
        """
        inverse_mass = 1 / self.D**2
        alpha0, b = history.bdf(h)
        slides = signs != 0
        rubs = len(assembly.frictions) > 0
        correct = rubs and self.friction == "corrected"
        iterate = correct or self.velocity_dependent
        eps0 = (0.01 if iterate else 0.1) * self.eps
        if not rubs:
            lam_star = np.zeros(len(assembly.normals))
        elif known == STUCK or (correct and known == 0 and not slides.any()):
            lam_star = np.full(len(assembly.normals), np.inf)
        elif known == 0:
            f_before = self.forces(q_before, history.v, t - h)
            lam_star = spring_multipliers(assembly, inverse_mass, q_before, history.v, f_before, h)
        else:
            lam_star = predicted_multipliers(assembly, known, h / history.h if history.h else 1.0)
        guess = history.predict(h) if self.velocity_dependent else history.v
        layout = _Layout(assembly, signs, self.D)
        redundant = rubs and not surely_independent(layout.A)
        change_before = np.inf
        for number in range(1, MAX_PASSES + 1):
            bound = assembly.bound(lam_star)
            driven = signs * np.where(slides, bound, 0.0)
            pushed = self.forces(q, guess, t) + assembly.friction_force(driven)
            c = h * inverse_mass * pushed + b
            stuck_bound = bound[layout.sticking]
            qp, solution = qps.solve(
                A=layout.A,
                d=self.D * c / h,
                lower=layout.column(np.zeros(len(lam_star)), -stuck_bound),
                upper=layout.column(np.full(len(lam_star), np.inf), stuck_bound),
                row_id=layout.row_id,
                feature=layout.feature,
                D=self.D,
                kind=_kind(number, self.velocity_dependent),
                t=t,
                h=h,
                alpha0=alpha0,
                eps0=eps0,
            )
            x = np.asarray(solution.x)
            v = h / alpha0 * qp.residual(x) / self.D
            if redundant:
                x = minimum_norm(qps, qp, x, layout.coulomb if correct else None)
            lam_N, lam_F = layout.split(x)
            step = VelocityStep(
                h=h,
                q=q,
                v=v,
                a=(alpha0 * v - b) / h,
                lam_N=lam_N,
                lam_F=lam_F + driven,
                at_bound=forced_signs(signs, lam_F, bound, assembly.slip_speed(v)) != 0,
                assembly=assembly,
                passes=number,
            )
            if not iterate:
                return step
            change = self.norm(v - guess) if self.velocity_dependent else 0.0
            if correct:
                new_bound = assembly.bound(lam_N)
                moved = force_change(assembly, signs, lam_F, bound, new_bound)
                change += (
                    h / alpha0 * float(np.linalg.norm(assembly.friction_force(moved) / self.D))
                )
            rate = change / change_before if number > 1 and change_before > 0 else FIRST_RATE
            # without friction the fixed point is a contraction or the step is too long
            if rate < 1 and (rate * change + h / alpha0 * eps0) / (1 - rate) <= 0.1 * self.eps:
                return step
            if number > 2 and rate >= 1 and not correct:
                break
            guess, change_before = v, change
            if correct:
                lam_star = newton_multipliers(assembly, self.D, signs, lam_star, lam_N, lam_F, v)
        return replace(step, settled=False)


class _Layout:
    """Columns of the QP: all normals and the sticking frictions, in the order of row_id."""

    def __init__(self, assembly: Assembly, signs: Vector, D: Vector):
        self.sticking = np.flatnonzero(signs == 0)
        ids = np.concatenate([assembly.normal_ids, assembly.friction_ids[self.sticking]])
        self.order = np.argsort(ids, kind="stable")
        self.row_id = ids[self.order]
        self.feature = assembly.features(self.sticking, self.order)
        every = np.arange(len(assembly.normals))
        self.A = assembly.scaled(every, self.sticking, D, self.order)
        self._n_normals = len(assembly.normals)
        self._n_frictions = len(assembly.frictions)
        self._assembly = assembly

    @cached_property
    def coulomb(self) -> sp.csr_array:
        return coulomb_rows(self._assembly, self.sticking, self.order)

    def column(self, normal: Vector, friction: Vector) -> Vector:
        return np.concatenate([normal, friction])[self.order]

    def split(self, x: Vector) -> tuple[Vector, Vector]:
        """λ_N (N,) and λ_F (F,), 0 where sliding, from the QP's x."""
        everything = np.empty_like(x)
        everything[self.order] = x
        lam_F = np.zeros(self._n_frictions)
        lam_F[self.sticking] = everything[self._n_normals :]
        return everything[: self._n_normals], lam_F


def _kind(number: int, velocity_dependent: bool) -> str:
    if number == 1:
        return "step"
    return "iteration" if velocity_dependent else "corrector"
