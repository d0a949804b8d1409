"""When to factorize anew, without assuming how conjugate gradients slow down.

The paper assumes c s^r iterations, s steps after a factorization, with c = r = 1 (§3.2), and gives
up an R in the middle of a QP.  This rule assumes only that an older R does not do better than a
younger one:

    factorize anew at the next QP when the last QP cost more than the average since the last
    factorization, that factorization included.

Derivation.  Let the QPs of a cycle cost C_QR + m_0, m_1, m_2, …, where m_i is the conjugate
gradient iterations of the QP i steps after the factorization, times C_IT.  A cycle of N QPs costs
on average

    A_N = (C_QR + m_0 + … + m_{N−1})/N

per QP, and by the renewal-reward theorem so does the whole sequence when all cycles are alike: the
best N is the one with the least A_N.  Now

    A_{N+1} − A_N = (m_N − A_N)/(N + 1),

so A falls exactly while the next QP costs less than the average.  Let N* be the first N with
m_N ≥ A_N.  Then A_{N+1} lies between A_N and m_N ≤ m_{N+1}, so that m_{N+1} ≥ A_{N+1} too, and so
on: where m never falls, A falls up to N* and never again, and N* is optimal among all N.

1. m_N is not known before it is paid for.  What is known after N QPs is m_{N−1}, and
   m_{N−1} > A_N is the same as A_N > A_{N−1}: the average has just stopped falling.  So a cycle is
   one QP longer than the best, where A is flat.
2. Any cost that all QPs share raises m and A alike and cancels: C_0 need not be known.
3. For m_s = c C_IT s^r, m_s = A_s is c C_IT s^r = C_QR/s + c C_IT s^r/(r + 1), so
   s^{r+1} = (r + 1)/r · C_QR/(c C_IT): the paper's optimum (`harness.criterion.cost_model`) for
   every c and r, none of which is an input here.  For m constant, the paper's r = 0, it never
   fires.
4. A QP that needs several descent directions costs more because its working set changed and not
   because R is old.  So m is taken per direction.
5. Where m is not monotone (single hard QPs), the rule fires early, and what it can lose by that is
   one factorization for each such QP.
6. An R that has become useless is given up in the middle of a QP, but not before the iterations
   beyond those that a new R needs have cost as much as the factorization does: whatever they still
   would have needed, giving up then costs at most twice the better choice (the ski-rental bound).
   The age at which that happened is remembered, and the next R is replaced before it gets so old;
   after 1, 2, 4, … such cycles an older one is tried again, so that what is lost to trying falls
   off when it keeps failing.

What the rule remembers stands in the workspace: `counts` and `reals` are its rows COUNTS and REALS.
"""

from __future__ import annotations

from math import ceil

from solvers.active_set.compiled import kernel
from solvers.active_set.workspace import (
    AGE,
    CAP,
    CYCLES,
    DUE,
    FACTORIZATION_COST,
    PATIENCE,
    SPENT,
    STEPS,
    YOUNG,
)

PRICE = 1.5
"""Time of a flop of a factorization, in units of one of an iteration; measured, 1 to 2.5."""
LONGEST_PATIENCE = 64.0


@kernel
def forget(counts, reals):
    """Nothing is known yet."""
    counts[DUE] = counts[CAP] = counts[CYCLES] = 0
    reals[PATIENCE] = 1.0
    reals[STEPS] = reals[SPENT] = reals[YOUNG] = 0.0


@kernel
def iterations_worth(reals, C_QR, C_IT):
    """Iterations of a direction on an old R after which it is given up (6.)."""
    return max(1.0, reals[YOUNG]) + ceil(PRICE * C_QR / C_IT)


@kernel
def keep_account(counts, reals, factorized, given_up, iteration_cost, directions):
    """After a QP: decide whether the next begins with a factorization, entry DUE of `counts`.

    factorized : whether A_F was factorized in this QP
    given_up : the age of the R that was given up in the middle of it, or 0
    iteration_cost : all conjugate gradient iterations of this QP times C_IT
    directions : its descent directions
    """
    marginal = iteration_cost / max(1, directions)
    if factorized:
        reals[STEPS] = reals[SPENT] = 0.0
        if given_up > 0:
            counts[CAP] = given_up
            counts[CYCLES] = 0
            reals[PATIENCE] = min(2.0 * reals[PATIENCE], LONGEST_PATIENCE)
            marginal = 0.0  # what the R before it cost is not this one's
        elif counts[CAP] > 0:
            counts[CYCLES] += 1
    elif counts[CAP] > 0 and counts[AGE] > counts[CAP]:  # older than the one that was useless
        counts[CAP] = 0
        reals[PATIENCE] = max(1.0, 0.5 * reals[PATIENCE])
    reals[STEPS] += 1.0
    reals[SPENT] += marginal
    average_rises = marginal * reals[STEPS] > PRICE * reals[FACTORIZATION_COST] + reals[SPENT]
    resting = counts[CAP] > 0 and counts[CYCLES] < reals[PATIENCE]
    too_old = resting and counts[AGE] + 1 >= counts[CAP]
    counts[DUE] = 1 if average_rises or too_old else 0
