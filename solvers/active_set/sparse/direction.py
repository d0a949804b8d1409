"""Step 3 of the sparse path: L of A_F, today's or old, and the descent direction by its help.

L (`sparse_cholesky`) preconditions conjugate gradients on the least-squares problem (3.19).  It
follows F column by column, and is given up for today's where it needs more iterations than the rule
allows.  What the shift is for is said in `sparse_loop`.
"""

from __future__ import annotations

from math import ceil, cos, sqrt

from solvers.active_set.compiled import kernel, stage
from solvers.active_set.loop import (
    CUSTOM,
    DEFERRED,
    NO_R,
    ONLINE,
    SCRATCH,
)
from solvers.active_set.online_rule import PRICE, iterations_worth
from solvers.active_set.sparse.cholesky import (
    add,
    cholesky,
    delete_column,
    dot,
    insert_column,
    inverse_norm,
    solve_L,
    solve_LT,
)
from solvers.active_set.sparse.workspace import (
    IN_F,
    IN_L,
    LARGEST_SHIFT,
)
from solvers.active_set.tolerances import LAST_STEP, LEAST_SHIFT, LOWERED, NOISE, ROUGH
from solvers.active_set.workspace import (
    AGE,
    CG_ITERATIONS,
    CG_LIMIT,
    COUNTS,
    DUE,
    FACTORIZATION_COST,
    FACTORIZATION_FLOPS,
    FACTORIZATIONS,
    FLOPS,
    FRESH,
    GRADIENT,
    INTERVAL,
    INVERSE_NORM,
    LOWER,
    ORDER,
    REALS,
    REMAINDER,
    RESIDUAL,
    SEARCH,
    SHIFT,
    UPDATES,
    UPPER,
    YOUNG,
    P,
    V,
    Y,
    Z,
)

MANY = 20.0
"""Iterations on today's L beyond which the next shift is lower, by `LOWERED`, fewer where a new L
costs less than they do; twice as many, and it is lowered at once."""
PER_FLOP, PER_ENTRY, PER_COLUMN = 0.37, 13.0, 83.0
"""What a factorization takes for each flop, entry and column of L, in units of 1/`PRICE` of an
iteration's flop; measured.  The online rule, which is about time, counts so; the paper's counts
flops."""
LOWER_SHIFT, TOO_OLD = 1, 2
"""Why the next QP is due to factorize."""
MOST_FACTORS = 8
"""Factorizations for one direction: an old L's place is taken, the shift lowered from first to
least, and something to spare."""
INVERSE_ITERATIONS = 4
"""Of inverse iteration, by which 1e-3 and more of ‖B_F v‖ becomes 1e-16 beside what is below."""
REFINEMENTS = 8
"""Conjugate gradient iterations with today's L without shift, which is right but for rounding: one
or two lead to what rounding leaves, and hundreds from there on to overflow."""
MOST_ITERATIONS = 200
"""Conjugate gradient iterations of one direction with today's L."""


@kernel
def factorize_sparse(pattern, Bx, Lx, S, I, f):
    """Today's L of the f columns in F, with the shift that they need.

    Row COUNTS remembers at ORDER the least size of F at which columns were dependent; a smaller F
    is tried without shift.
    """
    inside, kept = I[IN_F], I[IN_L]
    for c in range(pattern.order.size):
        kept[c] = inside[c]
    if f < I[COUNTS, ORDER]:
        S[REALS, SHIFT] = 0.0
    flops = cholesky(pattern, Bx, S, I, Lx, S[REALS, SHIFT])
    if flops < 0:
        I[COUNTS, ORDER] = f
        S[REALS, SHIFT] = S[REALS, LARGEST_SHIFT]
        I[COUNTS, FLOPS] += -1 - flops
        flops = cholesky(pattern, Bx, S, I, Lx, S[REALS, SHIFT])
    S[REALS, FACTORIZATION_FLOPS] = flops
    k = pattern.order.size
    if I[COUNTS, AGE] > 0:
        for c in range(k):
            for b in range(Bx.shape[1]):
                Bx[k + c, b] = Bx[c, b]
    S[REALS, FACTORIZATION_COST] = PER_FLOP * flops + PER_ENTRY * pattern.entries + PER_COLUMN * k
    S[REALS, INVERSE_NORM] = inverse_norm(pattern, S, I, Lx)
    I[COUNTS, AGE] = 0
    I[COUNTS, FACTORIZATIONS] += 1
    I[COUNTS, FLOPS] += flops + 8 * pattern.entries


