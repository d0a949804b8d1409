"""Algorithm 2 as one compiled loop (Lötstedt 1984, §3.2); see `method` for the numbered steps.

Inner parts are exchangeable.  *Fresh*: A_F of today is factorized with its reflections, whenever F
changes from the column that changes on; what `glambda` uses for small QPs, and both for impulses.
*Old R*: the R of an earlier A_F, updated as columns come and go, preconditions conjugate gradients.
A solve that starts on an old R and cannot finish on it ends fresh.
"""

from __future__ import annotations

from math import inf, nan, sqrt

from problems.kernels.numba_internals import lent
from problems.qp import AT_LOWER, AT_UPPER, FREE, LARGEST, PASSIVE
from problems.qp_kernel import WARM
from solvers.active_set.compiled import function, kernel, stage
from solvers.active_set.conjugate_gradients import conjugate_gradients
from solvers.active_set.factorization import (
    apply_reflection,
    dependence_tolerance,
    inverse_norm_estimate,
    qr_append,
    qr_factorize,
    r_delete,
    row_length,
    solve_R,
)
from solvers.active_set.flops import (
    cg_iteration_flops,
    cg_limit,
    delete_flops,
    estimate_flops,
    insert_flops,
    product_flops,
    qr_flops,
    triangular_flops,
)
from solvers.active_set.gram import NOTHING
from solvers.active_set.newton import LEAST, MOST, solve_by_newton
from solvers.active_set.online_rule import forget, iterations_worth, keep_account
from solvers.active_set.settled import residual_and_sizes, solve_settled
from solvers.active_set.tolerances import OUT_OF_PROPORTION, ROUNDING, SHARE, UNIT_ROUNDOFF
from solvers.active_set.workspace import (
    AGE,
    BEFORE,
    CG_ITERATIONS,
    CG_LIMIT,
    CHANGES,
    COUNTS,
    DIRECTIONS,
    DUE,
    FACTORIZATION_COST,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    GROWN_NORM,
    INACCURATE,
    INTERVAL,
    INVERSE_NORM,
    LANES,
    LAST_TIME,
    LENGTH,
    LOWER,
    MARK,
    MEMBER,
    MOMENTUM,
    N_FLOAT_ROWS,
    NORM2,
    OLD_F,
    OLD_K,
    OLD_MEMBER,
    OLD_ORDER,
    OLD_ROW,
    ORDER,
    OUT_OF_PASSES,
    PASSES,
    PREVIOUS,
    REALS,
    REFUSED,
    REMAINDER,
    RESIDUAL,
    SOLVED,
    STATUS,
    TIME,
    TIME_BEFORE,
    TODAY,
    UPDATES,
    UPPER,
    WRONG,
    YOUNG,
    F,
    P,
    V,
    X,
    Y,
    Z,
)

OWN_SET, TODAYS_QR, NO_R, CUSTOM, ONLINE, GRAM = 2, 4, 8, 16, 32, 64
SCRATCH, EXTRAPOLATED, DEFERRED, UNCHECKED = 128, 256, 1024, 2048
"""Bits of `mode` beside `WARM`, there is a previous solution: F is chosen anew; factorize today's
A_F; conjugate gradients without R; the options in rows REALS and COUNTS replace the paper's;
factorize by the online rule and not by the paper's; try normal equations first; never
update a factorization; begin with x extrapolated from two QPs; by the paper's rule the QP is
finished first, and the next one factorized; nobody has looked at the arrays yet."""
ENTERED, BOUNCED, DISMISSED, NOW_IN_F = 1, 2, 4, 8
"""Bits of row MARK: entered F since A x last moved; thrown back since; not worth freeing; in F,
while step 8 looks for who enters."""


@stage
def lay_out(A, d, lower, upper, S, mp):
    """Columns of A one after the other at length 1, bounds on z_j = ‖a_j‖ x_j."""
    m, k = A.shape
    B0 = N_FLOAT_ROWS
    for j in range(k):
        b, size = S[B0 + j], 0.0
        for i in range(m):
            b[i] = A[i, j]
        for i in range(m, mp):
            b[i] = 0.0
        for i in range(mp):
            size += b[i] * b[i]
        length = sqrt(size) if size > 0.0 else 1.0
        inverse = 1.0 / length
        for i in range(mp):
            b[i] *= inverse
        S[LENGTH, j] = length
        S[LOWER, j] = length * lower[j]
        S[UPPER, j] = length * upper[j]
    for i in range(m):
        S[MOMENTUM, i] = d[i]
    for i in range(m, mp):
        S[MOMENTUM, i] = 0.0


