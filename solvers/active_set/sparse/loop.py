"""Algorithm 2 where A is large and sparse: thousands of contacts, each between two bodies.

The steps are those of `method`, with some inner parts exchanged:

1. L = Rᵀ by sparse Cholesky (`sparse_cholesky`), of today's A or that of an earlier QP,
   preconditions conjugate gradients for the descent direction (3.19).  Columns that leave F leave
   L, and those that enter F enter L (`follow`).  When it pays to factorize anew is decided by a
   rule (`keep_account`).
2. Many variables change sides at once.  Step 4 first tries the whole step, cut off at the bounds
   variable by variable, then a quarter of it and so on (Bertsekas 1982), and takes the first by
   which the objective falls at least as far as by the step to the first bound (`step_length`);
   `glambda` sweeps over all variables then (`sweeps`).  Step 8 frees every variable whose sign is
   wrong by a thousandth of the worst.  Where A x did not move after that, one variable at a time
   enters, as in the paper.
3. F may hold columns that depend on each other, so that no set P is needed.  Conjugate gradients
   converge on singular systems that have a solution, and preconditioned by B_Fᵀ B_F + shift · 1,
   which commutes with B_Fᵀ B_F, they find the p of least norm: contacts that share a load share
   what changes of it, and stay off their bounds.  Picking independent columns instead would throw
   load onto a few of them, and one bound after the other would be hit.  A large shift makes an old
   L last: with a small one, what has turned out of the null space since weighs (angle)²/shift.  A
   small shift makes ill-conditioned systems converge.  So it starts large, and is lowered where
   today's L needs many iterations; where no column is dependent there is none.
4. Where that has taken many directions, `glambda` lets interior points choose F (`interior`), and
   the paper's method, if the columns are independent, leaps (`leap`).
"""

from __future__ import annotations

from math import inf, sqrt

from problems.kernels.numba_internals import lent
from problems.qp import AT_LOWER, AT_UPPER, FREE, PASSIVE
from problems.qp_kernel import WARM
from solvers.active_set.compiled import kernel, stage
from solvers.active_set.loop import (
    BOUNCED,
    CUSTOM,
    ENTERED,
    EXTRAPOLATED,
    NO_R,
    ONLINE,
    OWN_SET,
    SCRATCH,
    TODAYS_QR,
    default_accuracy,
    extrapolated,
    extrapolation,
    map_rows,
    remember_before,
    unmark,
    wrong_sign,
)
from solvers.active_set.online_rule import forget, keep_account
from solvers.active_set.sparse.cholesky import (
    add,
    dot,
)
from solvers.active_set.sparse.direction import (
    INVERSE_ITERATIONS,
    MANY,
    conjugate_gradients_sparse,
    direction,
    enough_of,
    error_hidden,
    error_left,
    factorize_sparse,
    follow,
    has_todays_L,
    is_of_this_A,
    iteration_flops,
)
from solvers.active_set.sparse.interior import approach
from solvers.active_set.sparse.pattern import SLOTS
from solvers.active_set.sparse.sweeps import SWEEPS, SWEPT, sweep
from solvers.active_set.sparse.workspace import (
    IN_F,
    KEPT_F,
    KEPT_Z,
    LARGEST_SHIFT,
    WORK,
)
from solvers.active_set.tolerances import (
    FIRST_SHIFT,
    LEAST_SHIFT,
    OUT_OF_PROPORTION_SPARSE,
    ROUNDING,
    SHARE,
)
from solvers.active_set.workspace import (
    AGE,
    BEFORE,
    CG_ITERATIONS,
    CHANGES,
    COUNTS,
    DIRECTIONS,
    DUE,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    INACCURATE,
    INTERVAL,
    INVERSE_NORM,
    LENGTH,
    LOWER,
    MARK,
    MEMBER,
    MOMENTUM,
    OLD_K,
    OLD_MEMBER,
    OLD_ROW,
    ORDER,
    OUT_OF_PASSES,
    PASSES,
    PREVIOUS,
    REALS,
    REMAINDER,
    RESIDUAL,
    SHIFT,
    SOLVED,
    STATUS,
    UPPER,
    WRONG,
    P,
    X,
    Z,
)

