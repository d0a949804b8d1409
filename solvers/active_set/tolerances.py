"""The tolerances of our method and of the paper's, dense and sparse, each with its reason.

Columns are of length 1 (`workspace`), so that lengths and cosines are pure numbers; u is the unit
roundoff.  Numbers of iterations and prices, which decide about time alone, stand where they are
used.
"""

from __future__ import annotations

import numpy as np

UNIT_ROUNDOFF = 0.5 * float(np.finfo(np.float64).eps)
"""u."""
ROUNDING = 4 * UNIT_ROUNDOFF
"""Rounding in Δ, in units of ‖ |B||z| + |d| ‖; of sparse columns, in units of its largest entry."""
SHARE = 0.1
"""Part of ε₀ that the direction and the signs may each take."""

# dependence, dense: by what QR can tell, 16 u √m (`factorization.dependence_tolerance`)
SUSPECT = 1e-4
"""Below a pivot like this `karasalo_bound` decides the rank; above, ten digits are to spare."""
LEAST_PIVOT = 1e-8
"""Squared distance of a unit column from the span of those before, by normal equations, which lose
half of the digits; below, QR decides."""
NEAR_ZERO = 2e-13
"""A gradient by normal equations, in units of the sum of its terms, that is taken for zero."""

OUT_OF_PROPORTION = 1e4
"""‖ |A||x| + |d| ‖, in units of ‖d‖, from where x is looked at as one that rounding may have made.
In the paper's scenes, towers, walls and pyramids it is 7 at most, in a tower of n boxes up to n/3,
in QPs that other programs have recorded 3,200; where columns differ by 1e-9 or less and no bound
holds x, 1e5 and more."""
OUT_OF_PROPORTION_SPARSE = 1e3
"""The same for the largest entries of either: x is only looked at there, whose columns may depend
on each other, and that of a tall tower is let pass."""

# dependence, sparse: by Cholesky's L of A_FᵀA_F + shift
DEPENDENT = 1e-11
"""Squared distance of a unit column from the span of others that cannot be told from rounding."""
FIRST_SHIFT, LEAST_SHIFT = 1e-4, 1e-10
"""Bounds on the shift: conjugate gradients see to the first in a few iterations, and the last is
what keeps pivots above `DEPENDENT`."""
LOWERED = 1e-2
"""The next shift, in units of the one that has taken too many iterations."""
ROUGH = 1e-3
"""Part of the gradient at which p is looked at: if it is blocked, it is not made more accurate."""
PATH_END = 1e-14
"""Interior points end at this part of ‖d‖² by which the objective can still fall, so that A x is
right to 1e-7 ‖d‖."""
LAST_STEP = 0.2
"""(vᵀy)^½, in units of the error in A p that the tolerance stands for by (3.20), below which one
more step of conjugate gradients will do."""
NOISE = 2.0
"""vᵀy in units of f (rounding in one Δ_j)²/shift, below which it may be rounding."""