@kernel
def map_rows(row_id, I, k):
    """Rows PREVIOUS and TODAY: where each row was in the previous QP, and where the old ones are.

    −1 where there is none.  Rows mostly keep their order, so the search goes on from the last hit.
    """
    old_k = I[COUNTS, OLD_K]
    for i in range(old_k):
        I[TODAY, i] = -1
    place = 0
    for j in range(k):
        I[PREVIOUS, j] = -1
        for _ in range(old_k):
            if place >= old_k:
                place = 0
            if I[OLD_ROW, place] == row_id[j]:
                I[PREVIOUS, j] = place
                I[TODAY, place] = j
                place += 1
                break
            place += 1


@kernel
def extrapolation(reals):
    """w = (t_n − t_{n−1})/(t_{n−1} − t_{n−2}) of x + w (x − x before); 0 where time stood still."""
    now, last, before = reals[TIME], reals[LAST_TIME], reals[TIME_BEFORE]
    return (now - last) / (last - before) if now > last > before else 0.0


@kernel
def remember_before(S, before, x, scratch, reals, previous, k, warm):
    """Row `before` := x of the time before t_{n−1}, once x is about to become that of t_n.

    previous (k,) : where each row was; a new row has stood still.
    """
    later = not warm or reals[TIME] > reals[LAST_TIME]
    source = S[x] if later else S[before]
    kept = S[scratch]
    for j in range(k):
        kept[j] = source[previous[j]] if warm and previous[j] >= 0 else nan
    for j in range(k):
        S[before, j] = kept[j]
    if later:
        reals[TIME_BEFORE] = reals[LAST_TIME] if warm else inf
    reals[LAST_TIME] = reals[TIME]


@kernel
def extrapolated(x, before, w):
    """x + w (x − before), x where there is no before."""
    return x + w * (x - before) if w > 0.0 and before == before else x


@kernel
def start(S, I, k, warm, own_set, w):
    """z from the previous x, members of X on today's bounds; F the previous F and new rows.

    Returns the number of columns put into F.  Cold, z is the feasible point nearest to 0 and F
    holds every row that can move (step 1).
    """
    f = 0
    for j in range(k):
        low, high = S[LOWER, j], S[UPPER, j]
        old = I[PREVIOUS, j] if warm else -1
        member = I[OLD_MEMBER, old] if old >= 0 else FREE
        z = S[LENGTH, j] * extrapolated(S[X, old], S[BEFORE, old], w) if old >= 0 else 0.0
        if (member == AT_LOWER and low > -inf) or z < low:
            z = low
        elif (member == AT_UPPER and high < inf) or z > high:
            z = high
        S[Z, j] = z
        I[MARK, j] = 0
        if low < high and (member == FREE or own_set):
            I[F, f] = j
            f += 1
    return f


@kernel
def take_residual(S, I, mp, k):
    """r = B z + d into row RESIDUAL; returns ‖change of r‖ and the rounding in Δ."""
    size = residual_and_sizes(S, I, mp, mp, k, MOMENTUM, FRESH)
    fresh, r, moved = S[FRESH], S[RESIDUAL], 0.0
    for i in range(mp):
        moved += (fresh[i] - r[i]) ** 2
        r[i] = fresh[i]
    return sqrt(moved), ROUNDING * size


@kernel
def take_gradient(S, mp, k, row):
    """Bᵀ row into row GRADIENT."""
    x = S[row]
    for j in range(k):
        b, along = S[N_FLOAT_ROWS + j], 0.0
        for i in range(mp):
            along += b[i] * x[i]
        S[GRADIENT, j] = along


