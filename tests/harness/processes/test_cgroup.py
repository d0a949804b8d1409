"""Control groups, where the system lets us make them: what the whole family takes, it takes."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from harness import replay
from harness.processes import cgroup
from harness.processes.cgroup import GROUPS, LOOKS, Group, executor, join
from solvers import registry
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.families_of_processes import WORK

needs_groups = pytest.mark.skipif(executor() != GROUPS, reason="no control groups here")
FAMILY = "tests.fakes.families_of_processes"


@pytest.fixture
def families(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {name: f"{FAMILY}:{name}" for name in ("FourByAThird", "GrandchildThatWorks")}
    monkeypatch.setattr(registry, "_REGISTERED", names)


def test_the_row_says_who_has_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = replay(fake_recording(), ["velocity"], arms=["cold"], repeats=1)
    assert set(rows["executor"]) == {executor()}
    monkeypatch.setattr(cgroup, "_parent", lambda owner: None)
    assert executor() == LOOKS and Group.fresh() is None
    rows = replay(fake_recording(), ["velocity"], arms=["cold"], repeats=1)
    assert set(rows["executor"]) == {LOOKS} and (rows["verdict"] == "verified").all()
    rows = replay(fake_recording(), ["velocity"], arms=["cold"], repeats=1, isolate=False)
    assert set(rows["executor"]) == {""}


def test_without_benchexec_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "benchexec.cgroups", None)
    cgroup._parent.cache_clear()
    assert executor() == LOOKS
    cgroup._parent.cache_clear()


@needs_groups
def test_what_is_in_a_group_counts_together_and_ends_with_it() -> None:
    group = Group.fresh()
    assert group is not None
    child = os.fork()
    if child == 0:
        join(group.joins)
        if os.fork() == 0:
            ends = time.process_time() + 0.2
            while time.process_time() < ends:
                pass
            os._exit(0)
        os.wait()
        time.sleep(600)
    for _ in range(200):
        time.sleep(0.05)
        if group.cpu() > 0.2:
            break
    assert 0.2 < group.cpu() < 5.0 and group.peak() > 0
    group.close()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) < 0
    assert not any(Path(file).exists() for file in group.joins)


@needs_groups
def test_four_processes_are_held_to_the_limit_of_one(families: None) -> None:
    rows = replay(fake_recording(), ["FourByAThird"], arms=["cold"], repeats=1, memory_limit=0.5)
    assert (rows["verdict"] == "crashed").any()
    text = "killed: it took more than 0.5 GiB of memory"
    assert rows["status_text"].str.startswith(text).any(), rows["status_text"].tolist()


@needs_groups
def test_the_work_of_who_was_never_waited_for_is_charged(families: None) -> None:
    rows = replay(fake_recording(), ["GrandchildThatWorks"], arms=["cold"], repeats=1)
    done: pd.DataFrame = rows[rows["verdict"].isin(["verified", "claimed_wrong"])]
    assert len(done) > 5
    assert done["runtime"].sum() > 0.5 * WORK * len(done)
