"""A motion between the times that a stepper accepted, by cubic Hermite interpolation.

Of order 4, where the stepper's own is 2.  At an impulse q is continuous and q̇ is not: its time
stands twice, so that no interval reaches across.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from problems.qp import Vector


def hermite(t: Vector, q: Vector, v: Vector, times: ArrayLike) -> tuple[Vector, Vector]:
    """q and its derivative, (times, bodies, 3) each, at `times` [s] from t[0] on.

    t : (n,) [s], ascending;  q, v : (n, bodies, 3)

    At an impulse it is the state after it; beyond the end, the last state.
    """
    times = np.asarray(times, dtype=np.float64)
    if len(t) == 1:
        return np.repeat(q, len(times), axis=0), np.repeat(v, len(times), axis=0)
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    h = (t[i + 1] - t[i])[:, None, None]
    ahead = (np.minimum(times, t[-1]) - t[i])[:, None, None]
    s = np.divide(ahead, h, out=np.ones_like(h), where=h > 0)
    q0, q1, v0, v1 = q[i], q[i + 1], v[i], v[i + 1]
    found = (
        (1 + 2 * s) * (1 - s) ** 2 * q0
        + s * (1 - s) ** 2 * h * v0
        + s * s * (3 - 2 * s) * q1
        - s * s * (1 - s) * h * v1
    )
    slope = np.divide(q1 - q0, h, out=np.zeros_like(q0), where=h > 0)
    return found, 6 * s * (1 - s) * slope + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