@stage
def ratio_test(S, I, f):
    """Step 4: θ = min(1, min τ_i) with τ_i the step to the bound ahead of z_i."""
    theta = 1.0
    for c in range(f):
        j, p = I[F, c], S[P, c]
        if p > 0:
            theta = min(theta, (S[UPPER, j] - S[Z, j]) / p)
        elif p < 0:
            theta = min(theta, (S[LOWER, j] - S[Z, j]) / p)
    return theta


@stage
def take_step(S, I, f, theta):
    """Step 5: z += θ p, members that reach a bound put on it; returns how many do.

    The step to a bound is computed as in `ratio_test`, so that whoever gave θ reaches its bound
    even where θ p underflows.
    """
    reached = 0
    for c in range(f):
        j, p = I[F, c], S[P, c]
        if p > 0 and (S[UPPER, j] - S[Z, j]) / p <= theta:
            S[Z, j] = S[UPPER, j]
            reached += 1
        elif p < 0 and (S[LOWER, j] - S[Z, j]) / p <= theta:
            S[Z, j] = S[LOWER, j]
            reached += 1
        else:
            S[Z, j] += theta * p
    return reached


@stage
def wrong_sign(S, j):
    """Step 8: by how much Δ_j has the wrong sign for where z_j is; |Δ_j| between the bounds."""
    wrong = 0.0
    if S[Z, j] < S[UPPER, j]:
        wrong = max(wrong, -S[GRADIENT, j])
    if S[Z, j] > S[LOWER, j]:
        wrong = max(wrong, S[GRADIENT, j])
    return wrong


@kernel
def factorize(S, I, m, mp, f, first):
    """Today's factorization from column `first` of F on, counted; returns the order."""
    if f > first:
        if first == 0:
            I[COUNTS, FACTORIZATIONS] += 1
            I[COUNTS, FLOPS] += qr_flops(m, f, False)
        else:
            I[COUNTS, UPDATES] += 1
            I[COUNTS, FLOPS] += 4 * m * first * (f - first) + qr_flops(m - first, f - first, False)
    return qr_factorize(S, I, m, mp, f, first)


@kernel
def keep_R(S, I, f):
    """Today's R becomes the preconditioner, of age 0, with its ‖R⁻¹‖."""
    I[COUNTS, AGE] = I[COUNTS, DUE] = 0
    I[COUNTS, FLOPS] += estimate_flops(f)
    S[REALS, INVERSE_NORM] = inverse_norm_estimate(S, f)


@kernel
def r_insert(S, I, m, mp, f, j, limit):
    """Append today's column j to an old R (step 8).  1 done, 0 dependent, −1 R is too old.

    w minimises ‖b_j − A_F w‖ by conjugate gradients, repeated until the remainder no longer
    shrinks; the new column of R is (R w; ρ), ρ the remainder.  Then A_F R⁻¹ gains a column of
    length 1 orthogonal to today's A_F: R is as good as before.  Row NORM2 holds w afterwards, and
    GROWN_NORM what ‖R⁻¹‖ becomes when the column is taken.
    """
    R0 = N_FLOAT_ROWS + 2 * S.shape[1]
    rho, size, right, spent = 0.0, 0.0, N_FLOAT_ROWS + j, 0
    for i in range(mp):
        S[FRESH, i] = S[right, i]
    rho = row_length(S, mp, FRESH)
    for c in range(f):
        S[NORM2, c] = 0.0
    for _ in range(4 if f else 0):
        aim = 0.1 * rho / S[REALS, INVERSE_NORM]
        made = conjugate_gradients(S, I, mp, f, FRESH, aim, limit - spent, True)
        spent += made if made >= 0 else -1 - made
        I[COUNTS, CG_ITERATIONS] += made if made >= 0 else -1 - made
        if made < 0:
            return -1
        for i in range(mp):
            S[FRESH, i] = S[REMAINDER, i]
        before, rho, size = rho, row_length(S, mp, FRESH), 0.0
        for c in range(f):
            S[NORM2, c] -= S[P, c]
            size += S[NORM2, c] ** 2
        if rho > 0.5 * before:
            break
        if rho <= dependence_tolerance(m) * (1.0 + sqrt(size)):
            return 0
    I[COUNTS, UPDATES] += 1
    I[COUNTS, FLOPS] += insert_flops(m, f, False) + spent * cg_iteration_flops(m, f, True)
    if rho == 0.0:
        return 0
    for i in range(f):
        value = 0.0
        for c in range(i, f):
            value += S[R0 + c, i] * S[NORM2, c]
        S[R0 + f, i] = value
    S[R0 + f, f] = rho
    old = S[REALS, INVERSE_NORM] if f else 0.0
    # the last column of the new R⁻¹ is (−w; 1)/ρ
    S[REALS, GROWN_NORM] = sqrt(old * old + (1.0 + size) / (rho * rho))
    I[F, f] = j
    return 1


