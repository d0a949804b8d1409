"""Names of solvers and arms, in order."""

from __future__ import annotations

from typing import Any

from harness.names import is_own


def in_order(names: Any, order: tuple[str, ...]) -> list[str]:
    """`names` in the given order, then numbers, the least first, then others by the alphabet."""
    present = {str(name) for name in names}
    rest = present - set(order)
    numbers = sorted((name for name in rest if is_number(name)), key=float)
    return [name for name in order if name in present] + numbers + sorted(rest - set(numbers))


def is_number(setting: str) -> bool:
    """Whether a setting is an accuracy given as a number, such as 1e-6."""
    try:
        float(setting)
    except ValueError:
        return False
    return True


def solver_order(name: str) -> tuple[bool, str]:
    """Sort key: our method, then the paper's and its variants, then the others by name."""
    return (not is_own(name), name)
