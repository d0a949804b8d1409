"""What each arm of a replay starts from, on sequences that are small enough to see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from harness import replay
from harness.judging.facts import facts_of, setting_name
from harness.passes.measure import run_pass
from harness.passes.starts import EVERY_ARM, Starts, after_restart, has_arm, order_of
from harness.passes.wire import Question
from harness.recordings.recording import Reference
from harness.study.replay import reproduce
from problems.qp import FREE, ContactQP, Solution
from solvers import make_solver
from solvers.base import Solver
from solvers.baselines.velocity import Velocity
from solvers.registry import solver_class
from tests.fakes.fake_recordings import fake_recording, solution_of
from tests.fakes.random_qps import random_qp
from tests.fakes.runs import scene_run, short_recording


def stretch(times: list[float], kinds: str = "step") -> list[ContactQP]:
    """One QP posed again and again, at these times; the first follows a restart."""
    qp, _ = random_qp("two_sided", 3)
    return [replace(qp, t=t, kind=kinds, restart=i == 0) for i, t in enumerate(times)]


class Adopting(Velocity):
    """Says what it was asked to adopt."""

    def adopt(self, memory: Any, start: Solution) -> Any:
        return f"{memory}, adopted"


def walk(
    arm: str,
    qps: Sequence[ContactQP],
    answer: Callable[[int, Solution | None], Solution],
    references: Sequence[Reference | None] | None = None,
    solver: Solver | None = None,
) -> dict[int, Solution | None]:
    """The start that an arm hands over for each QP; `answer(i, start)` is the solver's."""
    solver = solver or Adopting()
    starts, alone, given = Starts(solver, arm), after_restart(qps), {}
    for position, i in enumerate(order_of(arm, len(qps))):
        known = references[i] if references is not None else None
        x = None if known is None else known.x
        start, adopt = starts.of(Question(i, qps[i], x, bool(alone[i]), position == 0))
        if start is not None and adopt:
            start = replace(start, memory=solver.adopt(start.memory, start))
        given[i] = start
        starts.take(qps[i], answer(i, start))
    return given


def told(
    qps: Sequence[ContactQP], x: Sequence[np.ndarray]
) -> Callable[[int, Solution | None], Solution]:
    """Answers x, with the number of the QP in its memory."""
    return lambda i, start: solution_of(qps[i], x[i], memory=f"of {i}")


def numbered(qps: list[ContactQP]) -> list[np.ndarray]:
    """x = (i, i, …) for QP i."""
    return [np.full(qp.k, float(i)) for i, qp in enumerate(qps)]


def first_entries(given: dict[int, Solution | None]) -> list[float | None]:
    return [None if s is None else float(s.x[0]) for _, s in sorted(given.items())]


def test_how_far_back() -> None:
    qps = stretch([0.1 * i for i in range(22)])
    answers = told(qps, numbered(qps))
    nothing: list[float | None] = [None]
    assert first_entries(walk("cold", qps, answers)) == nothing * 22
    for arm in ("warm", "bare"):
        assert first_entries(walk(arm, qps, answers)) == [None, *range(21)]
    assert first_entries(walk("stale5", qps, answers)) == nothing * 5 + [*range(17)]
    assert first_entries(walk("stale20", qps, answers)) == nothing * 20 + [0, 1]


def test_memory_is_that_of_the_last_solve_and_is_told_where_x_is_another() -> None:
    qps = stretch([0.1 * i for i in range(8)])
    for arm in ("warm", "bare", "kept", "extrapolated", "stale5", "corrupted"):
        given = walk(arm, qps, told(qps, numbered(qps)))
        handed = {i: s.memory for i, s in given.items() if s is not None}
        assert len(handed) == (3 if arm == "stale5" else 7)
        for i, memory in handed.items():
            own = {"warm": f"of {i - 1}", "bare": None}
            assert memory == own.get(arm, f"of {i - 1}, adopted")


@pytest.mark.parametrize("arm", [arm for arm in EVERY_ARM if arm not in ("cold", "shuffled")])
def test_a_stretch_ends_at_a_restart_and_impulses_stand_apart(arm: str) -> None:
    qps = stretch([0.1 * i for i in range(30)])
    qps[24] = replace(qps[24], restart=True)
    qps[2] = replace(qps[2], kind="impulse")
    known = Reference(np.zeros(qps[0].k), np.zeros(qps[0].m), 0.0)
    references = [known] * 30
    for i, start in walk(arm, qps, told(qps, numbered(qps)), references).items():
        if i in (0, 2, 24):
            assert start is None
        elif start is not None and arm not in ("exact", "corrupted", "kept"):
            assert start.x[0] != 2.0  # not from the impulse
            assert i < 24 or start.x[0] >= 24
    assert np.flatnonzero(after_restart(qps)).tolist() == [0, 24]