@stage
def carry_R(S, I, m, mp, wanted):
    """The old R on the `wanted` columns that stand in F; returns its order, −1 where it is too old.

    Columns of rows that are gone leave by rotations, today's columns of new rows enter; those
    found dependent are left out, so that their rows are passive.
    """
    for c in range(wanted):
        I[MARK, I[F, c]] = ENTERED
    f = I[COUNTS, OLD_ORDER]
    for c in range(f):
        I[F, c] = I[TODAY, I[OLD_F, c]]
    for c in range(f - 1, -1, -1):
        j = I[F, c]
        if j < 0 or I[MARK, j] != ENTERED:
            I[COUNTS, UPDATES] += 1
            I[COUNTS, FLOPS] += delete_flops(m, f, c, False)
            r_delete(S, I, f, c)
            f -= 1
        else:
            I[MARK, j] = 0
    k = I[COUNTS, ORDER]
    for j in range(k):
        if I[MARK, j] == ENTERED:
            I[MARK, j] = 0
            done = r_insert(S, I, m, mp, f, j, 2 * f + 20)
            if done < 0:
                for rest in range(j, k):
                    I[MARK, rest] = 0
                return -1
            if done > 0:
                S[REALS, INVERSE_NORM] = S[REALS, GROWN_NORM]
                f += 1
    return f


@kernel
def direction_by_Q(S, mp, f):
    """Step 3 with today's factorization: R p = −(Qᵀ r)_{1…f}."""
    for i in range(mp):
        S[Y, i] = S[RESIDUAL, i]
    for l in range(f):
        apply_reflection(S, mp, l, Y)
    for c in range(f):
        S[P, c] = -S[Y, c]
    solve_R(S, f, P)


@stage
def direction_by_cg(S, I, m, mp, f, tolerance, mode):
    """Step 3 with the old R; returns (order, whether p was found).

    Where conjugate gradients would take more iterations than the criterion allows, A_F is
    factorized at once and they go on with that; where that does not help either, p was not found.
    """
    for _ in range(2):
        plain = (mode & NO_R) != 0
        interval, worth = 0, cg_limit(m, f)
        if mode & ONLINE:
            worth = iterations_worth(S[REALS], qr_flops(m, f), cg_iteration_flops(m, f))
        if mode & CUSTOM:
            interval = I[COUNTS, INTERVAL]
            if S[REALS, CG_LIMIT] >= 0:
                worth = S[REALS, CG_LIMIT]
        limit = worth
        if plain:
            limit = 10.0 * f + 100
        elif I[COUNTS, AGE] == 0 or interval > 0 or mode & DEFERRED:
            limit = 2.0 * f + 20
        made = conjugate_gradients(S, I, mp, f, RESIDUAL, tolerance, limit, not plain)
        spent = made if made >= 0 else -1 - made
        I[COUNTS, CG_ITERATIONS] += spent
        I[COUNTS, FLOPS] += spent * cg_iteration_flops(m, f, not plain) + product_flops(m, f)
        if I[COUNTS, AGE] == 0:
            S[REALS, YOUNG] = spent
        if mode & DEFERRED and spent > worth:
            I[COUNTS, DUE] = 1
        if made >= 0:
            return f, True
        if I[COUNTS, AGE] == 0:
            break
        f = factorize(S, I, m, mp, f, 0)
        keep_R(S, I, f)
    return f, False


