"""Normal equations on a small F: H = AᵀA in the rows of R, L D Lᵀ of H_FF in those of W, compiled.

Columns of A stand in B as they are, not scaled; F is in the order of the columns.  A contact
touches two bodies: where the bits of TOUCHED tell that two columns have no row in common their
entry of H is 0.  Row c of L begins at its first entry that is not, EDGE[c]: L D Lᵀ has no others
(George and Liu 1981, the envelope).
"""

from __future__ import annotations

from problems.kernels.compiled import places
from problems.qp import FREE, PASSIVE
from solvers.active_set.compiled import stage
from solvers.active_set.tolerances import LEAST_PIVOT
from solvers.active_set.workspace import (
    EDGE,
    FRESH,
    MEMBER,
    N_FLOAT_ROWS,
    TOUCHED,
    F,
    P,
    Y,
)

BITS = 64
"""Of an entry of TOUCHED: each stands for a row of A, or for several next to each other."""


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
def find_entries(A, I):
    """Row TOUCHED."""
    m, k = A.shape
    touched, together = I[TOUCHED], (m + BITS - 1) // BITS
    for j in range(k):
        touched[j] = 0
    for i in range(m):
        bit = 1 << (i // together)
        for j in range(k):
            touched[j] |= bit if A[i, j] != 0.0 else 0


@stage
def take_gram_of_free(A, S, I, mp, f):
    """The lower half of H_FF but for its diagonal."""
    find_entries(A, I)
    B0, H0, free = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1], I[F]
    touched = I[TOUCHED]
    for c in range(f):
        j = free[c]
        b, h, bits = S[B0 + j], S[H0 + j], touched[j]
        for e in range(c):
            i, product = free[e], 0.0
            if bits & touched[i]:
                other = S[B0 + i]
                for l in range(mp):
                    product += b[l] * other[l]
            h[i] = product


@stage
def take_gram(A, S, I, mp, k):
    """The whole of H."""
    find_entries(A, I)
    B0, H0 = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1]
    touched = I[TOUCHED]
    for j in range(k):
        b, h, bits = S[B0 + j], S[H0 + j], touched[j]
        for e in range(0, j + 1, 4):  # four at a time; what is past k is not looked at
            p0 = p1 = p2 = p3 = 0.0
            if bits & (touched[e] | touched[e + 1] | touched[e + 2] | touched[e + 3]):
                b0, b1, b2, b3 = S[B0 + e], S[B0 + e + 1], S[B0 + e + 2], S[B0 + e + 3]
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
    member, free, edge, inverse = I[MEMBER], I[F], I[EDGE], S[Y]
    f = 0
    for j in range(k):
        if member[j] != FREE:
            continue
        h, row = S[H0 + j], S[L0 + f]
        first = 0
        while first < f and h[free[first]] == 0.0:
            first += 1
        for e in places(first, f):
            row[e] = h[free[e]]
        for e in range(first, f):  # row f of L, times D on the way
            before, value = S[L0 + e], row[e]
            for a in places(max(first, edge[e]), e):
                value -= row[a] * before[a]
            row[e] = value
        pivot = h[j]
        for e in places(first, f):
            value = row[e]
            row[e] = value * inverse[e]
            pivot -= value * row[e]
        if pivot > LEAST_PIVOT * h[j] and f < m:
            inverse[f] = row[f] = 1.0 / pivot
            free[f], edge[f] = j, first
            f += 1
        else:
            member[j] = PASSIVE
    return f


@stage
def solve_gram(S, I, f):
    """Row P := H_FF⁻¹ P."""
    L0, p, edge = N_FLOAT_ROWS + S.shape[1], S[P], I[EDGE]
    for c in range(f):
        row, value = S[L0 + c], p[c]
        for e in places(edge[c], c):
            value -= row[e] * p[e]
        p[c] = value
    for c in range(f):
        p[c] *= S[L0 + c, c]
    for c in range(f - 1, -1, -1):
        row, value = S[L0 + c], p[c]
        for e in places(edge[c], c):
            p[e] -= row[e] * value
