"""Impacts that bounce, beside the plastic ones of (2.13), (2.14).

Two rules, with a coefficient 0 ≤ e ≤ 1 of each pair of bodies:

    newton   g_Nᵀ q̇₊ ≥ −e g_Nᵀ q̇₋, complementary to Λ.  With u, Gᵀu = (−e g_Nᵀ q̇₋, 0), it is the
             plastic problem for q̇ − u.  With friction the kinetic energy may grow (Kane 1984)
    poisson  the plastic problem gives Λ; then e Λ, friction included, acts once more; where that
             makes contacts approach, they are struck plastically.  The second impulse is shortened
             where the energy would grow, which is possible only where coefficients differ: Λ and
             G_Nᵀq̇ are complementary contact by contact, so that with one e, and F = 0,
             2ΔT = −(1 − e²) ‖AΛ‖²

What would part slower than `LEAST_BOUNCE` does not bounce, so that a ball comes to rest after some
impacts: its flight would be over within the first steps after a restart, which are of order one.
Joints and stops do not bounce.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from problems.contacts.assembly import Assembly
from problems.qp import Vector
from problems.stepping.drift import correction

RestitutionRule = Literal["poisson", "newton"]
LEAST_BOUNCE = 10.0
"""The slowest, in `drop_tol`."""
RESTING = 1e-12
"""Contacts that approach slower than this do not [m/s]."""
Plastic = Callable[[Vector, Vector], tuple[Vector, Vector]]
"""(q̇₋, F) → (q̇₊, Λ over [normals, frictions]) of a plastic impact."""


def coefficients(
    assembly: Assembly, between: Callable[[int, int], float], v: Vector, drop_tol: float
) -> Vector:
    """e (N,) of the normals, 0 of those that would part no faster than so many `drop_tol` [m/s]."""
    touching = assembly.touching
    e = np.zeros(assembly.count)
    e[touching] = [between(*pair) for pair in assembly.columns.bodies[touching].tolist()]
    return np.where(-e * assembly.gap_speed(v) > LEAST_BOUNCE * drop_tol, e, 0.0)


def bounced(
    assembly: Assembly,
    D: Vector,
    e: Vector,
    v: Vector,
    F: Vector,
    plastic: Plastic,
    rule: RestitutionRule,
) -> Vector:
    """q̇₊ (3n,) from q̇₋ = v with coefficients e (N,) and an external impulse F (3n,)."""
    frictions = np.arange(assembly.mu.size)
    A = assembly.scaled(np.arange(e.size), frictions, D)
    if rule == "newton":
        wanted = np.append(-e * assembly.gap_speed(v), np.zeros(frictions.size))
        u = correction(A, D, wanted)
        return u + plastic(v - u, F)[0]
    before, Lam = plastic(v, F)
    of_friction = np.zeros(frictions.size)
    np.maximum.at(
        of_friction, assembly.rubbing[assembly.friction_of >= 0], e[assembly.friction_of >= 0]
    )
    again = A @ (np.append(e, of_friction) * Lam) / D
    energy = D * v + F / D
    after = before + _allowed(D * before, D * again, float(energy @ energy)) * again
    if (assembly.gap_speed(after)[assembly.touching] < -RESTING).any():
        return plastic(after, np.zeros_like(F))[0]
    return after


def _allowed(w: Vector, dw: Vector, most: float) -> float:
    """The largest share s ≤ 1 of dw with ‖w + s dw‖² ≤ most."""
    a, b, c = float(dw @ dw), float(w @ dw), float(w @ w) - most
    if a == 0 or a + 2 * b + c <= 0:
        return 1.0
    return float(max(0.0, (np.sqrt(max(b * b - a * c, 0.0)) - b) / a))