@kernel
def follow(pattern, Bx, Lx, S, I, f):
    """Make L that of the present F: column by column, or anew where that costs less.

    An old L gets the columns of its own time, which are kept past today's in Bx.
    """
    inside, kept, change = I[IN_F], I[IN_L], pattern.change
    k, cost, changes = change.size, 0, 0
    for c in range(k):
        if inside[c] != kept[c]:
            cost += change[c]
            changes += 1
    if changes == 0:
        return
    sound = cost < S[REALS, FACTORIZATION_FLOPS]
    if sound:
        for c in range(k):
            if kept[c] and not inside[c]:
                sound = delete_column(pattern, Lx, S, I, c) and sound
        for c in range(k):
            if inside[c] and not kept[c]:
                sound = insert_column(pattern, Bx[k:], Lx, S, I, c, S[REALS, SHIFT]) and sound
        I[COUNTS, UPDATES] += changes
        I[COUNTS, FLOPS] += cost
    if not sound:
        factorize_sparse(pattern, Bx, Lx, S, I, f)


@stage
def is_of_this_A(Bx, k):
    """Whether L is that of today's A, be it of another F."""
    differ = 0
    for c in range(k):
        for b in range(Bx.shape[1]):
            differ += Bx[c, b] != Bx[k + c, b]
    return differ == 0


@kernel
def has_todays_L(I, k):
    """Whether L is that of today's A and of the present F."""
    if I[COUNTS, AGE] > 0:
        return False
    inside, kept = I[IN_F], I[IN_L]
    same = True
    for c in range(k):
        same = same and inside[c] == kept[c]
    return same


@kernel
def error_left(pattern, Lx, S, I):
    """‖A(x − x*)‖ that the gradient on F stands for, (Δ_Fᵀ(B_FᵀB_F)⁻¹Δ_F)^½, if L is of B_F."""
    inside, y = I[IN_F], S[Y]
    total = 0.0
    for c in range(pattern.order.size):
        y[c] = S[GRADIENT, c] if inside[c] else 0.0
    solve_L(pattern, Lx, y)
    for c in range(pattern.order.size):
        total += y[c] * y[c]
    return sqrt(total)


@kernel
def error_hidden(pattern, Bx, Lx, S, I, m, rounding):
    """‖A δx‖ that rounding may hide where columns of F all but depend on each other.

    Along v, ‖v‖ = 1, of which ‖B_F v‖ is as small as it gets: a gradient on F says no more than
    rounding/‖B_F v‖ about A x, and z itself no more than ‖z‖ ‖B_F v‖.  v by inverse iteration with
    today's L, whose shift tells it from all that is independent.
    """
    k, inside, v, w = pattern.order.size, I[IN_F], S[Y], S[FRESH]
    for c in range(k):
        v[c] = cos(1.0 + c) if inside[c] else 0.0  # a start that favours none
    for _ in range(INVERSE_ITERATIONS):
        solve_L(pattern, Lx, v)
        solve_LT(pattern, Lx, v)
        total = 0.0
        for c in range(k):
            total += v[c] * v[c]
        for c in range(k):
            v[c] /= sqrt(total)
    for i in range(m):
        w[i] = 0.0
    length = 0.0
    for c in range(k):
        length += S[Z, c] ** 2
        if inside[c]:
            add(pattern.Bi, Bx, c, v[c], w)
    moved = 0.0
    for i in range(m):
        moved += w[i] * w[i]
    return min(rounding / sqrt(moved), sqrt(length * moved)) if moved > 0.0 else 0.0


