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

from problems.contacts.active_kernels import Frictions
from problems.kernels.arena import numbers
from problems.kernels.compiled import kernel

FrictionRule = Literal["paper", "corrected"]

SPRING = 2.0
"""k = SPRING · m_eff/h² in (4.4) is the rigid force of a single contact; d = 0, for g_Nᵀq̇ ≈ 0."""


@kernel
def extrapolated_multipliers(lam, before, known, w, arena=None):
    """λ_* ≥ 0 (N,) by (4.3) with one known time point, by (4.2) with two; w = h_n/h_{n−1}."""
    found = numbers(arena, lam.size)
    for i in range(lam.size):
        change = w * (lam[i] - before[i]) if known > 1 else 0.0
        found[i] = max(0.0, lam[i] + change)
    return found


@kernel
def spring_loads(now, then, compliance, h, arena=None):
    """λ_* ≥ 0 (N,) of (4.4) from φ (N,) now and where the path would be without contacts [m]."""
    found = numbers(arena, now.size)
    for i in range(now.size):  # those beyond `then` are rows of joints, which bound nothing
        pressed = -SPRING / (h * h * compliance[i]) * (then[i] - now[i]) if i < then.size else 0.0
        found[i] = max(0.0, pressed)
    return found


@kernel
def cone_entries(frictions):
    """Row, column and value of what is not 0 in `cones`, normals first."""
    count = frictions.sticking.size
    rank = np.full(frictions.mu.size, -1)
    for s in range(count):
        rank[frictions.sticking[s]] = s
    bounded = 0
    for j in frictions.friction_of:
        bounded += j >= 0 and rank[j] >= 0
    size, n = 2 * (bounded + count), 0
    row, column = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    value = np.empty(size)
    for i in range(frictions.friction_of.size):
        j = frictions.friction_of[i]
        if j >= 0 and rank[j] >= 0:
            for half in range(2):
                row[n], column[n] = rank[j] + half * count, frictions.normal_column[i]
                value[n] = frictions.mu[j]
                n += 1
    for s in range(count):
        for half in range(2):
            row[n], column[n] = s + half * count, frictions.sticking_column[s]
            value[n] = 2.0 * half - 1.0
            n += 1
    return row, column, value


@kernel
def cones(frictions):
    """Rows C (2 S, k) with C λ ≥ 0 ⇔ |λ_F| ≤ μ Σ λ_N of what sticks, for (4.8); λ as laid out."""
    C = np.zeros((2 * frictions.sticking.size, frictions.row.size))
    row, column, value = cone_entries(frictions)
    for n in range(row.size):
        C[row[n], column[n]] = value[n]
    return C


def coulomb_rows(frictions: Frictions) -> sp.csr_array:
    """`cones`, sparse."""
    row, column, value = cone_entries(frictions)
    shape = (2 * frictions.sticking.size, frictions.row.size)
    return sp.csr_array((value, (row, column)), shape=shape)