TODAYS_A = 512
"""Bit of `mode`: L is of today's A, and the least shift will do.  The ridge of a minimum norm is as
small, so that with an old L p is wrong along what has been the null space, by (angle)²/shift."""
INSISTENCE = 3
"""Full steps after which what is left of the gradient is taken for rounding."""
LEAP_AFTER, LATER = 50, 4
"""Descent directions after which a leap is tried, and by what factor more after one in vain.

As many as cost what a leap does, so that at most twice the better choice is lost: a direction takes
0.4 of a factorization, measured on towers and heaps with friction; a leap, or interior points, some
20 factorizations.  Who leaps sooner loses x as well: interior points leave loads that contacts
share close to zero, where the next QPs are blocked (a pyramid of 105: 450 µs a QP after 30, 180
after 50).
"""
LEAPS = 30
"""Sets F that a leap tries."""
LENGTHS, SHORTER = 8, 0.25
"""Steps that are tried for one direction, cut off at the bounds, and each in units of the last.

With the first alone, heaps with friction take twice the directions: where loads are wrong by much
in a few places, all of p is too long, and the first bound is close by.
"""
ENTERING = 1e-3
"""Wrong signs that may enter, in units of the worst; with a tenth, one contact after the other
entered along a tower."""


@kernel
def lay_out_sparse(pattern, data, d, lower, upper, Bx, S, m):
    """Columns of A in elimination order at length 1, bounds on z_c = ‖a_j‖ x_j."""
    order, indptr = pattern.order, pattern.indptr
    length, low, high, momentum = S[LENGTH], S[LOWER], S[UPPER], S[MOMENTUM]
    for c in range(order.size):
        source, count, size = indptr[order[c]], indptr[order[c] + 1] - indptr[order[c]], 0.0
        if count == SLOTS:
            for b in range(SLOTS):
                size += data[source + b] ** 2
        else:
            for b in range(count):
                size += data[source + b] ** 2
        length[c] = size
    for c in range(order.size):
        length[c] = sqrt(length[c]) if length[c] > 0.0 else 1.0
    for c in range(order.size):
        j = order[c]
        source, count, scale = indptr[j], indptr[j + 1] - indptr[j], 1.0 / length[c]
        if count == SLOTS:
            for b in range(SLOTS):
                Bx[c, b] = scale * data[source + b]
        else:
            for b in range(count):
                Bx[c, b] = scale * data[source + b]
        low[c] = length[c] * lower[j]
        high[c] = length[c] * upper[j]
    for i in range(m):
        momentum[i] = d[i]


@stage
def start_sparse(order, S, I, warm, own_set, w):
    """Step 1: z from the previous x, F the previous F and new rows; returns the size of F."""
    x, before, length, low, high, z = S[X], S[BEFORE], S[LENGTH], S[LOWER], S[UPPER], S[Z]
    inside, mark, previous, members = I[IN_F], I[MARK], I[PREVIOUS], I[OLD_MEMBER]
    f = 0
    for c in range(order.size):
        old = previous[order[c]] if warm else -1
        member = members[old] if old >= 0 else FREE
        value = length[c] * extrapolated(x[old], before[old], w) if old >= 0 else 0.0
        if (member == AT_LOWER and low[c] > -inf) or value < low[c]:
            value = low[c]
        elif (member == AT_UPPER and high[c] < inf) or value > high[c]:
            value = high[c]
        z[c] = value
        mark[c] = 0
        inside[c] = 1 if low[c] < high[c] and (member == FREE or own_set) else 0
        f += inside[c]
    return f