def test_kept_is_cold_but_for_the_memory() -> None:
    qps = stretch([0.1 * i for i in range(3)])
    given = walk("kept", qps, told(qps, numbered(qps)))
    assert given[0] is None
    for i in (1, 2):
        np.testing.assert_array_equal(given[i].x, np.clip(0.0, qps[i].lower, qps[i].upper))
        assert (given[i].working_set == FREE).all()
        assert given[i].memory == f"of {i - 1}, adopted"


@pytest.mark.parametrize("name", ["glambda", "lotstedt"])
def test_a_kept_workspace_does_the_work_of_a_cold_solve(name: str) -> None:
    solver, qps, compared = make_solver(name), scene_run("fig5").qps[:80], []

    def compare(i: int, start: Solution | None) -> Solution:
        qp = qps[i]
        kept, cold = solver.solve(qp, start), solver.solve(qp)
        if start is not None:
            assert np.shares_memory(kept.memory.S, start.memory.S)
            assert kept.iterations == cold.iterations
            assert np.linalg.norm(qp.A @ (kept.x - cold.x)) <= 2 * qp.eps0
            compared.append(qp.k > 0)
        return kept

    walk("kept", qps, compare, solver=solver)
    assert sum(compared) > 20


def test_extrapolation_is_linear_in_time_and_stands_where_time_stands() -> None:
    qps = stretch([0.0, 0.1, 0.1, 0.4, 0.2])
    x = [np.full(qp.k, value) for qp, value in zip(qps, [1.0, 2.0, 3.0, 7.0, 0.0], strict=True)]
    given = first_entries(walk("extrapolated", qps, told(qps, x)))
    # 1: one solution only; 2: no time has passed; 3: from t = 0 and the later one of t = 0.1;
    # 4: time went back
    assert given == [None, 1.0, 2.0, pytest.approx(3.0 + 3 * (3.0 - 1.0)), 7.0]


def test_extrapolation_maps_rows() -> None:
    qps = stretch([0.0, 0.1, 0.2])
    k = qps[0].k
    qps[1] = replace(qps[1], row_id=qps[0].row_id[::-1].copy())
    new = np.r_[10**6, qps[0].row_id[1:]]
    qps[0] = replace(qps[0], row_id=new)
    before, last = np.arange(k, dtype=float), np.full(k, 100.0)
    start = walk("extrapolated", qps, told(qps, [before, last, last]))[2]
    expected = 2 * last - before[::-1]
    expected[-1] = 100.0  # unknown before
    np.testing.assert_allclose(start.x, expected)


def test_the_corrupted_start_is_far_off_feasible_and_the_same_for_all() -> None:
    qps = stretch([0.0, 0.1, 0.2])
    answers = [np.full(qp.k, 2.0) for qp in qps]
    once, again = (walk("corrupted", qps, told(qps, answers)) for _ in range(2))
    for i in (1, 2):
        start = once[i]
        assert np.linalg.norm(start.x - 2.0) == pytest.approx(np.linalg.norm(answers[i]))
        np.testing.assert_array_equal(start.x, again[i].x)
        np.testing.assert_array_equal(start.working_set, again[i].working_set)
    assert not np.array_equal(once[1].x, once[2].x)
    free, _ = random_qp("bilateral", 0)
    qps = [replace(free, t=t, restart=t == 0) for t in (0.0, 0.1)]
    start = walk("corrupted", qps, told(qps, [np.ones(free.k)] * 2))[1]
    for bound, member in ((free.lower, -1), (free.upper, 1)):
        assert not (start.working_set[np.isinf(bound)] == member).any()


def test_exact_starts_from_the_reference_and_its_working_set() -> None:
    made = fake_recording()
    zeros, alone = [np.zeros(qp.k) for qp in made.qps], after_restart(made.qps)
    given = walk("exact", made.qps, told(made.qps, zeros), made.references)
    for i, (qp, known) in enumerate(zip(made.qps, made.references, strict=True)):
        start = given[i]
        if qp.kind == "step" and not alone[i] and known is not None:
            np.testing.assert_array_equal(start.x, known.x)
            assert (
                (start.working_set == FREE) == (qp.lower < known.x) & (known.x < qp.upper)
            ).all()
        else:
            assert start is None


def test_shuffled_visits_all_once_and_starts_from_the_last_visited() -> None:
    qps = stretch([0.1 * i for i in range(12)])
    order = order_of("shuffled", 12)
    assert sorted(order) == list(range(12)) and order != list(range(12))
    given = walk("shuffled", qps, told(qps, numbered(qps)))
    assert given[order[0]] is None
    for before, now in pairwise(order):
        assert given[now].x[0] == before


def test_outcomes_of_a_shuffled_pass_are_in_the_order_of_the_qps() -> None:
    qps = [qp for qp in scene_run("fig4").qps if qp.kind == "step"][:40]
    solver = make_solver("velocity")
    cold, _ = run_pass(solver, qps, arm="cold")
    shuffled, times = run_pass(solver, qps, arm="shuffled")
    assert np.isfinite(times[:, :-1]).all() and len(shuffled) == len(qps)
    for qp, one, other in zip(qps, cold, shuffled, strict=True):
        np.testing.assert_allclose(qp.A @ one.x, qp.A @ other.x, atol=1e-9 * np.abs(qp.d).max())