@kernel
def iteration_flops(pattern, f, m, plain):
    """C_IT: products with B_F and B_Fᵀ, solves with L and Lᵀ, and the vectors."""
    k = pattern.order.size
    products = 4 * pattern.nonzeros * f // max(k, 1)
    return products + (0 if plain else 4 * pattern.entries) + 4 * m + 10 * f


@kernel
def enough_of(S, f, tolerance, rounding):
    """vᵀ(L Lᵀ)⁻¹v, the square of what is left in A p, at which one more step will do.

    Where columns depend on each other: there is no end to conjugate gradients otherwise than by
    p so long along what has only just become independent that it ends at one bound after another.
    """
    shift = S[REALS, SHIFT]
    if shift == 0.0:
        return 0.0
    left = LAST_STEP * tolerance * S[REALS, INVERSE_NORM]
    return max(left * left, NOISE * f * rounding * rounding / shift)


@stage
def is_blocked(S, I, k):
    """Whether z + p is beyond a bound."""
    z, p, low, high, inside = S[Z], S[P], S[LOWER], S[UPPER], I[IN_F]
    blocked = False
    for c in range(k):
        if inside[c]:
            blocked = blocked or z[c] + p[c] < low[c] or z[c] + p[c] > high[c]
    return blocked


@kernel
def conjugate_gradients_sparse(
    pattern, Bx, Lx, S, I, m, tolerance, enough, limit, plain, bounded=True
):
    """Minimise ‖B_F p + r‖ over p, preconditioned by L Lᵀ, until ‖B_Fᵀ(B_F p + r)‖ ≤ tolerance.

    Row GRADIENT holds Bᵀ r.  p is left in row P, 0 outside F, and B_F p + r in row REMAINDER.
    A p that will be cut short, if it is `bounded`, need only be roughly right.  Returns the
    iterations made, as a negative number, −1 − iterations, when the next would exceed `limit`.

    With M⁻¹ = E (L Lᵀ)⁻¹ Eᵀ, E the rows of F, which is positive definite whatever columns L has:
    v = B_Fᵀ s, y = M⁻¹ v, q := −y + (vᵀy/vᵀy before) q, α = vᵀy/‖B_F q‖² (Björck and Elfving 1979).

    Rounding in v along what is dependent weighs 1/shift in vᵀy, and where that is most of it α is
    far too long.  So vᵀy at or below `enough` makes for a last step, with q = −y and α = 1, which
    is iterative refinement.
    """
    k = pattern.order.size
    s, w, p, v = S[REMAINDER], S[FRESH], S[P], S[V]
    y, q, r, inside, gradient = S[Y], S[SEARCH], S[RESIDUAL], I[IN_F], S[GRADIENT]
    for i in range(m):
        s[i] = r[i]
    for c in range(k):
        p[c] = 0.0
        q[c] = 0.0
    gamma = 1.0
    rough = 0.0
    iterations = 0
    while True:
        slope = 0.0
        for c in range(k):
            along = 0.0
            if inside[c]:
                if iterations == 0:
                    along = gradient[c]
                else:
                    along = dot(pattern.Bi, Bx, c, s)
            v[c] = along
            y[c] = along
            slope += along * along
        if sqrt(slope) <= tolerance:
            return iterations
        if iterations + 1 > limit:
            return -1 - iterations
        if iterations == 0:
            rough = ROUGH * sqrt(slope) if bounded else 0.0
        elif sqrt(slope) <= rough:
            rough = 0.0
            if is_blocked(S, I, k):
                return iterations
        if not plain:
            solve_L(pattern, Lx, y)
            solve_LT(pattern, Lx, y)
        before, gamma = gamma, 0.0
        for c in range(k):
            gamma += v[c] * y[c]
        last = gamma <= enough
        ratio = 0.0 if last else gamma / before
        for i in range(m):
            w[i] = 0.0
        for c in range(k):
            if inside[c]:
                value = q[c] * ratio - y[c]
                q[c] = value
                add(pattern.Bi, Bx, c, value, w)
        curvature = 0.0
        for i in range(m):
            curvature += w[i] * w[i]
        if curvature == 0.0:
            return -1 - iterations
        alpha = 1.0 if last else gamma / curvature
        for c in range(k):
            p[c] += alpha * q[c]
        for i in range(m):
            s[i] += alpha * w[i]
        iterations += 1
        if last:
            return iterations


