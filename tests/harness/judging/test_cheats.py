"""Every way to cheat that we know of, and what the judge says of it.

The cheats are tried on all QPs of a recorded scene whose A x* is proved, at two accuracies, with
and without the proof at hand.  None of them is verified but where it happens to be right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from harness import judge, replay
from harness.judging.error_bound import error_bound
from harness.judging.facts import facts_of
from harness.judging.judge import VERIFIED_WITHIN
from harness.judging.oracle import reference
from harness.passes.limits import TIME_LIMIT
from harness.processes.introduction import forget
from harness.recordings.recording import Reference
from problems.qp import ContactQP, Vector, positions_of
from reports.rows.comparison import compare
from reports.rows.results import prepare
from solvers import registry
from solvers.active_set.glambda import Glambda
from solvers.base import Unsupported
from tests.fakes.crooked import Right
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.runs import scene_recording

INF = np.inf


def solved(qp: ContactQP) -> Vector:
    return np.asarray(Glambda(1e-14).solve(qp).x)


def least_residual(qp: ContactQP, x: Vector) -> Vector:
    """The tiniest residual there is, with no gradient at all, by forces of the wrong sign."""
    return np.linalg.lstsq(qp.dense_A, -qp.d, rcond=None)[0]


def regularised(qp: ContactQP, x: Vector) -> Vector:
    """An easier problem: strictly convex by 1e-4 on the diagonal."""
    A = np.vstack([qp.dense_A, 1e-2 * np.eye(qp.k)])
    d = np.append(qp.d, np.zeros(qp.k))
    return solved(ContactQP(A, d, qp.lower, qp.upper))


def without_bounds_of_friction(qp: ContactQP, x: Vector) -> Vector:
    """An easier problem: nothing ever slips."""
    both = np.isfinite(qp.upper)
    return solved(
        replace(qp, lower=np.where(both, -INF, qp.lower), upper=np.full(qp.k, INF), D=None)
    )


def without_the_last_row(qp: ContactQP, x: Vector) -> Vector:
    """An easier problem: one contact less."""
    A, d, lower, upper = qp.dense_A, qp.d, qp.lower, qp.upper
    return np.append(solved(ContactQP(A[:, :-1], d, lower[:-1], upper[:-1])), 0.0)


def in_single_precision(qp: ContactQP, x: Vector) -> Vector:
    """An easier problem: data of 24 bits."""
    short = [np.float32(part).astype(float) for part in (qp.dense_A, qp.d, qp.lower, qp.upper)]
    return solved(ContactQP(*short))


CHEATS: dict[str, Callable[[ContactQP, Vector], Any]] = {
    cheat.__name__: cheat
    for cheat in (
        least_residual, regularised, without_bounds_of_friction, without_the_last_row,
        in_single_precision,
    )
} | {
    "signs_turned": lambda qp, x: -x,
    "nothing": lambda qp, x: np.zeros(qp.k),
    "a_bound": lambda qp, x: np.nan_to_num(
        np.where(np.isfinite(qp.upper), qp.upper, qp.lower), neginf=0.0
    ),
    "everything": lambda qp, x: np.full(qp.k, 1e300),
    "a_little_off": lambda qp, x: x + 1e-4,
    "rounded": lambda qp, x: np.round(x, 3),
}  # fmt: skip


def distance(qp: ContactQP, x: Vector, known: Reference) -> float:
    """How wrong x is: in A x, and in bounds violated as forces.  By this file's own reckoning."""
    A = qp.dense_A.astype(np.longdouble)
    beyond = np.maximum(np.maximum(qp.lower - x, x - qp.upper), 0.0)
    lengths = np.sqrt((A * A).sum(axis=0))
    return float(max(np.linalg.norm(A @ x - known.Ax), (beyond * lengths).max(initial=0.0)))


@pytest.mark.parametrize("name", sorted(CHEATS))
@pytest.mark.parametrize("setting", ["paper", "high"])
def test_a_cheat_is_verified_only_where_it_is_right(name: str, setting: str) -> None:
    recording, caught = scene_recording("fig5"), 0
    for qp, known in zip(recording.qps[::3], recording.references[::3], strict=True):
        if qp.k == 0:
            continue
        x = np.asarray(CHEATS[name](qp, known.x))
        facts = facts_of(qp)
        asked = facts.asked(setting)
        off = distance(qp, x, known)
        proved = judge(qp, x, asked=asked, reference=known, facts=facts)
        bounded = judge(qp, x, asked=asked, facts=facts, seek_reference=False)
        error = np.linalg.norm(facts.A @ x - known.Ax)
        assert error_bound(qp, x, facts) >= error * (1 - 1e-15) - known.error_bound
        for verdict in (proved, bounded):
            assert verdict.error >= off * (1 - 1e-9) - known.error_bound
            assert (verdict.verdict == "verified") <= (off <= VERIFIED_WITHIN * asked * (1 + 1e-9))
        caught += proved.verdict != "verified"
    assert caught


