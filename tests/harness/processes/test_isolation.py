"""Processes of their own: whatever a backend does becomes a row, and the study goes on.

The crimes themselves, and what is to be found of each, are in `tests.fakes.crimes`.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

from harness import replay
from harness.passes.clocks import Asking, counted
from harness.passes.limits import hard_limit
from harness.passes.measure import MOST_LOST
from harness.passes.outcome import Outcome
from harness.passes.wire import (
    SETTLED,
    Question,
    answer_size,
    answered,
    outcome_of,
    packed,
    unpacked,
)
from harness.processes import isolate, process
from harness.processes.own_process import cause_of_death
from harness.processes.process import server
from harness.results.shard_file import BY_CLOCK
from harness.results.store import StoreError, read_spent
from problems.qp import WorkCounts
from solvers import registry
from tests.fakes.crimes import CRIMES, MEMORY_LIMIT, SCENE, targets
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.random_qps import random_qp

pytestmark = pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork")
SHORT = 2.0
"""Hard limit of those that do not come back [s]; the others have that of every study, which an
honest answer does not reach on a busy machine either."""


@pytest.fixture(scope="module", autouse=True)
def known() -> Iterator[None]:
    """The criminals, by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_REGISTERED", targets())
        yield


@pytest.fixture(scope="module")
def study() -> pd.DataFrame:
    """The rows of two studies in which every crime is committed, as they end by themselves or do
    not."""
    options: Any = {"arms": ["cold"], "repeats": 2, "memory_limit": MEMORY_LIMIT}
    endless = [name for name, crime in CRIMES.items() if crime.verdict == "timeout"]
    rows = replay(fake_recording(), [n for n in targets() if n not in endless], **options)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("harness.processes.isolate", "harness.study.replay"):
            patch.setattr(sys.modules[module], "hard_limit", lambda _: SHORT)
        patch.setattr(isolate, "FIRST_CALL", SHORT)
        others = replay(fake_recording(), endless, **options)
    return pd.concat([rows, others]).sort_values(["solver", "step"], ignore_index=True)


def rows_of(study: pd.DataFrame, name: str) -> pd.DataFrame:
    return study[study["solver"] == name]


@pytest.mark.parametrize("name", CRIMES)
def test_each_crime_has_its_verdict(study: pd.DataFrame, name: str) -> None:
    crime = CRIMES[name]
    row = crime.row(rows_of(study, name))
    assert row["verdict"] == crime.verdict
    assert re.search(crime.text, row["status_text"])
    assert row["status_text"].isprintable() and len(row["status_text"]) <= 500


@pytest.mark.parametrize("name", CRIMES)
def test_all_other_answers_are_kept(study: pd.DataFrame, name: str) -> None:
    rows = rows_of(study, name)
    others = rows.drop(index=CRIMES[name].row(rows).name)
    if name == "dies_at_each":
        assert (others["verdict"] == "crashed").all()
        assert (others["status_text"] == "SIGABRT").sum() == MOST_LOST - 1
        assert others["status_text"].str.startswith("not tried: 3 processes").sum() == 8
    elif name == "leaks":
        assert others["verdict"].tolist().count("verified") == 6
    else:
        assert (others["verdict"] == "verified").all()


def test_a_run_that_has_lost_a_process_is_not_repeated(study: pd.DataFrame) -> None:
    repeats = study.groupby("solver")["repeats"].first()
    loses = [name for name, crime in CRIMES.items() if crime.verdict in ("crashed", "timeout")]
    assert repeats[loses][repeats[loses] != 1].empty
    # one that loses a process to a busy machine, at whatever pass, tells nothing
    lost = study.groupby("solver")["verdict"].agg(lambda v: v.isin(["crashed", "timeout"]).any())
    assert repeats[~lost & (repeats != 2)].empty
    assert len(loses) >= 20 and (~lost).sum() >= 20


def test_a_killed_solve_has_the_time_that_was_waited_for_it(study: pd.DataFrame) -> None:
    row = CRIMES["endless_loop"].row(rows_of(study, "endless_loop"))
    assert row["call_time"] == row["runtime"] >= SHORT and np.isnan(row["solve_time"])


@pytest.mark.parametrize("name", [name for name in CRIMES if "time" in name or "clock" in name])
def test_who_lies_about_the_time_has_ours(study: pd.DataFrame, name: str) -> None:
    row = CRIMES[name].row(rows_of(study, name))
    assert row["runtime"] == row["call_time"] > 0
    assert np.isnan(row["setup_time"]) and np.isnan(row["solve_time"]) and not row["believed"]
    # What is believed depends on what else the machine does.
    heard = study[study["believed"]]
    own = heard["setup_time"] + heard["solve_time"]
    assert (heard["runtime"] == own).all() and (own <= heard["call_time"]).all()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
