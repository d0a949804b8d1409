"""Which column of a time step's QP is which constraint."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from problems.contacts.active_kernels import qp_columns
from problems.least_norm.independence import IndependenceProof
from problems.qp import Indices, Vector


class Layout:
    """Columns of the QP: all normals and the sticking frictions, in the order of row_id.

    row_id (k,), feature (k, 5) : see `ContactQP`
    columns : `qp_columns`, row, tangential, normal_column, sticking, sticking_column : its parts
    cones, proof : `friction.coulomb_rows` and whether its columns are independent, kept here
    """

    def __init__(
        self,
        normal_ids: Indices,
        friction_ids: Indices,
        feature: Indices,
        first: Indices,
        signs: Vector,
    ):
        self.columns = qp_columns(normal_ids, friction_ids, first, signs)
        self.row_id, self.row, self.tangential = self.columns[:3]
        self.normal_column, self.sticking, self.sticking_column = self.columns[3:]
        self.feature = feature[self.row]
        self.feature[:, 4] = self.tangential
        self.proof = IndependenceProof()
        self.cones: dict[bytes, sp.csr_array] = {}
        self.row_id.setflags(write=False)
        self.feature.setflags(write=False)

    @property
    def k(self) -> int:
        """Number of columns."""
        return self.row_id.size

    def limits(self, stuck_bound: Vector) -> tuple[Vector, Vector]:
        """lower and upper (k,): λ_N ≥ 0, and |λ_F| ≤ stuck_bound (S,)."""
        lower, upper = self._one_sided
        if self.sticking.size == 0:
            return lower, upper
        lower, upper = lower.copy(), upper.copy()
        lower[self.sticking_column] = -stuck_bound
        upper[self.sticking_column] = stuck_bound
        return lower, upper

    def split(self, x: Vector, n_frictions: int) -> tuple[Vector, Vector]:
        """λ_N (N,) and λ_F (F,), 0 where sliding, from the QP's x (k,)."""
        lam_F = np.zeros(n_frictions)
        lam_F[self.sticking] = x[self.sticking_column]
        return x[self.normal_column], lam_F

    @cached_property
    def _one_sided(self) -> tuple[Vector, Vector]:
        return np.zeros(self.k), np.full(self.k, np.inf)
