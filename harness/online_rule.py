"""When to factorize anew, without assuming how conjugate gradients slow down.

The paper assumes c s^r iterations, s steps after a factorization, with c = r = 1 (§3.2).  This rule
assumes only that an older R does not do better than a younger one:

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
   s^{r+1} = (r + 1)/r · C_QR/(c C_IT): the paper's optimum (`harness.cost_model`) for every c and
   r, none of which is an input here.  For m constant, the paper's r = 0, it never fires.
4. A QP that needs several descent directions costs more because its working set changed and not
   because R is old.  So m is taken per direction.
5. Where m is not monotone (single hard QPs), the rule fires early, and what it can lose by that is
   one factorization for each such QP.

The functions are pure and take numbers only.
"""

from __future__ import annotations

from typing import NamedTuple


class Cycle(NamedTuple):
    """The QPs since the last factorization, the one that was factorized included.

    steps : their number;  spent : Σ m_i;  last : m of the last one, in the unit of C_IT
    """

    steps: int = 0
    spent: float = 0.0
    last: float = 0.0


def one_more(
    cycle: Cycle, factorized: bool, iterations: int, directions: int, C_IT: float
) -> Cycle:
    """The cycle with one more QP, or a new one that begins with it.

    factorized : whether A_F was factorized in this QP
    iterations, directions : conjugate gradient iterations and descent directions of this QP
    C_IT : cost of an iteration, in any unit
    """
    marginal = C_IT * iterations / max(1, directions)
    if factorized:
        return Cycle(1, marginal, marginal)
    return Cycle(cycle.steps + 1, cycle.spent + marginal, marginal)


def average_stopped_falling(cycle: Cycle, C_QR: float) -> bool:
    """Whether to factorize at the next QP: m_{N−1} > A_N, with C_QR in the unit of C_IT."""
    return cycle.last * cycle.steps > C_QR + cycle.spent
