"""Arrays of an arena: parts of its memory while there is room, and arrays like any other beyond."""

from __future__ import annotations

import numpy as np
import pytest

from problems.contacts.geometry_kernels import (
    column_speeds,
    column_sum,
    place_corners,
)
from problems.kernels.arena import PER_ENTRY, Arena, integers, numbers, table, zeros
from problems.least_norm.independence import SAFE_FRACTION, far_from_dependent


def test_arrays_of_an_arena_lie_one_behind_the_other() -> None:
    arena = Arena.of(2)
    arena.numbers[:] = 7.0
    first, second, third = numbers(arena, 5), zeros(arena, 3), table(arena, 4, 2)
    assert [array.shape for array in (first, second, third)] == [(5,), (3,), (4, 2)]
    first[:], third[:] = 1.0, np.arange(8.0).reshape(4, 2)
    np.testing.assert_array_equal(arena.numbers[:8], [1.0] * 5 + [0.0] * 3)
    np.testing.assert_array_equal(arena.numbers[8:17], [*range(8), 7.0])
    rows = integers(arena, 6)
    rows[:] = 3
    assert (arena.integers[:6] == 3).all()
    assert arena.used.tolist() == [16, 6]


@pytest.mark.parametrize("make", [numbers, zeros, integers])
def test_beyond_the_arena_arrays_are_made_anew(make) -> None:
    arena = Arena.of(1)
    make(arena, PER_ENTRY - 3)
    fits, too_long = make(arena, 3), make(arena, 1)
    base = arena.integers if make is integers else arena.numbers
    assert np.shares_memory(fits, base)
    assert not np.shares_memory(too_long, base)
    assert arena.used.max() == PER_ENTRY


def test_kernels_find_the_same_in_an_arena_and_without() -> None:
    rng = np.random.default_rng(3)
    count, n = 7, 4
    entries, bodies = rng.standard_normal((count, 6)), rng.integers(-1, n, (count, 2))
    v, weights = rng.standard_normal(3 * n), rng.standard_normal(count)
    local, body = rng.standard_normal((9, 4)), rng.integers(0, n, 9)
    A = rng.standard_normal((12, 5))
    calls = [
        (place_corners, v, body, local),
        (column_speeds, entries, bodies, v),
        (column_sum, entries, bodies, weights, 3 * n),
        (far_from_dependent, A, SAFE_FRACTION),
        (far_from_dependent, np.hstack([A, A]), SAFE_FRACTION),
    ]
    for size in (0, 30):
        for kernel, *arguments in calls:
            arena = Arena.of(size)
            arena.numbers[:] = np.nan
            np.testing.assert_equal(kernel(*arguments, arena), kernel(*arguments))