@stage
def drop_reached(S, I, m, mp, f, fresh, scratch):
    """Step 6: members of F at a bound that p leads to move to X; returns the order.

    The columns before the first that leaves keep their place in today's QR, except with `scratch`.
    """
    kept = 0
    first = f
    for c in range(f):
        j, p = I[F, c], S[P, c]
        stays = not ((p > 0 and S[Z, j] >= S[UPPER, j]) or (p < 0 and S[Z, j] <= S[LOWER, j]))
        if stays:
            I[TODAY, kept] = j  # scratch from here on
            kept += 1
        else:
            first = min(first, c)
            if I[MARK, j] & ENTERED:
                I[MARK, j] |= BOUNCED
            I[COUNTS, CHANGES] += 1
    if fresh:
        for c in range(kept):
            I[F, c] = I[TODAY, c]
        return factorize(S, I, m, mp, kept, 0 if scratch else first)
    for c in range(f - 1, -1, -1):
        j, p = I[F, c], S[P, c]
        if (p > 0 and S[Z, j] >= S[UPPER, j]) or (p < 0 and S[Z, j] <= S[LOWER, j]):
            I[COUNTS, UPDATES] += 1
            I[COUNTS, FLOPS] += delete_flops(m, f, c, False)
            r_delete(S, I, f, c)
            for later in range(c, f - 1):
                S[P, later] = S[P, later + 1]
            f -= 1
    return f


@stage
def append_column(S, I, m, mp, f, j, fresh, eps0, rounding):
    """Step 8: put column j last into F where that is possible and worth it; returns (done, fresh).

    `done` is false where the column depends on A_F, or where Δ_j is below ε₁ and freeing x_j would
    move A x by less than eps0: with b_j = A_F w + s, s ⟂ A_F and ρ = ‖s‖, A x moves by |sᵀr|/ρ,
    sᵀr = Δ_j − wᵀΔ_F.
    """
    R0 = N_FLOAT_ROWS + 2 * S.shape[1]
    w_row = NORM2
    if not fresh:
        done = r_insert(S, I, m, mp, f, j, 2 * f + 20)
        if done == 0:
            return False, False
        if done < 0:
            order = factorize(S, I, m, mp, f, 0)
            I[COUNTS, ORDER] = order
            f, fresh = order, True
    if fresh:
        I[COUNTS, UPDATES] += 1
        I[COUNTS, FLOPS] += 4 * m * (f + 1) + triangular_flops(f)
        if f >= m or not qr_append(S, I, m, mp, f, j):
            return False, fresh
        w_row = V
    along, size = S[GRADIENT, j], 0.0
    for c in range(f):
        along -= S[w_row, c] * S[GRADIENT, I[F, c]]
        size += S[w_row, c] ** 2
    rho = abs(S[R0 + f, f])
    if abs(along) > max(eps0 * rho, rounding * (1.0 + sqrt(size))):
        return True, fresh
    # qr_append used row V; the estimate below uses V and Y
    inverse_norm = inverse_norm_estimate(S, f) if fresh else S[REALS, INVERSE_NORM]
    return abs(S[GRADIENT, j]) > max(eps0 / inverse_norm, rounding), fresh


@stage
def finish(row_id, lower, upper, S, I, k, f):
    """x in the units of the QP and the members of X, F and P.

    Both are remembered for the next QP, unless x is not finite.
    """
    total = 0.0
    for j in range(k):
        z = S[Z, j]
        x = z / S[LENGTH, j]
        member = PASSIVE
        if z <= S[LOWER, j]:
            x, member = lower[j], AT_LOWER
        elif z >= S[UPPER, j]:
            x, member = upper[j], AT_UPPER
        S[X, j] = min(max(x, lower[j]), upper[j])
        total += abs(S[X, j])
        I[MEMBER, j] = member
        I[OLD_ROW, j] = row_id[j]
    for c in range(f):
        I[MEMBER, I[F, c]] = FREE
        I[OLD_F, c] = I[F, c]
    for j in range(k):
        I[OLD_MEMBER, j] = I[MEMBER, j]
    I[COUNTS, OLD_K] = k if total < inf else -1


@stage
def reset(I, mode):
    """Counts of a new QP, and whether an earlier one is remembered."""
    for i in range(DIRECTIONS, FLOPS + 1):
        I[COUNTS, i] = 0
    if not mode & WARM:  # a new workspace holds anything
        I[COUNTS, OLD_K] = I[COUNTS, OLD_ORDER] = -1
        I[COUNTS, AGE] = 0
    return (mode & WARM) != 0 and I[COUNTS, OLD_K] >= 0


