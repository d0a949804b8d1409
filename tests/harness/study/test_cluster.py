"""A replay on a real cluster of worker processes, one of which is killed in the middle."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from harness.machine.machine import problems_version
from harness.processes.introduction import solver_version
from harness.recordings.recording import write_recording
from harness.results.shard_file import FROM_PASSES
from harness.results.store import read_passes, read_results
from harness.study.cluster import ClusterError, connected, do_job, replay_on
from harness.study.replay import replay
from tests.fakes.fake_recordings import fake_recording

pytest.importorskip("distributed")

SOLVERS = ("glambda", "scipy_bvls")
SETTINGS = ("paper", "high")
ARMS = ("cold", "warm")
OPTIONS: dict[str, Any] = {"repeats": 2, "time_limit": 60.0}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with connected(2) as client:
        yield client


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The rows of a replay here."""
    folder = tmp_path_factory.mktemp("home")
    return replay(fake_recording(), SOLVERS, SETTINGS, ARMS, results=folder, **OPTIONS)


def but_times(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.drop(columns=list(FROM_PASSES))  # workers may find the machine busy


def test_a_cluster_gives_the_rows_of_a_replay_at_home(
    client: Any, home: pd.DataFrame, tmp_path: Path
) -> None:
    recording = fake_recording()
    told: list[int] = []
    there = replay_on(
        client, [recording], SOLVERS, SETTINGS, ARMS, results=tmp_path / "there",
        progress=lambda what, done, of: told.append(done), **OPTIONS,
    )  # fmt: skip
    pd.testing.assert_frame_equal(but_times(home), but_times(there))
    assert told[-1] == len(recording.qps) * len(SOLVERS) * len(SETTINGS)


def test_what_is_there_is_not_sent_again(client: Any, tmp_path: Path) -> None:
    recording = fake_recording()
    replay(recording, SOLVERS, ("paper",), ARMS, results=tmp_path, **OPTIONS)
    before = {path: path.read_bytes() for path in (tmp_path / "solves").iterdir()}
    rows = replay_on(client, [recording], SOLVERS, SETTINGS, ARMS, results=tmp_path, **OPTIONS)
    assert set(rows["settings"]) == set(SETTINGS)
    assert all(path.read_bytes() == content for path, content in before.items())


def test_missing_passes_are_made(client: Any, tmp_path: Path) -> None:
    recording, once = fake_recording(), OPTIONS | {"repeats": 1}
    replay(recording, SOLVERS, ("paper",), ARMS, results=tmp_path, **once)
    rows = replay_on(client, [recording], SOLVERS, ("paper",), ARMS, results=tmp_path, **OPTIONS)
    passes = read_passes(tmp_path).groupby(["solver", "arm"]).size()
    assert (passes >= OPTIONS["repeats"]).all() and set(rows["solver"]) == set(SOLVERS)


def test_jobs_for_accuracy_alone_make_one_pass(client: Any, tmp_path: Path) -> None:
    rows = replay_on(
        client, [fake_recording()], SOLVERS, ("high",), ARMS, results=tmp_path, timed=False,
        **OPTIONS,
    )  # fmt: skip
    assert set(rows["solver"]) == set(SOLVERS) and (rows["repeats"] == 1).all()


def test_the_job_of_a_killed_worker_goes_to_another(
    client: Any, home: pd.DataFrame, tmp_path: Path
) -> None:
    recording = fake_recording()
    client.wait_for_workers(2, timeout=60)
    pids = client.run(os.getpid)
    failed: list[BaseException] = []

    def study() -> None:
        try:
            replay_on(client, [recording], SOLVERS, SETTINGS, ARMS, results=tmp_path, **OPTIONS)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=study)
    thread.start()
    killed = ""
    while thread.is_alive() and not killed:
        busy = [worker for worker, tasks in client.processing().items() if tasks]
        if busy:
            killed = busy[0]
            os.kill(pids[killed], signal.SIGKILL)
        time.sleep(0.01)
    thread.join()
    assert killed and not failed
    pd.testing.assert_frame_equal(but_times(read_results(tmp_path)), but_times(home))
    client.wait_for_workers(2, timeout=60)
    assert pids[killed] not in client.run(os.getpid).values()


def test_a_worker_of_other_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.h5"
    write_recording(path, fake_recording())
    versions = {"problems": problems_version(), "daqp": solver_version("daqp") + " older"}
    with pytest.raises(ClusterError, match="install the same versions"):
        do_job(path.read_bytes(), "high", ("daqp",), ARMS, versions, OPTIONS)


def test_nobody_at_the_address_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("harness.study.cluster.PATIENCE", 0.5)
    with pytest.raises(ClusterError, match="no scheduler answers"), connected("127.0.0.1:1"):
        pass
