"""Normal equations on a small F: H = AᵀA in the rows of R, L D Lᵀ of H_FF in those of W, compiled.

Columns of A stand in B as they are, not scaled.  A contact touches two bodies: where the bits of
TOUCHED tell that two columns have no row in common their entry of H is 0, and where they have some
they are summed from FROM to PAST alone.  Columns are eliminated in the order SORTED, by where in A
their entries are: those of neighbours come after each other, in which order contacts were found or
not.  Row c of L begins at its first entry that is not 0, FIRST[c]: L D Lᵀ has no others (George and
Liu 1981, the envelope).

Where contacts are soft, as MuJoCo's, A ends with a diagonal, and so do regularized least squares.
The last rows that have one entry at most are not in B but in the rows ALONE and ALONE_IN: in H they
are on the diagonal only.
"""

from __future__ import annotations

import numpy as np

from problems.kernels.compiled import places
from problems.qp import FREE, PASSIVE
from solvers.active_set.compiled import kernel, stage
from solvers.active_set.tolerances import LEAST_PIVOT
from solvers.active_set.workspace import (
    ALONE,
    ALONE2,
    ALONE_IN,
    BEFORE_IT,
    EDGE,
    FIRST,
    FRESH,
    FROM,
    LANES,
    MARK,
    MEMBER,
    N_FLOAT_ROWS,
    NORM2,
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
NOTHING, COLUMNS, LONG, SHORT, WHOLE = range(5)
HAS_L = 8
"""What is known of today's A: nothing; its columns are in B; and they are long; and they are short,
so that H of the rows that were free in the last QP is of use where F is another; and so is all of
H.  A bit beside these: so is L."""
MANY = 12
"""Columns from which rows of a full L are made by fours."""
SUMS = NORM2
FEW, REACH = 16, 0.45
"""Of fewer columns, or such as reach on average over more of the rows, all are multiplied whole, in
the order in which they come.  Those of contacts reach over 0.1 to 0.4 of them, measured, those of
robots' joints over more than half."""


@stage
def take_columns(A, d, S, I, mp):
    """The first rows of A into B, d into row FRESH, both continued with zeros.

    Returns how many rows B has, a multiple of `LANES`.  From there on row i of A is ALONE[i] in
    column ALONE_IN[i]; row ALONE2 has the sums of their squares, by columns.
    """
    m, k = A.shape
    head = take_lonely_rows(A, S, I, mp)
    rows = min(head, m)
    for j in range(k):
        b = S[N_FLOAT_ROWS + j]
        for i in range(rows):
            b[i] = A[i, j]
        for i in range(rows, head):
            b[i] = 0.0
    for i in range(m):
        S[FRESH, i] = d[i]
    for i in range(m, mp):
        S[FRESH, i] = 0.0
    return head


@stage
def take_lonely_rows(A, S, I, mp):
    """Rows ALONE, ALONE_IN and ALONE2; returns where the rows begin that are in them."""
    m, k = A.shape
    alone, alone_in, squares = S[ALONE], I[ALONE_IN], S[ALONE2]
    for j in range(k):
        squares[j] = 0.0
    past = m
    while past > LANES and k > 0:
        i, entries, column = past - 1, 0, 0
        for j in range(k):
            there = A[i, j] != 0.0
            entries += there
            column += j if there else 0
        if entries > 1:
            break
        alone[i], alone_in[i] = A[i, column], column
        past = i
    head = min((past + LANES - 1) // LANES * LANES, mp)
    for i in range(head, m):
        squares[alone_in[i]] += alone[i] * alone[i]
    for i in range(max(head, m), mp):
        alone[i], alone_in[i] = 0.0, 0
    return head


@stage
def find_entries(A, I, head):
    """Rows TOUCHED, FROM, PAST and SORTED; returns whether columns are short, as of a contact."""
    m, k = min(A.shape[0], head), A.shape[1]
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
        past[j] = min((place_of(bits & ~above) + 1) * together + UNROLLED - 1, head) // UNROLLED
        groups += past[j] - start[j]
    if k >= FEW and UNROLLED * groups <= REACH * head * k:
        sort_columns(I, head, k)
        return True
    for j in range(k):
        I[SORTED, j] = j
    return False


@stage
def place_of(bits):
    """The highest bit of a number whose next is 0: the exponent of a float64."""
    return max((np.float64(bits).view(np.int64) >> 52) - 1023, 0)


@stage
def sort_columns(I, head, k):
    """Row SORTED: the columns by the middle of their entries, where it is the same as they come."""
    start, past, order, count = I[FROM], I[PAST], I[SORTED], I[MARK]
    for i in range(head // 2 + 1):
        count[i] = 0
    for j in range(k):
        count[start[j] + past[j]] += 1
    before = 0
    for i in range(head // 2 + 1):
        count[i], before = before, before + count[i]
    for j in range(k):
        place = start[j] + past[j]
        order[count[place]] = j
        count[place] += 1


@stage
def product(S, I, i, j, head, short):
    """a_iᵀ a_j in the rows of B; of short columns from the rows that both may have an entry in."""
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
        for l in range(head):
            p0 += a[l] * b[l]
    return (p0 + p1) + (p2 + p3)


@stage
def take_gram_of_free(A, S, I, head, f):
    """H_FF but for its diagonal, by columns, and row EDGE: the first of the columns before a column
    that it has a row in common with.  Returns `LONG`, `SHORT`, or `WHOLE`.

    f : how many are free; where these are most of many long ones all of H is made, by fours
    """
    short = find_entries(A, I, head)
    if not short and f >= FEW and 4 * f >= 3 * A.shape[1]:
        take_gram_by_fours(S, I, head, A.shape[1])
        return WHOLE
    touched, order, member = I[TOUCHED], I[SORTED], I[MEMBER]
    for o in range(A.shape[1]):
        j, edge = order[o], o
        if member[j] != FREE:
            continue
        h, bits = S[N_FLOAT_ROWS + 2 * S.shape[1] + j], touched[j]
        for e in range(o):
            i, value = order[e], 0.0
            if bits & touched[i] and member[i] == FREE:
                value = product(S, I, i, j, head, short)
                edge = min(edge, e)
            h[i] = value
        I[EDGE, o] = edge
    return SHORT if short else LONG


@stage
def take_gram(A, S, I, head, known):
    """The whole of H, and row EDGE.

    known : what is, by `settled.solve_settled`
    """
    k, H0 = A.shape[1], N_FLOAT_ROWS + 2 * S.shape[1]
    if known & ~HAS_L == WHOLE:
        return
    has_H = known & ~HAS_L == SHORT
    short = find_entries(A, I, head) if known <= COLUMNS else has_H
    if not short:
        take_gram_by_fours(S, I, head, k)
        return
    touched, order, old_member = I[TOUCHED], I[SORTED], I[OLD_MEMBER]
    for o in range(k):
        j, edge = order[o], o
        h, bits = S[H0 + j], touched[j]
        there = has_H and old_member[j] == FREE
        for e in range(o):
            i, value = order[e], 0.0
            if bits & touched[i]:
                value = h[i] if there and old_member[i] == FREE else product(S, I, i, j, head, True)
                edge = min(edge, e)
            h[i] = S[H0 + i, j] = value
        h[j] = product(S, I, j, j, head, True) + S[ALONE2, j]
        I[EDGE, o] = edge


@kernel
def take_gram_by_fours(S, I, head, k):
    """The whole of H, and row EDGE, where most columns have rows in common."""
    B0, H0, touched = N_FLOAT_ROWS, N_FLOAT_ROWS + 2 * S.shape[1], I[TOUCHED]
    for j in range(k):
        b, h, bits, edge = S[B0 + j], S[H0 + j], touched[j], j
        for e in range(0, j + 1, 4):  # what is past k is not looked at
            p0 = p1 = p2 = p3 = 0.0
            if bits & (touched[e] | touched[e + 1] | touched[e + 2] | touched[e + 3]):
                b0, b1, b2, b3 = S[B0 + e], S[B0 + e + 1], S[B0 + e + 2], S[B0 + e + 3]
                for i in range(head):
                    value = b[i]
                    p0 += value * b0[i]
                    p1 += value * b1[i]
                    p2 += value * b2[i]
                    p3 += value * b3[i]
                edge = min(edge, e)
            h[e], h[e + 1], h[e + 2], h[e + 3] = p0, p1, p2, p3
        h[j] += S[ALONE2, j]
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
    if k >= MANY and is_full(I, k):
        return factorize_by_fours(S, I, m, k, ridge)
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
def is_full(I, k):
    """Whether most of L is not 0; row EDGE is of the free rows only."""
    total = rows = 0
    for o in range(k):
        free = I[MEMBER, I[SORTED, o]] == FREE
        total += I[EDGE, o] if free else 0
        rows += free
    return 8 * total <= rows * k


@kernel
def factorize_by_fours(S, I, m, k, ridge):
    """As `factorize_gram`, where L is full: what four rows of it need is fetched once."""
    H0, L0 = N_FLOAT_ROWS + 2 * S.shape[1], N_FLOAT_ROWS + S.shape[1]
    member, free, listed, nth, inverse = I[MEMBER], I[F], I[BEFORE_IT], I[MARK], S[Y]
    n = f = 0
    for o in range(k):
        if member[I[SORTED, o]] == FREE:
            listed[n] = I[SORTED, o]
            n += 1
    for c in range(0, n, 4):
        begun, together = f, min(4, n - c)
        start_four_rows(S, I, c, together, f)
        for q in range(together):
            j = listed[c + q]
            h, row = S[H0 + j], S[L0 + begun + q]
            pivot = (1.0 + ridge) * h[j] - S[SUMS, 5 * q]
            for e in range(begun, f):  # those of the four that are in F
                before, value = S[L0 + e], h[free[e]] - S[SUMS, 4 * nth[e] + q]
                for a in range(begun, e):
                    value -= row[a] * before[a]
                row[e] = value
            for e in range(begun, f):
                value = row[e]
                row[e] = value * inverse[e]
                pivot -= value * row[e]
            if pivot > LEAST_PIVOT * h[j] and (f < m or ridge > 0.0):
                kept = S[L0 + f]
                for e in places(0, f if f < begun + q else 0):
                    kept[e] = row[e]
                inverse[f] = kept[f] = 1.0 / pivot
                free[f], I[FIRST, f], nth[f] = j, 0, q
                f += 1
            else:
                member[j] = PASSIVE
    return f


@stage
def start_four_rows(S, I, c, together, f):
    """Rows f to f + 3 of L, those of the columns listed from c on, as far as its columns that are
    there; in row SUMS at 4 p + q, p ≤ q, what they take from entry p, q of H.

    together : how many there are; instead of those that are missing the last is taken again
    """
    H0, L0 = N_FLOAT_ROWS + 2 * S.shape[1], N_FLOAT_ROWS + S.shape[1]
    free, listed, inverse, sums = I[F], I[BEFORE_IT], S[Y], S[SUMS]
    for q in range(together):
        h, row = S[H0 + listed[c + q]], S[L0 + f + q]
        for e in places(0, f):
            row[e] = h[free[e]]
    last = f + together - 1
    r0, r1 = S[L0 + f], S[L0 + min(f + 1, last)]
    r2, r3 = S[L0 + min(f + 2, last)], S[L0 + last]
    for e in range(f):
        before, p0, p1, p2, p3 = S[L0 + e], r0[e], r1[e], r2[e], r3[e]
        for a in places(0, e):
            value = before[a]
            p0 -= value * r0[a]
            p1 -= value * r1[a]
            p2 -= value * r2[a]
            p3 -= value * r3[a]
        r0[e], r1[e], r2[e], r3[e] = p0, p1, p2, p3
    s00 = s01 = s02 = s03 = s11 = s12 = s13 = s22 = s23 = s33 = 0.0
    for e in places(0, f):
        v0, v1, v2, v3 = r0[e], r1[e], r2[e], r3[e]
        w0, w1, w2, w3 = v0 * inverse[e], v1 * inverse[e], v2 * inverse[e], v3 * inverse[e]
        s00 += v0 * w0
        s01 += v0 * w1
        s02 += v0 * w2
        s03 += v0 * w3
        s11 += v1 * w1
        s12 += v1 * w2
        s13 += v1 * w3
        s22 += v2 * w2
        s23 += v2 * w3
        s33 += v3 * w3
    sums[0], sums[1], sums[2], sums[3], sums[5] = s00, s01, s02, s03, s11
    sums[6], sums[7], sums[10], sums[11], sums[15] = s12, s13, s22, s23, s33
    for q in range(together):
        row = S[L0 + f + q]
        for e in places(0, f):
            row[e] *= inverse[e]


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
