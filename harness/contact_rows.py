"""Which rows of a QP are normals, which are tangents, and which normals bound which tangent.

The QP says which corner and edge carry a row (`feature`) and keeps its column g = Dᵀa.  A contact
is the rows of one pair of bodies whose normals are parallel: one normal, or the two ends of an edge
that lies on an edge, and a tangent.  So are contacts made (`problems.constraint_graph`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from problems.contacts import PARALLEL_SINE
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
    of_pair = defaultdict(list)
    for i, row in enumerate(normal.tolist()):
        of_pair[_pair(qp, row)].append(i)
    entries = [
        (f, i)
        for f, row in enumerate(tangent.tolist())
        for i in of_pair[_pair(qp, row)]
        if abs(_along(qp, row) @ _along(qp, int(normal[i]))) < PARALLEL_SINE
    ]
    rows, columns = np.array(entries, dtype=np.int64).reshape(-1, 2).T
    shape = (tangent.size, normal.size)
    return ContactRows(
        normal, tangent, sp.csr_array((np.ones(rows.size), (rows, columns)), shape=shape)
    )


def _pair(qp: ContactQP, row: int) -> tuple[int, int]:
    one, _, other, _, _ = qp.feature[row].tolist()
    return (one, other) if one < other else (other, one)


def _along(qp: ContactQP, row: int) -> Vector:
    """The direction of a row in the plane: how it moves the body of its corner.  (2,)"""
    at = 3 * int(qp.feature[row, 0])
    column = qp.A[at : at + 2, [row]]
    column = column.toarray() if sp.issparse(column) else column
    return np.asarray(column[:, 0] * qp.D[at : at + 2])
