"""Open-loop replay: the protocol of arms and settings, failures as rows, and resuming."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness import replay
from harness.machine.unrest import Reading
from harness.passes.clocks import Asking
from harness.passes.limits import Pass, Task
from harness.passes.measure import PATIENCE, others, run_pass
from harness.processes import introduction
from harness.processes import isolate as isolate_module
from harness.processes.isolate import Block, here
from harness.recordings.recording import write_recording
from harness.results.store import COLUMNS, StoreError, read_passes, read_repeats, read_results
from harness.study.replay import reproduce
from solvers import registry
from tests.fakes.crooked import CROOKED, Right, Slow
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.random_qps import random_qp


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solvers of `tests.fakes.crooked`, by name, beside the real ones."""
    introduction.forget()
    monkeypatch.setattr(registry, "_REGISTERED", dict(CROOKED))
    Right.starts.clear()


@pytest.fixture(params=[True, False], ids=["isolated", "in our process"])
def isolate(request: pytest.FixtureRequest) -> bool:
    """Both ways of running."""
    return bool(request.param)


def test_rows_have_the_columns_of_the_store_and_are_judged() -> None:
    made = fake_recording()
    rows = replay(made, ["right", "liar"], ["paper"], ["cold"], repeats=2)
    assert list(rows.columns) == list(COLUMNS)
    assert len(rows) == 2 * len(made.qps)
    right, liar = (rows[rows["solver"] == name] for name in ("right", "liar"))
    assert (right["verdict"] == "verified").all()
    assert right["glambda_error"].dropna().max() < 1e-12
    # QP 4 has no reference: judged by the bound.
    assert np.isnan(right.loc[right["step"] == 4, "glambda_error"]).all()
    assert (right["error_bound"] >= 0).all()
    unmoved = liar["k"] == 0
    assert (liar.loc[~unmoved & (liar["step"] != 4), "verdict"] == "claimed_wrong").all()
    assert (liar.loc[liar["step"] == 4, "verdict"] == "undecided").all()  # a bound proves nothing
    assert (right["repeats"] == 2).all() and (right["iterations"] == 3).all()
    assert (right["runtime"] > 0).all() and (right["call_time"] >= right["runtime"]).all()
    assert (right["runtime_median"] >= right["runtime"]).all()


def test_settings_ask_for_their_accuracy(isolate: bool) -> None:
    made, settings = fake_recording(), ["paper", "high", "default"]
    rows = replay(made, ["right"], settings, ["cold"], repeats=1, isolate=isolate)
    paper, high, default = (rows[rows["settings"] == s] for s in ("paper", "high", "default"))
    assert (paper["asked"] == 1e-6).all()
    np.testing.assert_allclose(high["asked"], 1e-9 * high["scale"])
    np.testing.assert_allclose(default["asked"], 1e-6 * default["scale"])
    # What the solver itself was asked: its defaults are its own affair.
    assert paper["status_text"].tolist() == ["1e-06"] * len(made.qps)
    assert high["status_text"].map(float).tolist() == high["asked"].tolist()
    assert default["status_text"].tolist() == ["None"] * len(made.qps)


def test_warm_starts_follow_the_protocol() -> None:
    made = fake_recording(length=6)
    run_pass(Right(), made.qps, arm="warm")
    given = [start is not None for _, start in Right.starts]
    # First of the sequence, and the restart at QP 3; QPs 6 and on are impulses.
    assert given == [False, True, True, False, True, True] + [False] * 5
    assert all(s is None or s.memory == "kept" for _, s in Right.starts)
    for (qp, start), (before, _) in zip(Right.starts[1:6], Right.starts[:5], strict=True):
        assert start is None or (start.row_id == before.row_id).all() or qp.restart


def test_an_impulse_does_not_break_the_chain() -> None:
    made = fake_recording(length=6)
    qps = [made.qps[0], replace(made.qps[1], kind="impulse"), made.qps[2]]
    run_pass(Right(), qps, arm="warm")
    (_, _), (_, second), (_, third) = Right.starts
    assert second is None and third is not None
    assert (third.row_id == qps[0].row_id).all()


def test_cold_arms_get_no_start_and_rows_tell_the_restarts() -> None:
    rows = replay(fake_recording(length=6), ["right"], repeats=1)
    cold, warm = (rows[rows["arm"] == arm].set_index("step") for arm in ("cold", "warm"))
    assert not cold["warm_started"].any()
    assert warm.index[warm["warm_started"]].tolist() == [1, 2, 4, 5]
    assert warm.index[warm["after_restart"]].tolist() == [0, 3]
    assert cold["after_restart"].tolist() == warm["after_restart"].tolist()


