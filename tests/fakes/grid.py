"""A grid of bodies, contacts between neighbours, as the QP of a minimum norm."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from problems.qp import ContactQP

RIDGE = 1e-5


def grid_qp(side: int, seed: int, loose: float) -> ContactQP:
    """One-sided contacts, twice as many as bodies, that can carry all of d; 1e-9 ‖d‖ is asked.

    loose : share of contacts that carried nothing where d was made
    """
    rng = np.random.default_rng(seed)
    body = np.arange(side * side).reshape(side, side)
    across = np.column_stack([body[:, :-1].ravel(), body[:, 1:].ravel()])
    upwards = np.column_stack([body[:-1].ravel(), body[1:].ravel()])
    pairs = np.vstack([across, upwards])
    k = len(pairs)
    G = sp.csc_array((np.tile([1.0, -1.0], k), pairs.ravel(), 2 * np.arange(k + 1)))
    carried = rng.random(k) * (rng.random(k) >= loose)
    A = sp.vstack([G, RIDGE * sp.eye_array(k)], format="csc")
    d = np.concatenate([-(G @ carried), np.zeros(k)])
    zero, inf = np.zeros(k), np.full(k, np.inf)
    eps0 = 1e-9 * float(np.linalg.norm(d))
    return ContactQP(A, d, zero, inf, kind="minimum_norm", eps0=eps0)
