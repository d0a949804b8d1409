"""The arithmetic of friction passes, compiled; see `problems.friction.passes`."""

from __future__ import annotations

import numpy as np

from problems.contacts.active_kernels import JOINT, friction_bounds
from problems.contacts.geometry_kernels import column_product, column_sum, columns_product
from problems.kernels.arena import numbers, zeros
from problems.kernels.compiled import kernel

AT_BOUND = 1e-9
"""Relative distance from its bound at which a friction force is at it."""
NO_SLIP = 1e-9
"""Fraction of the fastest slip up to which one is rounding, without a direction."""
QUIET_PASSES = 3
"""Passes of corrected friction that are no sign of trouble."""
RIDGE = 1e-8
"""Fraction of the largest ‖a_j‖² added to the diagonal where contacts are redundant.  What rounding
does to λ_* grows with its inverse, and it hardly slows Newton's method."""
SMALLEST_PIVOT = 1e-10
"""Pivots below this fraction of the largest ‖a_j‖² say that contacts are redundant."""


@kernel
def driven_forces(signs, bound, arena=None):
    """s μ Σ λ_* of the sliding contacts, 0 of the sticking ones (F,)."""
    force = zeros(arena, bound.size)
    for j in range(bound.size):
        if signs[j] != 0.0:
            force[j] = signs[j] * bound[j]
    return force


@kernel
def at_bound(lam_F, bound):
    """Whether the friction force of one contact is at its bound."""
    return abs(lam_F) >= bound * (1.0 - AT_BOUND)


@kernel
def largest_finite(bound):
    """The largest of the bounds that are finite; 0 without one."""
    most = 0.0
    for j in range(bound.size):
        if bound[j] < np.inf:
            most = max(most, bound[j])
    return most


@kernel
def forced_signs(signs, lam_F, bound, slip, arena=None):
    """σ (F,): the sign of a friction force that is proportional to λ_*, 0 where it is not.

    signs : s of a sliding contact, 0 of a sticking one;  lam_F, bound : λ_F and μ Σ λ_*
    slip : g_Fᵀq̇ up to a positive factor, for the contacts without a load, where λ_F is rounding
    """
    sigma = zeros(arena, bound.size)
    fastest, least = 0.0, AT_BOUND * largest_finite(bound)
    for j in range(bound.size):
        fastest = max(fastest, abs(slip[j]))
    for j in range(bound.size):
        if signs[j] != 0.0:
            sigma[j] = signs[j]
        elif at_bound(lam_F[j], bound[j]):
            if bound[j] > least:
                sigma[j] = np.sign(lam_F[j])
            elif abs(slip[j]) > NO_SLIP * fastest:
                sigma[j] = -np.sign(slip[j])
    return sigma


@kernel
def force_change(signs, stuck, bound, new_bound, arena=None):
    """How far each friction multiplier would move under the new bounds μ Σ λ_N.  (F,)

    signs : (F,) s of a sliding contact, 0 of a sticking one
    stuck : (F,) λ_F of the QP where sticking
    bound, new_bound : (F,) μ Σ λ_* before, infinite where it sticks whatever the load, and after

    A sliding force moves with its bound; a sticking one only where it is at the old bound, as it
    is where that is rounding, or beyond the new one.
    """
    change = numbers(arena, bound.size)
    least = AT_BOUND * largest_finite(bound)
    for j in range(bound.size):
        step = new_bound[j] - (0.0 if bound[j] == np.inf else bound[j])
        if signs[j] != 0.0:
            change[j] = signs[j] * step
            continue
        if bound[j] > least and abs(stuck[j]) < bound[j] * (1.0 - 1e-12):
            step = min(0.0, new_bound[j] - abs(stuck[j]))
        change[j] = -step if stuck[j] < 0.0 else step
    return change


@kernel
def loaded(lam_N, friction_of):
    """Which normals bear a load that is more than rounding, and all rows of joints (N,)."""
    most = 0.0
    for i in range(lam_N.size):
        if friction_of[i] != JOINT:
            most = max(most, lam_N[i])
    return (lam_N > AT_BOUND * most) | (friction_of == JOINT)


