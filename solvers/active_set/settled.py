"""The QP whose working set is still right: one descent direction by normal equations, compiled.

Most QPs of a sequence end after one descent direction on the F of the QP before, and where they are
small the shortest way to it is not a QR factorization but A_Fᵀ A_F = L D Lᵀ, with r computed anew
after each solve so that the squared condition costs digits of the correction only (Björck 1987,
the corrected seminormal equations).  Nothing is scaled, sorted or pivoted.  Where anything is not
as expected (other rows, a small pivot, a bound in the way, a wrong sign, slow refinement) this
gives up before x is touched, and algorithm 2 begins.
"""

from __future__ import annotations

from math import sqrt

from problems.qp import AT_LOWER, AT_UPPER, FREE
from solvers.active_set.compiled import stage
from solvers.active_set.flops import product_flops, triangular_flops
from solvers.active_set.tolerances import LEAST_PIVOT
from solvers.active_set.workspace import (
    COUNTS,
    DIRECTIONS,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    LANES,
    LENGTH,
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


@stage
def solve_settled(A, d, lower, upper, row_id, S, I, rounding_unit):
    """Try to solve a QP on the F of the one before; True when its KKT conditions hold.

    rounding_unit : rounding in Δ, in units of ‖ |A||x| + |d| ‖

    On success everything is left in the workspace as `algorithm_2` does.
    """
    m, k = A.shape
    counts, old_row, member = I[COUNTS], I[OLD_ROW], I[OLD_MEMBER]
    if counts[OLD_K] != k:
        return False
    for j in range(k):
        if old_row[j] != row_id[j]:
            return False
    mp = (m + LANES - 1) // LANES * LANES
    B0, G0 = N_FLOAT_ROWS, N_FLOAT_ROWS + S.shape[1]
    x, r, sizes, g, p = S[Z], S[RESIDUAL], S[SIZES], S[GRADIENT], S[P]
    old_x, squares, pad, free = S[X], S[LENGTH], S[FRESH], I[F]  # squares of lengths, of F
    f = 0
    for j in range(k):
        b = S[B0 + j]
        for i in range(m):
            b[i] = A[i, j]
        for i in range(m, mp):
            b[i] = 0.0
        value = old_x[j]
        if member[j] == FREE:
            free[f] = j
            f += 1
            if lower[j] >= upper[j]:
                return False
        elif member[j] == AT_LOWER:
            value = lower[j]
        elif member[j] == AT_UPPER:
            value = upper[j]
        if not lower[j] <= value <= upper[j] or abs(value) > 1e300:
            return False
        x[j] = value
    if f > m:
        return False
    for i in range(m):
        pad[i] = d[i]
    for i in range(m, mp):
        pad[i] = 0.0

    tried, slope_before, factorized, rounding = 0, 0.0, False, 0.0
    while True:
        for i in range(mp):
            r[i] = pad[i]
            sizes[i] = abs(pad[i])
        for j in range(k):
            value = x[j]
            if value != 0.0:
                b = S[B0 + j]
                for i in range(mp):
                    term = value * b[i]
                    r[i] += term
                    sizes[i] += abs(term)
        total = 0.0
        for i in range(mp):
            total += sizes[i] * sizes[i]
        if not total < 1e300:
            return False
        rounding = rounding_unit * sqrt(total)
        slope = 0.0
        for c in range(f):
            b, along, size = S[B0 + free[c]], 0.0, 0.0
            for i in range(mp):
                along += b[i] * r[i]
                size += b[i] * b[i]
            g[c] = along
            squares[c] = size
            if size > 0.0:
                slope += along * along / size
        slope = sqrt(slope)
        if slope <= rounding * sqrt(max(f, 1)):
            break
        if tried == REFINEMENTS or (tried > 1 and slope > 0.5 * slope_before):
            return False
        slope_before = slope
        tried += 1
        if not factorized:
            factorized = True
            for c in range(f):
                row, b = S[G0 + c], S[B0 + free[c]]
                for e in range(c):
                    other, along = S[B0 + free[e]], 0.0
                    for i in range(mp):
                        along += b[i] * other[i]
                    row[e] = along
                # row c of L, times D on the way
                pivot = squares[c]
                for e in range(c):
                    before, value = S[G0 + e], row[e]
                    for a in range(e):
                        value -= row[a] * before[a]
                    row[e] = value
                for e in range(c):
                    value = row[e]
                    row[e] = value * p[e]  # p holds 1/D until the solve
                    pivot -= value * row[e]
                if pivot <= LEAST_PIVOT * squares[c] or not pivot > 0.0:
                    return False
                p[c] = 1.0 / pivot
                row[c] = p[c]
        for c in range(f):
            row, value = S[G0 + c], -g[c]
            for e in range(c):
                value -= row[e] * p[e]
            p[c] = value
        for c in range(f):
            p[c] *= S[G0 + c, c]
        for c in range(f - 1, -1, -1):
            row, value = S[G0 + c], p[c]
            for e in range(c):
                p[e] -= row[e] * value
        for c in range(f):
            j = free[c]
            x[j] += p[c]
            if not lower[j] < x[j] < upper[j]:
                return False

    for j in range(k):
        if member[j] != FREE:
            b, along, size = S[B0 + j], 0.0, 0.0
            for i in range(mp):
                along += b[i] * r[i]
                size += b[i] * b[i]
            wrong = max(-along if x[j] < upper[j] else 0.0, along if x[j] > lower[j] else 0.0)
            if wrong * wrong > rounding * rounding * size:
                return False
    for j in range(k):
        old_x[j] = x[j]
        I[MEMBER, j] = member[j]
    for i in range(DIRECTIONS, FLOPS + 1):
        counts[i] = 0
    counts[DIRECTIONS] = 1 if tried else 0
    counts[FACTORIZATIONS] = 1 if factorized else 0
    products = product_flops(m, k) + product_flops(m, f)
    counts[FLOPS] = (tried + 1) * products + tried * 2 * triangular_flops(f)
    if factorized:
        counts[FLOPS] += m * f * f + f * f * f // 3
    counts[OLD_ORDER] = -1
    counts[STATUS] = SOLVED
    return True
