"""Compiled kernels for the QR factorization of the free columns, A_F = Q R, of algorithm 2.

    qr_factorize            pivoted Householder (Businger and Golub 1965), from any column on
    karasalo_bound          a lower bound on σ_min of R (Karasalo 1974)
    inverse_norm_estimate   ‖R⁻¹‖ for (3.20) and ε₁ (Cline, Moler, Stewart and Wilkinson 1979)
    qr_append               one more column of today, by its Householder reflection
    r_delete                one column less of an R whose Q is not kept, by Givens rotations

Today's factorization has its reflections in W, so that Qᵀr is at hand; it is what small QPs use.
An R that outlives its QP stands alone, a preconditioner for tomorrow's A_F.  mp is m rounded up to
`LANES`.  The columns are of length 1, so that "dependent" has one meaning for all of them.
"""

from __future__ import annotations

from math import hypot, sqrt

from solvers.active_set.compiled import kernel
from solvers.active_set.tolerances import SUSPECT, UNIT_ROUNDOFF
from solvers.active_set.workspace import LANES, N_FLOAT_ROWS, NORM2, TAU, F, V, Y


@kernel
def dependence_tolerance(m):
    """Distance ρ of a unit column from the span of others that is rounding: 16 u √m."""
    return 16 * UNIT_ROUNDOFF * sqrt(max(m, 1))


@kernel
def row_length(S, mp, row):
    """Length of a row of m entries."""
    total, x = 0.0, S[row]
    for i in range(mp):
        total += x[i] * x[i]
    return sqrt(total)


@kernel
def reflect(S, l, length):
    """Make reflection l of column l of W, whose entries above l are 0 and whose length is given.

    H = I − tau v vᵀ takes it to (R_ll, 0, …); v stays in W, tau in row TAU, R_ll goes to R.
    """
    n = S.shape[1]
    w = N_FLOAT_ROWS + n + l
    alpha = S[w, l]
    beta = -length if alpha >= 0 else length
    S[w, l] = alpha - beta
    S[TAU, l] = 1.0 / (beta * (beta - alpha))
    S[N_FLOAT_ROWS + 2 * n + l, l] = beta


@kernel
def apply_reflection(S, mp, l, row):
    """Row `row` := (I − tau v vᵀ) row for reflection l."""
    first = l // LANES * LANES
    v, x = S[N_FLOAT_ROWS + S.shape[1] + l, first:mp], S[row, first:mp]
    product = 0.0
    for i in range(v.size):
        product += v[i] * x[i]
    product *= S[TAU, l]
    for i in range(v.size):
        x[i] -= product * v[i]


@kernel
def reflect_column(S, mp, l, c):
    """Apply reflection l to column c of W; its entry l is R_lc, and moves to R.  Returns it."""
    n = S.shape[1]
    w = N_FLOAT_ROWS + n + c
    apply_reflection(S, mp, l, w)
    entry = S[w, l]
    S[N_FLOAT_ROWS + 2 * n + c, l] = entry
    S[w, l] = 0.0
    return entry


@kernel
def exchange_columns(S, I, mp, order, c, d):
    """Columns c and d of W, with their first `order` entries of R, change places in F."""
    n = S.shape[1]
    W0, R0 = N_FLOAT_ROWS + n, N_FLOAT_ROWS + 2 * n
    I[F, c], I[F, d] = I[F, d], I[F, c]
    S[NORM2, c], S[NORM2, d] = S[NORM2, d], S[NORM2, c]
    x, y = S[W0 + c], S[W0 + d]
    for i in range(mp):
        x[i], y[i] = y[i], x[i]
    x, y = S[R0 + c], S[R0 + d]
    for i in range(order):
        x[i], y[i] = y[i], x[i]


@kernel
def qr_factorize(S, I, m, mp, f, first):
    """Factorize the columns I[F, :f] from position `first` on; returns how many are independent.

    The first `first` columns keep their place and their reflections.  Of the others the one of the
    greatest remaining length is next (Businger and Golub).  F is put in pivot order; the columns
    past the returned order depend on those before.
    """
    n = S.shape[1]
    B0, W0, R0 = N_FLOAT_ROWS, N_FLOAT_ROWS + n, N_FLOAT_ROWS + 2 * n
    for c in range(first, f):
        w, b = S[W0 + c], S[B0 + I[F, c]]
        for i in range(mp):
            w[i] = b[i]
        for l in range(first):
            reflect_column(S, mp, l, c)
        S[NORM2, c] = 1.0 if first == 0 else row_length(S, mp, W0 + c) ** 2
    tolerance = dependence_tolerance(m)
    order = first
    while order < min(f, m):
        best = order
        for c in range(order + 1, f):
            if S[NORM2, c] > S[NORM2, best]:
                best = c
        # lengths are downdated below; the pivot's is taken anew
        length = row_length(S, mp, W0 + best)
        if length * length < 0.01 * S[NORM2, best]:
            for c in range(order, f):
                S[NORM2, c] = row_length(S, mp, W0 + c) ** 2
            continue
        if length <= tolerance:
            break
        if best != order:
            exchange_columns(S, I, mp, order, order, best)
        reflect(S, order, length)
        for c in range(order + 1, f):
            entry = reflect_column(S, mp, order, c)
            S[NORM2, c] = max(0.0, S[NORM2, c] - entry * entry)
        order += 1
    while order > 0 and abs(S[R0 + order - 1, order - 1]) < SUSPECT:
        if (
            karasalo_bound(S, order) > tolerance
            or inverse_norm_estimate(S, order) * tolerance < 1.0
        ):
            break
        order -= 1
    return order


