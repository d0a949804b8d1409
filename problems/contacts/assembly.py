"""The discretized equations of motion, assembled from the constraint graph at one position (§5).

A column of G has six entries at most, for the two bodies of its contact, and is kept as these.  The
products with G that a step needs are sums over them; matrices are made for the QP only.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from problems.contacts.active_kernels import friction_bounds
from problems.contacts.constraint_graph import ActiveSet, ConstraintGraph
from problems.contacts.geometry import Columns, Pose
from problems.contacts.geometry_kernels import (
    column_speeds,
    column_sum,
    dense_columns,
    gather_columns,
    sparse_columns,
)
from problems.contacts.layout import Layout
from problems.joints.row_kernels import rows_at
from problems.qp import Indices, Matrix, Vector

DENSE_ENTRIES = 4_000
"""Matrices with more entries than this are kept sparse."""


class Assembly:
    """Columns g_N and g_F of all active constraints at the position q (3n,).

    Of N normals the first C are of contacts, the others rows of joints.

    active : `ActiveSet`, that of the graph if none is given
    normals, frictions : its vertices, in the order of row_id; C and F of them
    place : (C, 3) corner, part and edge of each contact;  rows : of joints
    columns : `Columns` of the normals, N rows
    friction_of : (N,) the friction that a normal bounds, or −1, or `JOINT`;  mu : (F,)
    """

    def __init__(self, graph: ConstraintGraph, q: Vector, active: ActiveSet | None = None):
        geometry = self.geometry = graph.geometry
        self.q = q
        self.active = active = graph.active_set() if active is None else active
        self.pose: Pose = geometry.pose(q)
        self.m = q.size
        self.normals, self.frictions = active.normals, active.frictions
        self.normal_ids, self.friction_ids = active.normal_ids, active.friction_ids
        self.friction_of, self.mu = active.friction_of, active.mu
        self.place: Indices = active.place
        self.rows = active.rows
        self.columns: Columns = self.columns_at(q)

    def columns_at(self, q: Vector) -> Columns:
        """The columns of the same constraints at another position q (3n,)."""
        pose = self.pose if q is self.q else self.geometry.pose(q)
        contacts, R = self.geometry.columns_at(pose, self.place), self.rows.kind.size
        if R == 0:
            return contacts
        phi, normal, bodies = rows_at(self.rows, q)
        blank = Columns(*(np.zeros((R, *part.shape[1:]), part.dtype) for part in contacts))
        rows = blank._replace(phi=phi, normal=normal, bodies=bodies, length=np.full(R, np.inf))
        return Columns(*(np.concatenate(pair) for pair in zip(contacts, rows, strict=True)))

    @property
    def count(self) -> int:
        """N."""
        return self.friction_of.size

    @property
    def rubbing(self) -> Indices:
        """(N,) the friction that a normal bounds, and any where it bounds none."""
        return np.maximum(self.friction_of, 0)

    @property
    def touching(self) -> slice:
        """The C normals that are contacts."""
        return slice(len(self.normals))

    @property
    def bilateral(self) -> Indices:
        """Numbers of the normals that are rows of joints, and no stops."""
        return len(self.normals) + np.flatnonzero(self.rows.stop == 0)

    @property
    def at_stop(self) -> Indices:
        """Numbers of those that are stops."""
        return len(self.normals) + np.flatnonzero(self.rows.stop)

    @property
    def held(self) -> Indices:
        """Numbers of the rows of joints whose multipliers have no bounds."""
        return len(self.normals) + np.flatnonzero(self.rows.unbounded())

    @property
    def yielding(self) -> Indices:
        """Numbers of those that yield at a finite force."""
        yields = (self.rows.stop == 0) & ~self.rows.unbounded()
        return len(self.normals) + np.flatnonzero(yields)

    # --- products with G -------------------------------------------------------------------------

    def gap_speed(self, v: Vector) -> Vector:
        """G_Nᵀ v (N,)."""
        return column_speeds(self.columns.normal, self.columns.bodies, v)

    def slip_speed(self, v: Vector) -> Vector:
        """G_Fᵀ v (F,)."""
        return column_speeds(*self.tangents, v)

    def friction_force(self, lam_F: Vector) -> Vector:
        """G_F λ_F (3n,)."""
        return column_sum(*self.tangents, lam_F, self.m)

    def bound(self, lam_N: Vector) -> Vector:
        """μ Σ λ_N, the bound of each friction (F,)."""
        return friction_bounds(self.friction_of, self.mu, lam_N)

    # --- matrices --------------------------------------------------------------------------------

    @cached_property
    def tangents(self) -> tuple[Vector, Indices]:
        """Entries (F, 6) of g_F and their bodies (F, 2)."""
        first = self.active.first
        return self.columns.tangent[first], self.columns.bodies[first]

    def laid_out(self, layout: Layout) -> tuple[Vector, Indices]:
        """Entries (k, 6) and bodies (k, 2) of the QP's columns."""
        columns = self.columns
        if layout.k == layout.normal_column.size:  # normals alone are in the order of row_id
            return columns.normal, columns.bodies
        laid_out = np.empty((layout.k, 6)), np.empty((layout.k, 2), np.int64)
        gather_columns(
            *(columns.normal, columns.tangent, columns.bodies, layout.row, layout.tangential),
            *laid_out,
        )
        return laid_out

    def scaled(self, normals: Indices, frictions: Indices, D: Vector) -> Matrix:
        """D⁻ᵀ[G_N, G_F] of these normals and frictions, see `scaled_matrix`."""
        tangent, bodies = self.tangents
        entries = np.concatenate([self.columns.normal[normals], tangent[frictions]])
        bodies = np.concatenate([self.columns.bodies[normals], bodies[frictions]])
        return scaled_matrix(entries, bodies, D)

    @cached_property
    def G_N(self) -> sp.csc_array:
        """(3n, N) sparse."""
        return _sparse(self.columns.normal, self.columns.bodies, np.ones(self.m))

    @cached_property
    def G_F(self) -> sp.csc_array:
        """(3n, F) sparse."""
        return _sparse(*self.tangents, np.ones(self.m))


def _sparse(entries: Vector, bodies: Indices, D: Vector) -> sp.csc_array:
    return sp.csc_array(sparse_columns(entries, bodies, D), shape=(D.size, len(bodies)))


def scaled_matrix(entries: Vector, bodies: Indices, D: Vector) -> Matrix:
    """D⁻ᵀ G of columns with these entries (k, 6) and bodies (k, 2), dense unless it is large.

    Entries that happen to be 0 stay in the pattern, which is that of the contact graph.
    """
    if D.size * len(bodies) <= DENSE_ENTRIES:
        return dense_columns(entries, bodies, D)
    return _sparse(entries, bodies, D)