@kernel
def solve_in_place(K, y, smallest):
    """K⁻¹y by elimination with partial pivoting, written to y (n,); K (n, n) is spoilt.

    Returns whether all pivots were larger than `smallest`.
    """
    n = y.size
    for c in range(n):
        best = c
        for i in range(c + 1, n):
            if abs(K[i, c]) > abs(K[best, c]):
                best = i
        if not abs(K[best, c]) > smallest:
            return False
        for j in range(c, n):
            K[c, j], K[best, j] = K[best, j], K[c, j]
        y[c], y[best] = y[best], y[c]
        for i in range(c + 1, n):
            factor = K[i, c] / K[c, c]
            if factor != 0.0:
                for j in range(c + 1, n):
                    K[i, j] -= factor * K[c, j]
                y[i] -= factor * y[c]
    for c in range(n - 1, -1, -1):
        for j in range(c + 1, n):
            y[c] -= K[c, j] * y[j]
        y[c] /= K[c, c]
    return True


@kernel
def newton_move(normals, tangents, inverse_mass, friction_of, mu, sigma, inside, free, gamma):
    """y of `problems.friction.passes` for the free normals, (N,), and whether there is one.

    normals, tangents : (entries (·, 6), bodies (·, 2)) of g_N and g_F
    sigma : (F,);  inside : (F,) whether strictly within its bound;  free : (N,);  gamma : (N,) γ
    """
    g_N, bodies = normals
    g_F, rubbing = tangents
    first, last = np.flatnonzero(free), np.flatnonzero(inside)
    n, size = first.size, first.size + last.size
    S, where = np.empty((size, 6)), np.empty((size, 2), dtype=np.int64)
    for c in range(size):
        S[c] = g_N[first[c]] if c < n else g_F[last[c - n]]
        where[c] = bodies[first[c]] if c < n else rubbing[last[c - n]]
    K = np.empty((size, size))
    most = 0.0
    for c in range(size):
        for e in range(c + 1):
            K[c, e] = K[e, c] = columns_product(S, where, c, S, where, e, inverse_mass)
        most = max(most, K[c, c])
    for e in range(n):
        j = friction_of[first[e]]
        if j >= 0 and sigma[j] != 0.0:
            for c in range(size):
                product = columns_product(S, where, c, g_F, rubbing, j, inverse_mass)
                K[c, e] += sigma[j] * mu[j] * product
    moved = sigma * friction_bounds(friction_of, mu, gamma)
    force = column_sum(g_F, rubbing, moved, inverse_mass.size)
    right = np.empty(size)
    for c in range(size):
        right[c] = -column_product(S, where, c, force, inverse_mass)
    y, solved = np.zeros(free.size), right.copy()
    regular = solve_in_place(K.copy(), solved, SMALLEST_PIVOT * most)
    if not regular:
        for c in range(size):
            K[c, c] += RIDGE * most
        solved = right
        regular = solve_in_place(K, solved, 0.0)
    if regular:  # else a gain of exactly 1
        for c in range(n):
            y[first[c]] = solved[c]
    return y, regular


@kernel
def next_multipliers(friction_of, lam_star, lam_N, y, from_above):
    """λ_* (N,) ≥ 0 of the next pass: the fixed point λ_N + y, or λ_N where that calls for λ < 0.

    One below 0 that λ_N falls towards is a contact without a load; one that it rises from is none,
    and on the way down from ∞ either may be: then none of them is believed.
    """
    found = np.empty_like(lam_N)
    most = 0.0
    for i in range(lam_N.size):
        if friction_of[i] != JOINT:
            most = max(most, lam_N[i] + y[i])
    for i in range(lam_N.size):
        if friction_of[i] == JOINT:  # bounds nothing
            found[i] = 0.0
            continue
        value = lam_N[i] + y[i]
        if value < -AT_BOUND * most and (from_above or lam_N[i] > lam_star[i]):
            if from_above:
                return lam_N.copy()
            value = lam_N[i]
        found[i] = max(0.0, value)
    return found


@kernel
def small_newton_multipliers(
    normals, tangents, inverse_mass, friction_of, mu, signs, sigma, lam_star, lam_N, from_above
):
    """λ_* (N,) of the next pass, see `problems.friction.passes.newton_multipliers`."""
    free = loaded(lam_N, friction_of)
    if not free.any() or not sigma.any() or np.isinf(lam_star).any():
        return lam_N.copy()
    inside = (signs == 0.0) & (sigma == 0.0)
    y, found = newton_move(
        normals, tangents, inverse_mass, friction_of, mu, sigma, inside, free, lam_N - lam_star
    )
    if not found:
        return lam_N.copy()
    return next_multipliers(friction_of, lam_star, lam_N, y, from_above)
