"""Normal equations on a small F: H = AᵀA in the rows of R, L D Lᵀ of H_FF in those of W, compiled.

Columns of A stand in B as they are, not scaled.  A contact touches two bodies: where the bits of
TOUCHED tell that two columns have no row in common their entry of H is 0, and where they have some
they are summed from FROM to PAST alone.  Columns are eliminated in the order SORTED, by where in A
their entries are: those of neighbours come after each other, in which order contacts were found or
not.  Row c of L begins at its first entry that is not 0, FIRST[c]: L D Lᵀ has no others (George and
Liu 1981, the envelope).
"""

from __future__ import annotations

import numpy as np

from problems.kernels.compiled import places
from problems.qp import FREE, PASSIVE
from solvers.active_set.compiled import kernel, stage
from solvers.active_set.tolerances import LEAST_PIVOT
from solvers.active_set.workspace import (
    BEFORE_IT,
    EDGE,
    FIRST,
    FRESH,
    FROM,
    MARK,
    MEMBER,
    N_FLOAT_ROWS,
    OLD_MEMBER,
    PAST,
    SORTED,
    TOUCHED,
    F,
    P,
    Y,
)

BITS = 64
"""Of an entry of TOUCHED: each stands for a row of A, or for several next to each other."""
UNROLLED = 4
"""Rows that are multiplied together, which entries of FROM and PAST count by."""
NOTHING, COLUMNS, LONG, SHORT = range(4)
HAS_L = 4
"""What is known of today's A: nothing; its columns are in B; and they are long; and they are short,
so that H of the rows that were free in the last QP is of use where F is another.  A bit beside
these: so is L."""
FEW, REACH = 16, 0.45
"""Of fewer columns, or such as reach on average over more of the rows, all are multiplied whole, in
the order in which they come.  Those of contacts reach over 0.1 to 0.4 of them, measured, those of
robots' joints over more than half."""


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
def find_entries(A, I, mp):
    """Rows TOUCHED, FROM, PAST and SORTED; returns whether columns are short, as of a contact."""
    m, k = A.shape
    touched, start, past, together = I[TOUCHED], I[FROM], I[PAST], (m + BITS - 1) // BITS
    for j in range(k):
        touched[j] = 0
    for i in range(m):
        bit = 1 << (i // together)
        for j in range(k):
            touched[j] |= bit if A[i, j] != 0.0 else 0
    groups = 0
    for j in range(k if k >= FEW else 0):
        bits = np.uint64(touched[j])
        above = bits >> np.uint64(1)
        start[j] = place_of(bits & (~bits + np.uint64(1))) * together // UNROLLED
        past[j] = min((place_of(bits & ~above) + 1) * together + UNROLLED - 1, mp) // UNROLLED
        groups += past[j] - start[j]
    if k >= FEW and UNROLLED * groups <= REACH * mp * k:
        sort_columns(I, mp, k)
        return True
    for j in range(k):
        I[SORTED, j] = j
    return False


@stage
def place_of(bits):
    """The highest bit of a number whose next is 0: the exponent of a float64."""
    return max((np.float64(bits).view(np.int64) >> 52) - 1023, 0)


@stage
def sort_columns(I, mp, k):
    """Row SORTED: the columns by the middle of their entries, where it is the same as they come."""
    start, past, order, count = I[FROM], I[PAST], I[SORTED], I[MARK]
    for i in range(mp // 2 + 1):
        count[i] = 0
    for j in range(k):
        count[start[j] + past[j]] += 1
    before = 0
    for i in range(mp // 2 + 1):
        count[i], before = before, before + count[i]
    for j in range(k):
        place = start[j] + past[j]
        order[count[place]] = j
        count[place] += 1


@stage
def product(S, I, i, j, mp, short):
    """a_iᵀ a_j; of short columns from the rows that both may have an entry in."""
    a, b = S[N_FLOAT_ROWS + i], S[N_FLOAT_ROWS + j]
    p0 = p1 = p2 = p3 = 0.0
    if short:
        for group in places(max(I[FROM, i], I[FROM, j]), min(I[PAST, i], I[PAST, j])):
            l = UNROLLED * group
            p0 += a[l] * b[l]
            p1 += a[l + 1] * b[l + 1]
            p2 += a[l + 2] * b[l + 2]
            p3 += a[l + 3] * b[l + 3]
    else:
        for l in range(mp):
            p0 += a[l] * b[l]
    return (p0 + p1) + (p2 + p3)


@stage
def take_gram_of_free(A, S, I, mp):
    """H_FF but for its diagonal, by columns, and row EDGE: the first of the columns before a column
    that it has a row in common with.  Returns `LONG` or `SHORT`."""
    short = find_entries(A, I, mp)
    touched, order, member = I[TOUCHED], I[SORTED], I[MEMBER]
    for o in range(A.shape[1]):
        j, edge = order[o], o
        if member[j] != FREE:
            continue
        h, bits = S[N_FLOAT_ROWS + 2 * S.shape[1] + j], touched[j]
        for e in range(o):
            i, value = order[e], 0.0
            if bits & touched[i] and member[i] == FREE:
                value = product(S, I, i, j, mp, short)
                edge = min(edge, e)
            h[i] = value
        I[EDGE, o] = edge
    return SHORT if short else LONG


@stage
def take_gram(A, S, I, mp, known):
    """The whole of H, and row EDGE.

    known : what is, by `settled.solve_settled`
    """
    k, H0 = A.shape[1], N_FLOAT_ROWS + 2 * S.shape[1]
    has_H = known & ~HAS_L == SHORT
    short = find_entries(A, I, mp) if known <= COLUMNS else has_H
    if not short:
        take_gram_by_fours(S, I, mp, k)
        return
    touched, order, old_member = I[TOUCHED], I[SORTED], I[OLD_MEMBER]
    for o in range(k):
        j, edge = order[o], o
        h, bits = S[H0 + j], touched[j]
        there = has_H and old_member[j] == FREE
        for e in range(o):
            i, value = order[e], 0.0
            if bits & touched[i]:
                value = h[i] if there and old_member[i] == FREE else product(S, I, i, j, mp, True)
                edge = min(edge, e)
            h[i] = S[H0 + i, j] = value
        h[j] = product(S, I, j, j, mp, True)
        I[EDGE, o] = edge


@kernel
def take_gram_by_fours(S, I, mp, k):
    """The whole of H, and row EDGE, where most columns have rows in common."""
    B0, H0, touched = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1], I[TOUCHED]
    for j in range(k):
        b, h, bits, edge = S[B0 + j], S[H0 + j], touched[j], j
        for e in range(0, j + 1, 4):  # what is past k is not looked at
            p0 = p1 = p2 = p3 = 0.0
            if bits & (touched[e] | touched[e + 1] | touched[e + 2] | touched[e + 3]):
                b0, b1, b2, b3 = S[B0 + e], S[B0 + e + 1], S[B0 + e + 2], S[B0 + e + 3]
                for i in range(mp):
                    value = b[i]
                    p0 += value * b0[i]
                    p1 += value * b1[i]
                    p2 += value * b2[i]
                    p3 += value * b3[i]
                edge = min(edge, e)
            h[e], h[e + 1], h[e + 2], h[e + 3] = p0, p1, p2, p3
        I[EDGE, j] = edge
    for j in range(k):
        for e in range(j + 1, k):
            S[H0 + j, e] = S[H0 + e, j]


@stage
def factorize_gram(S, I, m, k, ridge):
    """F := the free rows; L D Lᵀ of H_FF, 1/D on the diagonal of L; returns |F|.

    Columns that depend on those before them are left out, and their rows become passive.
    ridge : by what share of itself the diagonal of H_FF is larger; then none depends on others
    """
    H0, L0 = N_FLOAT_ROWS + 2 * S.shape[1], N_FLOAT_ROWS + S.shape[1]
    member, free, first_of, inverse = I[MEMBER], I[F], I[FIRST], S[Y]
    order, edge, before_it = I[SORTED], I[EDGE], I[BEFORE_IT]
    f = 0
    for o in range(k):
        j = order[o]
        before_it[o] = f
        if member[j] != FREE:
            continue
        h, row, first = S[H0 + j], S[L0 + f], before_it[edge[o]]
        for e in places(first, f):
            row[e] = h[free[e]]
        for e in range(first, f):  # row f of L, times D on the way
            before, value = S[L0 + e], row[e]
            for a in places(max(first, first_of[e]), e):
                value -= row[a] * before[a]
            row[e] = value
        pivot = (1.0 + ridge) * h[j]
        for e in places(first, f):
            value = row[e]
            row[e] = value * inverse[e]
            pivot -= value * row[e]
        if pivot > LEAST_PIVOT * h[j] and (f < m or ridge > 0.0):
            inverse[f] = row[f] = 1.0 / pivot
            free[f], first_of[f] = j, first
            f += 1
        else:
            member[j] = PASSIVE
    return f


@stage
def solve_gram(S, I, f):
    """Row P := H_FF⁻¹ P."""
    L0, p, first = N_FLOAT_ROWS + S.shape[1], S[P], I[FIRST]
    for c in range(f):
        row, value = S[L0 + c], p[c]
        for e in places(first[c], c):
            value -= row[e] * p[e]
        p[c] = value
    for c in range(f):
        p[c] *= S[L0 + c, c]
    for c in range(f - 1, -1, -1):
        row, value = S[L0 + c], p[c]
        for e in places(first[c], c):
            p[e] -= row[e] * value
