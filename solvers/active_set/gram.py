"""Normal equations on a small F: H = AᵀA in the rows of R, L D Lᵀ of H_FF in those of W, compiled.

Columns of A stand in B as they are, not scaled; F is in the order of the columns.
"""

from __future__ import annotations

from problems.qp import FREE, PASSIVE
from solvers.active_set.compiled import stage
from solvers.active_set.tolerances import LEAST_PIVOT
from solvers.active_set.workspace import FRESH, MEMBER, N_FLOAT_ROWS, F, P, Y


@stage
def take_columns(A, d, S, mp):
    """A column after column into B, d into row FRESH, both continued with zeros."""
    m, k = A.shape
    for j in range(k):
        b = S[N_FLOAT_ROWS + j]
        for i in range(m):
            b[i] = A[i, j]
        for i in range(m, mp):
            b[i] = 0.0
    for i in range(m):
        S[FRESH, i] = d[i]
    for i in range(m, mp):
        S[FRESH, i] = 0.0


@stage
def take_gram_of_free(S, I, mp, f):
    """The lower half of H_FF but for its diagonal."""
    B0, H0, free = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1], I[F]
    for c in range(f):
        b, h = S[B0 + free[c]], S[H0 + free[c]]
        for e in range(c):
            other, product = S[B0 + free[e]], 0.0
            for i in range(mp):
                product += b[i] * other[i]
            h[free[e]] = product


@stage
def take_gram(S, mp, k):
    """The whole of H."""
    B0, H0 = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1]
    for j in range(k):
        b, h = S[B0 + j], S[H0 + j]
        for e in range(0, j + 1, 4):  # four at a time; what is past k is not looked at
            b0, b1, b2, b3 = S[B0 + e], S[B0 + e + 1], S[B0 + e + 2], S[B0 + e + 3]
            p0 = p1 = p2 = p3 = 0.0
            for i in range(mp):
                value = b[i]
                p0 += value * b0[i]
                p1 += value * b1[i]
                p2 += value * b2[i]
                p3 += value * b3[i]
            h[e], h[e + 1], h[e + 2], h[e + 3] = p0, p1, p2, p3
    for j in range(k):
        for e in range(j + 1, k):
            S[H0 + j, e] = S[H0 + e, j]


@stage
def factorize_gram(S, I, m, k):
    """F := the free rows; L D Lᵀ of H_FF, 1/D on the diagonal of L; returns |F|.

    Columns that depend on those before them are left out, and their rows become passive.
    """
    H0, L0 = N_FLOAT_ROWS + 2 * S.shape[1], N_FLOAT_ROWS + S.shape[1]
    member, free, inverse = I[MEMBER], I[F], S[Y]
    f = 0
    for j in range(k):
        if member[j] != FREE:
            continue
        h, row = S[H0 + j], S[L0 + f]
        for e in range(f):
            row[e] = h[free[e]]
        for e in range(f):  # row f of L, times D on the way
            before, value = S[L0 + e], row[e]
            for a in range(e):
                value -= row[a] * before[a]
            row[e] = value
        pivot = h[j]
        for e in range(f):
            value = row[e]
            row[e] = value * inverse[e]
            pivot -= value * row[e]
        if pivot > LEAST_PIVOT * h[j] and f < m:
            inverse[f] = row[f] = 1.0 / pivot
            free[f] = j
            f += 1
        else:
            member[j] = PASSIVE
    return f


@stage
def solve_gram(S, f):
    """Row P := H_FF⁻¹ P."""
    L0, p = N_FLOAT_ROWS + S.shape[1], S[P]
    for c in range(f):
        row, value = S[L0 + c], p[c]
        for e in range(c):
            value -= row[e] * p[e]
        p[c] = value
    for c in range(f):
        p[c] *= S[L0 + c, c]
    for c in range(f - 1, -1, -1):
        row, value = S[L0 + c], p[c]
        for e in range(c):
            p[e] -= row[e] * value
