"""A guess at F by interior points, where descent directions would have to be taken by the hundred.

From a feasible z, primal-dual path following with Mehrotra's predictor and corrector (1992) on

    min ½‖B z + d‖²,  low ≤ z ≤ high;      g − a + b = 0,  a (z − low) = b (high − z) = μ,  g = Bᵀ r

until k μ, by which the objective can still fall, is small.  A step costs one factorization, of
BᵀB + a/(z − low) + b/(high − z), which has the pattern of L, and moves all variables at once: their
number hardly grows with that of the columns.  What it ends at is neither exact nor at its bounds,
so that it only chooses F: a variable whose distance from a bound has shrunk by more than the
multiplier of the bound in the last step goes there (El-Bakry, Tapia and Zhang 1994).  That is no
matter of units, and of a ridge not either: along it gradients are smaller than z by its square.
Algorithm 2 takes it up.
"""

from __future__ import annotations

from math import inf

from problems.kernels.numba_internals import lent
from solvers.active_set.compiled import kernel
from solvers.active_set.sparse.cholesky import add, cholesky, dot, solve_L, solve_LT
from solvers.active_set.sparse.workspace import (
    DUAL_HIGH,
    DUAL_LOW,
    IN_F,
    IN_L,
    KEPT_F,
    KEPT_Z,
    WEIGHT,
)
from solvers.active_set.tolerances import LEAST_SHIFT, PATH_END
from solvers.active_set.workspace import (
    CHANGES,
    COUNTS,
    DIRECTIONS,
    FACTORIZATIONS,
    FLOPS,
    GRADIENT,
    LOWER,
    MOMENTUM,
    RESIDUAL,
    UPPER,
    P,
    Y,
    Z,
)

STEPS_AT_MOST = 60
"""Steps along the path; some 25 are usual."""
TENTH = 0.1
SHORT_OF_BOUND = 0.995
"""Part of the way to the next bound that a step goes."""


@kernel
def gradient_at(pattern, Bx, S, m):
    """r = B z + d and Bᵀ r into their rows; returns ½‖r‖²."""
    r, z, g, d = S[RESIDUAL], S[Z], S[GRADIENT], S[MOMENTUM]
    for i in range(m):
        r[i] = d[i]
    for c in range(pattern.order.size):
        add(pattern.Bi, Bx, c, z[c], r)
    for c in range(pattern.order.size):
        g[c] = dot(pattern.Bi, Bx, c, r)
    objective = 0.0
    for i in range(m):
        objective += 0.5 * r[i] * r[i]
    return objective


@kernel
def start_inside(pattern, Bx, Lx, S, I, m):
    """z, a and b to start from (Mehrotra 1992); IN_L becomes what is not fixed.

    z is what would be best without bounds, and moved inside by half more than it misses them: so
    it has the size of the answer.  Returns False where BᵀB could not be factorized.
    """
    z, low, high, g, a, b = S[Z], S[LOWER], S[UPPER], S[GRADIENT], S[DUAL_LOW], S[DUAL_HIGH]
    k, y = pattern.order.size, S[Y]
    for c in range(k):
        I[IN_L, c] = 1 if low[c] < high[c] else 0
        y[c] = -g[c] if low[c] < high[c] else 0.0
    I[COUNTS, FACTORIZATIONS] += 1
    flops = cholesky(pattern, Bx, S, I, Lx, LEAST_SHIFT)
    if flops < 0:
        return False
    I[COUNTS, FLOPS] += flops + 8 * pattern.entries
    solve_L(pattern, Lx, y)
    solve_LT(pattern, Lx, y)
    missed = longest = 0.0
    for c in range(k):
        if low[c] < high[c]:
            missed = max(missed, low[c] - z[c] - y[c], z[c] + y[c] - high[c])
            longest = max(longest, abs(y[c]))
    off = 1.5 * missed if missed > 0.0 else TENTH * longest
    for c in range(k):
        if low[c] < high[c]:
            inside, value = min(off, 0.25 * (high[c] - low[c])), z[c] + y[c]
            if low[c] > -inf:
                value = max(value, low[c]) + inside
            if high[c] < inf:
                value = min(value, high[c] - inside)
            z[c] = value
    gradient_at(pattern, Bx, S, m)
    mean = 0.0
    for c in range(k):
        mean += abs(g[c]) / k
    for c in range(k):
        moves = low[c] < high[c]
        a[c] = max(g[c], 0.0) + TENTH * mean if moves and low[c] > -inf else 0.0
        b[c] = max(-g[c], 0.0) + TENTH * mean if moves and high[c] < inf else 0.0
    return off > 0.0 and mean > 0.0