@kernel
def take_residual_sparse(pattern, Bx, S, m):
    """r = B z + d into row RESIDUAL; whether it moved by more than rounding, and that in one Δ_j.

    A column has few entries, so that its Δ_j knows nothing of the other rows' rounding.
    """
    Bi = pattern.Bi
    fresh, r, d, sizes, z = S[FRESH], S[RESIDUAL], S[MOMENTUM], S[WORK], S[Z]
    for i in range(m):
        fresh[i] = d[i]
        sizes[i] = abs(d[i])
    for c in range(Bi.shape[0]):
        value = z[c]
        if value != 0.0:
            for first in range(0, Bi.shape[1], SLOTS):
                for b in range(first, first + SLOTS):
                    term = value * Bx[c, b]
                    fresh[Bi[c, b]] += term
                    sizes[Bi[c, b]] += abs(term)
    change = total = most = 0.0
    for i in range(m):
        change += (fresh[i] - r[i]) ** 2
        total += sizes[i] * sizes[i]
        most = max(most, sizes[i])
        r[i] = fresh[i]
    return sqrt(change) > ROUNDING * sqrt(total), ROUNDING * most


@kernel
def take_gradient_sparse(pattern, Bx, S, row):
    """Bᵀ row into row GRADIENT."""
    x, gradient = S[row], S[GRADIENT]
    for c in range(pattern.order.size):
        gradient[c] = dot(pattern.Bi, Bx, c, x)


@stage
def step_length(pattern, Bx, S, I, m, theta):
    """The part of p to take, cut off at the bounds variable by variable: 1, ¼, 1/16, ... or θ.

    The longest that lowers ½‖B z + d‖² at least as far as θ p does.  What a step changes of it,
    Δᵀδz + ½‖B δz‖², is summed up itself: near the end it is less than rounding in the whole.
    """
    inside = I[IN_F]
    z, p, low, high, gradient = S[Z], S[P], S[LOWER], S[UPPER], S[GRADIENT]
    r, s, moved = S[RESIDUAL], S[REMAINDER], S[FRESH]
    k, short, part = pattern.order.size, 0.0, 1.0
    for c in range(k):
        if inside[c]:
            short += gradient[c] * theta * p[c]
    for i in range(m):
        short += 0.5 * (theta * (s[i] - r[i])) ** 2
    for _ in range(LENGTHS):
        if part <= theta:
            break
        change = 0.0
        for i in range(m):
            moved[i] = 0.0
        for c in range(k):
            if inside[c]:
                step = min(max(z[c] + part * p[c], low[c]), high[c]) - z[c]
                add(pattern.Bi, Bx, c, step, moved)
                change += gradient[c] * step
        for i in range(m):
            change += 0.5 * moved[i] * moved[i]
        I[COUNTS, FLOPS] += 2 * pattern.nonzeros
        if change <= short and change < 0.0:
            return part
        part *= SHORTER
    return theta


@stage
def take_step_sparse(S, I, k, length):
    """Steps 5 and 6: z := z + length p, cut off at the bounds; what reaches one leaves F.

    Returns how many do.  Those that entered F since A x last moved are marked as thrown back.
    """
    z, p, low, high = S[Z], S[P], S[LOWER], S[UPPER]
    inside, mark = I[IN_F], I[MARK]
    reached = 0
    for c in range(k):
        if not inside[c]:
            continue
        if p[c] > 0 and (high[c] - z[c]) / p[c] <= length:
            z[c] = high[c]
        elif p[c] < 0 and (low[c] - z[c]) / p[c] <= length:
            z[c] = low[c]
        else:
            z[c] += length * p[c]
            continue
        inside[c] = 0
        reached += 1
        if mark[c] & ENTERED:
            mark[c] |= BOUNCED
    return reached


@stage
def ratio_test_sparse(S, I, k):
    """Step 4: θ = min(1, min τ_i) with τ_i the step to the bound ahead of z_i."""
    z, p, low, high, inside = S[Z], S[P], S[LOWER], S[UPPER], I[IN_F]
    theta = 1.0
    for c in range(k):
        if inside[c]:
            if p[c] > 0:
                theta = min(theta, (high[c] - z[c]) / p[c])
            elif p[c] < 0:
                theta = min(theta, (low[c] - z[c]) / p[c])
    return theta


