"""Compiled kernels for L with L Lᵀ = B_Fᵀ B_F, the sparse counterpart of `factorization`.

L is Rᵀ of B_F = Q R.  It is computed by fronts, each from those left of it (Ng and Peyton 1993),
without pivoting.  The condition of B_F is squared on the way, so that a solve with L alone is not
accurate; it is the preconditioner of conjugate gradients on the least-squares problem, which lose
no digits (`sparse_direction`).  Where columns depend on each other, L Lᵀ = B_Fᵀ B_F + shift · 1 is
there instead.  The places of columns that are not in L hold those of the unit matrix.

A column is taken out of L, or into it, along its path to the root (Davis and Hager 2005).

Lx holds a block for each front, (columns, rows), with reciprocals on the diagonal.  Rows
SPREAD, CHANGED and WEIGHT of S are 0 between calls.
"""

from __future__ import annotations

from math import sqrt

from problems.kernels.compiled import places
from solvers.active_set.compiled import kernel, stage
from solvers.active_set.sparse.pattern import SLOTS
from solvers.active_set.sparse.workspace import CHANGED, IN_L, PLACE, SPREAD, WEIGHT, WORK
from solvers.active_set.tolerances import DEPENDENT
from solvers.active_set.workspace import V, Y


@stage
def dot(Bi, Bx, c, x):
    """b_cᵀ x."""
    total = 0.0
    for first in range(0, Bi.shape[1], SLOTS):
        for b in range(first, first + SLOTS):
            total += Bx[c, b] * x[Bi[c, b]]
    return total


@stage
def add(Bi, Bx, c, value, x):
    """x := x + value b_c."""
    for first in range(0, Bi.shape[1], SLOTS):
        for b in range(first, first + SLOTS):
            x[Bi[c, b]] += value * Bx[c, b]


@stage
def spread(Bi, Bx, c, x):
    """x := b_c at its rows; returns ‖b_c‖²."""
    total = 0.0
    for first in range(0, Bi.shape[1], SLOTS):
        for b in range(first, first + SLOTS):
            value = Bx[c, b]
            x[Bi[c, b]] = value
            total += value * value
    return total


@stage
def clear(Bi, c, x):
    """x := 0 at the rows of b_c."""
    for first in range(0, Bi.shape[1], SLOTS):
        for b in range(first, first + SLOTS):
            x[Bi[c, b]] = 0.0


@stage
def add_four(columns, size, row, end, target, sign):
    """target_i += sign · Σ L_row L_i over four columns of L, i = row … end − 1.

    columns : they begin with the first of them;  size : of each
    """
    one, two = columns[:size], columns[size : 2 * size]
    three, four = columns[2 * size : 3 * size], columns[3 * size : 4 * size]
    x1, x2, x3, x4 = sign * one[row], sign * two[row], sign * three[row], sign * four[row]
    for i in places(row, end):
        target[i] += (x1 * one[i] + x2 * two[i]) + (x3 * three[i] + x4 * four[i])


