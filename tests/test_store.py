"""The results folder: shards are whole or absent, and never mix."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from harness.shard_file import summarise
from harness.store import (
    COLUMNS,
    REPEAT_COLUMNS,
    Shard,
    ShardKey,
    Store,
    StoreError,
    read_repeats,
    read_results,
)
from tests.fake_recordings import fake_recording

KEY = ShardKey("fake", "abc", "daqp", "paper", "cold", "daqp 1.0", "a machine", 1.0)
TIMES = np.array(
    [
        [[1.0, 2.0, 3.0, 7.0], [1.0, 1.0, 1.0, 4.0], [np.nan] * 4],
        [[1.0, 1.0, 1.0, 4.0], [1.0, 5.0, 5.0, 12.0], [np.nan] * 4],
        [[1.0, 4.0, 4.0, 9.0], [1.0, 2.0, 2.0, 6.0], [np.nan] * 4],
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
    return Shard(key, rows, TIMES[:passes], "study1")


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
    out = summarise(TIMES)
    np.testing.assert_array_equal(out["runtime"], [2.0, 2.0, np.nan])
    np.testing.assert_array_equal(out["runtime_median"], [5.0, 4.0, np.nan])
    np.testing.assert_array_equal(out["call_time"], [4.0, 4.0, np.nan])  # of the same pass
    np.testing.assert_array_equal(out["repeats"], [3, 3, 3])


def test_a_call_that_raised_counts_as_a_whole() -> None:
    times = np.array([[[np.nan, np.nan, np.nan, 0.5]]])
    assert summarise(times)["runtime"] == [0.5]


def test_load_gives_back_what_was_saved(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.load(KEY) is None
    store.save(shard(passes=2))
    loaded = store.load(KEY)
    assert loaded is not None
    np.testing.assert_array_equal(loaded.passes, TIMES[:2])
    store.save(replace(loaded, passes=TIMES))
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
    with pytest.raises(StoreError, match=r"cannot be read .*delete it and replay again"):
        read_results(tmp_path)
    with pytest.raises(StoreError, match="cannot be read"):
        store.load(KEY)
    pq.write_table(pa.table({"x": [1.0]}), path)
    with pytest.raises(StoreError, match="no shard"):
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
