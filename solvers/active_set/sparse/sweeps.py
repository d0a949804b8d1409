"""Projected Gauss–Seidel between two directions: it sorts out who is in F, without a factor.

Where z + p was cut off at the bounds of some, its neighbours are wrong by as much as these moved,
and find out one direction after the other, each with an L to be changed.  Sweeps, which minimise
½‖B z + d‖² one z after the other, tell them at the price of a product with B and Bᵀ each.

Measured, µs per QP without / with them: heaps of 225 and 500 bodies, cold, 580 / 360 and
1,570 / 770; towers of 110, 225 and 500 with friction, warm, in the mean 494 / 172, 390 / 263 and
2,780 / 2,520, in the median, which rests on an older L then, 64 / 71, 79 / 92 and 394 / 381.  For
columns that are independent: those that share a load would share it by the order of the sweeps, and
be blocked (a pyramid of 105 bodies 180 / 455).
"""

from __future__ import annotations

from solvers.active_set.compiled import kernel
from solvers.active_set.sparse.cholesky import add, dot
from solvers.active_set.sparse.workspace import IN_F
from solvers.active_set.workspace import LOWER, RESIDUAL, UPPER, Z

SWEEPS = 2
"""In either direction once."""
SWEPT = 8
"""Directions of a QP that are followed by sweeps; what goes on for longer goes round in circles."""


@kernel
def sweep(pattern, Bx, S, I, aim):
    """Lower ½‖B z + d‖² from z on, each z within its bounds; returns |F| afterwards.

    Row RESIDUAL holds B z + d and follows.  Who is between its bounds, or pulled off its bound by a
    slope beyond `aim`, is in F then, and who is pushed against it is not.
    """
    Bi, k = pattern.Bi, pattern.order.size
    z, low, high, r, inside = S[Z], S[LOWER], S[UPPER], S[RESIDUAL], I[IN_F]
    for turn in range(SWEEPS):
        for place in range(k):
            c = place if turn % 2 == 0 else k - 1 - place
            value = min(max(z[c] - dot(Bi, Bx, c, r), low[c]), high[c])
            if value != z[c]:
                add(Bi, Bx, c, value - z[c], r)
                z[c] = value
    f = 0
    for c in range(k):
        if low[c] < z[c] < high[c]:
            inside[c] = 1
        elif low[c] < high[c]:
            slope = dot(Bi, Bx, c, r) if z[c] <= low[c] else -dot(Bi, Bx, c, r)
            if abs(slope) > aim:
                inside[c] = 1 if slope < 0.0 else 0
        f += inside[c]
    return f
