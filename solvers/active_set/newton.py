"""A small QP by projected Newton steps on its Gram matrix, compiled.

Where F is not known yet, or the last one is no longer right, H = AᵀA is made once, and a step costs
one L D Lᵀ of H_FF instead of a QR of A_F.  Newton's method on F leads to a point; who would leave
his bounds on the way is put on them, so that whole sets of rows change sides at once, if the
objective falls by that (Bertsekas 1982); else the way ends where the first is stopped, as in
algorithm 2.  Then all rows with a wrong sign enter F.  Cold, everybody is in F at first: contacts
mostly hold.  Columns that depend on those of F before them are left out, and their x stays; cold it
is what the step of least norm has made of it, so that no few of them bear the load of all.

H squares the condition: what is found is refined with r from A itself (`refine_on_L`), and its
KKT conditions are those of algorithm 2.  Where that does not end it, algorithm 2 goes on from the x
and the F that were reached.
"""

from __future__ import annotations

from math import inf, sqrt

from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE
from solvers.active_set.compiled import kernel, stage
from solvers.active_set.flops import product_flops, triangular_flops
from solvers.active_set.gram import (
    HAS_L,
    NOTHING,
    factorize_gram,
    solve_gram,
    take_columns,
    take_gram,
)
from solvers.active_set.settled import GO_ON, RIGHT, correct, leave, look_at
from solvers.active_set.tolerances import NEAR_ZERO
from solvers.active_set.workspace import (
    ALONE,
    ALONE_IN,
    CHANGES,
    COUNTS,
    DIRECTIONS,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    MEMBER,
    N_FLOAT_ROWS,
    OLD_K,
    OLD_MEMBER,
    OLD_ORDER,
    PREVIOUS,
    SEARCH,
    STEP,
    F,
    P,
    V,
    X,
    Z,
)

ZERO = SEARCH
LEAST, MOST = 4, 256
"""Columns for which this is tried: of fewer a QR is as fast; of more H and its factors cost more
than they save.  Nor is it where a start is warm and k > m: algorithm 2 mends that F sooner."""
FEW, SHARE_OF_K, MANY, WARM_STEPS = 4, 0.5, 30, 8
"""Factorizations before algorithm 2 goes on: cold FEW + SHARE_OF_K k, MANY at most; WARM_STEPS."""
SHARED, MOST_DEPENDENT, RIDGE = 16, 0.5, 1e-6
"""Columns from which a cold start looks for a load that is shared: of fewer, looking takes as long
as it saves (fig5, 9 columns: 2.3 directions in 3.4 µs, 1.7 in 3.8).  Share of dependent columns up
to which it is contacts that share a load: where 77 of 96 depend on the others, as of a minimum
norm, nearly all end at a bound.  What the ridge leaves of the gradient is of that share, and
Newton's steps see to it."""


@kernel
def solve_by_newton(A, d, lower, upper, row_id, S, I, mp, rounding_unit, warm, known, head):
    """Try to solve a QP; returns whether its KKT conditions hold, else whether row X holds what was
    reached, in row OLD_MEMBER the sets, and in row PREVIOUS that it is of this QP.

    warm : x and the sets of rows PREVIOUS are known
    known, head : what is known of A, and how many of its rows are in B (`gram`)
    """
    m, k = A.shape
    counts = I[COUNTS]
    if known == NOTHING:
        head = take_columns(A, d, S, I, mp)
    take_gram(A, S, I, head, known)
    take_slopes(S, I, mp, k, head)
    counts[FLOPS] += m * k * k
    objective = place(lower, upper, S, I, k, warm)
    choose_free(lower, upper, S, I, k, True)
    has_L = known & HAS_L != 0 and is_last_F(I, k)
    if not warm and k >= SHARED:
        dependent = count_dependent(S, I, m, k)
        has_L = not 0 < dependent <= MOST_DEPENDENT * k
        if not has_L:
            objective = share_load(lower, upper, S, I, m, k, objective)
    left = WARM_STEPS if warm else min(FEW + int(SHARE_OF_K * k), MANY)
    before = inf
    # where the objective no longer falls, columns were left out that are wanted
    while left > 0 and before - objective > NEAR_ZERO * abs(objective):
        before = objective
        f, stopped, objective, left = newton_steps(lower, upper, S, I, m, k, objective, left, has_L)
        has_L = False
        if stopped == 0 and wrong_signs(lower, upper, S, I, k) == 0:
            if refine_on_L(lower, upper, S, I, mp, head, k, f, rounding_unit):
                leave(row_id, lower, upper, S, I, k)
                return True, True
            break
        counts[CHANGES] += choose_free(lower, upper, S, I, k, False)
    return False, keep_reached(lower, upper, S, I, k)


