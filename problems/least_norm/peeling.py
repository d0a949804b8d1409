"""A proof that the columns of a contact graph are independent, body by body.

Let Gλ = 0.  If few constraints act on a body, so that their columns, as far as they are about this
body, are independent, then its three equations leave these λ no other value than 0.  The body and
its constraints are taken away, its neighbours have fewer, and so on.  Where nothing is left of the
graph, G has full column rank: a tower comes down from the top.

It costs a pass over the columns, and what a factorization of GᵀG can prove ends where the least
singular value squared is rounding: at some thousand bodies on top of each other, each with friction
that sticks.  Here only the columns of one body are weighed against each other.
"""

from __future__ import annotations

import numpy as np

from problems.kernels.compiled import kernel

SURE_SINE = 1e-3
"""Sine of the angle between a column and the span of others that is no rounding."""


@kernel
def peels(entries, bodies, D):
    """Whether all columns of D⁻ᵀG are proved independent; False proves nothing.

    entries : (k, 6) for the two bodies of each column;  bodies : (k, 2), −1 the ground;  D : (3n,)
    """
    k, n = bodies.shape[0], D.size // 3
    begin = np.zeros(n + 1, np.int64)
    for c in range(k):
        for side in range(2):
            if bodies[c, side] >= 0:
                begin[bodies[c, side] + 1] += 1
    left = begin[1:].copy()
    for b in range(n):
        begin[b + 1] += begin[b]
    columns, end = np.empty(begin[n], np.int64), begin[:-1].copy()
    for c in range(k):
        for side in range(2):
            b = bodies[c, side]
            if b >= 0:
                columns[end[b]] = c
                end[b] += 1
    waiting, many = np.empty(n + begin[n], np.int64), 0
    for b in range(n):
        if 0 < left[b] <= 3:
            waiting[many] = b
            many += 1
    gone, remaining = np.zeros(k, np.bool_), k
    basis, these = np.empty((3, 3)), np.empty(3, np.int64)
    while many > 0:
        many -= 1
        b = waiting[many]
        found, independent = 0, True
        for place in range(begin[b], begin[b + 1]):
            c = columns[place]
            if gone[c]:
                continue
            offset = 0 if bodies[c, 0] == b else 3
            for i in range(3):
                basis[found, i] = entries[c, offset + i] / D[3 * b + i]
            size = np.sqrt(np.sum(basis[found] ** 2))
            for other in range(found):
                share = np.sum(basis[found] * basis[other])
                for i in range(3):
                    basis[found, i] -= share * basis[other, i]
            rest = np.sqrt(np.sum(basis[found] ** 2))
            if not rest > SURE_SINE * size:
                independent = False
                break
            basis[found] /= rest
            these[found] = c
            found += 1
        if not independent:
            continue
        for place in range(found):
            c = these[place]
            gone[c] = True
            for side in range(2):
                other = bodies[c, side]
                if other >= 0:
                    left[other] -= 1
                    if other != b and 0 < left[other] <= 3:
                        waiting[many] = other
                        many += 1
        remaining -= found
    return remaining == 0
