"""A motion between the times that a stepper accepted, by cubic Hermite interpolation.

Of order 4, where the stepper's own is 2.  At an impulse q is continuous and q̇ is not: its time
stands twice, and a spline ends and another begins there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from problems.qp import Vector


def hermite(t: Vector, q: Vector, v: Vector, times: ArrayLike) -> tuple[Vector, Vector]:
    """q and its derivative, (times, bodies, 3) each, at `times` [s] from t[0] on.

    t : (n,) [s], ascending;  q, v : (n, bodies, 3)

    At an impulse it is the state after it; beyond the end, the last state.
    """
    seen = np.minimum(np.asarray(times, dtype=np.float64), t[-1])
    t = np.append(t, t[-1] + 1.0)  # so that the last state has an interval, whose end nobody sees
    q, v = (np.concatenate([state, state[-1:]]) for state in (q, v))
    impulses = np.flatnonzero(np.diff(t) == 0) + 1
    smooth = np.searchsorted(t[impulses], seen, side="right")
    bounds = [0, *impulses, len(t)]
    found_q, found_v = np.empty((2, len(seen), *q.shape[1:]))
    for i in np.unique(smooth):
        nodes, here = slice(bounds[i], bounds[i + 1]), smooth == i
        spline = CubicHermiteSpline(t[nodes], q[nodes], v[nodes])
        found_q[here], found_v[here] = spline(seen[here]), spline(seen[here], 1)
    return found_q, found_v