@pytest.mark.parametrize("solver", ["glambda", "velocity", "daqp", "osqp", "proxqp", "scs"])
def test_every_start_leads_to_the_same_answer_and_a_better_one_to_less_work(solver: str) -> None:
    rows = replay(
        short_recording("fig4", 40), [solver], ["high"], EVERY_ARM, repeats=1, time_limit=60.0
    )
    assert (rows["verdict"] == "verified").all()
    assert set(rows["arm"]) == set(EVERY_ARM)
    served = rows[rows["warm_started"] & (rows["k"] > 0) & ~rows["after_restart"]]
    shared = set.intersection(
        *(set(served.loc[served["arm"] == arm, "problem"]) for arm in ("exact", "warm"))
    )
    rows = rows[rows["problem"].isin(shared)]
    work = rows.groupby("arm")["iterations"].sum()
    assert len(shared) > 20
    assert work["exact"] < work["cold"]
    if solver in ("glambda", "velocity"):  # how a package counts is its own affair
        assert work["exact"] <= work["bare"] <= work["corrupted"]
        assert work["warm"] <= work["corrupted"]


def test_who_has_which_arms() -> None:
    assert all(has_arm(solver_class("glambda"), arm) for arm in EVERY_ARM)
    assert [arm for arm in EVERY_ARM if has_arm(solver_class("clarabel"), arm)] == [
        *("cold", "warm", "shuffled")
    ]
    assert [arm for arm in EVERY_ARM if has_arm(solver_class("quadprog"), arm)] == ["cold"]
    with pytest.raises(ValueError, match="arm 'tepid' is unknown; choose from cold, kept, warm"):
        has_arm(solver_class("glambda"), "tepid")


@pytest.mark.parametrize("arm", ["shuffled", "stale5", "exact"])
def test_a_row_of_any_arm_can_be_had_again(arm: str) -> None:
    made = fake_recording(length=12)
    rows = replay(made, ["glambda"], ["1e-4"], [arm], repeats=1).set_index("step")
    row = reproduce(made, "glambda", "1e-4", arm, 8)
    for name in ("verdict", "glambda_error", "asked", "warm_started", "descent_directions"):
        assert row[name] == rows.loc[8, name]


@pytest.mark.parametrize(
    ("given", "stored"),
    [("1e-6", "1e-6"), ("1E-06", "1e-6"), ("0.00025", "2.5e-4"), (".5", "5e-1"), ("high", "high")],
)
def test_numbers_are_settings_and_have_one_spelling(given: str, stored: str) -> None:
    assert setting_name(given) == stored
    facts = facts_of(random_qp("full_rank", 0)[0])
    if given != "high":
        assert facts.asked(given) == pytest.approx(float(given) * facts.scale)


@pytest.mark.parametrize("given", ["loose", "0", "1", "-1e-3", "nan", "inf", ""])
def test_other_settings_are_refused(given: str) -> None:
    with pytest.raises(ValueError, match="is unknown; choose from paper, high, default, or give"):
        setting_name(given)


@pytest.mark.parametrize("solver", ["glambda", "daqp", "osqp", "proxqp", "scs"])
def test_an_adopted_memory_starts_as_if_there_were_none(solver: str) -> None:
    """What counts is x and the working set that are handed over, not those of the memory."""
    chosen = make_solver(solver, accuracy=1e-9)
    qp, _ = random_qp("two_sided", 4)
    other = replace(qp, d=-2.0 * qp.d)
    right, last = chosen.solve(qp), chosen.solve(other)
    bare = chosen.solve(qp, replace(right, memory=None))
    adopted = chosen.solve(qp, replace(right, memory=chosen.adopt(last.memory, right)))
    assert adopted.found and bare.found
    if solver == "glambda":
        assert adopted.work == bare.work
        np.testing.assert_array_equal(adopted.x, bare.x)
    else:
        np.testing.assert_allclose(qp.A @ adopted.x, qp.A @ bare.x, atol=1e-8)
        stale = chosen.solve(qp, chosen.solve(other))  # a memory goes on with what it solved last
        assert adopted.iterations <= stale.iterations


def test_an_adopted_memory_is_not_extrapolated_from() -> None:
    """The times and the x before last that it knows are of other QPs than the start."""
    chosen = make_solver("lotstedt[extrapolated]", accuracy=1e-9)
    qp = replace(random_qp("two_sided", 4)[0], t=0.3)
    right = chosen.solve(qp)
    last = None
    for t, times in ((0.1, -0.5), (0.2, -2.0)):
        last = chosen.solve(replace(qp, d=times * qp.d, t=t), last)
    assert last is not None
    bare = chosen.solve(qp, replace(right, memory=None))
    adopted = chosen.solve(qp, replace(right, memory=chosen.adopt(last.memory, right)))
    assert adopted.work == bare.work
    np.testing.assert_array_equal(adopted.x, bare.x)