def test_the_answer_of_the_qp_before_is_caught_by_its_error() -> None:
    recording, moved = scene_recording("fig4"), 0
    before = None
    for qp, solution, known in zip(
        recording.qps[:150], recording.solutions, recording.references, strict=False
    ):
        if before is not None and qp.k and known is not None:
            place = positions_of(qp.row_id, before.row_id)
            old = np.where(place >= 0, np.append(before.x, 0.0)[place], 0.0)
            facts = facts_of(qp)
            asked = facts.asked("high")
            verdict = judge(qp, old, asked=asked, reference=known, facts=facts)
            off = distance(qp, old, known)
            assert (verdict.verdict == "verified") == (off <= VERIFIED_WITHIN * asked)
            moved += off > VERIFIED_WITHIN * asked
        before = solution
    assert moved > 100


@pytest.mark.parametrize("word", [True, False])
@pytest.mark.parametrize("value", [np.nan, INF, -INF, 1e308, -1e308])
def test_what_is_not_finite_or_overflows_is_no_answer(value: float, word: bool) -> None:
    qp = ContactQP(np.eye(2) * 1e3, [-2.0, -1.0], np.zeros(2), np.full(2, INF))
    verdict = judge(qp, [2e-3, value], found=word)
    assert verdict.verdict == ("claimed_wrong" if word and np.isfinite(value) else "failed")
    assert verdict.error > 1e300


def test_a_tiny_residual_does_not_make_up_for_a_wrong_sign() -> None:
    """r = 0 and Δ = 0, by pulling: stationary, complementary, and wrong."""
    qp = ContactQP([[1.0]], [2.0], [0.0], [INF], eps0=1e-6)
    verdict = judge(qp, [-2.0])
    assert verdict.dual_residual == 0.0 and verdict.verdict == "claimed_wrong"
    assert verdict.primal_residual == pytest.approx(2.0) and verdict.error == pytest.approx(2.0)


def test_right_forces_by_pulling_are_not_right() -> None:
    """Two rows do the same: (−5, 7) has the A x of (1, 1), and holds the bodies together."""
    qp = ContactQP([[1.0, 1.0]], [-2.0], np.zeros(2), np.full(2, INF), eps0=1e-3)
    verdict = judge(qp, [-5.0, 7.0])
    assert verdict.glambda_error == 0.0
    assert verdict.verdict == "claimed_wrong" and verdict.error == pytest.approx(5.0)
    assert verdict.error_bound >= 5.0 * (1 - 1e-15)


def test_a_tiny_violation_may_not_hide_a_large_force() -> None:
    """1e-9 beyond the bound of a row whose column is 1e9 long is a force of 1."""
    qp = ContactQP(np.diag([1e9, 1.0]), [1.0, -1.0], np.zeros(2), np.full(2, INF), eps0=1e-6)
    verdict = judge(qp, [-1e-9, 1.0])
    assert verdict.primal_residual == 1e-9
    assert verdict.verdict == "claimed_wrong" and verdict.error == pytest.approx(1.0)


def test_x_is_judged_and_not_what_becomes_of_it_when_clipped() -> None:
    qp = ContactQP(np.eye(2), [1.0, -1.0], np.zeros(2), np.full(2, INF), eps0=1e-6)
    assert judge(qp, [0.0, 1.0]).verdict == "verified"
    assert judge(qp, [-0.1, 1.0]).verdict == "claimed_wrong"
    assert judge(qp, [-0.1, 1.0], seek_reference=False).verdict == "claimed_wrong"


def test_forces_along_the_null_space_may_not_swallow_A_x() -> None:
    """(t, t) does nothing in exact arithmetic; with t = 1e13 whoever computes A x may get noise.

    So it is not verified; nor is it wrong, since its A x is not.
    """
    A = np.array([[0.1, -0.1, 1.0], [0.7, -0.7, 0.0]])
    qp = ContactQP(A, [-2.0, 0.0], np.zeros(3), np.full(3, INF), eps0=1e-6)
    assert judge(qp, [3.0, 3.0, 2.0]).verdict == "verified"
    lost = judge(qp, [1e13, 1e13, 2.0])
    assert lost.glambda_error < 1e-12
    assert lost.verdict == "inaccurate" and lost.error > 1e-3


