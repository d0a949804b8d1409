"""What a scene is made of is looked at where it is made."""

from __future__ import annotations

from operator import index
from typing import Any

import numpy as np


def check_numbers(owner: str, count: int, **fields: Any) -> None:
    """Raise ValueError, naming owner and field, for what is not `count` finite numbers."""
    for name, value in fields.items():
        try:
            numbers = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.array(np.nan)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise ValueError(f"{owner}: {name} = {value!r}; it must be {count} finite numbers")


def check_number(owner: str, least: float = -np.inf, **fields: Any) -> None:
    """Raise ValueError, naming owner and field, for what is no finite number ≥ `least`."""
    for name, value in fields.items():
        try:
            fits = bool(np.ndim(value) == 0 and np.isfinite(value) and value >= least)
        except TypeError:
            fits = False
        if not fits:
            bound = "" if least == -np.inf else f", at least {least:g}"
            raise ValueError(f"{owner}: {name} = {value!r}; it must be a finite number{bound}")


def check_body(owner: str, body: Any, n: float = np.inf) -> None:
    """Raise ValueError, naming owner, for what is no index of one of n bodies."""
    try:
        fits = 0 <= index(body) < n
    except TypeError:
        fits = False
    if not fits:
        known = "" if n == np.inf else f" to {n - 1}"
        raise ValueError(f"{owner}: body = {body!r}; it must be the index of a body, from 0{known}")