@stage
def unmark(I, k):
    """Forget who entered F, and who was thrown back or barred."""
    for j in range(k):
        I[MARK, j] = 0


@stage
def knows_set(I, m):
    """Whether the rows remembered as free can be an F, whose columns are independent."""
    free = 0
    for i in range(I[COUNTS, OLD_K]):
        free += I[OLD_MEMBER, i] == FREE
    return free <= m


@stage
def default_accuracy(S, k):
    """1e-9 of the largest |b_jᵀ d|, ‖b_j‖ = 1, which row GRADIENT holds."""
    eps0 = 0.0
    for j in range(k):
        eps0 = max(eps0, 1e-9 * abs(S[GRADIENT, j]))
    return eps0


@stage
def begin(S, I, m, mp, k, mode, warm, w):
    """Step 1: F and its R, that of an earlier QP unless it is due to be renewed.

    Returns the number of columns in F, and the age of R, 0 where it is today's.
    """
    fresh, own_set = (mode & TODAYS_QR) != 0, (mode & OWN_SET) != 0
    f, age, carried = start(S, I, k, warm, own_set, w), 0, -1
    I[COUNTS, AGE] += 1
    I[COUNTS, ORDER] = k
    if not fresh and I[COUNTS, OLD_ORDER] < 0:
        forget(I[COUNTS], S[REALS])
    if warm and not fresh and not own_set and I[COUNTS, OLD_ORDER] >= 0:
        interval = I[COUNTS, INTERVAL] if mode & CUSTOM else 0
        due = I[COUNTS, DUE] != 0 if interval == 0 else I[COUNTS, AGE] >= interval
        if not due:
            age = I[COUNTS, AGE]
            carried = carry_R(S, I, m, mp, f)
            if carried < 0:
                f = start(S, I, k, warm, False, w)
    if carried >= 0:
        return carried, age
    f = factorize(S, I, m, mp, f, 0)
    if not fresh:
        keep_R(S, I, f)
    return f, age


@stage
def slope_of(S, I, f):
    """‖A_Fᵀ r‖."""
    slope = 0.0
    for c in range(f):
        slope += S[GRADIENT, I[F, c]] ** 2
    return sqrt(slope)


@stage
def descend(S, I, m, mp, k, f, fresh, aim, mode):
    """Steps 3 to 6: a direction, by conjugate gradients or today's QR, as far as it is feasible.

    Returns |F|, whether R is today's, θ, how many bounds were reached, the rounding of r.
    """
    if not fresh:  # 3.
        f, found = direction_by_cg(S, I, m, mp, f, 0.5 * aim, mode)
        if not found:
            f, fresh = factorize(S, I, m, mp, f, 0), True
    if fresh:
        direction_by_Q(S, mp, f)
        I[COUNTS, FLOPS] += 2 * product_flops(m, f) + triangular_flops(f)
    theta = ratio_test(S, I, f)  # 4.
    reached = take_step(S, I, f, theta)  # 5.
    moved, rounding = take_residual(S, I, mp, k)
    I[COUNTS, FLOPS] += product_flops(m, k)
    if moved > rounding:
        unmark(I, k)
    if reached > 0:  # 6.
        f = drop_reached(S, I, m, mp, f, fresh, (mode & SCRATCH) != 0)
        for j in range(k):
            I[MARK, j] &= ~DISMISSED
    return f, fresh, theta, reached, rounding


@stage
def most_wrong(S, I, k, f, slope):
    """Step 8: ‖A_Fᵀ r‖ or the largest wrong sign, the largest of rows that may enter, and which."""
    left, worst, entering = slope, 0.0, -1
    for c in range(f):
        I[MARK, I[F, c]] |= NOW_IN_F
    for j in range(k):
        wrong = wrong_sign(S, j)
        left = max(left, wrong)
        if wrong > worst and not I[MARK, j] & (BOUNCED | DISMISSED | NOW_IN_F):
            worst, entering = wrong, j
        I[MARK, j] &= ~NOW_IN_F
    return left, worst, entering