@stage
def leap(pattern, Bx, Lx, S, I, m, f, tolerance, rounding):
    """Primal-dual active sets (Hintermüller, Ito, Kunisch 2002) from here; returns the size of F.

    Every variable of F that the whole step p takes beyond a bound goes to it, every one at a bound
    whose sign is wrong then enters F, all at once, until none does.  Where that has not lowered the
    objective in the end, z and F are what they were.  It is for columns that are independent.
    """
    k = pattern.order.size
    inside, kept_f, z, kept_z = I[IN_F], I[KEPT_F], S[Z], S[KEPT_Z]
    p, r, low, high = S[P], S[RESIDUAL], S[LOWER], S[UPPER]
    f_before, before, after, changes = f, 0.0, 0.0, 1
    for c in range(k):
        kept_z[c], kept_f[c] = z[c], inside[c]
    for i in range(m):
        before += r[i] * r[i]
    for _ in range(LEAPS):
        if I[COUNTS, AGE] > 0:
            factorize_sparse(pattern, Bx, Lx, S, I, f)
        follow(pattern, Bx, Lx, S, I, f)
        take_residual_sparse(pattern, Bx, S, m)
        take_gradient_sparse(pattern, Bx, S, RESIDUAL)
        if S[REALS, SHIFT] > LEAST_SHIFT:
            break
        enough = enough_of(S, f, tolerance, rounding)
        made = conjugate_gradients_sparse(
            pattern, Bx, Lx, S, I, m, tolerance, enough, MANY, False, False
        )
        made = made if made >= 0 else -1 - made
        I[COUNTS, DIRECTIONS] += 1
        I[COUNTS, CG_ITERATIONS] += made
        I[COUNTS, FLOPS] += made * iteration_flops(pattern, f, m, False) + 4 * pattern.nonzeros
        take_gradient_sparse(pattern, Bx, S, REMAINDER)
        changes = 0
        for c in range(k):
            if inside[c]:
                z[c] = min(max(z[c] + p[c], low[c]), high[c])
                if (z[c] == low[c] or z[c] == high[c]) and p[c] != 0.0:
                    inside[c] = 0
                    changes, f = changes + 1, f - 1
            elif low[c] < high[c] and wrong_sign(S, c) > tolerance:
                inside[c] = 1
                changes, f = changes + 1, f + 1
        I[COUNTS, CHANGES] += changes
        if changes == 0:
            break
    take_residual_sparse(pattern, Bx, S, m)
    for i in range(m):
        after += r[i] * r[i]
    if after < before:
        return f
    for c in range(k):
        z[c], inside[c] = kept_z[c], kept_f[c]
    take_residual_sparse(pattern, Bx, S, m)
    return f_before


@stage
def finish_sparse(order, row_id, lower, upper, S, I):
    """x in the units of the QP and the members of X, F and P; both remembered for the next QP."""
    z, x, length, low, high = S[Z], S[X], S[LENGTH], S[LOWER], S[UPPER]
    inside, members = I[IN_F], I[MEMBER]
    for c in range(order.size):
        j = order[c]
        value, member = z[c] / length[c], PASSIVE
        if inside[c]:
            member = FREE
        elif z[c] <= low[c]:
            value, member = lower[j], AT_LOWER
        elif z[c] >= high[c]:
            value, member = upper[j], AT_UPPER
        x[j] = min(max(value, lower[j]), upper[j])
        members[j] = member
    for j in range(order.size):
        I[OLD_MEMBER, j] = members[j]
        I[OLD_ROW, j] = row_id[j]
    I[COUNTS, OLD_K] = order.size


