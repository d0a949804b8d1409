"""Which singular values count as 0: one fraction of the largest for each question.

The stepper and the solvers have fractions of their own: the judge borrows nothing from them.
"""

from __future__ import annotations

RANK_TOL = 1e-10
"""The rank that rows and reports tell: columns nearer to dependence than this have multipliers that
no solver finds to more than a few digits, and the stepper counts them as dependent, too."""
SPAN_TOL = 1e-12
"""In the error bound.  Smaller ones cannot be told from 0 by an SVD, which is some 1e-13 of the
largest off; what is left out is made good by a term of its own, so that the bound stays one."""
STEP_TOL = 1e-13
"""In the oracle's steps: just above rounding, so that the minimum is reached along every direction
there is.  A step along one that there is not does no harm, since the bound judges the answer."""