@stage
def enter(S, I, m, mp, f, entering, fresh, eps0, rounding, mode):
    """A column enters F, unless it depends on it.  Returns |F|, whether R is today's, whether."""
    I[COUNTS, ORDER] = f
    done, fresh = append_column(S, I, m, mp, f, entering, fresh, SHARE * eps0, rounding)
    f = I[COUNTS, ORDER]
    if not done:
        I[MARK, entering] |= DISMISSED
        return f, fresh, False
    f += 1
    if not fresh:
        S[REALS, INVERSE_NORM] = S[REALS, GROWN_NORM]
    if fresh and mode & SCRATCH:
        f = factorize(S, I, m, mp, f, 0)
    I[MARK, entering] |= ENTERED
    I[COUNTS, CHANGES] += 1
    return f, fresh, True


@stage
def noise_of_A(S, I, mp, f):
    """What rounding of A_F may do to A x: ‖R⁻ᵀ e‖ with |e_c| = u |b_c|ᵀ|r| (Björck 1996, section
    1.4.6), and signs by which it grows."""
    R0, r, sums, total = N_FLOAT_ROWS + 2 * S.shape[1], S[RESIDUAL], S[V], 0.0
    for c in range(f):
        sums[c] = 0.0
    for c in range(f):
        b, size, before = S[N_FLOAT_ROWS + I[F, c]], 0.0, sums[c]
        for i in range(mp):
            size += abs(b[i] * r[i])
        y = (UNIT_ROUNDOFF * size + abs(before)) / S[R0 + c, c]
        y = y if before < 0.0 else -y
        total += y * y
        for later in range(c + 1, f):
            sums[later] += S[R0 + later, c] * y
    return sqrt(total)


@stage
def is_doubtful(S, I, mp, k, f, exact, eps0, rounding):
    """Whether x is out of all proportion, as where columns of F differ by little and no bound holds
    it, and no full step by today's Q and R has led to it, or rounding of A is more than eps0 and
    `default_accuracy`."""
    if f == 0 or rounding <= OUT_OF_PROPORTION * ROUNDING * row_length(S, mp, MOMENTUM):
        return False
    if not exact:
        return True
    take_gradient(S, mp, k, MOMENTUM)
    return noise_of_A(S, I, mp, f) > max(eps0, default_accuracy(S, k))


@stage
def remember_R(S, I, m, f, fresh, age, mode):
    """What the next QP may use of R, and what its use has cost."""
    I[COUNTS, OLD_ORDER] = -1
    if mode & TODAYS_QR:
        return
    if fresh:
        keep_R(S, I, f)
    I[COUNTS, OLD_ORDER] = f
    if mode & ONLINE:
        S[REALS, FACTORIZATION_COST] = qr_flops(m, f)
        cost = cg_iteration_flops(m, f) * I[COUNTS, CG_ITERATIONS]
        factorized = I[COUNTS, FACTORIZATIONS] > 0
        given_up = age if factorized else 0
        keep_account(I[COUNTS], S[REALS], factorized, given_up, cost, I[COUNTS, DIRECTIONS])


@stage
def are_sound(A, d, lower, upper):
    """Whether entries are finite, as of `problems.qp`, and lower < upper throughout."""
    m, k = A.shape
    size, apart = 0.0, 0
    for i in range(m):
        for j in range(k):
            size += A[i, j] * A[i, j]
        size += d[i] * d[i]
    for j in range(k):
        apart += lower[j] < upper[j]
    return size <= LARGEST and apart == k


