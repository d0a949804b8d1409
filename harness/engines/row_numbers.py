"""Rows of an engine's QPs by what they stand for, so that warm starts find them again.

A row of a joint, a limit or an equality is named by what it belongs to.  A contact is one of a pair
of geoms, and there may be several: the contacts of a pair are matched with those of the step before
by the least sum of distances between their places on the second geom (assignment problem).  Each
edge of its friction pyramid is a row of its own.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from problems.qp import Indices, Vector

CONTACT = 5
"""From this value of mjtConstraint on, a row is of a contact."""


class RowNumbers:
    """Hands out numbers, the same along a motion for the same thing."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._contacts: dict[tuple[int, int], tuple[list[int], Vector]] = {}
        self._made = 0

    def of(self, data: Any, J: Vector) -> Indices:
        """(k,) numbers of the rows of a `mujoco.MjData` with constraint Jacobian J (k, nv)."""
        contacts = self._match(data)
        seen: dict[tuple[Any, ...], int] = defaultdict(int)
        numbers = np.zeros(len(J), np.int64)
        for row, (kind, of) in enumerate(
            zip(data.efc_type.tolist(), data.efc_id.tolist(), strict=True)
        ):
            if kind >= CONTACT:
                name: tuple[Any, ...] = (kind, contacts[of])
            else:  # of both limits of a joint the signs differ
                first = J[row][np.flatnonzero(J[row])[:1]]
                name = (kind, of, bool((first < 0).any()))
            numbers[row] = self._numbers.setdefault((*name, seen[name]), len(self._numbers))
            seen[name] += 1
        return numbers

    def _match(self, data: Any) -> list[int]:
        """A number for each contact."""
        geoms = data.contact.geom.reshape(-1, 2)
        places = data.contact.pos.reshape(-1, 3)
        of_pair: dict[tuple[int, int], list[int]] = defaultdict(list)
        for contact, (first, second) in enumerate(geoms.tolist()):
            of_pair[first, second].append(contact)
        numbers = [0] * len(geoms)
        now = {}
        for pair, members in of_pair.items():
            at = places[members]
            if pair[1] >= 0:  # a flexible body has no frame
                turn = data.geom_xmat[pair[1]].reshape(3, 3)
                at = (at - data.geom_xpos[pair[1]]) @ turn
            known, before = self._contacts.get(pair, ([], np.zeros((0, 3))))
            apart = np.linalg.norm(at[:, None] - before[None], axis=2)
            taken = dict(
                zip(*(index.tolist() for index in linear_sum_assignment(apart)), strict=True)
            )
            for i, contact in enumerate(members):
                numbers[contact] = known[taken[i]] if i in taken else self._new()
            now[pair] = ([numbers[contact] for contact in members], at)
        self._contacts = now
        return numbers

    def _new(self) -> int:
        self._made += 1
        return self._made