@stage
def take_slopes(S, I, mp, k, head):
    """Aᵀd into row V, what of Δ is taken for 0 into ZERO."""
    H0, d, size = N_FLOAT_ROWS + 2 * S.shape[1], S[FRESH], 0.0
    for i in range(mp):
        size += d[i] * d[i]
    for j in range(k):
        b, along = S[N_FLOAT_ROWS + j], 0.0
        for i in range(head):
            along += b[i] * d[i]
        S[V, j] = along
        S[ZERO, j] = NEAR_ZERO * sqrt(size * S[H0 + j, j])
    for i in range(head, mp):
        S[V, I[ALONE_IN, i]] += S[ALONE, i] * d[i]


@stage
def place(lower, upper, S, I, k, warm):
    """Rows where they were, x on today's bounds where it was on one; else free, and nearest to 0.

    Returns the objective.
    """
    x, y = S[Z], S[STEP]
    for j in range(k):
        old = I[PREVIOUS, j] if warm else -1
        side = I[OLD_MEMBER, old] if old >= 0 else FREE
        value = S[X, old] if old >= 0 else 0.0
        I[MEMBER, j] = side
        if side == AT_LOWER and lower[j] > -1e300:
            value = lower[j]
        elif side == AT_UPPER and upper[j] < 1e300:
            value = upper[j]
        x[j] = y[j] = min(max(value, lower[j]), upper[j])
    return look(S, k)


@stage
def look(S, k):
    """Δ = H x + Aᵀd for the x in row STEP; the objective there but for ½‖d‖², times 2."""
    H0, g, y = N_FLOAT_ROWS + 2 * S.shape[1], S[GRADIENT], S[STEP]
    for j in range(k):
        g[j] = S[V, j]
    for j in range(k):
        value = y[j]
        if value != 0.0:
            h = S[H0 + j]
            for i in range(k):
                g[i] += value * h[i]
    objective = 0.0
    for j in range(k):
        objective += y[j] * (g[j] + S[V, j])
    return objective


@stage
def choose_free(lower, upper, S, I, k, first):
    """F: all but those whom the sign of Δ holds at a bound; returns how many were at one.

    first : who was free before is so again, whatever the sign
    """
    x, g, member = S[Z], S[GRADIENT], I[MEMBER]
    entered = 0
    for j in range(k):
        zero, kept = S[ZERO, j], first and member[j] == FREE
        low, high = x[j] <= lower[j], x[j] >= upper[j]
        member[j] = FREE
        if low and (high or (g[j] >= -zero and not kept)):
            member[j] = AT_LOWER
        elif high and g[j] <= zero and not kept:
            member[j] = AT_UPPER
        elif low or high:
            entered += 1
    return entered


@stage
def is_last_F(I, k):
    """Whether the free rows are those that were in the last QP."""
    same = True
    for j in range(k):
        same = same and (I[MEMBER, j] == FREE) == (I[OLD_MEMBER, j] == FREE)
    return same


@stage
def count_dependent(S, I, m, k):
    """L of H_FF; how many columns of F depend on others before them, and are out of it."""
    factorize_gram(S, I, m, k, 0.0)
    dependent = 0
    for j in range(k):
        dependent += I[MEMBER, j] == PASSIVE
    return dependent


