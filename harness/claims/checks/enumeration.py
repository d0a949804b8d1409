"""How many sets an enumeration tries (end of §3.2), at worst and on average."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from harness.claims.checking import check
from harness.criterion.enumeration_growth import fit_base, loses_from, randomly
from problems import ContactQP
from problems.qp import working_set_of
from solvers import make_solver

RANDOM = range(2, 13)
"""Sizes of random QPs."""
SIZES, CASES = np.arange(2, 9), 4
"""Sizes of those that are guessed wrong, and how many of each."""


@cache
def _rows() -> Any:
    return randomly(RANDOM)


@check
def guesses(column: str) -> float:
    """By what the "sets" of an enumeration, or "directions", grow with each row of random QPs."""
    return fit_base(_rows(), column).base


@check
def loses(own: str, other: str) -> float:
    """The least k from which on the median count of `own` exceeds that of `other`; ∞: none."""
    found = loses_from(_rows(), own, other)
    return np.inf if found is None else float(found)


@check
def worst(upper: float, guess: str = "wrong") -> float:
    """By what the sets tried are multiplied for each row of random QPs, 0 ≤ x ≤ upper.

    guess : the first set; "wrong" in every row, or the "right" one
    """
    tried = []
    for k in SIZES:
        rng, counts = np.random.default_rng(int(k)), []
        for _ in range(CASES):
            A, x = rng.standard_normal((2 * k, k)), rng.standard_normal(k)
            qp = ContactQP(A, -A @ x, np.zeros(k), np.full(k, upper))
            answer = make_solver("glambda", accuracy=1e-13).solve(qp)
            start = np.array(answer.x)
            if guess == "wrong":
                free = working_set_of(qp, start) == 0
                start = np.where(free, 0.0, 0.5 * min(upper, 2.0))
            first = replace(answer, x=start, working_set=working_set_of(qp, start), memory=None)
            counts.append(make_solver("enumeration").solve(qp, first).iterations)
        tried.append(np.mean(counts))
    return float(np.exp(np.polyfit(SIZES, np.log(tried), 1)[0]))