@stage
def direction(pattern, Bx, Lx, S, I, m, f, tolerance, rounding, mode):
    """Step 3; returns the age of the L that was given up on the way, or 0.

    An old L that needs more iterations than the rule allows is replaced by today's at once: by the
    paper's, (2 C_QR/C_IT)^½, by the online rule as many as cost what a factorization does.  Where
    the paper's rule is deferred, the next QP is due to factorize instead.
    """
    given_up, worth, spent = 0, 0.0, 0
    if mode & SCRATCH and not has_todays_L(I, pattern.order.size):
        factorize_sparse(pattern, Bx, Lx, S, I, f)
    plain = (mode & NO_R) != 0
    if not plain:
        follow(pattern, Bx, Lx, S, I, f)
    interval = I[COUNTS, INTERVAL] if mode & CUSTOM else 0
    for _ in range(MOST_FACTORS):
        todays = has_todays_L(I, pattern.order.size)
        C_IT = iteration_flops(pattern, f, m, plain)
        C_QR = S[REALS, FACTORIZATION_COST]
        many = min(MANY, 2.0 + 2.0 * PRICE * C_QR / C_IT)
        worth = sqrt(2.0 * S[REALS, FACTORIZATION_FLOPS] / C_IT)
        if mode & ONLINE:
            worth = iterations_worth(S[REALS], C_QR, C_IT)
        if mode & CUSTOM and S[REALS, CG_LIMIT] >= 0:
            worth = S[REALS, CG_LIMIT]
        limit = worth
        if plain:
            limit = 10.0 * f + 100
        elif todays:
            if S[REALS, SHIFT] == 0.0:
                limit = REFINEMENTS
            else:
                limit = ceil(2.0 * many) if S[REALS, SHIFT] > LEAST_SHIFT else MOST_ITERATIONS
        elif interval > 0 or mode & DEFERRED:
            limit = MOST_ITERATIONS
        enough = 0.0 if plain else enough_of(S, f, tolerance, rounding)
        made = conjugate_gradients_sparse(pattern, Bx, Lx, S, I, m, tolerance, enough, limit, plain)
        spent = made if made >= 0 else -1 - made
        I[COUNTS, CG_ITERATIONS] += spent
        I[COUNTS, FLOPS] += spent * C_IT
        if todays:
            S[REALS, YOUNG] = spent
        lower = todays and spent > many and S[REALS, SHIFT] > LEAST_SHIFT
        if lower and I[COUNTS, DUE] != LOWER_SHIFT:
            S[REALS, SHIFT] = max(LOWERED * S[REALS, SHIFT], LEAST_SHIFT)
            I[COUNTS, DUE] = LOWER_SHIFT
        if made >= 0 or plain or (todays and not lower):
            break
        given_up = max(given_up, I[COUNTS, AGE])
        I[COUNTS, DUE] = 0
        factorize_sparse(pattern, Bx, Lx, S, I, f)
    if mode & DEFERRED and spent > worth and I[COUNTS, DUE] == 0:
        I[COUNTS, DUE] = TOO_OLD
    return given_up
