"""Conjugate gradients for the descent direction, preconditioned with an old R; compiled.

The descent direction of algorithm 2 solves (Lötstedt 1984, (3.19), corrected)

    A_Fᵀ A_F p + A_Fᵀ r = 0,      that is   minimise ‖A_F p + r‖.

A = D⁻ᵀG varies little from step to step, so that R of an earlier QR factorization makes A_F R⁻¹
nearly orthogonal, and conjugate gradients on the least-squares problem in y = R p converge in a few
iterations (Björck and Elfving 1979, p. 156):

1. g = R⁻ᵀ A_Fᵀ s with s = A_F p + r, q the first time −g
2. w = A_F R⁻¹ q, α = ‖g‖²/‖w‖²
3. p += α R⁻¹ q,  s += α w
4. v = A_Fᵀ s; stop if ‖v‖ is small, by (3.20) ‖A_F δp‖ ≤ ‖v‖ ‖R⁻¹‖
5. the new g; q := −g + (‖g‖²/‖g_old‖²) q; back to 2

A_Fᵀ A_F is never formed.
"""

from __future__ import annotations

from math import sqrt

from solvers.active_set.compiled import kernel
from solvers.active_set.factorization import solve_R, solve_RT
from solvers.active_set.workspace import N_FLOAT_ROWS, REMAINDER, SEARCH, STEP, F, P, V, Y


@kernel
def conjugate_gradients(S, I, mp, f, right, tolerance, limit, preconditioned):
    """Minimise ‖A_F p + b‖ with b in row `right`, until ‖A_Fᵀ(A_F p + b)‖ ≤ tolerance.

    p is left in row P, A_F p + b in row REMAINDER.  Returns the iterations made; as a negative
    number, −1 − iterations, when the next one would exceed `limit`.
    """
    B0 = N_FLOAT_ROWS
    s, w, p, v = S[REMAINDER], S[Y], S[P], S[V]
    search, step, b = S[SEARCH], S[STEP], S[right]
    for i in range(mp):
        s[i] = b[i]
    for j in range(f):
        p[j] = 0.0
        search[j] = 0.0
    gamma = 1.0
    iterations = 0
    while True:
        slope = 0.0
        for j in range(f):
            b, along = S[B0 + I[F, j]], 0.0
            for i in range(mp):
                along += b[i] * s[i]
            v[j] = along
            slope += along * along
        if sqrt(slope) <= tolerance:
            return iterations
        if iterations + 1 > limit:
            return -1 - iterations
        if preconditioned:
            solve_RT(S, f, V)
        before, gamma = gamma, 0.0
        for j in range(f):
            gamma += v[j] * v[j]
        for j in range(f):
            search[j] = search[j] * (gamma / before) - v[j]
            step[j] = search[j]
        if preconditioned:
            solve_R(S, f, STEP)
        for i in range(mp):
            w[i] = 0.0
        for j in range(f):
            b, value = S[B0 + I[F, j]], step[j]
            for i in range(mp):
                w[i] += value * b[i]
        curvature = 0.0
        for i in range(mp):
            curvature += w[i] * w[i]
        if curvature == 0.0:
            return -1 - iterations
        alpha = gamma / curvature
        for j in range(f):
            p[j] += alpha * step[j]
        for i in range(mp):
            s[i] += alpha * w[i]
        iterations += 1