@kernel
def share_load(lower, upper, S, I, m, k, objective):
    """x by the step of least norm, cut off at the bounds, where columns of F depend on each other.

    A load that contacts share is on all of them then, and no bound is near.  Returns the objective.
    """
    x, y, member = S[Z], S[STEP], I[MEMBER]
    for j in range(k):
        member[j] = FREE if member[j] == PASSIVE else member[j]
        y[j] = x[j]
    f = factorize_gram(S, I, m, k, RIDGE)
    newton_point(S, I, k, f)
    bend(lower, upper, S, I, f)
    found = look(S, k)
    if found < objective:
        objective = found
        for j in range(k):
            x[j] = y[j]
    I[COUNTS, DIRECTIONS] += 1
    I[COUNTS, FACTORIZATIONS] += 2
    I[COUNTS, FLOPS] += 2 * (f * f * f // 3) + 2 * triangular_flops(f) + product_flops(k, k)
    choose_free(lower, upper, S, I, k, False)
    return objective


@stage
def newton_steps(lower, upper, S, I, m, k, objective, left, has_L):
    """Newton steps on F, `left` of them at most, until one is not stopped, or is worth bending.

    has_L : whether row F and L are there already

    Returns |F|, how many rows were stopped in the last one, the objective, and how many are left.
    """
    counts, x, y = I[COUNTS], S[Z], S[STEP]
    f, stopped = 0, 1
    for j in range(k if has_L else 0):
        f += I[MEMBER, j] == FREE
    while stopped > 0 and left > 0:
        left -= 1
        f = f if has_L else factorize_gram(S, I, m, k, 0.0)
        has_L = False
        newton_point(S, I, k, f)
        for j in range(k):
            y[j] = x[j]
        stopped, share = bend(lower, upper, S, I, f)
        counts[DIRECTIONS] += f > 0
        counts[FACTORIZATIONS] += f > 0
        counts[CHANGES] += stopped
        counts[FLOPS] += f * f * f // 3 + 2 * triangular_flops(f) + product_flops(k, k)
        found = look(S, k)
        if stopped == 0 or found < objective:
            objective = found
            for j in range(k):
                x[j] = y[j]
            break
        advance(lower, upper, S, I, f, share)
    return f, stopped, objective, left


@stage
def newton_point(S, I, k, f):
    """P := the x_F where Δ_F = 0, the other x being what they are."""
    H0 = N_FLOAT_ROWS + 2 * S.shape[1]
    free, p, x, member = I[F], S[P], S[Z], I[MEMBER]
    for c in range(f):
        p[c] = -S[V, free[c]]
    for j in range(k):
        value = x[j]
        if member[j] != FREE and value != 0.0:
            h = S[H0 + j]
            for c in range(f):
                p[c] -= value * h[free[c]]
    solve_gram(S, I, f)


@stage
def bend(lower, upper, S, I, f):
    """STEP := Newton's point, who is beyond a bound put on it; how many, and the share of the way
    at which the first of them is stopped."""
    free, x, y, p = I[F], S[Z], S[STEP], S[P]
    stopped, share = 0, 1.0
    for c in range(f):
        j, value = free[c], p[c]
        if value < lower[j]:
            share = min(share, (lower[j] - x[j]) / (value - x[j]))
            value = lower[j]
            stopped += 1
        elif value > upper[j]:
            share = min(share, (upper[j] - x[j]) / (value - x[j]))
            value = upper[j]
            stopped += 1
        y[j] = value
    return stopped, share


@stage
def advance(lower, upper, S, I, f, share):
    """x goes that share of the way to Newton's point, and who is stopped there leaves F."""
    free, x, p, member = I[F], S[Z], S[P], I[MEMBER]
    for c in range(f):
        j, value = free[c], p[c]
        if value < lower[j] and (lower[j] - x[j]) / (value - x[j]) <= share:
            x[j], member[j] = lower[j], AT_LOWER
        elif value > upper[j] and (upper[j] - x[j]) / (value - x[j]) <= share:
            x[j], member[j] = upper[j], AT_UPPER
        else:
            x[j] += share * (value - x[j])


@stage
def wrong_signs(lower, upper, S, I, k):
    """How many rows outside F ought to move."""
    x, g, member = S[Z], S[GRADIENT], I[MEMBER]
    wrong = 0
    for j in range(k):
        if member[j] != FREE:
            zero = S[ZERO, j]
            if (x[j] < upper[j] and g[j] < -zero) or (x[j] > lower[j] and g[j] > zero):
                wrong += 1
    return wrong


@stage
def refine_on_L(lower, upper, S, I, mp, head, k, f, rounding_unit):
    """As `settled.refine` on an F whose L is there; whether the KKT conditions hold to rounding."""
    tried, slope_before = 0, 0.0
    while True:
        found, slope = look_at(
            lower, upper, S, I, mp, head, k, f, tried, slope_before, rounding_unit
        )
        if found != GO_ON or not correct(lower, upper, S, I, f):
            return found == RIGHT
        slope_before = slope
        tried += 1


@stage
def keep_reached(lower, upper, S, I, k):
    """x and the sets as those of a QP before this one; False where x is not finite."""
    x, member = S[Z], I[MEMBER]
    total = 0.0
    for j in range(k):
        total += abs(x[j])
    if not total < 1e300:
        return False
    for j in range(k):
        S[X, j] = min(max(x[j], lower[j]), upper[j])
        I[OLD_MEMBER, j] = member[j]
        I[PREVIOUS, j] = j
    I[COUNTS, OLD_K], I[COUNTS, OLD_ORDER] = k, -1
    return True
