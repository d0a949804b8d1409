"""J_N and J_F in arrays, and which of them are columns of a QP; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.kernels.arena import zeros
from problems.kernels.compiled import kernel
from problems.qp import Indices, Vector

JOINT = -2
"""`friction_of` a row of a joint, whose multiplier may have either sign."""


class Contacts(NamedTuple):
    """N normals and F frictions that are active, each in the order of row_id.

    The first C normals are of contacts, the others rows of joints.

    place : (C, 3) corner, part, edge;  normal_ids : (N,)
    friction_of : (N,) the friction that a normal bounds, or −1, or `JOINT`
    lam, lam_before : (N,) λ_N at the last two time points
    friction_ids : (F,);  first : (F,) the first normal of its contact;  mu : (F,)
    signs : (F,) s of those that slide, 0 of those that stick
    """

    place: Indices
    normal_ids: Indices
    friction_of: Indices
    lam: Vector
    lam_before: Vector
    friction_ids: Indices
    first: Indices
    mu: Vector
    signs: Vector


class Frictions(NamedTuple):
    """Which normals bound which frictions, and the k columns of the QP of both.

    friction_of, first, mu, signs : see `Contacts`
    row_id : (k,), read only, and the others of `qp_columns`
    """

    friction_of: Indices
    first: Indices
    mu: Vector
    signs: Vector
    row_id: Indices
    row: Indices
    tangential: NDArray[np.bool_]
    normal_column: Indices
    sticking: Indices
    sticking_column: Indices


@kernel
def qp_columns(normal_ids, friction_ids, first, signs):
    """The columns of a QP, all normals and the sticking frictions, in the order of row_id.

    For k columns and S frictions that stick:

    row_id : (k,);  row, tangential : (k,) each column is g_N, or g_F, of this row of the normals
    normal_column : (N,) the column of each normal
    sticking, sticking_column : (S,) the frictions that have a column, and which
    """
    N, S = normal_ids.size, 0
    for j in range(signs.size):
        S += signs[j] == 0.0
    row_id, row = np.empty(N + S, dtype=np.int64), np.empty(N + S, dtype=np.int64)
    tangential = np.zeros(N + S, dtype=np.bool_)
    normal_column = np.empty(N, dtype=np.int64)
    sticking, sticking_column = np.empty(S, dtype=np.int64), np.empty(S, dtype=np.int64)
    i = j = s = 0
    for c in range(N + S):
        while j < signs.size and signs[j] != 0.0:
            j += 1
        if i < N and (j == signs.size or normal_ids[i] < friction_ids[j]):
            row_id[c], row[c], normal_column[i] = normal_ids[i], i, c
            i += 1
        else:
            row_id[c], row[c], tangential[c] = friction_ids[j], first[j], True
            sticking[s], sticking_column[s] = j, c
            j, s = j + 1, s + 1
    return row_id, row, tangential, normal_column, sticking, sticking_column


@kernel
def friction_bounds(friction_of, mu, lam_N, arena=None):
    """μ Σ λ_N, the bound of each friction (F,)."""
    bound = zeros(arena, mu.size)
    for i in range(friction_of.size):
        if friction_of[i] >= 0:
            bound[friction_of[i]] += lam_N[i]
    for j in range(mu.size):
        bound[j] *= mu[j]
    return bound
