"""The results folder: shards are whole or absent, and never mix."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from harness.files import whole_files
from harness.files.folder_lock import ForeignLock, Locked
from harness.files.json_file import sealed_json
from harness.files.seal import sealed
from harness.machine.unrest import Unrest
from harness.names import NOT_KNOWN
from harness.recordings.recording import write_recording
from harness.results.shard_file import read_shard, shard_bytes, summarise
from harness.results.store import (
    COLUMNS,
    PASS_COLUMNS,
    REPEAT_COLUMNS,
    Shard,
    ShardKey,
    Store,
    StoreError,
    read_passes,
    read_repeats,
    read_results,
    read_spent,
    read_study,
)
from tests.endurance.forged_shards import parquet
from tests.fakes.fake_recordings import fake_recording

ROOT = Path(__file__).parents[3]
KEY = ShardKey("fake", "abc", "daqp", "paper", "cold", "daqp 1.0", "a machine", 1.0)
TIMES = np.array(
    [
        [[1.0, 2.0, 3.0, 7.0, 0.0, 1.0, 0.1], [1.0, 1.0, 1.0, 4.0, 0.0, 1.0, 0.1], [np.nan] * 7],
        [[1.0, 1.0, 1.0, 4.0, 0.0, 1.0, 0.2], [1.0, 5.0, 5.0, 12.0, 0.0, 1.0, 0.2], [np.nan] * 7],
        [[1.0, 4.0, 4.0, 9.0, 0.0, 1.0, 0.3], [1.0, 2.0, 2.0, 6.0, 0.0, 1.0, 0.3], [np.nan] * 7],
    ]
)


def shard(key: ShardKey = KEY, passes: int = 3) -> Shard:
    rows = [
        {
            "problem": f"{key.scene}/{i:06d}",
            "found": True,
            "step": i,
            "kind": "step",
            "verdict": "skipped" if i == 2 else "verified",
            "iterations": None if i == 2 else i,
            "glambda_error": 1e-12,
            "status_text": "µ",
        }
        for i in range(3)
    ]
    return Shard(key, rows, TIMES[:passes], [Unrest()] * passes, "study1")


def test_what_is_saved_is_read(tmp_path: Path) -> None:
    Store(tmp_path).save(shard())
    rows = read_results(tmp_path)
    assert list(rows.columns) == list(COLUMNS)
    assert list(rows["problem"]) == ["fake/000000", "fake/000001", "fake/000002"]
    assert list(rows["solver"].unique()) == ["daqp"] and rows["study"][0] == "study1"
    assert list(rows["runtime"][:2]) == [2.0, 2.0] and np.isnan(rows["runtime"][2])
    assert rows["iterations"].isna().tolist() == [False, False, True]
    assert rows["iterations"].dtype == "Int64"
    repeats = read_repeats(tmp_path)
    assert list(repeats.columns) == list(REPEAT_COLUMNS) and len(repeats) == 9
    second = repeats[(repeats["problem"] == "fake/000001") & (repeats["repeat"] == 1)]
    assert second["solve_time"].item() == 5.0


def test_the_fastest_pass_is_kept_whole_and_the_median_beside_it() -> None:
    out = summarise(TIMES, [Unrest()] * 3)
    np.testing.assert_array_equal(out["runtime"], [2.0, 2.0, np.nan])
    np.testing.assert_array_equal(out["runtime_median"], [5.0, 4.0, np.nan])
    np.testing.assert_array_equal(out["call_time"], [4.0, 4.0, np.nan])  # of the same pass
    np.testing.assert_array_equal(out["repeats"], [3, 3, 3])


def test_passes_that_were_disturbed_count_where_none_was_quiet(tmp_path: Path) -> None:
    noisy = Unrest(seconds=1.0, pressure=0.5)
    out = summarise(TIMES, [noisy, Unrest(), Unrest(steal=0.0)])
    np.testing.assert_array_equal(out["runtime"], [2.0, 4.0, np.nan])
    np.testing.assert_array_equal(out["runtime_median"], [5.0, 7.0, np.nan])
    assert out["repeats"].tolist() == [2, 2, 2] and out["quiet"].all()
    out = summarise(TIMES, [noisy] * 3)
    assert out["repeats"].tolist() == [3, 3, 3] and not out["quiet"].any()
    Store(tmp_path).save(replace(shard(), unrest=[noisy, Unrest(), Unrest(steal=0.0)]))
    stored = Store(tmp_path).load(KEY)
    assert stored is not None and stored.unrest[0].as_json() == noisy.as_json()
    passes = read_passes(tmp_path)
    assert tuple(passes.columns) == PASS_COLUMNS and passes["pace"].tolist() == [0.1, 0.2, 0.3]
    assert passes["disturbed_by"].tolist() == ["pressure", "", ""]
    assert passes["steal"].isna().tolist() == [True, True, False]  # unavailable is not 0
    assert read_repeats(tmp_path)["quiet"].tolist() == [False, True, True] * 3


@pytest.mark.parametrize(
    "told",
    [None, [], [[0.0] * 7] * 2, [[0.0] * 6] * 3, [["0"] * 7] * 3, [[True] * 7] * 3, [1] * 3],
)
def test_a_shard_that_does_not_tell_of_its_passes_is_refused(tmp_path: Path, told: Any) -> None:
    path = tmp_path / f"{KEY.name}.parquet"
    sound = shard_bytes(shard())
    path.write_bytes(sound)
    table = pq.ParquetFile(io.BytesIO(sound)).read()
    path.write_bytes(sealed(parquet(table, {"key": asdict(KEY), "unrest": told})))
    with pytest.raises(StoreError, match="unrest"):
        read_shard(path)


def test_a_call_that_raised_counts_as_a_whole() -> None:
    times = np.array([[[np.nan, np.nan, np.nan, 0.5, 0.0, 1.0, 0.1]]])
    assert summarise(times, [Unrest()])["runtime"] == [0.5]


def test_who_is_charged_no_more_than_was_told_is_believed() -> None:
    told = [1.0, 1.0, 1.0, 4.0, 0.0, 1.0, 0.1]
    unheard = [np.nan, np.nan, np.nan, 4.0, 0.0, np.nan, 0.1]
    times = np.array([[told, [*told[:4], 1.5, *told[5:]], unheard, [np.nan] * 7]])
    found = summarise(times, [Unrest()])
    assert found["believed"].tolist() == [True, False, False, False]
    assert found["runtime"][:3].tolist() == [2.0, 3.5, 4.0]


def test_load_gives_back_what_was_saved(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.load(KEY) is None
    store.save(shard(passes=2))
    loaded = store.load(KEY)
    assert loaded is not None
    np.testing.assert_array_equal(loaded.passes, TIMES[:2])
    store.save(replace(loaded, passes=TIMES, unrest=[Unrest()] * 3))
    again = read_results(tmp_path)
    assert again["repeats"].tolist() == [3, 3, 3]
    assert again["verdict"].tolist() == ["verified", "verified", "skipped"]
    assert again["iterations"].isna().tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("recording_digest", "other"),
        ("versions", "daqp 2.0"),
        ("machine", "another machine"),
        ("time_limit", 2.0),
        ("format_version", 1_000),
    ],
)
def test_shards_made_otherwise_refuse_to_mix(tmp_path: Path, field: str, value: object) -> None:
    store = Store(tmp_path)
    store.save(shard())
    with pytest.raises(StoreError, match=rf"{field} .*may not be mixed"):
        store.load(replace(KEY, **{field: value}))


def test_reading_refuses_two_recordings_of_one_scene(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.save(shard(replace(KEY, solver="osqp", recording_digest="other")))
    with pytest.raises(StoreError, match="recording_digest 'other', but fake__daqp"):
        read_results(tmp_path)


def test_reading_refuses_two_versions_of_one_solver(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.save(shard(replace(KEY, arm="warm", versions="daqp 2.0")))
    with pytest.raises(StoreError, match=r"versions 'daqp 2\.0', but .* with 'daqp 1\.0'"):
        read_results(tmp_path)


def test_reading_refuses_two_time_limits(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.save(shard(replace(KEY, solver="osqp", time_limit=2.0)))
    with pytest.raises(StoreError, match=r"time_limit 2\.0, but .* with 1\.0"):
        read_results(tmp_path)


def test_a_mixture_is_refused_before_it_is_made(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.refuse_mixture([KEY, replace(KEY, solver="osqp", machine="another")])
    with pytest.raises(
        StoreError, match=r"osqp.*: to be made with time_limit 2\.0, but fake__daqp"
    ):
        store.refuse_mixture([replace(KEY, solver="osqp", time_limit=2.0)])


def test_what_is_made_again_goes_once_nothing_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.save(shard(replace(KEY, solver="osqp")))
    newer = replace(KEY, versions="daqp 2.0")
    with pytest.raises(StoreError, match="to be made with time_limit"):
        store.refuse_mixture([replace(newer, time_limit=2.0)], ["daqp"])
    assert len(read_results(tmp_path)["solver"].unique()) == 2
    store.refuse_mixture([newer], ["daqp"])
    assert list(read_results(tmp_path)["solver"].unique()) == ["osqp"]


def test_who_could_not_be_imported_is_tried_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard(replace(KEY, versions=NOT_KNOWN)))
    store.refuse_mixture([KEY])
    assert store.load(KEY) is None
    store.save(shard())
    store.save(shard(replace(KEY, arm="warm", versions=NOT_KNOWN)))
    assert set(read_results(tmp_path)["versions"]) == {KEY.versions, NOT_KNOWN}


def test_machines_may_mix_when_read(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    store.save(shard(replace(KEY, arm="warm", machine="another")))
    assert set(read_results(tmp_path)["machine"]) == {"a machine", "another"}


def test_half_written_files_are_not_read(tmp_path: Path) -> None:
    Store(tmp_path).save(shard())
    half = tmp_path / "solves" / ".fake__osqp__paper__cold.parquet.1.tmp"
    half.write_bytes(b"PAR1 half")
    assert len(read_results(tmp_path)) == 3


def test_damaged_and_foreign_shards_are_named(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    path = tmp_path / "solves" / f"{KEY.name}.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StoreError, match=r"seal is missing .*delete it and replay again"):
        read_results(tmp_path)
    with pytest.raises(StoreError, match="seal is missing"):
        store.load(KEY)
    pq.write_table(pa.table({"x": [1.0]}), path)
    with pytest.raises(StoreError, match=r"seal is missing .*foreign"):
        read_results(tmp_path)
    path.unlink()
    path.mkdir()
    with pytest.raises(StoreError, match="is no file"):
        read_results(tmp_path)


def test_a_write_that_fails_leaves_the_old_shard(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard())
    wrong = replace(shard(), rows=[{**row, "step": "no number"} for row in shard().rows])
    with pytest.raises((ValueError, TypeError)):
        store.save(wrong)
    assert read_results(tmp_path)["step"].tolist() == [0, 1, 2]
    assert not list((tmp_path / "solves").glob(".*"))


def test_recordings_are_kept_once_and_never_replaced(tmp_path: Path) -> None:
    store = Store(tmp_path)
    made = fake_recording()
    store.add_recording(made)
    path = tmp_path / "recordings" / "fake.h5"
    before = path.stat().st_mtime_ns
    store.add_recording(replace(made, code_version="later"))
    assert path.stat().st_mtime_ns == before
    with pytest.raises(StoreError, match="another recording of this scene"):
        store.add_recording(replace(made, eps=2e-3))
    path.write_bytes(b"damaged")
    with pytest.raises(StoreError, match="use another results folder"):
        store.add_recording(made)


def test_an_empty_folder_has_no_rows(tmp_path: Path) -> None:
    assert len(read_results(tmp_path)) == 0
    assert list(read_results(tmp_path).columns) == list(COLUMNS)


HOLD = """
import sys, time
from harness.results.store import Store
store = Store(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


HOLD_AND_FORK = """
import os, sys, time
from harness.results.store import Store
store = Store(sys.argv[1])
print("held", flush=True)
if child := os.fork():
    print(child, flush=True)
time.sleep(60)
"""


def other_process(folder: Path, program: str = HOLD) -> subprocess.Popen[str]:
    """A process that holds the folder."""
    made = subprocess.Popen(
        [sys.executable, "-c", program, str(folder)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert made.stdout is not None and made.stdout.readline() == "held\n"
    return made


def test_one_process_writes_at_a_time_and_a_dead_one_locks_nobody_out(tmp_path: Path) -> None:
    holder = other_process(tmp_path)
    try:
        words = rf"another study \(process {holder.pid}\) is writing there; wait"
        with pytest.raises(Locked, match=words):
            Store(tmp_path)
        assert len(read_results(tmp_path)) == 0  # readers need no lock
    finally:
        holder.kill()
        holder.communicate()
    assert (tmp_path / ".lock").read_text() == str(holder.pid)  # left behind
    Store(tmp_path).save(shard())


def test_a_process_shares_its_lock_and_gives_it_back(tmp_path: Path) -> None:
    first, second = Store(tmp_path), Store(tmp_path / "." / "solves" / "..")
    first.save(shard())
    second.save(shard(replace(KEY, arm="warm")))
    del first, second
    holder = other_process(tmp_path)
    holder.kill()
    holder.communicate()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
def test_a_child_that_outlives_its_study_locks_nobody_out(tmp_path: Path) -> None:
    holder = other_process(tmp_path, HOLD_AND_FORK)
    try:
        assert holder.stdout is not None
        child = int(holder.stdout.readline())
        with pytest.raises(Locked):
            Store(tmp_path)
        holder.kill()
        holder.wait()
        Store(tmp_path).save(shard())
        os.kill(child, 0)  # it was there all the time
    finally:
        holder.kill()
        os.kill(child, signal.SIGKILL)
        holder.communicate()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("kind", ["link", "dangling", "other name", "folder", "pipe", "notes"])
def test_a_lock_that_is_somebody_elses_is_left_alone(tmp_path: Path, kind: str) -> None:
    folder, lock, precious = tmp_path / "study", tmp_path / "study" / ".lock", tmp_path / "precious"
    folder.mkdir()
    precious.write_text("precious")
    make: dict[str, Callable[[], object]] = {
        "link": lambda: lock.symlink_to(precious),
        "dangling": lambda: lock.symlink_to(tmp_path / "absent"),
        "other name": lambda: lock.hardlink_to(precious),
        "folder": lock.mkdir,
        "pipe": lambda: os.mkfifo(lock),
        "notes": lambda: lock.write_text("12 notes of mine"),
    }
    make[kind]()
    with pytest.raises(ForeignLock, match=r"\.lock: is no lock of glambda; remove it"):
        Store(folder)
    assert precious.read_text() == "precious" and not (tmp_path / "absent").exists()
    assert kind != "notes" or lock.read_text() == "12 notes of mine"


def test_a_temporary_of_somebody_else_is_not_written_through(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("precious")
    (tmp_path / f".x.{os.getpid()}.tmp").symlink_to(precious)
    whole_files.write_whole(tmp_path / "x", b"content")
    assert precious.read_text() == "precious"
    assert (tmp_path / "x").read_bytes() == b"content" and not (tmp_path / "x").is_symlink()


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "solves").write_text("x")
    with pytest.raises(StoreError, match=r"solves: is no folder; move it away"):
        Store(tmp_path)


SECONDS = {"resolution": 1e-8, "empty_call": 1e-6, "empty_runtime": 1e-6}
STRANGE: tuple[Any, ...] = (None, True, -1, 10**400, float("inf"), "", "x", [], [[]], {"a": {}})


def test_study_json_is_what_it_should_be_or_refused_by_name(tmp_path: Path) -> None:
    assert read_study(tmp_path) == {}
    path, sound = tmp_path / "study.json", {"clock": SECONDS, "study": "ab", "machine": {"n": 2}}
    path.write_text(json.dumps(sound))
    assert read_study(tmp_path) == sound
    wrong = [{**sound, name: value} for name in sound for value in STRANGE]
    wrong += [{**sound, "clock": {**SECONDS, n: v}} for n in SECONDS for v in STRANGE]
    refused = 0
    for each in [*wrong, *STRANGE]:
        path.write_text(json.dumps(each))
        try:
            read = read_study(tmp_path)
        except StoreError as error:
            assert str(path) in str(error) and "delete it" in str(error)
            assert "\n" not in str(error)
            refused += 1
        else:  # a text may be any, and so may names and values
            assert isinstance(read.get("study", ""), str)
            assert isinstance(read.get("machine", {}), dict)
            assert all(0 <= float(seconds) < np.inf for seconds in read.get("clock", {}).values())
    assert refused > 0.7 * len(wrong)


def test_a_study_json_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    path.symlink_to("/dev/zero")
    with pytest.raises(StoreError, match=r"study.json: is no file"):
        read_study(tmp_path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(StoreError, match=r"study.json: is no file"):
        read_study(tmp_path)
    path.unlink()
    path.write_text("[" * 1_000_000)
    with pytest.raises(StoreError, match=r"nested too deep; delete it"):
        read_study(tmp_path)


def test_what_was_spent_adds_up_and_a_changed_number_is_noticed(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for _ in range(2):
        store.add_spent({"replaying": 2.0, "in_calls": 1.0})
    assert read_spent(tmp_path) == {"replaying": 4.0, "in_passes": 0.0, "in_calls": 2.0}
    path = tmp_path / "spent.json"
    path.write_bytes(path.read_bytes().replace(b"4.0", b"5.0"))
    for read in (lambda: read_spent(tmp_path), lambda: Store(tmp_path)):
        with pytest.raises(StoreError, match=r"spent.json: its seal is missing or wrong"):
            read()
    path.write_bytes(sealed_json({"replaying": "x", "in_passes": 0.0, "in_calls": 2.0}))
    with pytest.raises(StoreError, match="needs numbers of seconds"):
        read_spent(tmp_path)


def test_leftovers_of_killed_writers_are_cleared(tmp_path: Path) -> None:
    Store(tmp_path).save(shard())
    Store(tmp_path).add_recording(fake_recording())
    left = [tmp_path / part / ".x.1.tmp" for part in ("", "solves", "recordings")]
    for path in left:
        path.write_bytes(b"half")
    Store(tmp_path)
    assert not any(path.exists() for path in left)
    assert len(read_results(tmp_path)) == 3


class Refusing:
    """`os`, but for one function that fails at its n-th call."""

    def __init__(self, name: str, error: int, at: int = 1) -> None:
        self.name, self.error, self.left = name, error, at

    def __getattr__(self, name: str) -> object:
        if name != self.name:
            return getattr(os, name)
        return self.fail

    def fail(self, *arguments: object) -> object:
        self.left -= 1
        if self.left == 0:
            raise OSError(self.error, os.strerror(self.error))
        return getattr(os, self.name)(*arguments)


@pytest.mark.parametrize("name", ["fsync", "replace"])
@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EIO, errno.EDQUOT])
def test_a_disk_that_refuses_is_told_in_one_line_and_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, error: int
) -> None:
    store = Store(tmp_path)
    store.save(shard(passes=1))
    store.write_study({"a": 1})
    with monkeypatch.context() as patch:
        for write, target in (
            (lambda: store.save(shard(passes=2)), f"solves/{KEY.name}.parquet"),
            (lambda: store.write_study({"a": 2}), "study.json"),
            (lambda: store.add_recording(fake_recording()), "recordings/fake.h5"),
        ):
            patch.setattr(whole_files, "os", Refusing(name, error))
            with pytest.raises(StoreError, match=r"is kept: make room or give the right") as told:
                write()
            assert f"{target}: cannot be written ({os.strerror(error)})" in str(told.value)
            assert "\n" not in str(told.value)
    assert not list(tmp_path.rglob("*.tmp")) and not list(tmp_path.rglob("*.h5"))
    assert read_results(tmp_path)["repeats"].tolist() == [1, 1, 1]
    assert json.loads((tmp_path / "study.json").read_text()) == {"a": 1}
    store.save(shard(passes=2))
    assert read_results(tmp_path)["repeats"].tolist() == [2, 2, 2]


FULL = """
import resource, sys
from harness.results.store import Store, StoreError
from tests.fakes.fake_recordings import fake_recording
from tests.harness.results.test_store import shard
store = Store(sys.argv[1])
store.save(shard(passes=1))
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for write in (lambda: store.save(shard(passes=2)), lambda: store.add_recording(fake_recording())):
    try:
        write()
    except StoreError as error:
        print(error)
"""


def test_a_write_that_the_system_cuts_short_costs_nothing(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.count("cannot be written (File too large)") == 2
    assert read_results(tmp_path)["repeats"].tolist() == [1, 1, 1]
    assert not list(tmp_path.rglob("*.tmp")) and not list(tmp_path.rglob("*.h5"))


def test_a_folder_that_cannot_be_written_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match=r"cannot be written \((File exists|Not a directory)\)"):
        Store(tmp_path / "file")

    def read_only(*_: object) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(StoreError, match="Read-only file system"):
        Store(tmp_path)


def test_a_recording_cannot_be_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole_files, "os", Refusing("fsync", errno.ENOSPC))
    with pytest.raises(OSError, match="No space left") as caught:
        write_recording(tmp_path / "x.h5", fake_recording())
    assert caught.value.filename == str(tmp_path / "x.h5")
    assert list(tmp_path.iterdir()) == []


def test_clocks_and_ages_of_files_do_not_matter(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(shard(passes=1))
    path = tmp_path / "solves" / f"{KEY.name}.parquet"
    for when in (0, 2**31):
        os.utime(path, (when, when))
        loaded = store.load(KEY)
        assert loaded is not None and loaded.passes.shape[0] == 1


def test_long_texts_are_cut_and_whole_letters_kept(tmp_path: Path) -> None:
    rows = [{**row, "status_text": "xµ" * 5000} for row in shard().rows]
    Store(tmp_path).save(replace(shard(), rows=rows))
    (text,) = read_results(tmp_path)["status_text"].unique()
    assert text[-1] == "…" and ("xµ" * 5000).startswith(text[:-1])
    assert 1990 < len(text.encode()) <= 2000


def test_a_shard_without_rows_is_kept(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.save(Shard(KEY, [], np.empty((2, 0, 7)), [Unrest()] * 2))
    loaded = store.load(KEY)
    assert loaded is not None and loaded.passes.shape == (2, 0, 7) and not len(loaded.rows)
    assert len(read_results(tmp_path)) == len(read_repeats(tmp_path)) == 0
