"""Coulomb friction in the discrete model of §4: lagged sliding forces and lagged bounds.

Where a contact slides (J_FW) the friction force is s μ λ_*, where it sticks (J_FO) the multiplier
is bounded by ± μ λ_*; λ_* stands for the normal multiplier, unknown until the QP is solved:

    (4.2)  extrapolated from the last two steps
    (4.3)  that of the last step, after a jump in q̈
    (4.4)  a spring and damper at the contact, in the first step and after a jump in q̇

`friction="paper"` uses these as printed.  `friction="corrected"` (the default) takes them as a
prediction, solves, and solves again with another λ_* until λ_N(λ_*) = λ_* as far as the friction
forces depend on it (`problems.friction.passes`).

This differs from the paper, because: 1. one sliding contact obeys λ_n = λ₀ + γ λ_* with the gain
γ = −μ s (g_NᵀM⁻¹g_F)/(g_NᵀM⁻¹g_N), and with (4.2) errors grow at any h unless −1/(1+2w) < γ;
2. (4.4) makes a start with sliding friction first order, a converged start keeps order 2; 3. (4.4)
is used with φ(q_*) − φ(q_{n−1}), not φ(q_*): drift times k would explode; 4. λ_* is clipped at 0;
5. (4.4) gives 0 between stacked bodies: where nothing slides, corrected passes begin with λ_* = ∞.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.sparse as sp

from problems.contacts.assembly import Assembly
from problems.contacts.geometry_kernels import compliances
from problems.contacts.layout import Layout
from problems.friction.kernels import spring_loads
from problems.qp import Vector

FrictionRule = Literal["paper", "corrected"]


def spring_multipliers(
    assembly: Assembly,
    inverse_mass: Vector,
    q: Vector,
    v: Vector,
    f: Vector,
    h: float,
) -> Vector:
    """λ_* (N,) by the spring of (4.4), with q, q̇ and f of t_{n−1}."""
    q_star = q + h * v + 0.5 * h * h * inverse_mass * f
    geometry = assembly.geometry
    now = geometry.columns_at(geometry.pose(q), assembly.place).phi
    then = geometry.columns_at(geometry.pose(q_star), assembly.place).phi
    compliance = compliances(assembly.columns.normal, assembly.columns.bodies, inverse_mass)
    return spring_loads(now, then, compliance, h)


def coulomb_rows(assembly: Assembly, layout: Layout) -> sp.csr_array:
    """Rows C with C λ ≥ 0 ⇔ |λ_F| ≤ μ Σ λ_N of the sticking contacts, for (4.8); λ as laid out.

    They are made once for a layout and its μ.
    """
    key = assembly.mu.tobytes()
    if key not in layout.cones:
        layout.cones[key] = _cones(assembly, layout)
    return layout.cones[key]


def _cones(assembly: Assembly, layout: Layout) -> sp.csr_array:
    rank = np.full(assembly.mu.size, -1)
    rank[layout.sticking] = np.arange(layout.sticking.size)
    loaded = np.flatnonzero(assembly.friction_of >= 0)
    friction = assembly.friction_of[loaded]
    loaded, friction = loaded[rank[friction] >= 0], friction[rank[friction] >= 0]
    row, count = rank[friction], layout.sticking.size
    cone, each = layout.normal_column[loaded], np.arange(count)
    mu, one = assembly.mu[friction], np.ones(count)
    rows = np.concatenate([row, each, count + row, count + each])
    columns = np.concatenate([cone, layout.sticking_column, cone, layout.sticking_column])
    return sp.csr_array(
        (np.concatenate([mu, -one, mu, one]), (rows, columns)), shape=(2 * count, layout.k)
    )