@kernel
def qr_append(S, I, m, mp, f, j):
    """Try column j as the (f+1)-th of today's factorization; False where it depends on the others.

    u = Qᵀ b_j, ρ = length of the rest.  b_j is dependent when ρ is no larger than the rounding in
    A_F w, tolerance · (1 + ‖w‖) with R w = u.  Row V holds w afterwards.
    """
    w_row, size = N_FLOAT_ROWS + S.shape[1] + f, 0.0
    w, b = S[w_row], S[N_FLOAT_ROWS + j]
    for i in range(mp):
        w[i] = b[i]
    for l in range(f):
        S[V, l] = reflect_column(S, mp, l, f)
    rho = row_length(S, mp, w_row)
    solve_R(S, f, V)
    for i in range(f):
        size += S[V, i] * S[V, i]
    if rho <= dependence_tolerance(m) * (1.0 + sqrt(size)):
        return False
    I[F, f] = j
    reflect(S, f, rho)
    return True


@kernel
def solve_R(S, f, row):
    """Row `row` := R⁻¹ row."""
    R0, x = N_FLOAT_ROWS + 2 * S.shape[1], S[row]
    for j in range(f - 1, -1, -1):
        r = S[R0 + j]
        value = x[j] / r[j]
        x[j] = value
        for i in range(j):
            x[i] -= value * r[i]


@kernel
def solve_RT(S, f, row):
    """Row `row` := R⁻ᵀ row."""
    R0, x = N_FLOAT_ROWS + 2 * S.shape[1], S[row]
    for j in range(f):
        r, value = S[R0 + j], x[j]
        for i in range(j):
            value -= r[i] * x[i]
        x[j] = value / r[j]


@kernel
def karasalo_bound(S, f):
    """Lower bound 1/‖W(R)⁻¹‖_F ≤ σ_min(R) for f > 0 (Karasalo 1974; Higham 2002, theorem 8.12).

    W has the diagonal |r_ii| and −b_i, b_i = max_{j>i} |r_ij|, in the rest of row i, so that
    |R⁻¹| ≤ W⁻¹ entry by entry.  With S_i the sum of squares of the column sums of W⁻¹ below i − 1,

        S_i = 1/r_ii² + (1 + b_i/|r_ii|)² S_{i+1},   ‖W⁻¹‖_F² = Σ 1/r_ii² + (b_i/|r_ii|)² S_{i+1}.
    """
    R0 = N_FLOAT_ROWS + 2 * S.shape[1]
    sums = 0.0
    total = 0.0
    for i in range(f - 1, -1, -1):
        largest = 0.0
        for j in range(i + 1, f):
            largest = max(largest, abs(S[R0 + j, i]))
        inverse = 1.0 / abs(S[R0 + i, i])
        ratio = largest * inverse
        total += inverse * inverse + ratio * ratio * sums
        sums = inverse * inverse + (1.0 + ratio) ** 2 * sums
    return 1.0 / sqrt(total)


@kernel
def inverse_norm_estimate(S, f):
    """Estimate ‖R⁻¹‖₂ from below (Cline, Moler, Stewart and Wilkinson 1979); 1 for f = 0.

    1. solve Rᵀ y = e, choosing each e_i = ±1 so that |y_i| and the sums that it leaves for the
       later unknowns grow most;
    2. solve R z = y; the estimate is ‖z‖/‖y‖.
    """
    if f == 0:
        return 1.0
    R0 = N_FLOAT_ROWS + 2 * S.shape[1]
    for i in range(f):
        S[V, i] = 0.0
    for i in range(f):
        pivot = S[R0 + i, i]
        sign = -1.0 if S[V, i] > 0 else 1.0
        greedy, other = (sign - S[V, i]) / pivot, (-sign - S[V, i]) / pivot
        grown_greedy, grown_other = abs(greedy), abs(other)
        for j in range(i + 1, f):
            grown_greedy += abs(S[V, j] + S[R0 + j, i] * greedy)
            grown_other += abs(S[V, j] + S[R0 + j, i] * other)
        y = greedy if grown_greedy >= grown_other else other
        S[Y, i] = y
        for j in range(i + 1, f):
            S[V, j] += S[R0 + j, i] * y
    largest = 0.0
    for i in range(f):
        largest = max(largest, abs(S[Y, i]))
    size = 0.0
    for i in range(f):
        S[Y, i] /= largest
        size += S[Y, i] * S[Y, i]
    solve_R(S, f, Y)
    grown = 0.0
    for i in range(f):
        grown = hypot(grown, S[Y, i])
    return grown / sqrt(size)


@kernel
def r_delete(S, I, f, position):
    """Remove one column from R and F; Givens rotations chase the subdiagonal that it leaves."""
    n = S.shape[1]
    R0 = N_FLOAT_ROWS + 2 * n
    for c in range(position, f - 1):
        I[F, c] = I[F, c + 1]
        for i in range(c + 2):
            S[R0 + c, i] = S[R0 + c + 1, i]
    for l in range(position, f - 1):
        a, b = S[R0 + l, l], S[R0 + l, l + 1]
        length = hypot(a, b)
        cosine, sine = a / length, b / length
        S[R0 + l, l] = length
        for c in range(l + 1, f - 1):
            upper, lower = S[R0 + c, l], S[R0 + c, l + 1]
            S[R0 + c, l] = cosine * upper + sine * lower
            S[R0 + c, l + 1] = cosine * lower - sine * upper