@kernel
def complementarity(S, I, k, step):
    """(mean of a (z − low) and b (high − z), their number) a part `step` of the way along P, which
    takes a and b along as Newton's method for μ = 0 does."""
    z, low, high, p, a, b = S[Z], S[LOWER], S[UPPER], S[P], S[DUAL_LOW], S[DUAL_HIGH]
    total, count = 0.0, 0
    for c in range(k):
        if a[c] > 0.0:
            s = z[c] - low[c]
            total += (s + step * p[c]) * (a[c] - step * (a[c] + a[c] / s * p[c]))
            count += 1
        if b[c] > 0.0:
            s = high[c] - z[c]
            total += (s - step * p[c]) * (b[c] - step * (b[c] - b[c] / s * p[c]))
            count += 1
    return total / max(count, 1), count


@kernel
def change_of_dual(dual, slack, step, target):
    """What Newton's method adds to a multiplier so that multiplier · slack = target."""
    return target / slack - dual - dual / slack * step


@kernel
def longest_step(S, k, row, target, corrected):
    """The part of the step in `row` that leaves z, a and b on their sides of zero, at most 1.

    corrected : the targets are those of the corrector, by the predictor in row P
    """
    z, low, high, a, b = S[Z], S[LOWER], S[UPPER], S[DUAL_LOW], S[DUAL_HIGH]
    step = S[row]
    theta = 1.0
    for c in range(k):
        if a[c] > 0.0:
            s, goal = z[c] - low[c], target
            if corrected:
                goal -= S[P, c] * change_of_dual(a[c], s, S[P, c], 0.0)
            if step[c] < 0.0:
                theta = min(theta, -SHORT_OF_BOUND * s / step[c])
            change = change_of_dual(a[c], s, step[c], goal)
            if change < 0.0:
                theta = min(theta, -SHORT_OF_BOUND * a[c] / change)
        if b[c] > 0.0:
            s, goal = high[c] - z[c], target
            if corrected:
                goal += S[P, c] * change_of_dual(b[c], s, -S[P, c], 0.0)
            if step[c] > 0.0:
                theta = min(theta, SHORT_OF_BOUND * s / step[c])
            change = change_of_dual(b[c], s, -step[c], goal)
            if change < 0.0:
                theta = min(theta, -SHORT_OF_BOUND * b[c] / change)
    return theta


