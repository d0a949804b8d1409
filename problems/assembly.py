"""The discretized equations of motion, assembled from the constraint graph at one position (§5)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from problems.bodies import GROUND
from problems.constraint_graph import ConstraintGraph
from problems.contacts import Columns, Pose
from problems.qp import Indices, Matrix, Vector

DENSE_ENTRIES = 4_000
"""Matrices with more entries than this are kept sparse."""


class Assembly:
    """Columns g_N and g_F of all active constraints at one position.

    normals, frictions : the vertices, in the order of row_id
    columns : `Columns` of the normals, N rows
    G_N, G_F : (3n, N), (3n, F) sparse
    members : (F, N) sparse 0/1, which normals bound which friction;  mu : (F,)
    """

    def __init__(
        self,
        graph: ConstraintGraph,
        q: Vector,
        handed_over: Mapping[int, tuple[int, int, int]] | None = None,
    ):
        handed_over = handed_over or {}
        geometry = self.geometry = graph.geometry
        self.pose: Pose = geometry.pose(q)
        self.normals = graph.active()
        self.frictions = graph.active_frictions()
        self.places: list[tuple[int, int, int]] = [
            handed_over.get(n.row_id, n.place) for n in self.normals
        ]
        self.place: Indices = np.array(self.places, dtype=np.int64).reshape(-1, 3)
        self.columns: Columns = geometry.columns(self.pose, *self.place.T)
        m = 3 * geometry.n_bodies
        index = {normal.row_id: i for i, normal in enumerate(self.normals)}
        groups = [[index[n.row_id] for n in f.contact.normals] for f in self.frictions]
        first = np.array([group[0] for group in groups], dtype=np.int64)
        bodies = self.columns.bodies
        self.G_N = _scatter(m, bodies, self.columns.normal)
        self.G_F = _scatter(m, bodies[first], self.columns.tangent[first])
        counts = [len(group) for group in groups]
        rows = np.repeat(np.arange(len(groups)), counts)
        self.members = sp.csr_array(
            (
                np.ones(len(rows)),
                (rows, np.array([i for group in groups for i in group], dtype=np.int64)),
            ),
            shape=(len(groups), len(self.normals)),
        )
        self.mu = np.array([f.contact.mu for f in self.frictions])
        self.normal_ids = np.array([n.row_id for n in self.normals], dtype=np.int64)
        self.friction_ids = np.array([f.row_id for f in self.frictions], dtype=np.int64)
        self._first = first

    def features(self, frictions: Indices, order: Indices) -> Indices:
        """`ContactQP.feature` of all normals and the given frictions, in `order`."""
        rows = [self.geometry.feature(place, 0) for place in self.places]
        rows += [self.geometry.feature(self.places[self._first[j]], 1) for j in frictions]
        return np.array(rows, dtype=np.int64).reshape(-1, 5)[order]


def _scatter(m: int, bodies: Indices, entries: Vector) -> sp.csc_array:
    """Columns with `entries` (N, 6) in the rows of their two bodies; the ground has none."""
    count = len(bodies)
    rows = 3 * np.repeat(bodies, 3, axis=1) + np.tile(np.arange(3), 2)
    moving = np.repeat(bodies != GROUND, 3, axis=1)
    where = np.broadcast_to(np.arange(count)[:, None], rows.shape)
    return sp.csc_array((entries[moving], (rows[moving], where[moving])), shape=(m, count))


def scaled_columns(G: sp.csc_array, D: Vector) -> Matrix:
    """A = D⁻ᵀ G, dense unless it is large.

    Entries that happen to be 0 stay in the pattern, which is that of the contact graph.
    """
    A = sp.csc_array((G.data / D[G.indices], G.indices, G.indptr), shape=G.shape)
    return A.toarray() if A.shape[0] * A.shape[1] <= DENSE_ENTRIES else A