@stage
def begin_sparse(pattern, Bx, Lx, S, I, kept, mode):
    """Step 1: z, F and its L, that of an earlier QP unless it is due to be renewed; returns |F|."""
    k, warm = pattern.order.size, (mode & WARM) != 0
    w = 0.0
    # where columns depend on each other x is not unique, and its changes are no trend
    if warm and mode & EXTRAPOLATED and S[REALS, SHIFT] == 0.0:
        w = extrapolation(S[REALS])
    f = start_sparse(pattern.order, S, I, warm, (mode & OWN_SET) != 0, w)
    I[COUNTS, AGE] += 1
    interval = I[COUNTS, INTERVAL] if mode & CUSTOM else 0
    due = I[COUNTS, DUE] != 0 if interval == 0 else I[COUNTS, AGE] >= interval
    S[REALS, LARGEST_SHIFT] = LEAST_SHIFT if mode & TODAYS_A else FIRST_SHIFT
    if not (warm and kept):
        forget(I[COUNTS], S[REALS])
    if not warm:
        I[COUNTS, ORDER] = k + 1
    another = mode & TODAYS_A and not is_of_this_A(Bx, k)
    if not (warm and kept) or mode & (OWN_SET | TODAYS_QR) or due or another:
        factorize_sparse(pattern, Bx, Lx, S, I, f)
    I[COUNTS, DUE] = 0
    return f


@stage
def slope_on_F(S, I, k):
    """‖B_Fᵀ r‖, and the largest entry of it."""
    inside = I[IN_F]
    slope = steepest = 0.0
    for c in range(k):
        if inside[c]:
            slope += S[GRADIENT, c] ** 2
            steepest = max(steepest, abs(S[GRADIENT, c]))
    return sqrt(slope), steepest


@stage
def choose_F(pattern, Bx, Lx, S, I, m, f, aim, rounding, mode):
    """Another F after many directions, by interior points or by a leap.

    Returns |F|, rounding, and the number of directions after which to choose once more.
    """
    if mode & ONLINE:
        f = approach(pattern, Bx, Lx, S, I, m, f)
        patience = LATER * I[COUNTS, DIRECTIONS]
        factorize_sparse(pattern, Bx, Lx, S, I, f)
        _, rounding = take_residual_sparse(pattern, Bx, S, m)
    else:
        patience = LATER * (I[COUNTS, DIRECTIONS] + LEAPS)
        f = leap(pattern, Bx, Lx, S, I, m, f, aim, rounding)
    unmark(I, pattern.order.size)
    return f, rounding, patience


@stage
def descend_sparse(pattern, Bx, Lx, S, I, m, f, aim, rounding, refine, mode):
    """Steps 3 to 6: a direction, and as much of it as is feasible, or more of it, cut off.

    refine : whether the direction is today's L's alone

    Returns how many reached a bound, θ, whether A x moved, rounding, and the age of an L given up.
    """
    age = 0
    if refine:
        conjugate_gradients_sparse(pattern, Bx, Lx, S, I, m, 0.0, inf, 1, False)
        I[COUNTS, CG_ITERATIONS] += 1
        I[COUNTS, FLOPS] += iteration_flops(pattern, f, m, False)
    else:
        age = direction(pattern, Bx, Lx, S, I, m, f, 0.5 * aim, rounding, mode)  # 3.
    theta = ratio_test_sparse(S, I, pattern.order.size)  # 4.
    length = step_length(pattern, Bx, S, I, m, theta) if theta < 1.0 else theta
    reached = take_step_sparse(S, I, pattern.order.size, length)  # 5., 6.
    moved, rounding = take_residual_sparse(pattern, Bx, S, m)
    I[COUNTS, FLOPS] += 2 * pattern.nonzeros
    I[COUNTS, CHANGES] += reached
    if moved:
        unmark(I, pattern.order.size)
    return reached, theta, moved, rounding, age


@stage
def may_sweep(I, m, k, mode):
    """Whether no columns are known to depend on each other, and the QP has not gone on for long."""
    independent = k <= m and I[COUNTS, ORDER] > k and not mode & TODAYS_A
    return mode & ONLINE and independent and I[COUNTS, DIRECTIONS] <= SWEPT