@kernel
def step_along_path(pattern, Bx, Lx, S, I, ridge):
    """One step by predictor and corrector from z, a and b; returns the part that was taken.

    0 where BᵀB + ridge could not be factorized, or not well enough.  IN_F becomes what has not
    gone to a bound as it seems.
    """
    k = pattern.order.size
    z, low, high, g = S[Z], S[LOWER], S[UPPER], S[GRADIENT]
    p, y, a, b, weight = S[P], S[Y], S[DUAL_LOW], S[DUAL_HIGH], S[WEIGHT]
    for c in range(k):
        if a[c] > 0.0:
            weight[c] += a[c] / (z[c] - low[c])
        if b[c] > 0.0:
            weight[c] += b[c] / (high[c] - z[c])
    flops = cholesky(pattern, Bx, S, I, Lx, ridge)
    for c in range(k):
        weight[c] = 0.0
    I[COUNTS, FACTORIZATIONS] += 1
    if flops < 0:
        return 0.0
    I[COUNTS, FLOPS] += flops + 16 * pattern.entries + 4 * pattern.nonzeros
    for c in range(k):
        p[c] = -g[c] if I[IN_L, c] else 0.0
    solve_L(pattern, Lx, p)
    solve_LT(pattern, Lx, p)
    mu, _ = complementarity(S, I, k, 0.0)
    ahead, _ = complementarity(S, I, k, longest_step(S, k, P, 0.0, False))
    target = mu * (ahead / mu) ** 3 if mu > 0.0 else 0.0
    for c in range(k):
        right = -g[c] if I[IN_L, c] else 0.0
        if a[c] > 0.0:
            s = z[c] - low[c]
            right += (target - p[c] * change_of_dual(a[c], s, p[c], 0.0)) / s
        if b[c] > 0.0:
            s = high[c] - z[c]
            right -= (target + p[c] * change_of_dual(b[c], s, -p[c], 0.0)) / s
        y[c] = right
    solve_L(pattern, Lx, y)
    solve_LT(pattern, Lx, y)
    total = 0.0
    for c in range(k):
        total += abs(y[c])
    if not total < inf:
        return 0.0
    theta = longest_step(S, k, Y, target, True)
    inside = I[IN_F]
    for c in range(k):
        inside[c] = I[IN_L, c]
        if a[c] > 0.0:
            s = z[c] - low[c]
            goal = target - p[c] * change_of_dual(a[c], s, p[c], 0.0)
            share = theta * change_of_dual(a[c], s, y[c], goal) / a[c]
            if theta * y[c] / s < share:
                inside[c] = 0
            a[c] += share * a[c]
        if b[c] > 0.0:
            s = high[c] - z[c]
            goal = target + p[c] * change_of_dual(b[c], s, -p[c], 0.0)
            share = theta * change_of_dual(b[c], s, -y[c], goal) / b[c]
            if -theta * y[c] / s < share:
                inside[c] = 0
            b[c] += share * b[c]
    for c in range(k):
        z[c] += theta * y[c]
    return theta


@kernel
def choose_F(S, I, k):
    """z of what is not in F to the nearer bound; returns the size of F and how many variables have
    another member than in row KEPT_F."""
    z, low, high = S[Z], S[LOWER], S[UPPER]
    f = changes = 0
    for c in range(k):
        inside = I[IN_F, c]
        if not inside:
            z[c] = low[c] if z[c] - low[c] < high[c] - z[c] else high[c]
        else:
            z[c] = min(max(z[c], low[c]), high[c])
        f += inside
        changes += inside != I[KEPT_F, c]
    return f, changes


@kernel
def approach(pattern, Bx, Lx, S, I, m, f):
    """Follow the path from z; returns the size of the F that was found.

    Where that has not lowered the objective, z and F are what they were.  L is of no further use.
    """
    pattern, Bx, Lx, S, I = lent(pattern), lent(Bx), lent(Lx), lent(S), lent(I)
    k = pattern.order.size
    for c in range(k):
        S[KEPT_Z, c], I[KEPT_F, c] = S[Z, c], I[IN_F, c]
    before, end, ridge = gradient_at(pattern, Bx, S, m), 0.0, 0.0
    for i in range(m):
        end += PATH_END * S[MOMENTUM, i] ** 2
    found = start_inside(pattern, Bx, Lx, S, I, m)
    for _ in range(STEPS_AT_MOST if found else 0):
        gradient_at(pattern, Bx, S, m)
        mu, count = complementarity(S, I, k, 0.0)
        if not count * mu > end:
            break
        if step_along_path(pattern, Bx, Lx, S, I, ridge) > 0.0:
            I[COUNTS, DIRECTIONS] += 1
        elif ridge < LEAST_SHIFT:
            ridge = LEAST_SHIFT
        else:
            break
    f_after, changes = choose_F(S, I, k)
    if found and gradient_at(pattern, Bx, S, m) < before:
        I[COUNTS, CHANGES] += changes
        return f_after
    for c in range(k):
        S[Z, c], I[IN_F, c] = S[KEPT_Z, c], I[KEPT_F, c]
    return f
