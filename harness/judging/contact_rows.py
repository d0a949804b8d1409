"""Which rows of a QP are normals, which are tangents, and which normals bound which tangent.

The QP says which corner and edge carry a row (`feature`) and keeps its column g = Dᵀa.  A contact
is the rows of one pair of bodies whose normals are parallel: one normal, or the two ends of an edge
that lies on an edge, and a tangent.  So are contacts made (`problems.contacts.constraint_graph`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from problems.contacts.geometry import PARALLEL_SINE
from problems.qp import NORMAL, TANGENT, ContactQP, Indices, Vector


@dataclass(frozen=True, eq=False)
class ContactRows:
    """Rows of a QP by what they are.

    normal : (N,) rows g_N;  tangent : (F,) rows g_F;  members : (F, N) sparse 0/1, the normals of
    the contact that a tangent belongs to
    """

    normal: Indices
    tangent: Indices
    members: sp.csr_array


def contact_rows(qp: ContactQP) -> ContactRows:
    """Rows of `qp`; none where it does not say which bodies touch."""
    direction = qp.feature[:, 4]
    normal, tangent = np.flatnonzero(direction == NORMAL), np.flatnonzero(direction == TANGENT)
    pushes, slips = _directions(qp, normal), _directions(qp, tangent)
    of_pair = defaultdict(list)
    for i, pair in enumerate(_pairs(qp, normal)):
        of_pair[pair].append(i)
    entries = [
        (f, i)
        for f, pair in enumerate(_pairs(qp, tangent))
        for i in of_pair[pair]
        if abs(slips[f] @ pushes[i]) < PARALLEL_SINE
    ]
    rows, columns = np.array(entries, dtype=np.int64).reshape(-1, 2).T
    shape = (tangent.size, normal.size)
    members = sp.csr_array((np.ones(rows.size), (rows, columns)), shape=shape)
    return ContactRows(normal, tangent, members)


def _pairs(qp: ContactQP, rows: Indices) -> list[tuple[int, ...]]:
    """The two bodies of each row, the lower number first."""
    return [tuple(pair) for pair in np.sort(qp.feature[rows][:, [0, 2]], axis=1).tolist()]


def _directions(qp: ContactQP, rows: Indices) -> Vector:
    """How each row moves the body of its corner: a unit vector in the plane.  (n, 2)"""
    at = 3 * qp.feature[rows, 0]
    parts = [np.asarray(qp.A[at + i, rows]).ravel() * qp.D[at + i] for i in (0, 1)]
    return np.stack(parts, axis=1)