def test_the_accuracy_asked_is_not_the_solvers_to_choose() -> None:
    qp = ContactQP([[1.0]], [-2.0], [0.0], [INF], eps0=1e-6)
    eased = qp.with_accuracy(1.0)
    x = [2.1]
    assert judge(eased, x, asked=qp.eps0, reference=reference(qp)).verdict == "claimed_wrong"


def test_no_word_of_the_solver_makes_an_answer_better() -> None:
    recording = scene_recording("fig5")
    for qp, known in zip(recording.qps[:20], recording.references, strict=False):
        for x in (known.x, known.x + 1e-5, known.x + 1.0):
            honest = judge(qp, x, reference=known, found=False)
            boasting = judge(qp, x, reference=known, found=True)
            assert honest.error == boasting.error
            ranks = ["verified", "inaccurate", "failed", "claimed_wrong"]
            assert ranks.index(boasting.verdict) >= ranks.index(honest.verdict)


# --- through the replay and the comparison -------------------------------------------------------


@dataclass(frozen=True)
class Eraser(Right):
    """Makes the data fit its answer, 0, past the read-only flag, and the next QP's as well."""

    warm_start: ClassVar[str] = "none"

    def answer(self, qp: ContactQP) -> Any:
        qp.d.setflags(write=True)
        qp.d[:] = 0.0
        return np.zeros(qp.k)


@dataclass(frozen=True)
class Rebinder(Right):
    """Puts other data into the QP in place of those that it was given."""

    warm_start: ClassVar[str] = "none"

    def answer(self, qp: ContactQP) -> Any:
        object.__setattr__(qp, "d", np.zeros(qp.m))
        object.__setattr__(qp, "eps0", 1e9)
        return np.zeros(qp.k)


@dataclass(frozen=True)
class Returner(Right):
    """Returns the answer of the QP before while it fits."""

    last: ClassVar[list[Vector]] = []

    def answer(self, qp: ContactQP) -> Any:
        x = super().answer(qp)
        old = self.last[-1] if self.last else x
        self.last.append(x)
        return old if old.shape == x.shape else x


@dataclass(frozen=True)
class Picker(Right):
    """Solves only what is easy: every third QP is not supported."""

    warm_start: ClassVar[str] = "none"

    def build(self, qp: ContactQP, start: Any) -> Any:
        if round(qp.t / 0.01) % 3 == 2:
            raise Unsupported("too hard")
        return qp


@pytest.fixture
def cheats(monkeypatch: pytest.MonkeyPatch) -> None:
    forget()
    known = (Right, Eraser, Rebinder, Returner, Picker)
    found = {cls.__name__.lower(): f"{cls.__module__}:{cls.__name__}" for cls in known}
    monkeypatch.setattr(registry, "_REGISTERED", found)


@pytest.mark.usefixtures("cheats")
def test_cheats_in_the_replay_are_not_verified_and_harm_nobody() -> None:
    names = ["eraser", "rebinder", "returner", "picker", "right"]
    rows = replay(fake_recording(), names, ["paper"], ["cold"], repeats=1, isolate=False)
    verdicts = rows[rows["k"] > 0].groupby("solver")["verdict"].agg(set)
    assert verdicts["right"] == {"verified"}
    assert verdicts["eraser"] == {"failed"}
    assert "verified" not in verdicts["rebinder"]  # of what it was handed, which was a copy
    assert "claimed_wrong" in verdicts["returner"]
    assert verdicts["picker"] == {"verified", "skipped"}


@pytest.mark.usefixtures("cheats")
def test_cheats_gain_nothing_in_the_comparison() -> None:
    names = ["rebinder", "picker", "right"]
    rows = replay(fake_recording(), names, ["paper"], ["cold"], repeats=1, isolate=False)
    comparison = compare(prepare(rows), "fake", "paper", "cold")
    # who answers only some is not compared, and takes no QP out of the comparison
    assert [entry.solver for entry in comparison.left_out] == ["picker"]
    assert comparison.common == comparison.qps
    rows = comparison.rows
    assert (rows.loc[rows["solver"] == "rebinder", "charged"] == TIME_LIMIT).all()
    summary = comparison.summary()
    assert summary.index[summary["best"]].tolist() == ["right"]
