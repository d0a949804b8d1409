"""The judge, the bound that trusts nobody, and the oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from harness import judge
from harness.judging.error_bound import error_bound
from harness.judging.facts import facts_of
from harness.judging.judge import VERDICTS, kkt_residuals
from harness.judging.oracle import reference
from problems.qp import ContactQP
from tests.fakes.random_qps import KINDS, random_qp

INF = np.inf
SIZES = (1e-12, 1e-9, 1e-6, 1e-3, 1.0, 30.0)


def one_contact(d: float = -2.0) -> ContactQP:
    """min ½(x + d)², x ≥ 0: x* = −d."""
    return ContactQP([[1.0]], [d], [0.0], [INF], eps0=1e-6)


def wrong_answers(qp: ContactQP, x: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Answers that are off by every size, inside the bounds and outside."""
    answers = []
    size = max(1e-3, float(np.abs(x).max(initial=0.0)))
    for share in SIZES:
        noise = share * size * rng.standard_normal(qp.k)
        pushed = np.where(x <= qp.lower, x + np.abs(noise), x)  # as interior points end
        single = x.copy()
        if qp.k:
            single[rng.integers(qp.k)] += noise[0]
        answers += [x + noise, np.clip(x + noise, qp.lower, qp.upper), pushed, single]
    return answers


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_error_bound_is_never_below_the_error(kind: str) -> None:
    rng = np.random.default_rng(5)
    checked = 0
    for seed in range(10):
        qp, Ax = random_qp(kind, seed)
        facts = facts_of(qp)
        # The known A x* is right to the rounding of d, in which it was hidden.
        known_to = 1e-15 * (1 + np.linalg.norm(qp.d) + np.abs(qp.dense_A).sum())
        x = reference(qp, facts).x
        for answer in wrong_answers(qp, x, rng):
            error = np.linalg.norm(facts.A @ answer - Ax)
            bound = error_bound(qp, answer, facts)
            assert bound >= error - known_to
            checked += 1
    assert checked >= 240


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"empty", "all_fixed"}))
def test_error_bound_is_sharp(kind: str) -> None:
    """Within a factor of 10 of the error, down to 1e-10 of the scale."""
    rng = np.random.default_rng(6)
    for seed in range(5):
        qp, _ = random_qp(kind, seed)
        facts = facts_of(qp)
        exact = reference(qp, facts)
        for answer in wrong_answers(qp, exact.x, rng):
            error = np.linalg.norm(facts.A @ answer - exact.Ax)
            if error > 1e-10 * facts.scale:
                assert error_bound(qp, answer, facts) <= 10 * error


def test_error_bound_by_hand() -> None:
    qp = one_contact()
    assert error_bound(qp, np.array([2.0])) < 1e-15
    assert error_bound(qp, np.array([2.5])) == pytest.approx(0.5)
    # x = −1 is clipped to 0, from where v = −r proves 2; the way back is added.
    assert error_bound(qp, np.array([-1.0])) == pytest.approx(3.0)
    assert error_bound(qp, np.array([np.nan])) == INF


def test_error_bound_where_snapping_goes_to_the_wrong_side() -> None:
    """Rows snapped to a bound that they leave must join S, or √g makes 1e-5 of 1e-10."""
    rng = np.random.default_rng(6)
    for seed in range(3):
        qp, _ = random_qp("tower", seed)
        facts = facts_of(qp)
        exact = reference(qp, facts)
        answers = wrong_answers(qp, exact.x, rng)
    error = np.linalg.norm(facts.A @ answers[4] - exact.Ax)
    assert error_bound(qp, answers[4], facts) <= 3 * error


def test_error_bound_needs_no_reference_where_a_wrong_sign_is_unbounded() -> None:
    """v = 0 is not admissible: Δ < 0 where u = ∞."""
    qp = ContactQP(np.eye(2), [-1.0, 3.0], [0.0, 0.0], [INF, INF])
    assert error_bound(qp, np.zeros(2)) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_oracle_finds_the_known_answer(kind: str) -> None:
    for seed in range(8):
        qp, Ax = random_qp(kind, seed)
        facts = facts_of(qp)
        found = reference(qp, facts)
        assert found is not None
        rounding = 4e-15 * (facts.scale + np.linalg.norm(qp.d))
        assert np.linalg.norm(found.Ax - Ax) <= rounding
        assert found.error_bound <= 1e-12 * facts.scale
        assert ((found.x >= qp.lower) & (found.x <= qp.upper)).all()