def test_no_process_is_left(study: pd.DataFrame) -> None:
    """Forks have the command line of the server, which has a folder of its own in it."""
    assert not study.empty

    def of_ours() -> list[str]:
        lines = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                lines.append(path.read_text())
        return [line for line in lines if str(server().folder) in line]

    assert wait_for(lambda: len(of_ours()) == 1)  # the server


def processes_with(word: str) -> set[int]:
    """Processes that have `word` in their environment."""
    found = set()
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if word.encode() in (path / "environ").read_bytes():
                found.add(int(path.name))
        except OSError:
            continue
    return found


def wait_for(what: Callable[[], Any], seconds: float = 60.0) -> Any:
    end = time.monotonic() + seconds
    while not (found := what()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


PROGRAM = """
import sys
from harness import replay
from solvers.registry import register
from tests.fakes.crimes import targets
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.random_qps import random_qp
for name, target in targets().items():
    register(name, target)
replay(fake_recording(), sys.argv[2:], arms=["cold"], repeats=1, results=sys.argv[1])
print("ended")
"""


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], str]]]:
    """Runs a study of some solvers in a program; returns it, and a word in its environment."""
    started = []

    def run(*solvers: str) -> tuple[subprocess.Popen[str], str]:
        word = uuid.uuid4().hex
        program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path), *solvers],
            env={**os.environ, "TEST_OF_ISOLATION": word},
            cwd=Path(__file__).parents[3],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(program)
        return program, word

    yield run
    for program in started:
        program.kill()
        program.communicate()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
@pytest.mark.parametrize(
    ("how", "solver"),
    [
        (signal.SIGKILL, "endless_native_call_with_the_gil"),
        (signal.SIGINT, "deaf_to_sigterm"),
    ],
)
def test_processes_end_with_their_parent(
    run: Any, tmp_path: Path, how: signal.Signals, solver: str
) -> None:
    program, word = run("Honest", "forks", solver)
    kept, before = (
        tmp_path / "solves" / f"fake__{name}__paper__cold.parquet" for name in ("Honest", "forks")
    )
    assert wait_for(before.exists) and kept.exists()
    assert wait_for(lambda: len(processes_with(word)) >= 3)
    program.send_signal(how)
    _, err = program.communicate(timeout=60)
    assert wait_for(lambda: not processes_with(word))
    if how == signal.SIGINT:
        assert err.splitlines()[-1] == "KeyboardInterrupt"
    assert kept.exists()


def test_a_study_that_is_resumed_has_the_same_rows(study: pd.DataFrame, tmp_path: Path) -> None:
    names = ["segfault", "Honest", "forks", "lies", "abort"]
    options: Any = {
        "arms": ["cold"],
        "repeats": 2,
        "memory_limit": MEMORY_LIMIT,
        "results": tmp_path,
    }
    told = []

    def interrupt(what: str, done: float, total: float) -> None:
        told.append(what)
        if "forks" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replay(fake_recording(), names, progress=interrupt, **options)
    assert told
    rows = replay(fake_recording(), names, **options).sort_values(["solver", "step"])
    before = study[study["solver"].isin(names)]
    times = list(BY_CLOCK)
    pd.testing.assert_frame_equal(
        rows.drop(columns=times).reset_index(drop=True),
        before.drop(columns=times).reset_index(drop=True),
    )


def test_the_same_rows_come_from_our_own_process() -> None:
    options: Any = {"settings": ["high"], "repeats": 1}
    solvers = ["Honest", "lies", "nan", "picks_and_chooses", "scipy_bvls", "glambda", "daqp"]
    rows = [replay(fake_recording(), solvers, isolate=flag, **options) for flag in (True, False)]
    how = [*BY_CLOCK, "executor"]
    pd.testing.assert_frame_equal(*(part.drop(columns=how) for part in rows))


def test_after_a_loss_a_warm_arm_begins_anew() -> None:
    rows = replay(fake_recording(), ["segfault", "Honest"], arms=["warm"], repeats=1)
    lost, honest = (rows_of(rows, name).set_index("step") for name in ("segfault", "Honest"))
    # The crime is at QP 2; QP 3 follows a restart anyway, and QPs 6 and on are impulses.
    assert honest.index[honest["warm_started"]].tolist() == [1, 2, 4, 5]
    assert lost.index[lost["warm_started"]].tolist() == [1, 4, 5]


