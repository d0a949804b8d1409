"""What an answer is worth as physics: Signorini, Coulomb, work and energy, in SI units.

With λ = x and the velocities after the step g_iᵀq̇ = (h/α₀) Δ_i, Δ = Aᵀ(A x + d), the laws are

    Signorini   0 ≤ λ_N ⊥ g_Nᵀq̇ ≥ 0
    Coulomb     |λ_F| ≤ b, and where a contact slips, λ_F = −b sign(g_Fᵀq̇)

and what an answer x does instead is

    approach        largest speed at which bodies in contact still move into each other [m/s]
    pull            largest force with which they hold on to each other [N; N·s for an impulse]
    coulomb_excess  largest |λ_F| − μ Σ λ_N with the λ_N of the answer itself [N]
    work_error      work that the laws forbid [J]: of λ_N on contacts that part or approach, and of
                    friction that slips below its bound or drives the slip s = g_Fᵀq̇,
                    h Σ |λ_N g_Nᵀq̇| + h Σ (b|s| + λ_F s)
    energy_error    kinetic energy after the step less that of the reference [J]

Impulses have h = α₀ = 1.  Where a friction impulse is posed by generators, Λ = V x, `approach` and
`pull` are those of the generators: a negative one is a Λ outside its cone.

b is the bound that the QP has, which is lagged: μ times another λ_N.  So the exact answer may have
a coulomb_excess too, and where λ is not unique it depends on which λ a solver returns.  All others
are 0 at every exact answer.  `physics_error` is the worst of them without units, and of what is
short of the laws on other rows: speeds over those that contact forces can change, (h/α₀)‖a_i‖
scale; forces beyond a bound over scale/‖a_i‖; work over (h²/α₀) scale²; energies over (h/α₀)²
scale².
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from harness.judging.facts import Facts
from problems.qp import Vector

NAN = float("nan")


@dataclass(frozen=True, kw_only=True)
class Physics:
    """The measures of the module; NaN where they make no sense."""

    approach: float = NAN
    pull: float = NAN
    coulomb_excess: float = NAN
    work_error: float = NAN
    energy_error: float = NAN
    physics_error: float = NAN


MEASURES = tuple(entry.name for entry in fields(Physics))
"""Names of the measures."""


def physics(
    facts: Facts, x: Vector, mu: Vector | None = None, objective_error: float = NAN
) -> Physics:
    """Physics of the answer x (k,) to the QP of `facts`.

    mu : (k,) friction coefficients of tangent rows (`Recording.mu`); None: no coulomb_excess
    objective_error : of x relative to the reference, in units of ½ scale² (`harness.judging.judge`)

    Everything is NaN for a QP that holds no motion of rigid bodies: one of kind minimum_norm, and
    one whose rows have no direction, which may be of anything.
    """
    qp = facts.qp
    if qp.kind == "minimum_norm" or (qp.k and (qp.feature[:, 4] < 0).all()):
        return Physics()
    rows = facts.contact_rows
    norms, scale, speed = facts.norms, facts.scale, qp.h / qp.alpha0
    slope = np.asarray(facts.A.T @ (facts.A @ x + facts.d), float)
    beyond = np.maximum(np.maximum(qp.lower - x, x - qp.upper), 0.0)
    up, down = np.maximum(slope, 0.0), np.maximum(-slope, 0.0)
    has_lower, has_upper = np.isfinite(qp.lower), np.isfinite(qp.upper)
    # what no bound can carry: speeds that should not be
    wrong = np.where(has_lower, 0.0, up) + np.where(has_upper, 0.0, down)
    work = float(wrong @ np.abs(x))
    work += float(up[has_lower] @ np.abs(x - qp.lower)[has_lower])
    work += float(down[has_upper] @ np.abs(qp.upper - x)[has_upper])
    energy = 0.5 * scale**2 * objective_error
    pushes = (qp.lower == 0) & ~has_upper
    pushes[rows.tangent] = False
    return Physics(
        approach=speed * float(wrong[pushes].max(initial=0.0)),
        pull=float(beyond[pushes].max(initial=0.0)),
        coulomb_excess=_coulomb_excess(facts, x, mu),
        work_error=qp.h * speed * work,
        energy_error=speed**2 * energy,
        physics_error=max(
            float((wrong / norms).max(initial=0.0)) / scale,
            float((beyond * norms).max(initial=0.0)) / scale,
            work / scale / scale,
            0.0 if np.isnan(objective_error) else 0.5 * abs(objective_error),
        ),
    )


def _coulomb_excess(facts: Facts, x: Vector, mu: Vector | None) -> float:
    rows = facts.contact_rows
    if mu is None or rows.tangent.size == 0:
        return NAN
    pushed = mu[rows.tangent] * (rows.members @ x[rows.normal])
    return max(0.0, float((np.abs(x[rows.tangent]) - pushed).max()))
