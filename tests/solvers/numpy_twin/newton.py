"""Projected Newton steps on the Gram matrix, in NumPy: the twin of `solvers.active_set.newton`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.qp import ContactQP, Vector
from solvers.active_set.newton import MOST_DEPENDENT, RIDGE, SHARED

Flags = NDArray[np.bool_]


class Found(NamedTuple):
    """x and the free rows (k,), Newton steps, the objective after each, whether that is the end."""

    x: Vector
    free: Flags
    steps: int
    objectives: list[float]
    ended: bool


def projected_newton(qp: ContactQP, x: Vector | None = None, most: int = 30) -> Found:
    """From x, or cold; columns that depend on those before them keep their x."""
    A, low, high = qp.dense_A, qp.lower, qp.upper
    H, b = A.T @ A, A.T @ qp.d
    zero = 2e-13 * np.linalg.norm(qp.d) * np.linalg.norm(A, axis=0)
    everybody = x is None
    x = np.clip(np.zeros(qp.k) if x is None else x, low, high)
    objectives = [_objective(H, b, x)]
    steps, ended = 0, False
    if everybody and qp.k >= SHARED and (low < high).any():
        shared = _shared_load(A, H, b, x, low, high)
        if shared is not None:
            steps, everybody = 1, False
            if _objective(H, b, shared) < objectives[-1]:
                x = shared
                objectives.append(_objective(H, b, x))
    while steps < most and not ended:
        gradient = H @ x + b
        held = ((x <= low) & (gradient >= -zero)) | ((x >= high) & (gradient <= zero))
        free = (low < high) & (everybody | ~held)
        everybody = False
        while steps < most:
            steps += 1
            free = _independent(A, free)
            point = x.copy()
            rest = b + H[:, ~free] @ x[~free]
            size = np.sqrt(H.diagonal()[free])
            scaled = H[np.ix_(free, free)] / np.outer(size, size)
            point[free] = np.linalg.lstsq(scaled, -rest[free] / size, rcond=None)[0] / size
            bent = np.clip(point, low, high)
            if (bent == point).all() or _objective(H, b, bent) < objectives[-1]:
                break
            beyond = bent != point
            shares = (bent - x)[beyond] / (point - x)[beyond]
            stopped = np.flatnonzero(beyond)[shares <= shares.min()]
            x = x + shares.min() * (point - x)
            x[stopped] = bent[stopped]
            free = free.copy()
            free[stopped] = False
            objectives.append(_objective(H, b, x))
        x = bent
        objectives.append(_objective(H, b, x))
        gradient = H @ x + b
        wrong = ((x < high) & (gradient < -zero)) | ((x > low) & (gradient > zero))
        ended = bool((bent == point).all() and not (wrong & ~free).any())
    return Found(x, free, steps, objectives, ended)


def _shared_load(A: Vector, H: Vector, b: Vector, x: Vector, low: Vector, high: Vector):
    """The step of least norm from x, cut off at the bounds; None if none or most depend."""
    free = low < high
    dependent = np.count_nonzero(free) - np.count_nonzero(_independent(A, free))
    if not 0 < dependent <= MOST_DEPENDENT * len(x):
        return None
    ridge = np.diag(RIDGE * H.diagonal()[free])
    point = x.copy()
    rest = b + H[:, ~free] @ x[~free]
    point[free] = np.linalg.solve(H[np.ix_(free, free)] + ridge, -rest[free])
    return np.clip(point, low, high)


def _objective(H: Vector, b: Vector, x: Vector) -> float:
    return float(0.5 * x @ H @ x + b @ x)


def _independent(A: Vector, free: Flags) -> Flags:
    """Those of the free columns that are further than 1e-4 of their length from those before."""
    kept = np.zeros_like(free)
    for j in np.flatnonzero(free):
        column, basis = A[:, j], A[:, kept]
        rest = column - basis @ np.linalg.lstsq(basis, column, rcond=None)[0]
        kept[j] = np.linalg.norm(rest) > 1e-4 * np.linalg.norm(column)
    return kept