def test_a_solver_without_warm_start_has_no_warm_arm() -> None:
    rows = replay(fake_recording(), ["choosy"], repeats=1)
    assert set(rows["arm"]) == {"cold"}


def test_whoever_writes_into_a_qp_harms_nobody_else() -> None:
    made = fake_recording()
    before = [qp.d.copy() for qp in made.qps]
    rows = replay(made, ["scribbler", "right"], ["paper", "high"], ["cold"])
    for qp, d in zip(made.qps, before, strict=True):
        np.testing.assert_array_equal(qp.d, d)
        assert not qp.d.flags.writeable
    assert (rows.loc[rows["solver"] == "right", "verdict"] == "verified").all()
    wrote = rows[(rows["solver"] == "scribbler") & rows["step"].isin([1, 2])]
    assert len(wrote) == 4
    assert (wrote["verdict"] == "failed").all()
    assert wrote["status_text"].str.contains("wrote into the QP").all()


def test_no_solution_and_an_exit_are_rows() -> None:
    rows = replay(fake_recording(), ["empty"], ["paper"], ["cold"], repeats=1)
    assert rows.loc[1, ["verdict", "status_text"]].tolist() == ["crashed", "SystemExit: 3"]
    assert (rows.drop(index=1)["verdict"] == "failed").all()
    assert rows.loc[0, "status_text"] == "TypeError: the solver returned no Solution with a Status"


def test_skips_and_exceptions_are_rows() -> None:
    rows = replay(fake_recording(length=6), ["choosy"], repeats=2).set_index("step")
    assert (rows.loc[6:, "verdict"] == "skipped").all()
    assert set(rows.loc[6:, "status_text"]) == {"no impulses"}
    assert rows.loc[6:, "runtime"].isna().all() and rows.loc[6:, "error_bound"].isna().all()
    assert rows.loc[1, "verdict"] == "failed"
    assert rows.loc[1, "status_text"] == "RuntimeError: native failure"
    assert rows.loc[1, "runtime"] > 0  # the whole call
    assert (rows.loc[[0, 2, 3, 4, 5], "verdict"] == "verified").all()


def test_no_answer_and_nan_are_failures() -> None:
    rows = replay(fake_recording(), ["silent"], ["paper"], ["cold"], repeats=1)
    assert (rows.loc[rows["k"] > 0, "verdict"] == "failed").all()


def test_late_answers_are_timeouts_and_patience_ends() -> None:
    made = fake_recording(length=PATIENCE + 4)
    outcomes, times = run_pass(Slow(), made.qps, arm="cold", time_limit=0.001)
    assert [o.verdict for o in outcomes] == ["timeout"] * len(made.qps)
    assert np.isfinite(times[:PATIENCE, :4]).all() and np.isnan(times[PATIENCE:]).all()
    assert outcomes[PATIENCE - 1].x is not None and outcomes[PATIENCE].x is None
    assert "not tried" in outcomes[PATIENCE].status_text


def test_slow_passes_are_not_repeated() -> None:
    for slow_pass, repeats in ((0.15, 1), (60.0, 2)):  # it sleeps for 0.22 s
        rows = replay(fake_recording(), ["slow"], arms=["cold"], repeats=2, slow_pass=slow_pass)
        assert (rows["repeats"] == repeats).all()


