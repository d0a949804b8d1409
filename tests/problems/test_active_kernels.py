"""Columns of a QP are in the order of row_id."""

from __future__ import annotations

import numpy as np
import pytest

from problems.contacts.active_kernels import Contacts, qp_columns


def some_contacts(seed: int) -> Contacts:
    """Frictions with one normal or two each, normals without any, row_id in the order of birth."""
    rng = np.random.default_rng(seed)
    owners = [-1, -1, *range(6), *rng.integers(0, 6, 3)]
    rng.shuffle(owners)
    normal_ids, friction_of, born, row_id = [], [], {}, 0
    for owner in owners:
        normal_ids.append(row_id)
        row_id += 1
        if owner >= 0 and owner not in born:
            born[owner] = row_id
            row_id += 1
        friction_of.append(-1 if owner < 0 else list(born).index(owner))
    N, F = len(normal_ids), len(born)
    return Contacts(
        place=rng.integers(0, 9, (N, 3)),
        normal_ids=np.array(normal_ids),
        friction_of=np.array(friction_of),
        lam=rng.random(N),
        lam_before=rng.random(N),
        friction_ids=np.array(list(born.values())),
        first=np.array([friction_of.index(j) for j in range(F)]),
        mu=rng.random(F),
        signs=rng.choice([-1.0, 0.0, 1.0], F),
    )


@pytest.mark.parametrize("seed", range(8))
def test_columns_are_in_the_order_of_row_id(seed):
    contacts = some_contacts(seed)
    ids, rubs, first, signs = (
        *(contacts.normal_ids, contacts.friction_ids),
        *(contacts.first, contacts.signs),
    )
    sticks = np.flatnonzero(signs == 0)
    both = np.concatenate([ids, rubs[sticks]])
    order = np.argsort(both)
    row_id, row, tangential, normal_column, sticking, sticking_column = qp_columns(
        ids, rubs, first, signs
    )
    np.testing.assert_array_equal(row_id, both[order])
    np.testing.assert_array_equal(row, np.concatenate([np.arange(ids.size), first[sticks]])[order])
    np.testing.assert_array_equal(tangential, order >= ids.size)
    np.testing.assert_array_equal(row_id[normal_column], ids)
    np.testing.assert_array_equal(sticking, sticks)
    np.testing.assert_array_equal(row_id[sticking_column], rubs[sticks])