def test_a_server_that_is_killed_between_passes_is_replaced() -> None:
    before = server()
    killed = []

    def kill(what: str, done: float, total: float) -> None:
        if not killed:
            killed.append(before._process.pid)
            os.kill(before._process.pid, signal.SIGKILL)
            before._process.wait()

    rows = replay(fake_recording(), ["Honest", "lies"], arms=["cold"], repeats=2, progress=kill)
    assert killed and server() is not before
    assert set(rows["verdict"]) == {"verified", "claimed_wrong"} and (rows["repeats"] == 2).all()


def test_the_memory_that_is_held_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process.Process, "memory", lambda self: 2**31)
    rows = replay(fake_recording(), ["endless_loop"], arms=["cold"], repeats=1, memory_limit=1.0)
    text = "killed: it took more than 1 GiB of memory"
    assert rows.loc[rows["t"] == SCENE, ["verdict", "status_text"]].to_numpy().tolist() == [
        ["crashed", text]
    ]


def test_a_server_that_cannot_be_started_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "_servers", threading.local())
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(process.IsolationError, match="the server of processes ended"):
        replay(fake_recording(), ["Honest"], arms=["cold"], repeats=1)


def test_without_fork_the_study_runs_in_our_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "fork")
    monkeypatch.setattr(isolate, "Apart", None)
    rows = replay(fake_recording(), ["Honest"], arms=["cold"], repeats=1)
    assert (rows["verdict"] == "verified").all()


def test_what_is_spent_inside_calls_is_kept(tmp_path: Path) -> None:
    assert read_spent(tmp_path) == {}
    rows = replay(fake_recording(), ["Honest"], arms=["cold"], repeats=1, results=tmp_path)
    spent = read_spent(tmp_path)
    assert spent["in_calls"] == pytest.approx(rows["call_time"].sum())
    assert 0 < spent["in_calls"] < spent["in_passes"] < spent["replaying"]
    replay(fake_recording(), ["Honest", "lies"], arms=["cold"], repeats=1, results=tmp_path)
    assert read_spent(tmp_path)["in_calls"] > spent["in_calls"]
    (tmp_path / "spent.json").write_text("[")
    with pytest.raises(StoreError, match=r"spent.json: its seal is missing .*; delete it"):
        read_spent(tmp_path)


KINDS = ["two_sided", "sparse_columns", "empty", "fixed_rows"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sparse", [False, True])
def test_a_question_comes_as_it_was_asked(kind: str, sparse: bool) -> None:
    qp, _ = random_qp(kind, 3)
    A = sp.csc_array(qp.dense_A) if sparse else qp.dense_A
    V = np.arange(2.0 * qp.k).reshape(2, qp.k)
    qp = replace(qp, A=A, generators=V, kind="impulse", accepted=False, t=-0.1, eps0=1e-7)
    x = np.arange(float(qp.k)) if sparse else None
    found = unpacked(packed(Question(7, qp, x, alone=True, fresh=True)))
    assert (found.number, found.alone, found.fresh) == (7, True, True)
    assert (found.reference is None) == (x is None)
    for name, value in vars(qp).items():
        other = getattr(found.qp, name)
        if sp.issparse(value):
            assert other.indices.dtype == value.indices.dtype
            np.testing.assert_array_equal(other.toarray(), value.toarray())
            value, other = value.data, other.data
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value, err_msg=name)
            assert other.dtype == value.dtype and not other.flags.writeable
        else:
            assert other == value


def test_an_answer_comes_as_it_was_given() -> None:
    x, counts = np.arange(3.0), WorkCounts(1, 2)
    first = Outcome(None, x, True, "SOLVED", "µ" * 300, 7, counts, True)
    second = Outcome("skipped", status_text="no\nimpulses")
    question = packed(Question(0, random_qp("two_sided", 0)[0]))
    answer = answered(question, first, (1.0, 2.0, 3.0, 4.0, 5.0), 3)
    assert len(answer) == answer_size(3) and answer[:8] == question[:8]
    found, told = outcome_of(answer)
    np.testing.assert_array_equal(found.x, x)
    assert found.status_text == "µ" * 200 and told == (1.0, 2.0, 3.0, 4.0, 5.0)
    for name in ("verdict", "found", "status", "iterations", "work", "warm_started"):
        assert getattr(found, name) == getattr(first, name)
    found, told = outcome_of(answered(question, second, (np.nan,) * 5, 3))
    assert found.x is None and found.iterations is None and found.work is None
    assert (found.verdict, found.status_text) == ("skipped", "no impulses")
    assert np.isnan(told).all()