@stage
def most_wrong_sparse(S, I, k, slope):
    """Step 8: ‖B_Fᵀ r‖ or the largest wrong sign, the largest of who may enter, and which."""
    inside, mark = I[IN_F], I[MARK]
    left, worst, entering = slope, 0.0, -1
    for c in range(k):
        if not inside[c]:
            wrong = wrong_sign(S, c)
            left = max(left, wrong)
            if wrong > worst and not mark[c] & BOUNCED:
                worst, entering = wrong, c
    return left, worst, entering


@stage
def is_sound(pattern, Bx, Lx, S, I, f, left, eps0, mode):
    """Step 9: whether what is left of the gradient is within what was asked."""
    sound = left <= SHARE * eps0 and left < inf
    unsure = left * S[REALS, INVERSE_NORM] > eps0 and S[REALS, SHIFT] == 0.0
    if sound and unsure and not mode & NO_R:
        follow(pattern, Bx, Lx, S, I, f)
        sound = error_left(pattern, Lx, S, I) <= eps0
        I[COUNTS, FLOPS] += 2 * pattern.entries
    return sound


@stage
def is_doubtful(pattern, Bx, Lx, S, I, m, eps0, rounding, mode):
    """Whether x is out of proportion, as where columns of F differ by little and no bound holds it,
    and rounding may hide more than eps0 and `default_accuracy`, or L is too old to tell."""
    largest = 0.0
    for i in range(m):
        largest = max(largest, abs(S[MOMENTUM, i]))
    in_proportion = rounding <= OUT_OF_PROPORTION_SPARSE * ROUNDING * largest
    if in_proportion or S[REALS, SHIFT] == 0.0 or mode & NO_R:
        return False
    if not has_todays_L(I, pattern.order.size):
        return True
    I[COUNTS, FLOPS] += 4 * INVERSE_ITERATIONS * pattern.entries
    hidden = error_hidden(pattern, Bx, Lx, S, I, m, rounding)
    take_gradient_sparse(pattern, Bx, S, MOMENTUM)
    return hidden > max(eps0, default_accuracy(S, pattern.order.size))


@stage
def enter_sparse(S, I, k, entering, least, one_by_one):
    """Step 9: `entering` enters F, and unless it is to be alone all whose sign is as wrong as
    `least`; returns how many."""
    inside, mark = I[IN_F], I[MARK]
    entered = 0
    for c in range(k):
        enters = c == entering
        if not (enters or one_by_one or inside[c] or mark[c] & BOUNCED):
            enters = wrong_sign(S, c) > least
        if enters:
            inside[c] = 1
            mark[c] |= ENTERED
            entered += 1
    I[COUNTS, CHANGES] += entered
    return entered