def test_oracle_declines_what_it_can_neither_prove_nor_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An answer that is off, whatever the reason, is no reference."""
    import harness.judging.oracle as oracle

    right = oracle._active_set
    monkeypatch.setattr(oracle, "_active_set", lambda facts: right(facts) + 1e-8)
    assert oracle.reference(one_contact()).x == [2.0]  # the proof goes on from there
    monkeypatch.setattr(oracle, "prove", lambda qp, x: None)
    assert oracle.reference(one_contact()) is None


def test_oracle_is_independent_of_the_solvers() -> None:
    import ast
    from pathlib import Path

    import harness.judging.oracle as oracle

    for name in ("oracle", "proof", "error_bound", "facts", "span", "judge"):
        tree = ast.parse(Path(oracle.__file__).with_name(f"{name}.py").read_text())
        modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        assert not any(module.startswith("solvers") for module in modules)


def test_verdicts() -> None:
    qp = one_contact()
    asked = qp.eps0

    def verdict(error: float, found: bool = True) -> str:
        return judge(qp, [2.0 + error], found=found).verdict

    assert verdict(0.0) == "verified"
    assert verdict(9 * asked) == "verified"
    assert verdict(9 * asked, found=False) == "verified"  # never by the solver's word
    assert verdict(11 * asked) == "inaccurate"
    assert verdict(900 * asked) == "inaccurate"
    assert verdict(1100 * asked) == "claimed_wrong"
    assert verdict(1100 * asked, found=False) == "failed"
    assert judge(qp, None).verdict == "failed"
    assert judge(qp, [np.nan]).verdict == "failed"
    assert judge(qp, [np.inf]).verdict == "failed"
    assert set(VERDICTS) >= {"verified", "timeout", "crashed", "skipped"}


def test_judge_measures_the_error_in_A_x() -> None:
    qp = ContactQP([[1.0, 1.0]], [-2.0], [0.0, 0.0], [INF, INF], eps0=1e-3)
    even, odd = judge(qp, [1.0, 1.0]), judge(qp, [2.0, 0.0])
    assert even.verdict == odd.verdict == "verified"
    assert even.glambda_error < 1e-15 and odd.glambda_error < 1e-15
    off = judge(qp, [1.0, 1.5])
    assert off.error == pytest.approx(0.5)
    assert off.glambda_error == pytest.approx(0.25)  # scale = ‖A A⁺ d‖ = 2
    assert off.eps0_ratio == pytest.approx(500)
    assert off.objective_error == pytest.approx(0.25 / 4)


def test_judge_without_a_reference_goes_by_the_bound() -> None:
    verdict = judge(one_contact(), [2.5], seek_reference=False)
    assert np.isnan(verdict.glambda_error)
    assert verdict.error == verdict.error_bound == pytest.approx(0.5)


def test_nothing_is_called_wrong_without_a_proof() -> None:
    """A bound says that an answer is right, never that it is wrong; a violated bound does."""
    qp = one_contact()
    for found in (True, False):
        assert judge(qp, [2.5], seek_reference=False, found=found).verdict == "undecided"
    assert judge(qp, [2.0], seek_reference=False).verdict == "verified"
    assert judge(qp, [-1.0], seek_reference=False).verdict == "claimed_wrong"
    assert judge(qp, [-1.0], seek_reference=False, found=False).verdict == "failed"


def test_what_references_that_are_not_proved_decide() -> None:
    """Large errors show in the objective; an answer is not verified by one known to be off."""
    qp = one_contact()
    known = replace(reference(qp), proof="nearby")
    assert judge(qp, [2.0], reference=known).verdict == "verified"
    assert judge(qp, [2.5], reference=known).verdict == "claimed_wrong"
    off = replace(known, x=np.array([2.1]), Ax=np.array([2.1]), proof="ill-posed")
    assert judge(qp, [2.1], reference=off).verdict == "undecided"
    assert judge(qp, [2.0], reference=off).verdict == "verified"  # by its own bound


@pytest.mark.parametrize("k", [1, 60, 61, 300])
def test_columns_of_zeros_are_judged(k: int) -> None:
    A = np.zeros((3, k))
    A[0, 0] = 1.0
    qp = ContactQP(A, [1.0, 0.0, 0.0], np.zeros(k), np.full(k, INF), eps0=1e-6)
    x = np.ones(k)
    x[0] = 0.0
    for zeroed in (qp, replace(qp, A=np.zeros((3, k)))):
        assert judge(zeroed, x).verdict == "verified"
        assert judge(zeroed, x, seek_reference=False).verdict == "verified"


@pytest.mark.parametrize("power", [-20, -30, -36, -44, -50])
@pytest.mark.parametrize("k", [60, 61, 201])
def test_columns_that_are_nearly_parallel_are_not_taken_for_one(k: int, power: int) -> None:
    """x reaches d with large forces along two columns; x = 1 does not, by `short`."""
    gap, short = 2.0**power, 2.0**-10
    A = np.eye(k)
    A[0, -1], A[-1, -1] = 1.0, gap
    right = np.ones(k)
    right[0], right[-1] = 1 - short / gap, short / gap
    wrong = np.ones(k)
    wrong[-1] = 0.0
    qp = ContactQP(A, -(A @ right), np.full(k, -INF), np.full(k, INF), eps0=1e-6)
    assert not (A @ right + qp.d).any()
    for seek in (True, False):
        assert judge(qp, wrong, seek_reference=seek).verdict in ("inaccurate", "undecided")
        assert judge(qp, wrong, seek_reference=seek).error_bound >= short
        assert judge(qp, right, seek_reference=seek).verdict not in ("claimed_wrong", "failed")


@pytest.mark.parametrize("length", [1e-100, 1e-155, 1e-163, 1e-170, 1e-300])
def test_short_columns_count(length: float) -> None:
    """Their squares underflow."""
    qp = ContactQP(np.diag([1.0, length]), [-1.0, -1.0], [0.0, 0.0], [INF, INF], eps0=1e-6)
    facts = facts_of(qp)
    assert facts.norms.tolist() == pytest.approx([1.0, length])
    assert facts.scale == pytest.approx(np.sqrt(2.0))
    assert judge(qp, [1.0, 1 / length]).verdict == "verified"
    assert judge(qp, [1.0, 0.0]).verdict == "claimed_wrong"
    tiny = ContactQP([[1.0]], [-length], [0.0], [INF], eps0=1e-300)
    assert error_bound(tiny, np.array([2 * length])) >= length


def test_judge_refuses_a_wrong_shape() -> None:
    with pytest.raises(ValueError, match=r"x needs 1 entries; got \(2,\)"):
        judge(one_contact(), [1.0, 2.0])


def test_minimum_norm_is_compared_in_z() -> None:
    """The least-distance form: z = −r_head/r_last is unique, u is not compared."""
    E, e = np.array([[1.0], [2.0]]), np.array([1.0, 1.0])  # z ≥ 1, 2z ≥ 1: z = 1
    d = np.array([0.0, -1.0])
    qp = ContactQP(np.vstack([E.T, e]), d, np.zeros(2), np.full(2, INF), kind="minimum_norm")
    found = reference(qp)
    r = found.Ax + d
    assert -r[0] / r[1] == pytest.approx(1.0)
    assert judge(qp, found.x, reference=found).lambda_distance < 1e-14
    as_step = judge(replace(qp, kind="step"), found.x + 0.1, reference=found)
    assert as_step.lambda_distance == pytest.approx(0.1 * np.sqrt(2))


def test_kkt_residuals_by_hand() -> None:
    qp = ContactQP(np.eye(3), [-1.0, 1.0, 2.0], [0.0, -INF, 0.0], [INF, INF, 1.0])
    x = np.array([0.0, 0.0, 1.5])  # Δ = −1, 1, 3.5
    primal, dual, gap = kkt_residuals(qp, x)
    assert primal == pytest.approx(0.5)
    assert dual == pytest.approx(1.0)  # nothing carries −1 at an infinite upper bound
    assert gap == pytest.approx(3.5 * 1.5)
    assert kkt_residuals(ContactQP(np.zeros((2, 0)), [1.0, 1.0], [], []), np.zeros(0)) == (0, 0, 0)


def test_scale_and_rank() -> None:
    A = np.array([[1.0, 1.0], [0.0, 0.0]])
    facts = facts_of(ContactQP(A, [3.0, 4.0], [0, 0], [INF, INF]))
    assert facts.rank == 1
    assert facts.scale == pytest.approx(3.0)
    assert facts.asked("high") == pytest.approx(3e-9)
    assert facts.asked("default") == pytest.approx(3e-6)
    # Where contacts can change nothing, the scale is ‖d‖ itself.
    assert facts_of(ContactQP(A, [0.0, 4.0], [0, 0], [INF, INF])).scale == pytest.approx(4.0)
    assert facts_of(ContactQP(A, [0.0, 0.0], [0, 0], [INF, INF])).scale == 1.0
    with pytest.raises(ValueError, match="setting 'loose' is unknown"):
        facts.asked("loose")


def test_inputs_are_not_touched() -> None:
    qp, _ = random_qp("two_sided", 3)
    x = np.full(qp.k, 0.3)
    before = x.copy()
    judge(qp, x)
    assert (x == before).all()