@kernel
def algorithm_2(A, d, lower, upper, row_id, S, I, eps0, mode):
    """Solve one QP with the step numbers of `method`; S and I are modified, nothing else is.

    A : (m, k) C order; d (m,); lower, upper, row_id (k,)
    S, I : a `Workspace` of at least this size, with the memory of the previous solve
    eps0 : accuracy in ‖A δx‖ (3.13), negative for 1e-9 of the largest |b_jᵀ d|, ‖b_j‖ = 1
    mode : the bits above

    x, the working set, the counts and the status are left in the workspace.
    """
    A, d, lower, upper, row_id = lent(A), lent(d), lent(lower), lent(upper), lent(row_id)
    S, I = lent(S), lent(I)
    if mode & UNCHECKED and not are_sound(A, d, lower, upper):
        I[COUNTS, STATUS] = REFUSED
        return
    m, k = A.shape
    gram, mp = (mode & GRAM) != 0, (m + LANES - 1) // LANES * LANES
    known, head = NOTHING, mp
    if gram and mode & WARM:
        done, known, head = solve_settled(A, d, lower, upper, row_id, S, I, ROUNDING)
        if done:
            return
    warm, fresh = reset(I, mode), (mode & TODAYS_QR) != 0
    if warm:
        map_rows(row_id, I, k)
    redundant = warm and k > m and knows_set(I, m)  # then the last F is seldom far off
    if gram and not mode & CUSTOM and LEAST <= k <= MOST and not redundant:
        done, reached = solve_by_newton(
            A, d, lower, upper, row_id, S, I, mp, ROUNDING, warm, known, head
        )
        if done:
            return
        warm = warm or reached
    lay_out(A, d, lower, upper, S, mp)
    if eps0 < 0:
        take_gradient(S, mp, k, MOMENTUM)
        eps0 = default_accuracy(S, k)
    w = extrapolation(S[REALS]) if warm and mode & EXTRAPOLATED else 0.0
    f, age = begin(S, I, m, mp, k, mode, warm, w)  # 1.
    _, rounding = take_residual(S, I, mp, k)  # 2.
    I[COUNTS, FLOPS] += product_flops(m, k)
    passes = 50 + 20 * k
    if mode & CUSTOM and I[COUNTS, PASSES] >= 0:
        passes = I[COUNTS, PASSES]
    refining = inf  # ‖A_Fᵀ r‖ before a full step on the same F; inf where F has changed
    demanded = False
    status = OUT_OF_PASSES

    while True:
        take_gradient(S, mp, k, RESIDUAL)  # 7., and the right-hand side of 3.
        I[COUNTS, FLOPS] += product_flops(m, k)
        slope, aim = slope_of(S, I, f), rounding
        if not fresh:
            aim = max(SHARE * eps0 / S[REALS, INVERSE_NORM], rounding)  # (3.20)
        # a slope that refinement does not halve is rounding
        if demanded or (slope > max(aim, rounding * sqrt(f)) and slope < 0.5 * refining):
            demanded = False
            if passes <= 0:
                break
            passes -= 1
            if refining == inf:
                I[COUNTS, DIRECTIONS] += 1
            f, fresh, theta, reached, rounding = descend(S, I, m, mp, k, f, fresh, aim, mode)
            refining = slope if theta == 1.0 and reached == 0 else inf
            continue
        left, worst, entering = most_wrong(S, I, k, f, slope)  # 8.
        if worst <= rounding:  # 9.
            S[REALS, WRONG] = left
            exact = fresh and (refining < inf or f == 0)
            passable = 100 if fresh else 2
            sound = left <= max(SHARE * eps0, passable * rounding) and rounding < inf
            sound = sound and not is_doubtful(S, I, mp, k, f, exact, eps0, rounding)
            if sound or exact:
                status = SOLVED if sound else INACCURATE
                break
            # rows are barred that should move: A_Fᵀ r is at rounding, but where A_F is nearly
            # dependent r is not yet.  A full step by today's Q and R makes r itself small
            if not fresh:
                f, fresh = factorize(S, I, m, mp, f, 0), True
            refining, demanded = inf, f > 0
            unmark(I, k)
            continue
        if passes <= 0:
            break
        passes -= 1
        f, fresh, entered = enter(S, I, m, mp, f, entering, fresh, eps0, rounding, mode)
        if entered:
            refining = inf

    remember_R(S, I, m, f, fresh, age, mode)
    I[COUNTS, STATUS] = status
    if mode & EXTRAPOLATED:
        remember_before(S, BEFORE, X, P, S[REALS], I[PREVIOUS], k, warm)
    finish(row_id, lower, upper, S, I, k, f)


@function
def solve(A, d, lower, upper, row_id, S, I, eps0, mode):
    """`algorithm_2` for compiled steps, see `problems.qp_kernel`."""
    algorithm_2(A, d, lower, upper, row_id, S, I, eps0, mode)
    return I[COUNTS, STATUS] == SOLVED