@kernel
def sparse_algorithm_2(data, d, lower, upper, row_id, pattern, Bx, Lx, S, I, kept, eps0, mode):
    """Solve one QP with the step numbers of `method`; Bx, Lx, S and I are modified, nothing else.

    data : of A (m, k) by columns;  d (m,);  lower, upper, row_id (k,)
    pattern, Bx, Lx, S, I : of a `SparseWorkspace`, with the memory of the previous solve
    kept : whether Lx holds an earlier L of this pattern
    eps0 : accuracy in ‖A δx‖ (3.13), negative for 1e-9 of the largest |b_jᵀ d|, ‖b_j‖ = 1
    mode : bits of `loop`, and TODAYS_A; GRAM is for small QPs
    """
    pattern, Bx, Lx, S, I = lent(pattern), lent(Bx), lent(Lx), lent(S), lent(I)
    m, k = d.size, pattern.order.size
    for i in range(DIRECTIONS, FLOPS + 1):
        I[COUNTS, i] = 0
    warm = (mode & WARM) != 0
    lay_out_sparse(pattern, data, d, lower, upper, Bx, S, m)
    if warm:
        map_rows(row_id, I, k)
    if eps0 < 0:
        take_gradient_sparse(pattern, Bx, S, MOMENTUM)
        eps0 = default_accuracy(S, k)
    f = begin_sparse(pattern, Bx, Lx, S, I, kept, mode)  # 1.
    _, rounding = take_residual_sparse(pattern, Bx, S, m)  # 2.
    I[COUNTS, FLOPS] += 2 * pattern.nonzeros
    passes = 50 + 20 * k
    if mode & CUSTOM and I[COUNTS, PASSES] >= 0:
        passes = I[COUNTS, PASSES]
    refining = inf  # ‖B_Fᵀ r‖ before a full step on the same F; inf where F has changed
    status = OUT_OF_PASSES
    one_by_one, given_up = False, 0
    # a slope within rounding is refined where L is at hand: the error it stands for may not be
    insisting, insisted = False, 0
    patience = passes if mode & (NO_R | SCRATCH | CUSTOM) else LEAP_AFTER

    while True:
        take_gradient_sparse(pattern, Bx, S, RESIDUAL)  # 7., and the right-hand side of 3.
        I[COUNTS, FLOPS] += 2 * pattern.nonzeros
        slope, steepest = slope_on_F(S, I, k)
        aim = max(SHARE * eps0 / S[REALS, INVERSE_NORM], rounding)  # (3.20)
        # a slope that refinement does not halve is rounding
        if insisting or (slope > aim and steepest > rounding and slope < 0.5 * refining):
            if passes <= 0:
                break
            passes -= 1
            choosable = not insisting and (mode & ONLINE or S[REALS, SHIFT] <= LEAST_SHIFT)
            if refining == inf and choosable and I[COUNTS, DIRECTIONS] >= patience:
                f, rounding, patience = choose_F(pattern, Bx, Lx, S, I, m, f, aim, rounding, mode)
                one_by_one = False
                continue
            if refining == inf:
                I[COUNTS, DIRECTIONS] += 1
            reached, theta, moved, rounding, age = descend_sparse(
                pattern, Bx, Lx, S, I, m, f, aim, rounding, insisting, mode
            )
            insisting = False
            given_up = max(given_up, age)
            f -= reached
            if reached > 0 and moved and may_sweep(I, m, k, mode):
                f = sweep(pattern, Bx, S, I, aim)
                _, rounding = take_residual_sparse(pattern, Bx, S, m)
                I[COUNTS, FLOPS] += 4 * (SWEEPS + 1) * pattern.nonzeros
            one_by_one = not moved and (reached > 0 or one_by_one)
            refining = slope if theta == 1.0 and reached == 0 else inf
            continue
        left, worst, entering = most_wrong_sparse(S, I, k, slope)  # 8.
        if worst <= aim:  # 9.
            S[REALS, WRONG] = left
            sound = is_sound(pattern, Bx, Lx, S, I, f, left, eps0, mode)
            doubtful = sound and is_doubtful(pattern, Bx, Lx, S, I, m, eps0, rounding, mode)
            sound = sound and not doubtful
            todays = has_todays_L(I, k)
            refinable = not (doubtful or mode & NO_R or insisted == INSISTENCE)
            if sound or (todays and not refinable):
                status = SOLVED if sound else INACCURATE
                break
            if todays:
                insisting = True
                insisted += 1
            else:
                factorize_sparse(pattern, Bx, Lx, S, I, f)
                unmark(I, k)
            refining = inf
            continue
        if passes <= 0:
            break
        passes -= 1
        refining = inf
        f += enter_sparse(S, I, k, entering, max(aim, ENTERING * worst), one_by_one)

    I[COUNTS, STATUS] = status
    if mode & ONLINE and I[COUNTS, DUE] == 0:
        cost = iteration_flops(pattern, f, m, False) * I[COUNTS, CG_ITERATIONS]
        factorized = I[COUNTS, FACTORIZATIONS] > 0
        keep_account(I[COUNTS], S[REALS], factorized, given_up, cost, I[COUNTS, DIRECTIONS])
    if mode & EXTRAPOLATED:
        remember_before(S, BEFORE, X, P, S[REALS], I[PREVIOUS], k, warm)
    finish_sparse(pattern.order, row_id, lower, upper, S, I)
