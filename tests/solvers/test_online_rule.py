"""The rule that gives R up when the average cost stops falling, as the kernel keeps its account."""

from __future__ import annotations

from math import ceil

import numpy as np
import pytest

from harness.criterion.cost_model import optimal_interval
from solvers.active_set.online_rule import (
    LONGEST_PATIENCE,
    PRICE,
    forget,
    iterations_worth,
    keep_account,
)
from solvers.active_set.workspace import (
    AGE,
    CAP,
    DUE,
    FACTORIZATION_COST,
    PATIENCE,
    SPENT,
    STEPS,
    YOUNG,
)


class Account:
    """What the kernel remembers of a sequence in which a factorization costs `C_QR`."""

    def __init__(self, C_QR: float) -> None:
        self.counts, self.reals = np.zeros(16, dtype=np.int64), np.zeros(10)
        forget(self.counts, self.reals)
        # the rule prices a factorization by its time; here times and operations are alike
        self.reals[FACTORIZATION_COST] = C_QR / PRICE

    def qp(self, factorized: bool, cost: float, directions: int = 1, given_up: int = 0) -> bool:
        """One QP of this cost; whether the next one is to be factorized."""
        self.counts[AGE] = 0 if factorized else self.counts[AGE] + 1
        keep_account(self.counts, self.reals, factorized, given_up, cost, directions)
        return bool(self.counts[DUE])

    def cycle(self, marginals: list[float]) -> int:
        """QPs until the next factorization, where QP i costs marginals[i]; 0 if there is none."""
        for i, cost in enumerate(marginals):
            if self.qp(i == 0, cost):
                return i + 1
        return 0


def averages(marginals: list[float], C_QR: float) -> np.ndarray:
    """Cost per QP of cycles of 1, 2, … QPs."""
    return (C_QR + np.cumsum(marginals)) / np.arange(1, len(marginals) + 1)


def test_a_cycle_by_hand() -> None:
    """Averages 11, 6, 14/3, 17/4, 21/5, 26/6: least after 5 QPs, seen to rise after 6."""
    marginals = [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert int(np.argmin(averages(marginals, 10.0))) + 1 == 5
    assert Account(10.0).cycle(marginals) == 6


@pytest.mark.parametrize(("c", "r"), [(1, 1), (4.7, 0.23), (1.5, 0.34), (12, 0.92), (0.5, 2)])
@pytest.mark.parametrize("C_QR", [3.0, 50.0, 900.0])
def test_a_cycle_is_one_qp_longer_than_the_best_whatever_c_and_r(
    c: float, r: float, C_QR: float
) -> None:
    marginals = [min(1.0, c), *(c * s**r for s in range(1, 20_000))]
    cost = averages(marginals, C_QR)
    length = Account(C_QR).cycle(marginals)
    assert length > 1 and cost[length - 2] == cost.min() < cost[length - 1]


def test_for_long_cycles_it_is_the_optimum_of_the_cost_model() -> None:
    marginals = [2.0 * s**0.5 for s in range(20_000)]
    expected = optimal_interval(1e5, 1.0, 2.0, 0.5)
    assert Account(1e5).cycle(marginals) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_noise_costs_little_over_the_best_fixed_interval(seed: int) -> None:
    """4 s^0.5 iterations, each QP off by a factor of about 1.2."""
    random = np.random.default_rng(seed)
    C_QR, n = 60.0, 4000
    noise = random.lognormal(0.0, 0.2, n)

    def cost(interval: int | None) -> float:
        account, age, spent, due = Account(C_QR), 0, 0.0, True
        for step in range(n):
            age = 0 if due else age + 1
            spent += C_QR if due else 0.0
            marginal = 4.0 * max(age, 0.25) ** 0.5 * noise[step]
            spent += marginal
            rises = account.qp(due, marginal)
            due = rises if interval is None else age + 1 >= interval
        return spent / n

    best = min(cost(s) for s in range(1, 60))
    assert cost(None) < 1.1 * best


@pytest.mark.parametrize("C_QR", [0.1, 40.0])
def test_it_never_fires_without_growth(C_QR: float) -> None:
    account = Account(C_QR)
    assert account.cycle([3.0] * 10_000) == 0
    assert account.reals[STEPS] == 10_000


def test_what_all_qps_cost_alike_changes_nothing() -> None:
    marginals = [1 + 0.3 * s for s in range(100)]
    length = Account(40.0).cycle(marginals)
    assert length > 2
    assert Account(40.0).cycle([m + 1e4 for m in marginals]) == length


def test_the_cycle_begins_anew_with_a_factorization_and_counts_per_direction() -> None:
    account = Account(50.0)
    for i in range(5):
        account.qp(i == 0, 14.0)
    account.qp(False, 60.0, directions=2)
    assert (account.reals[STEPS], account.reals[SPENT]) == (6.0, 100.0)
    account.qp(False, 0.0, directions=0)
    assert (account.reals[STEPS], account.reals[SPENT]) == (7.0, 100.0)
    account.qp(True, 10.0)
    assert (account.reals[STEPS], account.reals[SPENT]) == (1.0, 10.0)


def test_an_r_is_given_up_where_going_on_has_cost_as_much_as_a_new_one() -> None:
    account = Account(50.0)
    account.reals[YOUNG] = 3.0
    assert iterations_worth(account.reals, 50.0, 4.0) == 3 + ceil(PRICE * 50 / 4)
    account.reals[YOUNG] = 0.0  # a direction takes one iteration at least
    assert iterations_worth(account.reals, 50.0, 4.0) == 1 + ceil(PRICE * 50 / 4)


def test_after_giving_up_the_next_r_is_replaced_before_it_gets_as_old() -> None:
    account = Account(1e6)  # so that the average never rises
    for i in range(5):
        assert not account.qp(i == 0, 1.0)
    assert not account.qp(True, 30.0, given_up=4)
    assert account.reals[SPENT] == 0.0  # those iterations were made with the R before
    assert [account.qp(False, 1.0) for _ in range(3)] == [False, False, True]


def test_an_older_r_is_tried_again_after_more_and_more_cycles() -> None:
    """Each R is useless from age 4 on: given up there, or replaced before."""
    account = Account(1e6)
    due, age, given_up_at = True, 0, []
    for step in range(2_000):
        age = 0 if due else age + 1
        if age == 4:
            given_up_at.append(step)
            due, age = account.qp(True, 30.0, given_up=4), 0
        else:
            due = account.qp(due, 1.0)
    gaps = np.diff(given_up_at)
    assert len(gaps) > 5
    assert (gaps[1:] >= gaps[:-1]).all()
    assert gaps[-1] > LONGEST_PATIENCE
    assert account.reals[PATIENCE] <= LONGEST_PATIENCE


def test_what_was_remembered_of_a_useless_r_fades() -> None:
    account = Account(1e6)
    account.qp(True, 1.0)
    account.qp(True, 1.0, given_up=3)
    assert account.counts[CAP] == 3 and account.reals[PATIENCE] == 2.0
    for _ in range(2):
        account.qp(True, 1.0)
    for _ in range(20):
        assert not account.qp(False, 1.0)
    assert account.reals[PATIENCE] == 1.0