@kernel
def cholesky(pattern, Bx, S, I, Lx, shift):
    """Factorize BᵀB + shift + row WEIGHT for the columns with I[IN_L] = 1.

    Returns the flops; as a negative number, −1 − flops, when a column was found dependent.
    """
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    Bi, Gp, Gi, Gx = pattern.Bi, pattern.Gp, pattern.Gi, pattern.Gx
    Up, Ut, Ua, Ub = pattern.Up, pattern.Ut, pattern.Ua, pattern.Ub
    inside, full, place, work = I[IN_L], S[SPREAD], I[PLACE], S[WORK]
    weight = S[WEIGHT]
    flops = 0
    for s in range(first.size - 1):
        c0, width, height = first[s], first[s + 1] - first[s], Rp[s + 1] - Rp[s]
        begin, rows = Lp[s], Rp[s]
        block = Lx[begin : Lp[s + 1]]
        for l in range(block.size):
            block[l] = 0.0
        for c in range(c0, c0 + width):
            if inside[c]:
                diagonal = begin + (c - c0) * (height + 1)
                Lx[diagonal] = spread(Bi, Bx, c, full) + shift + weight[c]
                for g in range(Gp[c], Gp[c + 1]):
                    if inside[Gi[g]]:
                        Lx[Gx[g]] = dot(Bi, Bx, Gi[g], full)
                clear(Bi, c, full)
                flops += 12 * (Gp[c + 1] - Gp[c] + 1)
        if Up[s + 1] > Up[s]:
            for i in range(height):
                place[Ri[rows + i]] = i
        for u in range(Up[s], Up[s + 1]):
            t = Ut[u]
            columns, end = first[t + 1] - first[t], Rp[t + 1] - Rp[t]
            their_rows, L = Ri[Rp[t] : Rp[t + 1]], Lx[Lp[t] : Lp[t + 1]]
            for a in range(Ua[u], Ub[u]):
                c = their_rows[a]
                if not inside[c]:
                    continue
                target = block[(c - c0) * height : (c - c0 + 1) * height]
                flops += 2 * columns * (end - a)
                if columns == 1:
                    for i in places(a, end):
                        target[place[their_rows[i]]] -= L[a] * L[i]
                    continue
                for i in places(a, end):
                    work[i] = 0.0
                for q in range(0, columns - 3, 4):
                    add_four(L[q * end :], end, a, end, work, 1.0)
                for q in range(columns // 4 * 4, columns):
                    column = L[q * end : (q + 1) * end]
                    for i in places(a, end):
                        work[i] += column[a] * column[i]
                for i in places(a, end):
                    target[place[their_rows[i]]] -= work[i]
        for q in range(width):
            column = block[q * height : (q + 1) * height]
            if q % 4 == 0 and q > 0:
                for j in range(q, width):
                    target = block[j * height : (j + 1) * height]
                    add_four(block[(q - 4) * height :], height, j, height, target, -1.0)
            if not inside[c0 + q]:
                for i in places(q + 1, height):
                    column[i] = 0.0
                column[q] = 1.0
                continue
            pivot = column[q]
            if pivot <= DEPENDENT:
                return -1 - flops
            inverse = 1.0 / sqrt(pivot)
            for i in places(q + 1, height):
                column[i] *= inverse
            column[q] = inverse
            panel = min(width, q // 4 * 4 + 4)
            for j in range(q + 1, panel):
                target, x = block[j * height : (j + 1) * height], column[j]
                for i in places(j, height):
                    target[i] -= x * column[i]
            flops += height - q + (width - q - 1) * (2 * height - width - q)
    return flops


@kernel
def solve_L(pattern, Lx, x):
    """x := L⁻¹ x."""
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    for s in range(first.size - 1):
        width, height = first[s + 1] - first[s], Rp[s + 1] - Rp[s]
        block, rows = Lx[Lp[s] : Lp[s + 1]], Ri[Rp[s] : Rp[s + 1]]
        own = x[first[s] : first[s + 1]]
        for q in range(width):
            column = block[q * height : (q + 1) * height]
            value = own[q] * column[q]
            own[q] = value
            for i in places(q + 1, width):
                own[i] -= value * column[i]
        q = 0
        while q + 3 < width:
            columns = block[q * height : (q + 4) * height]
            one, two = columns[:height], columns[height : 2 * height]
            three, four = columns[2 * height : 3 * height], columns[3 * height :]
            x1, x2, x3, x4 = own[q], own[q + 1], own[q + 2], own[q + 3]
            for i in places(width, height):
                x[rows[i]] -= (x1 * one[i] + x2 * two[i]) + (x3 * three[i] + x4 * four[i])
            q += 4
        while q < width:
            column = block[q * height : (q + 1) * height]
            for i in places(width, height):
                x[rows[i]] -= own[q] * column[i]
            q += 1


@kernel
def solve_LT(pattern, Lx, x):
    """x := L⁻ᵀ x."""
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    for s in range(first.size - 2, -1, -1):
        width, height = first[s + 1] - first[s], Rp[s + 1] - Rp[s]
        block, rows = Lx[Lp[s] : Lp[s + 1]], Ri[Rp[s] : Rp[s + 1]]
        own = x[first[s] : first[s + 1]]
        q = 0
        while q + 3 < width:
            columns = block[q * height : (q + 4) * height]
            one, two = columns[:height], columns[height : 2 * height]
            three, four = columns[2 * height : 3 * height], columns[3 * height :]
            x1 = x2 = x3 = x4 = 0.0
            for i in places(width, height):
                value = x[rows[i]]
                x1 += value * one[i]
                x2 += value * two[i]
                x3 += value * three[i]
                x4 += value * four[i]
            own[q] -= x1
            own[q + 1] -= x2
            own[q + 2] -= x3
            own[q + 3] -= x4
            q += 4
        while q < width:
            column, product = block[q * height : (q + 1) * height], 0.0
            for i in places(width, height):
                product += x[rows[i]] * column[i]
            own[q] -= product
            q += 1
        for q in range(width - 1, -1, -1):
            column = block[q * height : (q + 1) * height]
            value = own[q]
            for i in places(q + 1, width):
                value -= column[i] * own[i]
            own[q] = value * column[q]


@kernel
def inverse_norm(pattern, S, I, Lx):
    """Estimate ‖L⁻¹‖₂ from below, as `factorization.inverse_norm_estimate` does for R = Lᵀ.

    Of the columns with I[IN_L] = 1; the others are those of the identity.
    """
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    sums, y, inside = S[V], S[Y], I[IN_L]
    for c in range(first[first.size - 1]):
        sums[c] = 0.0
    before = 0.0
    for s in range(first.size - 1):
        height = Rp[s + 1] - Rp[s]
        for q in range(first[s + 1] - first[s]):
            c, at = first[s] + q, Lp[s] + q * height
            if not inside[c]:
                y[c] = 0.0
                continue
            sign = -1.0 if sums[c] > 0 else 1.0
            greedy, other = (sign - sums[c]) * Lx[at + q], (-sign - sums[c]) * Lx[at + q]
            grown_greedy, grown_other = abs(greedy), abs(other)
            for i in range(q + 1, height):
                row, entry = Ri[Rp[s] + i], Lx[at + i]
                grown_greedy += abs(sums[row] + entry * greedy)
                grown_other += abs(sums[row] + entry * other)
            value = greedy if grown_greedy >= grown_other else other
            y[c] = value
            before += value * value
            for i in range(q + 1, height):
                sums[Ri[Rp[s] + i]] += value * Lx[at + i]
    if before == 0.0:
        return 1.0
    solve_LT(pattern, Lx, y)
    after = 0.0
    for c in range(first[first.size - 1]):
        after += y[c] * y[c]
    return sqrt(after / before)


@kernel
def change_path(pattern, Lx, w, c, sign):
    """L Lᵀ := L Lᵀ + sign w wᵀ, w in the columns from c on up the tree; w becomes 0.

    Returns whether the outcome is positive definite; L is of no use where it is not.
    """
    first, front, Rp, Ri, Lp = pattern.first, pattern.front, pattern.Rp, pattern.Ri, pattern.Lp
    sound = True
    while c >= 0:
        s = front[c]
        height, rows = Rp[s + 1] - Rp[s], Rp[s]
        for q in range(c - first[s], first[s + 1] - first[s]):
            value = w[first[s] + q]
            w[first[s] + q] = 0.0
            if value == 0.0:
                continue
            at = Lp[s] + q * height
            sine = value * Lx[at + q]
            cosine2 = 1.0 + sign * sine * sine
            if cosine2 <= DEPENDENT:
                sound, cosine2 = False, 1.0
            cosine = sqrt(cosine2)
            inverse = 1.0 / cosine
            Lx[at + q] *= inverse
            for i in range(q + 1, height):
                row = Ri[rows + i]
                entry = (Lx[at + i] + sign * sine * w[row]) * inverse
                Lx[at + i] = entry
                w[row] = cosine * w[row] - sine * entry
        width = first[s + 1] - first[s]
        c = Ri[rows + width] if height > width else -1
    return sound


@kernel
def delete_column(pattern, Lx, S, I, c):
    """Take column c out of L; returns whether L is sound."""
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    s, w = pattern.front[c], S[CHANGED]
    for u in range(pattern.Up[s], pattern.Up[s + 1]):
        t = pattern.Ut[u]
        for a in range(pattern.Ua[u], pattern.Ub[u]):
            if Ri[Rp[t] + a] == c:
                for q in range(first[t + 1] - first[t]):
                    Lx[Lp[t] + q * (Rp[t + 1] - Rp[t]) + a] = 0.0
    height, place = Rp[s + 1] - Rp[s], c - first[s]
    for q in range(place):
        Lx[Lp[s] + q * height + place] = 0.0
    at = Lp[s] + place * height
    for i in range(place + 1, height):
        w[Ri[Rp[s] + i]] = Lx[at + i]
        Lx[at + i] = 0.0
    Lx[at + place] = 1.0
    I[IN_L, c] = 0
    if place + 1 == height:
        return True
    return change_path(pattern, Lx, w, Ri[Rp[s] + place + 1], 1.0)


@kernel
def insert_column(pattern, Bx, Lx, S, I, c, shift):
    """Take column c into L, at its inner products with the others; returns whether L is sound."""
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    Bi, s, w, full, inside = pattern.Bi, pattern.front[c], S[CHANGED], S[SPREAD], I[IN_L]
    diagonal = spread(Bi, Bx, c, full) + shift
    for u in range(pattern.Up[s], pattern.Up[s + 1]):
        t = pattern.Ut[u]
        for a in range(pattern.Ua[u], pattern.Ub[u]):
            if Ri[Rp[t] + a] == c:
                for other in range(first[t], first[t + 1]):
                    w[other] = dot(Bi, Bx, other, full) if inside[other] else 0.0
    for other in range(first[s], c):
        w[other] = dot(Bi, Bx, other, full) if inside[other] else 0.0
    for g in range(pattern.Gp[c], pattern.Gp[c + 1]):
        other = pattern.Gi[g]
        w[other] = dot(Bi, Bx, other, full) if inside[other] else 0.0
    clear(Bi, c, full)
    w[c] = diagonal
    for u in range(pattern.Up[s], pattern.Up[s + 1]):
        t = pattern.Ut[u]
        for a in range(pattern.Ua[u], pattern.Ub[u]):
            if Ri[Rp[t] + a] == c:
                eliminate(pattern, Lx, w, t, first[t + 1] - first[t], a)
    height, place = Rp[s + 1] - Rp[s], c - first[s]
    eliminate(pattern, Lx, w, s, place, place)
    pivot = w[c]
    w[c] = 0.0
    sound = pivot > DEPENDENT
    inverse = 1.0 / sqrt(pivot) if sound else 1.0
    at = Lp[s] + place * height
    Lx[at + place] = inverse
    for i in range(place + 1, height):
        row = Ri[Rp[s] + i]
        w[row] *= inverse
        Lx[at + i] = w[row]
    I[IN_L, c] = 1
    if place + 1 == height:
        return sound
    return change_path(pattern, Lx, w, Ri[Rp[s] + place + 1], -1.0) and sound


@kernel
def eliminate(pattern, Lx, w, s, columns, place):
    """Forward substitution in w by the first columns of front s; their row `place` of L becomes it.

    w becomes 0 at these columns.
    """
    first, Rp, Ri, Lp = pattern.first, pattern.Rp, pattern.Ri, pattern.Lp
    height = Rp[s + 1] - Rp[s]
    for q in range(columns):
        at = Lp[s] + q * height
        value = w[first[s] + q] * Lx[at + q]
        w[first[s] + q] = 0.0
        Lx[at + place] = value
        if value != 0.0:
            for i in range(q + 1, height):
                w[Ri[Rp[s] + i]] -= value * Lx[at + i]
