"""Which column of a time step's QP is which constraint."""

from __future__ import annotations

from typing import Any

from problems.contacts.active_kernels import qp_columns
from problems.least_norm.independence import IndependenceProof
from problems.qp import Indices, Vector


class Layout:
    """Columns of the QP: all normals and the sticking frictions, in the order of row_id.

    row_id (k,), feature (k, 5) : see `ContactQP`
    columns : `qp_columns`, row, tangential, normal_column, sticking, sticking_column : its parts
    proof : whether its columns are independent, kept here;  room : what steps work with
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
        contacts = self.feature[:, 4] >= 0
        self.feature[contacts, 4] = self.tangential[contacts]
        self.proof = IndependenceProof()
        self.room: dict[bool, Any] = {}
        self.row_id.setflags(write=False)
        self.feature.setflags(write=False)

    @property
    def k(self) -> int:
        """Number of columns."""
        return self.row_id.size
