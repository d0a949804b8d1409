"""Memory of which kernels take arrays by the dozen, and give them back all at once.

To ask the system for an array and to count who holds it takes longer than the arithmetic of a few
bodies.  A kernel that makes arrays takes an `arena`: None, for arrays that are anybody's to keep,
as the caller in Python wants them; or an `Arena`, whose arrays last until its `used` is set back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from problems.kernels.compiled import kernel
from problems.kernels.numba_internals import in_rows
from problems.qp import Indices, Vector

PER_ENTRY = 64
"""Numbers, and integers, for each of what an arena is made for; hardly an array is longer then."""


class Arena(NamedTuple):
    """Where an array of so many entries still fits it is a part of these, else it is made anew.

    used : (2,) how much of numbers and of integers is taken
    """

    numbers: Vector
    integers: Indices
    used: Indices

    @classmethod
    def of(cls, size: int) -> Arena:
        """For a step or collision with so many coordinates, rows and candidates, taken together."""
        numbers, integers = np.empty(PER_ENTRY * size), np.empty(PER_ENTRY * size, np.int64)
        return cls(numbers, integers, np.zeros(2, np.int64))

    @property
    def size(self) -> int:
        """What it was made for."""
        return self.numbers.size // PER_ENTRY


@kernel
def own_numbers(n):
    """An array that is no part of an arena; apart, so that those that are can be had in line."""
    return np.empty(n)


@kernel
def own_integers(n):
    """The same of integers."""
    return np.empty(n, np.int64)


@kernel
def numbers(arena, n):
    """(n,) numbers of any value."""
    if arena is None:
        return own_numbers(n)
    first = arena.used[0]
    if n > arena.numbers.size - first:
        return own_numbers(n)
    arena.used[0] = first + n
    return arena.numbers[first : first + n]


@kernel
def integers(arena, n):
    """(n,) integers of any value."""
    if arena is None:
        return own_integers(n)
    first = arena.used[1]
    if n > arena.integers.size - first:
        return own_integers(n)
    arena.used[1] = first + n
    return arena.integers[first : first + n]


@kernel
def zeros(arena, n):
    """(n,) zeros."""
    array = numbers(arena, n)
    for i in range(n):
        array[i] = 0.0
    return array


@kernel
def table(arena, n, m):
    """(n, m) numbers of any value."""
    return in_rows(numbers(arena, n * m), n, m)
