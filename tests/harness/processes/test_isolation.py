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
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from harness import replay
from harness.passes.limits import hard_limit
from harness.passes.measure import Outcome, believed
from harness.processes import isolate, live_process
from harness.processes.isolate import MOST_LOST
from harness.processes.live_process import server
from harness.processes.own_process import cause_of_death
from harness.processes.sheet import HEADER, ROW, SETTLED, Layout, Pen, Sheet
from harness.results.store import TIMES, StoreError, read_spent
from problems.qp import WorkCounts
from solvers import registry
from tests.fakes.crimes import CRIMES, MEMORY_LIMIT, SCENE, targets
from tests.fakes.fake_recordings import fake_recording

pytestmark = pytest.mark.skipif(not isolate.is_available(), reason="the system cannot fork")
SHORT = 1.0
"""Hard limit of these tests [s]."""


@pytest.fixture(scope="module", autouse=True)
def known() -> Iterator[None]:
    """The criminals, by name, and a hard limit that is soon reached."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_REGISTERED", targets())
        for module in ("harness.processes.isolate", "harness.study.replay"):
            patch.setattr(sys.modules[module], "hard_limit", lambda _: SHORT)
        patch.setattr(isolate, "FIRST_CALL", 1.0)
        yield


@pytest.fixture(scope="module")
def study() -> pd.DataFrame:
    """The rows of one study in which every crime is committed."""
    names = list(targets())
    rows = replay(fake_recording(), names, arms=["cold"], repeats=2, memory_limit=MEMORY_LIMIT)
    return rows.sort_values(["solver", "step"])


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
    elif name == "cuts_its_sheet_short":
        assert (others["verdict"] == "crashed").all()  # its answers were there
    else:
        assert (others["verdict"] == "verified").all()


def test_a_run_that_has_lost_a_process_is_not_repeated(study: pd.DataFrame) -> None:
    lossy = study.groupby("solver")["verdict"].agg(lambda v: v.isin(["crashed", "timeout"]).any())
    repeats = study.groupby("solver")["repeats"].first()
    assert (repeats[lossy] == 1).all() and (repeats[~lossy] == 2).all()
    assert lossy.sum() >= 20 and (~lossy).sum() >= 20


def test_a_killed_solve_has_the_time_that_was_waited_for_it(study: pd.DataFrame) -> None:
    row = CRIMES["endless_loop"].row(rows_of(study, "endless_loop"))
    assert row["call_time"] == row["runtime"] >= SHORT and np.isnan(row["solve_time"])


@pytest.mark.parametrize("name", [name for name in CRIMES if "time" in name or "clock" in name])
def test_who_lies_about_the_time_has_ours(study: pd.DataFrame, name: str) -> None:
    row = CRIMES[name].row(rows_of(study, name))
    assert row["runtime"] == row["call_time"] > 0
    honest = rows_of(study, "Honest")
    own = honest["setup_time"] + honest["solve_time"]
    assert (honest["runtime"] == own).all() and (own < honest["call_time"]).all()


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

    assert len(of_ours()) == 1  # the server


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
    kept = tmp_path / "solves" / "fake__Honest__paper__cold.parquet"
    assert wait_for(kept.exists)
    assert wait_for(lambda: len(processes_with(word)) >= 3)
    program.send_signal(how)
    _, err = program.communicate(timeout=60)
    assert wait_for(lambda: not processes_with(word))
    if how == signal.SIGINT:
        assert err.splitlines()[-1] == "KeyboardInterrupt"
    assert kept.exists()


def test_a_study_that_is_resumed_has_the_same_rows(study: pd.DataFrame, tmp_path: Path) -> None:
    names = ["segfault", "Honest", "endless_loop", "lies", "forks"]
    options: Any = {
        "arms": ["cold"],
        "repeats": 2,
        "memory_limit": MEMORY_LIMIT,
        "results": tmp_path,
    }
    told = []

    def interrupt(what: str, done: float, total: float) -> None:
        told.append(what)
        if "endless" in what:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replay(fake_recording(), names, progress=interrupt, **options)
    assert told
    rows = replay(fake_recording(), names, **options).sort_values(["solver", "step"])
    before = study[study["solver"].isin(names)]
    times = ["runtime", "runtime_median", *TIMES]
    pd.testing.assert_frame_equal(
        rows.drop(columns=times).reset_index(drop=True),
        before.drop(columns=times).reset_index(drop=True),
    )


def test_the_same_rows_come_from_our_own_process() -> None:
    options: Any = {"settings": ["high"], "repeats": 1}
    solvers = ["Honest", "lies", "nan", "picks_and_chooses", "scipy_bvls", "lotstedt", "daqp"]
    rows = [replay(fake_recording(), solvers, isolate=flag, **options) for flag in (True, False)]
    times = ["runtime", "runtime_median", *TIMES]
    pd.testing.assert_frame_equal(*(part.drop(columns=times) for part in rows))


def test_after_a_loss_a_warm_arm_begins_anew() -> None:
    rows = replay(fake_recording(), ["segfault", "Honest"], arms=["warm"], repeats=1)
    lost, honest = (rows_of(rows, name).set_index("step") for name in ("segfault", "Honest"))
    # The crime is at QP 2; QP 3 follows a restart anyway, and QPs 6 and on are impulses.
    assert honest.index[honest["warm_started"]].tolist() == [1, 2, 4, 5]
    assert lost.index[lost["warm_started"]].tolist() == [1, 4, 5]


def test_more_tasks_than_may_live_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolate, "MOST_LIVE", 1)
    alive = []

    class Counted(isolate.Process):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            alive.append(self)
            assert sum(process.is_alive for process in alive) == 1

    monkeypatch.setattr(isolate, "Process", Counted)
    rows = replay(fake_recording(), ["Honest", "lies"], arms=["cold"], repeats=2)
    assert len(alive) == 4 and (rows["repeats"] == 2).all()


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
    monkeypatch.setattr(isolate.Process, "memory", lambda self: 2**31)
    rows = replay(fake_recording(), ["endless_loop"], arms=["cold"], repeats=1, memory_limit=1.0)
    text = "killed: it took more than 1 GiB of memory"
    assert rows.loc[rows["t"] == SCENE, ["verdict", "status_text"]].to_numpy().tolist() == [
        ["crashed", text]
    ]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk to be had")
def test_a_sheet_on_a_full_disk_is_an_error_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "sheet").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"No space left on device.*sheet"):
        Sheet(tmp_path / "sheet", Layout(SIZES))


def test_a_server_that_cannot_be_started_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_process, "_servers", threading.local())
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(live_process.IsolationError, match="the server of processes ended"):
        replay(fake_recording(), ["Honest"], arms=["cold"], repeats=1)


def test_without_fork_the_study_runs_in_our_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "fork")
    monkeypatch.setattr(isolate.Block, "do_pass", None)
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


SIZES = [3, 0, 2]


@pytest.fixture
def sheet(tmp_path: Path) -> Iterator[Sheet]:
    sheet = Sheet(tmp_path / "sheet", Layout(SIZES))
    yield sheet
    sheet.close()
    assert not sheet.path.exists()


def test_a_sheet_gives_back_what_was_written(sheet: Sheet) -> None:
    pen = Pen(sheet.path, Layout(SIZES))
    first = Outcome(None, np.arange(3.0), True, "SOLVED", "µ" * 300, 7, WorkCounts(1, 2), True)
    second = Outcome("skipped", status_text="no\nimpulses", after_restart=True)
    assert sheet.position() == -1 and sheet.read() == {}
    pen.begin(0)
    pen.end(0, first, np.arange(4.0))
    pen.begin(2)
    pen.end(2, second, np.full(4, np.nan))
    assert sheet.position() == 2
    found = sheet.read()
    assert set(found) == {0, 2}
    outcome, times = found[0]
    np.testing.assert_array_equal(outcome.x, first.x)
    np.testing.assert_array_equal(times, np.arange(4.0))
    assert outcome.status_text == "µ" * 200
    for name in ("verdict", "found", "status", "iterations", "work", "warm_started"):
        assert getattr(outcome, name) == getattr(first, name)
    outcome, times = found[2]
    assert outcome.x is None and outcome.iterations is None and outcome.work is None
    assert (outcome.verdict, outcome.status_text) == ("skipped", "no impulses")
    assert outcome.after_restart and np.isnan(times).all()
    sheet.clear()
    assert sheet.position() == -1 and sheet.read() == {}


@pytest.mark.parametrize("seed", range(20))
def test_whatever_stands_in_a_sheet_is_outcomes(sheet: Sheet, seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = rng.bytes(rng.integers(0, HEADER + 4 * ROW.itemsize))
    sheet.path.write_bytes(content)
    assert -1 <= sheet.position() < 3
    for index, (outcome, times) in sheet.read().items():
        assert outcome.verdict in (None, *SETTLED[1:]) and times.shape == (4,)
        assert outcome.x is None or outcome.x.shape == (SIZES[index],)


def test_clocks_are_believed_within_bounds() -> None:
    honest = [1e-6, 1e-6, 5e-6, 2e-5]
    times = np.array(
        [
            honest,
            [1e-6, -1e-6, 5e-6, 2e-5],
            [1e-6, 1e-6, np.inf, 2e-5],
            [1e-6, np.nan, 5e-6, 2e-5],
            [1e-6, 0.0, 0.0, 2e-5],
            [1e-6, 1e-6, 5e-5, 2e-5],
            [1e-6, 1e-6, 5e-6, 1.0],
            [0.4, 0.1, 0.1, 1.0],
            [np.nan, np.nan, np.nan, 1.0],
            [1e-6, 1e-6, 5e-6, -1.0],
        ]
    )
    cleared, impossible = believed(times)
    assert impossible == [1, 2, 3, 4, 5, 9]
    believed_ones = [0, 7]
    np.testing.assert_array_equal(cleared[believed_ones], times[believed_ones])
    others = np.setdiff1d(np.arange(10), believed_ones)
    assert np.isnan(cleared[others, :3]).all()
    np.testing.assert_array_equal(cleared[:9, 3], times[:9, 3])
    assert np.isnan(cleared[9, 3])


def test_causes_of_death_have_names() -> None:
    assert cause_of_death(-11) == "SIGSEGV"
    assert cause_of_death(-64 - 1) == "signal 65"
    assert cause_of_death(3) == "left with exit code 3"


def test_the_hard_limit_is_far_beyond_the_soft_one() -> None:
    # The module's own, not the short one of these tests.
    assert hard_limit(1.0) == 11.0 and hard_limit(0.001) > 1.0
