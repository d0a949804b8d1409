"""Guessing the active set: every working set in turn until one meets the KKT conditions.

Lötstedt names it for 1 to 3 active constraints.  A working set says of each row whether x is free
or at which bound, so that there are 2 to 3 choices a row: 20,736 sets for 8 normals and 4 friction
rows.

1. Guess a set: the previous one, or, cold, the rows free whose least-squares x lies inside.
2. Take the sets by the number of rows in which they differ from the guess, in batches.
3. Screen a batch: solve P_FF x_F = −(q + P x)_F for all of them at once, P = AᵀA with 1e-13 added
   to its diagonal, since F may be dependent, and keep those that meet the KKT conditions to 1e-6.
4. Solve min ‖A_F x_F + …‖ of each that is left by the SVD; the first to meet the conditions to
   rounding is the answer.

A solution with A_F of full rank always exists, so that sets with a dependent F may fail harmlessly.
A QP is given up after `max_guesses` sets, and not taken where it has more than `max_rows` rows that
are not fixed: then not even the sets in the neighbourhood of the guess can be tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from problems.qp import AT_LOWER, AT_UPPER, FREE, Status, Vector
from solvers.adapters.package import Built, Native, Outcome, PackageSolver
from solvers.adapters.posed import Posed
from solvers.base import Form, Start, Unsupported

_BATCH = 2048
_SCREEN, _EXACT, _LOOSE = 1e-6, 1e-12, 1e-8  # KKT violations, in scaled units


@dataclass(frozen=True)
class Enumeration(PackageSolver):
    """Guessing the active set by enumeration, nearest to a first guess first (our own)."""

    max_guesses: int = 100_000
    max_rows: int = 32

    name: ClassVar[str] = "enumeration"
    form: ClassVar[Form] = "least_squares"
    warm_start: ClassVar[str] = "working set"
    dense: ClassVar[bool] = True
    statuses: ClassVar[dict[Any, Status]] = {"solved": Status.SOLVED}

    def arrays(self, posed: Posed) -> Any:
        """The states that each row may take."""
        states = [
            [FREE, *[AT_LOWER] * bool(low > -np.inf), *[AT_UPPER] * bool(high < np.inf)]
            for low, high in zip(posed.lower, posed.upper, strict=True)
        ]
        if posed.n > self.max_rows:
            raise Unsupported(
                f"{posed.n} rows have {_count(states):.3g} working sets; no more than "
                f"{self.max_rows} rows are tried (max_rows)"
            )
        return states

    def setup(self, problem: Built, asked: float | None, start: Start | None) -> Native:
        """P and the first guess."""
        posed = problem.posed
        x: Any = posed.start
        if x is None:
            x = np.linalg.lstsq(posed.dense, -posed.d, rcond=1e-10)[0]
        guess = np.full(posed.n, FREE, np.int8)
        guess[x >= posed.upper] = AT_UPPER
        guess[x <= posed.lower] = AT_LOWER
        return Native(posed, (posed.P + 1e-13 * np.eye(posed.n), guess), problem.arrays)

    def run(self, native: Native) -> Any:
        """Steps 2 to 4: x, the number of sets tried and how it ended."""
        P, guess = native.object
        best, least, tried = None, np.inf, 0
        sets = islice(_by_distance(guess, native.arrays), self.max_guesses)
        while batch := list(islice(sets, min(max(1, 8 * tried), _BATCH))):
            states = np.array(batch)
            promising = np.flatnonzero(_screen(native.posed, P, states) <= _SCREEN)
            for i in promising:
                x, violation = _exact(native.posed, states[i])
                if violation < least:
                    best, least = x, violation
                if violation <= _EXACT:
                    return x, tried + int(i) + 1, "solved"
            tried += len(batch)
        if least > _LOOSE:
            raise Unsupported(
                f"none of the {tried:,} working sets nearest to the guess is right, of "
                f"{_count(native.arrays):.3g} (max_guesses)"
            )
        return best, tried, "solved"

    def outcome(self, native: Native, result: Any) -> Outcome:
        """The answer; its iterations are the sets that were tried."""
        x, tried, text = result
        return Outcome(x, text, tried)


def _count(states: list[list[int]]) -> float:
    """Number of working sets."""
    return float(np.prod([float(len(each)) for each in states]))


def _by_distance(guess: NDArray[np.int8], states: list[list[int]]) -> Iterator[NDArray[np.int8]]:
    """Working sets by the number of rows in which they differ from `guess`."""
    others = [
        [state for state in each if state != now] for each, now in zip(states, guess, strict=True)
    ]
    for distance in range(len(states) + 1):
        for rows in combinations(range(len(states)), distance):
            for changed in product(*(others[row] for row in rows)):
                one = guess.copy()
                one[list(rows)] = changed
                yield one


def _at_bounds(posed: Posed, states: NDArray[np.int8]) -> Vector:
    """x of the rows at a bound, 0 for the free ones; for one set or a batch of them."""
    x = np.where(states == AT_LOWER, posed.lower, posed.upper)
    return np.where(states == FREE, 0.0, x)


def _violation(posed: Posed, states: NDArray[np.int8], x: Vector, gradient: Vector) -> Vector:
    """By how much x breaks the bounds, or Δ the sign that its bound demands, at most."""
    outside = np.maximum(posed.lower - x, x - posed.upper)
    sign = np.where(states == FREE, np.abs(gradient), states * gradient)
    return np.maximum(outside, sign).max(axis=-1)


def _screen(posed: Posed, P: Vector, states: NDArray[np.int8]) -> Vector:
    """KKT violations of a batch of working sets.  (batch,)"""
    free = states == FREE
    fixed = _at_bounds(posed, states)
    both = free[:, :, None] & free[:, None, :]
    matrices = np.where(both, P, np.eye(posed.n))
    right = np.where(free, -(posed.q + fixed @ P), fixed)
    x = np.linalg.solve(matrices, right[:, :, None])[:, :, 0]
    return _violation(posed, states, x, posed.q + x @ P)


def _exact(posed: Posed, states: NDArray[np.int8]) -> tuple[Vector, float]:
    """x of one working set by the SVD of A_F, and its KKT violation."""
    A, free = posed.dense, states == FREE
    x = _at_bounds(posed, states)
    for _ in range(2):  # a step of refinement
        residual = posed.d + A @ x
        x[free] -= np.linalg.lstsq(A[:, free], residual, rcond=1e-10)[0]
    violation = float(_violation(posed, states, x, posed.q + A.T @ (A @ x)))
    return np.clip(x, posed.lower, posed.upper), violation
