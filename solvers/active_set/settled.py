"""The QP whose working set is still right: one descent direction by normal equations, compiled.

Most QPs of a sequence end after one descent direction on the F of the QP before, and where they are
small the shortest way to it is not a QR factorization but A_Fᵀ A_F = L D Lᵀ, with r computed anew
after each solve so that the squared condition costs digits of the correction only (Björck 1987,
the corrected seminormal equations).  Nothing is scaled, sorted or pivoted.  Where anything is not
as expected (other rows, a small pivot, a bound in the way, a wrong sign, slow refinement) this
gives up before x is touched.
"""

from __future__ import annotations

from math import sqrt

from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE
from solvers.active_set.compiled import stage
from solvers.active_set.factorization import row_length
from solvers.active_set.flops import product_flops, triangular_flops
from solvers.active_set.gram import (
    COLUMNS,
    HAS_L,
    NOTHING,
    factorize_gram,
    solve_gram,
    take_columns,
    take_gram_of_free,
)
from solvers.active_set.tolerances import OUT_OF_PROPORTION
from solvers.active_set.workspace import (
    ALONE,
    ALONE2,
    ALONE_IN,
    COUNTS,
    DIRECTIONS,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    LANES,
    MEMBER,
    N_FLOAT_ROWS,
    OLD_K,
    OLD_MEMBER,
    OLD_ORDER,
    OLD_ROW,
    RESIDUAL,
    SIZES,
    SOLVED,
    STATUS,
    F,
    P,
    X,
    Z,
)

REFINEMENTS = 4
RIGHT, GO_ON, GIVE_UP = range(3)


@stage
def solve_settled(A, d, lower, upper, row_id, S, I, rounding_unit):
    """Try to solve a QP on the F of the one before; whether its KKT conditions hold, what is known
    of A, and how many of its rows are in B (`gram`).

    rounding_unit : rounding in Δ, in units of ‖ |A||x| + |d| ‖

    On success everything is left in the workspace as `algorithm_2` does.
    """
    m, k = A.shape
    counts, old_row, old_member = I[COUNTS], I[OLD_ROW], I[OLD_MEMBER]
    if counts[OLD_K] != k:
        return False, NOTHING, 0
    for j in range(k):
        if old_row[j] != row_id[j]:
            return False, NOTHING, 0
    x, old_x, member, free = S[Z], S[X], I[MEMBER], I[F]
    f = 0
    for j in range(k):
        value, side = old_x[j], old_member[j]
        if side == FREE:
            free[f] = j
            f += 1
            if lower[j] >= upper[j]:
                return False, NOTHING, 0
        elif side == AT_LOWER:
            value = lower[j]
        elif side == AT_UPPER:
            value = upper[j]
        if not lower[j] <= value <= upper[j] or abs(value) > 1e300:
            return False, NOTHING, 0
        x[j] = value
        member[j] = side
    if f > m:
        return False, NOTHING, 0
    mp = (m + LANES - 1) // LANES * LANES
    head = take_columns(A, d, S, I, mp)
    right, tried, known = refine(A, lower, upper, S, I, m, mp, head, k, f, rounding_unit)
    if not right:
        return False, known, head
    for i in range(DIRECTIONS, FLOPS + 1):
        counts[i] = 0
    counts[DIRECTIONS] = counts[FACTORIZATIONS] = 1 if tried else 0
    products = product_flops(m, k) + product_flops(m, f)
    counts[FLOPS] = (tried + 1) * products + tried * 2 * triangular_flops(f)
    if tried:
        counts[FLOPS] += m * f * f + f * f * f // 3
    leave(row_id, lower, upper, S, I, k)
    return True, known, head


@stage
def refine(A, lower, upper, S, I, m, mp, head, k, f, rounding_unit):
    """Newton's method on F with r from A itself; x of the other rows stays.

    Returns whether the KKT conditions hold to rounding, how many steps were made, and what is known
    of A.
    """
    tried, known, slope_before = 0, COLUMNS, 0.0
    while True:
        found, slope = look_at(
            lower, upper, S, I, mp, head, k, f, tried, slope_before, rounding_unit
        )
        if found != GO_ON:
            return found == RIGHT, tried, known
        slope_before = slope
        tried += 1
        if tried == 1:
            known = take_gram_of_free(A, S, I, head, f)
            if factorize_gram(S, I, m, k, 0.0) < f:
                return False, tried, known
            known |= HAS_L
        if not correct(lower, upper, S, I, f):
            return False, tried, known


