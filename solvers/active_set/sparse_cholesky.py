"""Compiled kernels for L with L Lᵀ = B_Fᵀ B_F, the sparse counterpart of `factorization`.

L is Rᵀ of B_F = Q R.  It is computed by columns, each from its left (George and Liu 1981), without
pivoting.  The condition of B_F is squared on the way, so that a solve with L alone is not accurate;
it is the preconditioner of conjugate gradients on the least-squares problem, which lose no digits
(`sparse_loop`).  Where columns depend on each other, L Lᵀ = B_Fᵀ B_F + shift · 1 is there instead.
The places of columns that are not in L hold those of the unit matrix.
"""

from __future__ import annotations

from math import sqrt

from solvers.active_set.compiled import kernel
from solvers.active_set.sparse_workspace import BEGUN, IN_L, LINK, NEXT, PLACE, WORK
from solvers.active_set.workspace import V, Y

DEPENDENT = 1e-11
"""Squared distance of a unit column from the span of others that cannot be told from rounding."""


@kernel
def cholesky(pattern, Bx, S, I, Lx, shift):
    """Factorize the columns with I[IN_L] = 1.

    Returns the flops; as a negative number, −1 − flops, when a column was found dependent.
    """
    k = pattern.order.size
    Bp, Bi, Rp, Rc, Rx = pattern.Bp, pattern.Bi, pattern.Rp, pattern.Rc, pattern.Rx
    Lp, Li = pattern.Lp, pattern.Li
    inside, work, head, following = I[IN_L], S[WORK], I[LINK], I[NEXT]
    head[:k] = -1  # first of the columns whose next entry to be used is in this row
    place = I[PLACE]  # of that entry in L
    begun = I[BEGUN]  # first entry of each row of B that is not left of c
    for i in range(Rp.size - 1):
        begun[i] = Rp[i]
    flops = 0
    for c in range(k):
        first, end = Lp[c], Lp[c + 1]
        if not inside[c]:
            for b in range(Bp[c], Bp[c + 1]):
                begun[Bi[b]] += 1
            for l in range(first, end):
                Lx[l] = 0.0
            Lx[first] = 1.0
            column = head[c]
            while column >= 0:  # rows that are left out stay 0
                later = following[column]
                place[column] += 1
                if place[column] < Lp[column + 1]:
                    row = Li[place[column]]
                    following[column] = head[row]
                    head[row] = column
                column = later
            continue
        for l in range(first, end):
            work[Li[l]] = 0.0
        for b in range(Bp[c], Bp[c + 1]):
            i, value = Bi[b], Bx[b]
            for r in range(begun[i], Rp[i + 1]):
                work[Rc[r]] += value * Bx[Rx[r]]
            flops += 2 * (Rp[i + 1] - begun[i])
            begun[i] += 1
        column = head[c]
        while column >= 0:
            later = following[column]
            l0, l1 = place[column], Lp[column + 1]
            factor = Lx[l0]
            if factor != 0.0:
                for l in range(l0, l1):
                    work[Li[l]] -= factor * Lx[l]
                flops += 2 * (l1 - l0)
            place[column] = l0 + 1
            if l0 + 1 < l1:
                row = Li[l0 + 1]
                following[column] = head[row]
                head[row] = column
            column = later
        pivot = work[c] + shift
        if pivot <= DEPENDENT:
            return -1 - flops
        inverse = 1.0 / sqrt(pivot)
        Lx[first] = pivot * inverse
        for l in range(first + 1, end):
            row = Li[l]
            Lx[l] = work[row] * inverse if inside[row] else 0.0
        flops += end - first
        if end > first + 1:
            place[c] = first + 1
            row = Li[first + 1]
            following[c] = head[row]
            head[row] = c
    return flops


@kernel
def solve_L(pattern, Lx, x):
    """x := L⁻¹ x."""
    Lp, Li = pattern.Lp, pattern.Li
    for c in range(Lp.size - 1):
        value = x[c] / Lx[Lp[c]]
        x[c] = value
        for l in range(Lp[c] + 1, Lp[c + 1]):
            x[Li[l]] -= value * Lx[l]


@kernel
def solve_LT(pattern, Lx, x):
    """x := L⁻ᵀ x."""
    Lp, Li = pattern.Lp, pattern.Li
    for c in range(Lp.size - 2, -1, -1):
        value = x[c]
        for l in range(Lp[c] + 1, Lp[c + 1]):
            value -= Lx[l] * x[Li[l]]
        x[c] = value / Lx[Lp[c]]


@kernel
def inverse_norm(pattern, S, Lx):
    """Estimate ‖L⁻¹‖₂ from below, as `factorization.inverse_norm_estimate` does for R = Lᵀ."""
    Lp, Li = pattern.Lp, pattern.Li
    k = Lp.size - 1
    sums, y = S[V], S[Y]
    for c in range(k):
        sums[c] = 0.0
    before = 0.0
    for c in range(k):
        pivot = Lx[Lp[c]]
        sign = -1.0 if sums[c] > 0 else 1.0
        greedy, other = (sign - sums[c]) / pivot, (-sign - sums[c]) / pivot
        grown_greedy, grown_other = abs(greedy), abs(other)
        for l in range(Lp[c] + 1, Lp[c + 1]):
            row, entry = Li[l], Lx[l]
            grown_greedy += abs(sums[row] + entry * greedy)
            grown_other += abs(sums[row] + entry * other)
        value = greedy if grown_greedy >= grown_other else other
        y[c] = value
        before += value * value
        for l in range(Lp[c] + 1, Lp[c + 1]):
            sums[Li[l]] += value * Lx[l]
    if before == 0.0:
        return 1.0
    solve_LT(pattern, Lx, y)
    after = 0.0
    for c in range(k):
        after += y[c] * y[c]
    return sqrt(after / before)