def test_garbage_collection_is_off_in_a_pass_and_on_after(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(Right, "run", lambda self, native: seen.append(gc.isenabled()))
    run_pass(Right(), fake_recording().qps, arm="cold")
    assert not any(seen) and gc.isenabled()


def test_passes_go_round_the_solvers(isolate: bool) -> None:
    told: list[str] = []

    def tell(what: str, done: float, total: float) -> None:
        if what not in told[-1:]:
            told.append(what)

    solvers = ["right", "liar"]
    replay(fake_recording(), solvers, arms=["cold"], repeats=2, isolate=isolate, progress=tell)
    assert [name.split("__")[1] for name in told] == [*solvers, *solvers]


@pytest.mark.parametrize("kind", ["two_sided", "sparse_columns", "empty"])
def test_what_one_warms_up_on_is_alike_and_another(kind: str) -> None:
    qp, _ = random_qp(kind, 1)
    (other,) = others([qp])
    assert other.A.shape == qp.A.shape and type(other.A) is type(qp.A)
    np.testing.assert_array_equal(other.dense_A != 0, qp.dense_A != 0)
    assert other.t != qp.t and (other.k == 0 or not np.array_equal(other.dense_A, qp.dense_A))
    assert sorted(np.abs(other.d)) == sorted(np.abs(qp.d))
    for name in ("lower", "upper", "row_id", "kind", "eps0"):
        np.testing.assert_array_equal(getattr(other, name), getattr(qp, name))


def test_nobody_is_warmed_up_on_what_counts() -> None:
    made = fake_recording()
    here(Task("right", (), "cold"), made.qps)
    warmed = {qp.t for qp, _ in Right.starts}
    assert warmed and not warmed & {qp.t for qp in made.qps}


def test_a_row_is_that_of_its_worst_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Garbage from the second pass on, in no time."""
    made, passes = fake_recording(), []

    def do_pass(self: Block, task: Task, advance: Any = None) -> Pass:
        done = Block._take(self, task, lambda count: None, again=False)
        if task.solver != "right":
            return done
        passes.append(done)
        bad = [replace(o, x=None if o.x is None else 0 * o.x) for o in done.outcomes]
        return done if len(passes) == 1 else done._replace(outcomes=bad)

    monkeypatch.setattr(Block, "do_pass", do_pass)
    rows = replay(made, ["right"], arms=["cold"], repeats=2, isolate=False)
    moved = rows["k"] > 0
    assert len(passes) == 2
    assert rows.loc[moved, "verdict"].isin(["claimed_wrong", "undecided"]).sum() > 5


def test_repeats_are_all_kept(tmp_path: Path) -> None:
    made = fake_recording()
    replay(made, ["right"], ["paper"], ["cold"], results=tmp_path, repeats=3)
    repeats = read_repeats(tmp_path)
    assert len(repeats) == 3 * len(made.qps)
    assert sorted(repeats["repeat"].unique()) == [0, 1, 2]
    rows = read_results(tmp_path).set_index("problem")
    parts = ("setup_time", "solve_time", "charged_time")
    total = repeats.assign(total=sum(repeats[part] for part in parts))
    total["total"] = total["total"].fillna(repeats["call_time"])
    least = total.groupby("problem")["total"].min()
    np.testing.assert_allclose(rows["runtime"], least[rows.index])


def test_a_finished_study_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = fake_recording()
    first = replay(made, ["right"], results=tmp_path, repeats=1)
    monkeypatch.setattr(Block, "_take", None)
    again = replay(made, ["right"], results=tmp_path, repeats=1)
    assert first.equals(again)


def test_of_a_solver_that_changed_rows_are_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, asked = fake_recording(), ["right", "liar"]
    replay(made, asked, results=tmp_path, repeats=1)
    passes: list[str] = []
    do_pass = Block.do_pass

    def seen(self: Block, task: Any, *rest: Any) -> Any:
        passes.append(task.solver)
        return do_pass(self, task, *rest)

    monkeypatch.setattr(Block, "do_pass", seen)
    rows = replay(made, asked, results=tmp_path, repeats=1, again=["liar"])
    assert set(passes) - {"nobody"} == {"liar"} and set(rows["solver"]) == set(asked)
    with pytest.raises(ValueError, match="again: osqp is not among"):
        replay(made, asked, results=tmp_path, repeats=1, again=["osqp"])


def test_an_interrupted_study_continues(tmp_path: Path, isolate: bool) -> None:
    made = fake_recording()

    def interrupt(what: str, done: float, total: float) -> None:
        raise KeyboardInterrupt  # Ctrl-C, once the first pass is stored

    arguments: Any = (made, ["right", "liar"], ["paper"], ["cold"])
    options: Any = {"results": tmp_path, "repeats": 2, "isolate": isolate}
    with pytest.raises(KeyboardInterrupt):
        replay(*arguments, **options, progress=interrupt)
    assert gc.isenabled()
    kept = read_results(tmp_path)
    assert set(kept["solver"]) == {"right"} and (kept["repeats"] == 1).all()
    before = read_repeats(tmp_path)
    rows = replay(*arguments, **options)
    assert set(rows["solver"]) == {"right", "liar"} and (rows["repeats"] == 2).all()
    after = read_repeats(tmp_path)
    after = after[(after["solver"] == "right") & (after["repeat"] == 0)].reset_index(drop=True)
    assert after.equals(before)


def test_other_qps_refuse_to_mix(tmp_path: Path) -> None:
    made = fake_recording()
    replay(made, ["right"], results=tmp_path, repeats=1)
    with pytest.raises(StoreError, match="recording_digest"):
        replay(replace(made, eps=5e-3), ["right"], results=tmp_path, repeats=1)


def test_another_limit_is_refused_before_anything_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = fake_recording()
    first = replay(made, ["right"], results=tmp_path, repeats=1)
    monkeypatch.setattr(Block, "_take", None)
    with pytest.raises(StoreError, match="to be made with time_limit 5"):
        replay(made, ["liar"], results=tmp_path, repeats=1, time_limit=5.0)
    assert first.equals(read_results(tmp_path))


def test_recordings_may_be_paths(tmp_path: Path) -> None:
    write_recording(tmp_path / "fake.h5", fake_recording())
    rows = replay(tmp_path / "fake.h5", ["right"], arms=["cold"], repeats=1)
    assert (rows["scene"] == "fake").all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": ["loose"]}, "setting 'loose' is unknown"),
        ({"arms": ["tepid"]}, "arm 'tepid' is unknown"),
        ({"repeats": 0}, "at least one pass"),
        ({"time_limit": float("nan")}, "time_limit = nan"),
        ({"time_limit": 0.0}, "time_limit = 0.0"),
        ({"solvers": ["nobody"]}, "unknown solver 'nobody'"),
    ],
)
def test_wrong_arguments(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replay(fake_recording(), **{"solvers": ["right"], **options})


def test_reproduce_gives_the_row_again() -> None:
    made = fake_recording()
    rows = replay(made, ["liar"], ["high"], ["warm"], repeats=1).set_index("step")
    row = reproduce(made, "liar", "high", "warm", 5)
    for name in ("problem", "verdict", "glambda_error", "error_bound", "asked", "warm_started"):
        assert row[name] == rows.loc[5, name]
    with pytest.raises(ValueError, match="has the QPs 0 to"):
        reproduce(made, "liar", "high", "warm", 99)


def test_every_pass_says_what_pace_the_machine_had(tmp_path: Path) -> None:
    replay(fake_recording(), ["glambda", "daqp"], results=tmp_path, repeats=2)
    pace = read_repeats(tmp_path).groupby(["solver", "arm", "repeat"])["pace"]
    assert (pace.nunique() == 1).all() and (pace.first() > 0).all()
    assert pace.first().nunique() > 1  # measured anew each time


def readings(pressures: list[float], then: float) -> object:
    """Stands for `read`: each pass, of two readings a second apart, has the next pressure."""
    left, taken = iter(pressures), list[Reading]()

    def next_reading(pid: int) -> Reading:
        assert pid > 0
        if len(taken) % 2:
            time, pressure, *others = taken[-1]
            taken.append(Reading(time + 1.0, pressure + next(left, then), *others))
        else:
            taken.append(Reading(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        return taken[-1]

    return next_reading


@pytest.mark.parametrize(
    ("pressures", "then", "passes", "repeats", "quiet"),
    [
        ([0.0, 0.5, 0.0], 0.0, 3, 2, True),
        ([0.5, 0.0, 0.5], 0.5, 4, 1, True),
        ([], 0.5, 4, 4, False),  # it will not become quiet
    ],
)
def test_another_pass_is_taken_for_a_disturbed_one(
    pressures: list[float],
    then: float,
    passes: int,
    repeats: int,
    quiet: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(isolate_module, "read", readings(pressures, then))
    monkeypatch.setattr(Block, "asking", lambda self, arm, again: Asking.nothing(len(self._posed)))
    options: Any = {"arms": ["cold"], "repeats": 2, "results": tmp_path}
    rows = replay(fake_recording(), ["right"], **options)
    assert (rows["repeats"] == repeats).all() and (rows["quiet"] == quiet).all()
    told = read_passes(tmp_path)
    assert len(told) == passes and told["pressure"].tolist() == [*pressures, *[then] * 9][:passes]
    assert (told["disturbed_by"] == "pressure").sum() == passes - (repeats if quiet else 0)
    again = replay(fake_recording(), ["right"], **options)  # nothing is left to do
    assert len(read_passes(tmp_path)) == passes and len(again) == len(rows)
