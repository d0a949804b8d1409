"""The arithmetic of friction passes, compiled; see `problems.friction_passes`."""

from __future__ import annotations

import numpy as np

from problems.compiled import kernel

AT_BOUND = 1e-9
"""Relative distance from its bound at which a friction force is at it."""


@kernel
def friction_bounds(friction_of, mu, lam_N):
    """μ Σ λ_N, the bound of each friction (F,)."""
    bound = np.zeros_like(mu)
    for i in range(friction_of.size):
        if friction_of[i] >= 0:
            bound[friction_of[i]] += lam_N[i]
    for j in range(mu.size):
        bound[j] *= mu[j]
    return bound


@kernel
def driven_forces(signs, bound):
    """s μ Σ λ_* of the sliding contacts, 0 of the sticking ones (F,)."""
    force = np.zeros_like(bound)
    for j in range(bound.size):
        if signs[j] != 0.0:
            force[j] = signs[j] * bound[j]
    return force


@kernel
def at_bound(lam_F, bound):
    """Whether the friction force of one contact is at its bound."""
    return abs(lam_F) >= bound * (1.0 - AT_BOUND)


@kernel
def forced_signs(signs, lam_F, bound, slip):
    """σ (F,): the sign of a friction force that is proportional to λ_*, 0 where it is not.

    signs : s of a sliding contact, 0 of a sticking one;  lam_F, bound : λ_F and μ Σ λ_*
    slip : g_Fᵀq̇ up to a positive factor, for the contacts without a load, where λ_F = ± 0
    """
    sigma = np.zeros_like(bound)
    for j in range(bound.size):
        if signs[j] != 0.0:
            sigma[j] = signs[j]
        elif at_bound(lam_F[j], bound[j]):
            sigma[j] = np.sign(lam_F[j]) if lam_F[j] != 0.0 else -np.sign(slip[j])
    return sigma


@kernel
def force_change(signs, stuck, bound, new_bound):
    """How far each friction multiplier would move under the new bounds μ Σ λ_N.  (F,)

    signs : (F,) s of a sliding contact, 0 of a sticking one
    stuck : (F,) λ_F of the QP where sticking
    bound, new_bound : (F,) μ Σ λ_* before, infinite where it sticks whatever the load, and after

    A sliding force moves with its bound; a sticking one only where it is at the old bound or
    beyond the new one.
    """
    change = np.empty_like(bound)
    for j in range(bound.size):
        step = new_bound[j] - (0.0 if bound[j] == np.inf else bound[j])
        if signs[j] != 0.0:
            change[j] = signs[j] * step
            continue
        if abs(stuck[j]) < bound[j] * (1.0 - 1e-12):
            step = min(0.0, new_bound[j] - abs(stuck[j]))
        change[j] = -step if stuck[j] < 0.0 else step
    return change
