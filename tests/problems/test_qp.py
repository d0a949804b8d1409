"""`problems.qp`: what a QP refuses, and that it cannot be changed."""

import numpy as np
import pytest
import scipy.sparse as sp

from problems.qp import AT_LOWER, AT_UPPER, FREE, ContactQP, positions_of, working_set_of

GOOD = {
    "A": np.arange(6.0).reshape(3, 2),
    "d": np.ones(3),
    "lower": np.zeros(2),
    "upper": np.full(2, np.inf),
}


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("A", np.full((3, 2), np.nan), "A holds NaN"),
        ("A", np.ones(3), "must be a matrix"),
        ("d", np.ones(2), "d needs shape (3,)"),
        ("d", np.array([1.0, np.nan, 0.0]), "d holds NaN at index [1]"),
        ("d", np.array([1.0, np.inf, 0.0]), "d holds an entry beyond"),
        ("lower", np.ones(3), "lower needs shape (2,)"),
        ("lower", np.full(2, np.inf), "may not be"),
        ("upper", np.array([-1.0, 1.0]), "lower[0] = 0 exceeds upper[0] = -1"),
        ("row_id", np.array([4, 4]), "row_id holds a number twice"),
        ("kind", "stepp", "kind 'stepp' is unknown"),
        ("h", 0.0, "h = 0"),
        ("eps0", np.nan, "eps0 = nan"),
        ("D", np.array([1.0, 0.0, 1.0]), "D must be positive"),
        ("generators", np.ones((3, 3)), "generators must have shape (l, 2)"),
        ("feature", np.ones((2, 4)), "feature needs shape (2, 5)"),
    ],
)
def test_bad_fields_are_refused_by_name(field, value, words):
    with pytest.raises(ValueError, match=r".") as error:
        ContactQP(**(GOOD | {field: value}))
    assert words in str(error.value)


@pytest.mark.parametrize("convert", [np.array, sp.csc_array, sp.coo_array])
def test_arrays_are_copies_that_cannot_be_written(convert):
    A = convert(GOOD["A"])
    qp = ContactQP(**(GOOD | {"A": A}))
    with pytest.raises(ValueError, match="read-only"):
        qp.d[0] = 5.0
    data = qp.A.data if sp.issparse(qp.A) else qp.A
    with pytest.raises((ValueError, TypeError)):
        data[...] = 0.0
    np.testing.assert_array_equal(qp.dense_A, GOOD["A"])
    assert GOOD["d"].flags.writeable


def test_residual_gradient_and_objective_agree():
    qp = ContactQP(**GOOD)
    x, step = np.array([0.3, 1.7]), 1e-6
    numeric = [
        (qp.objective(x + step * e) - qp.objective(x - step * e)) / (2 * step) for e in np.eye(2)
    ]
    np.testing.assert_allclose(qp.gradient(x), numeric, rtol=1e-8)


def test_multipliers_of_generators():
    V = np.array([[1.0, 1.0], [0.5, -0.5]])
    qp = ContactQP(**GOOD, generators=V)
    np.testing.assert_array_equal(qp.multipliers(np.array([2.0, 1.0])), [3.0, 0.5])


def test_positions_follow_identity_not_place():
    assert positions_of([7, 3, 9], [3, 5, 7]).tolist() == [2, 0, -1]
    assert positions_of([7], []).tolist() == [-1]
    assert positions_of([], [1]).tolist() == []


def test_working_set_of_fixed_and_bounded_rows():
    qp = ContactQP(np.eye(3), np.zeros(3), np.array([0.0, -1.0, 2.0]), np.array([1.0, 1.0, 2.0]))
    assert working_set_of(qp, [0.5, 1.0, 2.0]).tolist() == [FREE, AT_UPPER, AT_LOWER]