@stage
def look_at(lower, upper, S, I, mp, head, k, f, tried, slope_before, rounding_unit):
    """r and Δ_F anew: `RIGHT`, the KKT conditions hold, `GO_ON`, or `GIVE_UP`; and ‖Δ_F‖, of
    columns of length 1.

    tried, slope_before : steps made, and ‖Δ_F‖ before the last of them
    """
    H0, B0 = N_FLOAT_ROWS + 2 * S.shape[1], N_FLOAT_ROWS
    r, g, free = S[RESIDUAL], S[GRADIENT], I[F]
    size_of_terms = residual_and_sizes(S, I, mp, head, k, FRESH, RESIDUAL)
    if not size_of_terms < 1e150:
        return GIVE_UP, 0.0
    rounding = rounding_unit * size_of_terms
    for j in range(k):
        g[j] = 0.0
    for i in range(head, mp):
        g[I[ALONE_IN, i]] += S[ALONE, i] * r[i]
    slope = 0.0
    for c in range(f):
        b, along, size = S[B0 + free[c]], g[free[c]], S[ALONE2, free[c]]
        for i in range(head):
            along += b[i] * r[i]
            size += b[i] * b[i]
        g[free[c]] = along
        S[H0 + free[c], free[c]] = size
        if size > 0.0:
            slope += along * along / size
    slope = sqrt(slope)
    if slope <= rounding * sqrt(max(f, 1)):
        if size_of_terms > OUT_OF_PROPORTION * row_length(S, mp, FRESH):
            return GIVE_UP, slope
        if not on_wrong_side(lower, upper, S, I, head, k, rounding):
            return RIGHT, slope
        if tried > 0 or f == 0:
            return GIVE_UP, slope
        # A_Fᵀ r is rounding, r itself may not be yet
    if tried == REFINEMENTS or (tried > 1 and slope > 0.5 * slope_before):
        return GIVE_UP, slope
    return GO_ON, slope


@stage
def correct(lower, upper, S, I, f):
    """x_F −= H_FF⁻¹ Δ_F; whether it stays within its bounds."""
    x, g, p, free = S[Z], S[GRADIENT], S[P], I[F]
    for c in range(f):
        p[c] = -g[free[c]]
    solve_gram(S, I, f)
    for c in range(f):
        j = free[c]
        x[j] += p[c]
        if not lower[j] < x[j] < upper[j]:
            return False
    return True


@stage
def residual_and_sizes(S, I, mp, head, k, d_row, r_row):
    """r = A z + d, from one row into another; returns ‖ |A||z| + |d| ‖.

    head : how many rows of A are in B, the others being in rows ALONE and ALONE_IN

    Four columns at a time: r and the sizes are fetched and put back a quarter as often.
    """
    z, d, r, sizes, B0 = S[Z], S[d_row], S[r_row], S[SIZES], N_FLOAT_ROWS
    for i in range(mp):
        r[i] = d[i]
        sizes[i] = abs(d[i])
    fours = k // 4 * 4
    for j in range(0, fours, 4):
        z0, z1, z2, z3 = z[j], z[j + 1], z[j + 2], z[j + 3]
        b0, b1, b2, b3 = S[B0 + j], S[B0 + j + 1], S[B0 + j + 2], S[B0 + j + 3]
        for i in range(head):
            t0, t1, t2, t3 = z0 * b0[i], z1 * b1[i], z2 * b2[i], z3 * b3[i]
            r[i] += (t0 + t1) + (t2 + t3)
            sizes[i] += (abs(t0) + abs(t1)) + (abs(t2) + abs(t3))
    for j in range(fours, k):
        value, b = z[j], S[B0 + j]
        for i in range(head):
            term = value * b[i]
            r[i] += term
            sizes[i] += abs(term)
    for i in range(head, mp):
        term = S[ALONE, i] * z[I[ALONE_IN, i]]
        r[i] += term
        sizes[i] += abs(term)
    total = 0.0
    for i in range(mp):
        total += sizes[i] * sizes[i]
    return sqrt(total)


@stage
def on_wrong_side(lower, upper, S, I, head, k, rounding):
    """Whether a row outside F ought to move, by more than rounding; row GRADIENT has its Δ but for
    what the rows of B add."""
    x, r, member = S[Z], S[RESIDUAL], I[MEMBER]
    for j in range(k):
        if member[j] != FREE:
            b, along, size = S[N_FLOAT_ROWS + j], S[GRADIENT, j], S[ALONE2, j]
            for i in range(head):
                along += b[i] * r[i]
                size += b[i] * b[i]
            wrong = max(-along if x[j] < upper[j] else 0.0, along if x[j] > lower[j] else 0.0)
            if wrong * wrong > rounding * rounding * size:
                return True
    return False


@stage
def leave(row_id, lower, upper, S, I, k):
    """The answer in Z and MEMBER as `algorithm_2` leaves it, remembered for the next QP."""
    counts, x, member = I[COUNTS], S[Z], I[MEMBER]
    for j in range(k):
        if member[j] == PASSIVE and x[j] <= lower[j]:
            member[j] = AT_LOWER
        elif member[j] == PASSIVE and x[j] >= upper[j]:
            member[j] = AT_UPPER
        S[X, j] = x[j]
        I[OLD_MEMBER, j] = member[j]
        I[OLD_ROW, j] = row_id[j]
    counts[OLD_K], counts[OLD_ORDER], counts[STATUS] = k, -1, SOLVED
