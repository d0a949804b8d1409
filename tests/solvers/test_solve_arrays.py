"""From arrays in one call: the same bits as by a `ContactQP`, and the same refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from glambda import make_solver, simulate
from problems.qp import ContactQP, Solution

INF = np.inf


@pytest.fixture(scope="module", params=["fig2", "fig4"])
def qps(request: pytest.FixtureRequest) -> list[ContactQP]:
    return [qp for qp in simulate(request.param, until=0.4).qps if qp.k and qp.kind == "step"]


def arrays(m: int = 9, k: int = 6, seed: int = 3) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    A, d = random.standard_normal((m, k)), random.standard_normal(m)
    return {"A": A, "d": d, "lower": np.zeros(k), "upper": np.full(k, INF)}


def assert_same(found: Solution, expected: Solution) -> None:
    assert found.x is not None and expected.x is not None
    assert found.x.tobytes() == expected.x.tobytes()
    assert found.working_set.tolist() == expected.working_set.tolist()
    assert found.row_id.tolist() == expected.row_id.tolist()
    assert (found.status, found.work) == (expected.status, expected.work)


@pytest.mark.parametrize("warm", [True, False])
@pytest.mark.parametrize("name", ["glambda", "lotstedt", "quadprog"])
def test_answers_are_those_of_a_contact_qp(qps: list[ContactQP], name: str, warm: bool) -> None:
    solver = make_solver(name, accuracy=1e-9)
    last = other = None
    for qp in qps:
        given = (qp.A, qp.d, qp.lower, qp.upper)
        found = solver.solve_arrays(*given, row_id=qp.row_id, start=last, t=qp.t)
        expected = solver.solve(ContactQP(*given, qp.row_id, t=qp.t), other)
        assert_same(found, expected)
        if warm:
            last, other = found, expected


@pytest.mark.parametrize("k", [0, 1, 20, 60, 120])
def test_any_number_of_columns(k: int) -> None:
    solver, given = make_solver("glambda"), arrays(k + 3, k)
    found, expected = solver.solve_arrays(**given), solver.solve(ContactQP(**given))
    assert_same(found, expected)
    given["d"] = 1.01 * given["d"]
    warm = solver.solve_arrays(**given, start=found)
    assert_same(warm, solver.solve(ContactQP(**given), expected))


def mapped(given: dict[str, Any], how: str) -> dict[str, Any]:
    given = dict(given)
    A = given["A"]
    if how == "lists":
        return {name: value.tolist() for name, value in given.items()}
    if how == "column by column":
        given["A"] = np.asfortranarray(A)
    elif how == "float32":
        given["A"] = A.astype(np.float32).astype(np.float64)
        given = {**given, "d": given["d"].astype(np.float32)}
    elif how == "every other":
        given["A"] = np.repeat(A, 2, axis=1)[:, ::2]
        given["d"] = np.repeat(given["d"], 2)[::2]
    elif how == "sparse":
        given["A"] = sp.csr_array(A)
    elif how == "swapped":
        given["A"] = A.astype(A.dtype.newbyteorder())
    elif how == "not aligned":
        room = np.empty(A.nbytes + 1, np.uint8)
        given["A"] = room[1:].view(np.float64).reshape(A.shape)
        given["A"][:] = A
    elif how == "read-only":
        for value in given.values():
            value.setflags(write=False)
    elif how == "fixed rows":
        given["upper"] = given["upper"].copy()
        given["upper"][0] = given["lower"][0]
    return given


@pytest.mark.parametrize(
    "how",
    ["lists", "column by column", "float32", "every other", "sparse", "swapped", "not aligned",
     "read-only", "fixed rows"],
)  # fmt: skip
def test_arrays_of_any_kind(how: str) -> None:
    solver, given = make_solver("glambda"), mapped(arrays(), how)
    assert_same(solver.solve_arrays(**given), solver.solve(ContactQP(**given)))


WRONG: list[tuple[str, Any]] = [
    ("A", np.full((9, 6), np.nan)),
    ("A", np.full((9, 6), INF)),
    ("A", np.full((9, 6), 1e152)),
    ("A", np.zeros(9)),
    ("A", np.zeros((8, 6))),
    ("d", np.full(9, np.nan)),
    ("d", np.full(9, -INF)),
    ("d", np.zeros((9, 1))),
    ("d", np.zeros(0)),
    ("lower", np.full(6, np.nan)),
    ("lower", np.full(6, INF)),
    ("lower", np.zeros(5)),
    ("upper", np.full(6, np.nan)),
    ("upper", np.full(6, -1.0)),
    ("upper", np.full(6, -INF)),
    ("row_id", np.zeros(6, np.int64)),
    ("row_id", np.arange(7)),
    ("t", np.nan),
    ("eps0", 0.0),
    ("eps0", np.nan),
    ("eps0", INF),
]


@pytest.mark.parametrize(("field", "value"), WRONG)
def test_what_a_contact_qp_refuses_is_refused_in_its_words(field: str, value: Any) -> None:
    solver, given = make_solver("glambda"), arrays()
    before, twin = solver.solve_arrays(**given), solver.solve_arrays(**given)
    kept = before.x.copy()
    with pytest.raises(ValueError) as expected:
        ContactQP(**given | {field: value})
    with pytest.raises(ValueError) as refused:
        solver.solve_arrays(**given | {field: value}, start=before)
    assert str(refused.value) == str(expected.value)
    warm = solver.solve_arrays(**given, start=before)
    assert_same(warm, solver.solve_arrays(**given, start=twin))
    assert before.x.tolist() == kept.tolist()


def test_one_entry_that_is_no_number_is_found() -> None:
    solver, given = make_solver("glambda"), arrays(33, 21)
    for name in given:
        for place in range(0, given[name].size, 5):
            spoilt = {other: value.copy() for other, value in given.items()}
            spoilt[name].reshape(-1)[place] = np.nan
            with pytest.raises(ValueError, match=rf"{name} holds NaN"):
                solver.solve_arrays(**spoilt)


def test_a_limit_and_what_is_not_solved() -> None:
    given = arrays(30, 30)
    limited = make_solver("glambda", iteration_limit=0)
    assert_same(limited.solve_arrays(**given), limited.solve(ContactQP(**given)))


def test_nothing_is_kept_of_the_arrays() -> None:
    given = arrays()
    found = make_solver("glambda").solve_arrays(**given)
    x = found.x.copy()
    for value in given.values():
        assert value.flags.writeable
        value[:] = 7.0
    assert found.x.tolist() == x.tolist() and found.timing.solve > 0