@pytest.mark.parametrize("seed", range(20))
def test_whatever_stands_in_an_answer_is_an_outcome(seed: int) -> None:
    found, told = outcome_of(np.random.default_rng(seed).bytes(answer_size(3)))
    assert found.verdict in (None, *SETTLED[1:]) and len(told) == 5
    assert found.x is None or found.x.shape == (3,)


NO_TIME = Asking.nothing(1)


def count(
    *times: float, asking: Asking = NO_TIME, stranger: bool = False
) -> tuple[list[float], bool]:
    """What counts of build, setup, solve, call, wall, waited, cpu [µs]; if stages are absurd."""
    told = np.array([[*times[:4], np.nan, *times[4:]]])
    found, absurd = counted(1e-6 * told, asking, stranger)
    return (1e6 * found[0, :5]).round(6).tolist(), bool(absurd)


def test_what_is_told_counts_where_it_explains_what_is_seen() -> None:
    assert count(5, 1, 4, 12, 30, 0, 12) == ([5, 1, 4, 12, 0], False)
    assert count(5, 1, 4, 12, 930, 910, 12) == ([5, 1, 4, 12, 0], False)  # it had to wait
    asking = Asking(np.array([[9e-4, 0.0]]), np.zeros(2))
    assert count(5, 1, 4, 12, 930, 0, 12, asking=asking) == ([5, 1, 4, 12, 0], False)
    assert count(5, 1, 4, 12, 30, 0, 12, stranger=True) == ([0, 6, 4, 12, 0], False)


@pytest.mark.parametrize("stranger", [False, True])
def test_a_package_s_own_clock_decides_nothing_and_is_kept_within_the_call(stranger: bool) -> None:
    for inside, kept in ((3.0, True), (13.0, False), (-1.0, False), (np.nan, False)):
        told = 1e-6 * np.array([[5, 1, 4, 12, inside, 30, 0, 12]])
        found, _ = counted(told, NO_TIME, stranger)
        np.testing.assert_array_equal(found[0, 3:5], 1e-6 * np.array([12, 0]))
        assert np.isnan(found[0, 5]) == (stranger or not kept)


def test_what_is_seen_and_not_told_is_charged() -> None:
    assert count(500, 100, 400, 1300, 1300, 0, 1300) == ([500, 100, 400, 1300, 300], False)
    busy = Asking(np.array([[4e-3, 6e-5]]), np.zeros(2))  # by the wall it takes 4 ms to be asked
    assert count(5, 1, 4, 10_010, 14_000, 0, 10_100, asking=busy)[0][4] == 0  # it is all charged
    assert count(5, 1, 4, 10_010, 14_000, 0, 10_100, asking=busy)[0][3] == 10_010
    assert count(500, 100, 400, 1000, 1300, 0, 1000) == ([500, 100, 400, 1300, 300], False)
    assert count(500, 100, 400, 1000, 1000, 0, 1500) == ([500, 100, 400, 1500, 500], False)


@pytest.mark.parametrize(
    ("own", "absurd"),
    [
        ((0, 0, 0.001), False),
        ((1, -1, 5), True),
        ((1, 1, np.inf), True),
        ((1, np.nan, 5), True),
        ((1, 0, 0), True),
        ((1, 1, 5000), True),
        ((np.nan, np.nan, np.nan), False),
    ],
)
def test_where_nothing_can_be_believed_the_whole_call_is_charged(own: Any, absurd: bool) -> None:
    found, told = count(*own, 1000, 1010, 0, 1000)
    assert np.isnan(found[:3]).all() and found[3:] == [1000, 0] and told == absurd
    for call in (-1.0, np.nan, np.inf, 0.0):
        assert count(*own, call, 1010, 0, 1000)[0][3:] == [1010, 0]


def test_who_is_not_back_has_all_of_the_time_that_was_waited() -> None:
    slow = Asking(np.array([[0.05, 0.01]]), np.zeros(2))  # on a busy machine
    found, _ = count(*[np.nan] * 4, 2_000_100, 0, np.nan, asking=slow)
    assert found[3:] == [2_000_100, 0]


def test_causes_of_death_have_names() -> None:
    assert cause_of_death(-11) == "SIGSEGV"
    assert cause_of_death(-64 - 1) == "signal 65"
    assert cause_of_death(3) == "left with exit code 3"


def test_the_hard_limit_is_far_beyond_the_soft_one() -> None:
    assert hard_limit(1.0) == 11.0 and hard_limit(0.001) > 1.0
