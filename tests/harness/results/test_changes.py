"""What changed between two studies: refusals, verdicts, work counts, times."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from glambda.cli import app
from harness.machine.unrest import Unrest
from harness.results.changes import compare_results
from harness.results.shard_file import TIMES
from harness.results.store import Shard, ShardKey, Store, StoreError

SOLVERS = ("daqp", "glambda", "osqp", "piqp")
ARMS = ("cold", "warm")
QPS = 40


def key(solver: str, arm: str, scene: str = "fake") -> ShardKey:
    return ShardKey(scene, f"digest of {scene}", solver, "high", arm, "1.0", "a machine", 1.0)


def shard(of: ShardKey, seed: int) -> Shard:
    """Three passes over QPs, of noisy times, verified, with exact work counts."""
    rng = np.random.default_rng(seed)
    rows = [
        {
            "problem": f"{of.scene}/{i:06d}",
            "step": i,
            "found": True,
            "verdict": "verified",
            "iterations": 5 + i % 3,
            "flops": 100 * (1 + i) if of.solver == "glambda" else None,
        }
        for i in range(QPS)
    ]
    passes = np.empty((3, QPS, len(TIMES)))
    passes[...] = 1e-6 * (1 + np.arange(QPS))[:, None] * rng.lognormal(0, 0.03, passes.shape)
    passes[:, :, TIMES.index("pace")] = 4e-4
    return Shard(of, rows, passes, [Unrest()] * 3, "study")


Change = Callable[[Shard], Shard | None]


def write(folder: Path, seed: int, change: Change = lambda made: made) -> Path:
    """A study, with its shards changed."""
    store = Store(folder)
    for i, solver in enumerate(SOLVERS):
        for j, arm in enumerate(ARMS):
            made = change(shard(key(solver, arm), 100 * seed + 10 * i + j))
            if made is not None:
                store.save(made)
    return folder


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return write(tmp_path / "before", 1)


def only(solver: str, change: Change) -> Change:
    return lambda made: change(made) if made.key.solver == solver else made


def with_rows(made: Shard, **values: Callable[[int, Any], Any]) -> Shard:
    """The shard with entries of its rows changed: value → function(position, value)."""
    rows = [
        dict(row) | {name: of(i, row[name]) for name, of in values.items()}
        for i, row in enumerate(made.rows)
    ]
    return replace(made, rows=rows)


def slowed(made: Shard, factor: float) -> Shard:
    """The shard with longer times; the machine keeps its pace."""
    factors = np.where(np.arange(len(TIMES)) == TIMES.index("pace"), 1.0, factor)
    return replace(made, passes=factors * made.passes)


def with_key(made: Shard, **fields: Any) -> Shard:
    return replace(made, key=replace(made.key, **fields))


def test_two_studies_alike_agree(before: Path, tmp_path: Path) -> None:
    changes = compare_results(before, write(tmp_path / "after", 2))
    assert changes.regressions == [] and changes.remarks == ()
    assert len(changes.times) == 8 and (changes.times["qps"] == QPS).all()
    assert not len(changes.counts) and not len(changes.verdicts)
    assert changes.pace == 1.0 and changes.disturbed == 0
    assert (changes.times["low"] < 1).all() and (changes.times["high"] > 1).all()


def test_a_slowdown_of_a_fifth_is_found(before: Path, tmp_path: Path) -> None:
    after = write(tmp_path / "after", 2, only("osqp", lambda m: slowed(m, 1.2)))
    changes = compare_results(before, after)
    assert [name for name, r in changes.ratios.solvers.items() if r.slower] == ["osqp"]
    assert "1 slower solvers" in changes.regressions
    faster = compare_results(after, before)
    assert faster.regressions == [] and faster.ratios.solvers["osqp"].faster


@pytest.mark.parametrize(("rise", "risen"), [(1.05, True), (1.01, False), (0.9, False)])
def test_a_rise_of_work_counts_is_found(
    before: Path, tmp_path: Path, rise: float, risen: bool
) -> None:
    more = only("glambda", lambda m: with_rows(m, flops=lambda i, n: int(rise * n)))
    changes = compare_results(before, write(tmp_path / "after", 2, more))
    assert set(changes.counts["work"]) == {"flops"}
    assert set(changes.counts["solver"]) == {"glambda"}
    assert (changes.counts["risen"] == risen).all()
    assert changes.regressions == (["2 risen work counts"] if risen else [])


def test_counts_that_were_zero_or_unknown(before: Path, tmp_path: Path) -> None:
    none = write(tmp_path / "none", 1, lambda m: with_rows(m, iterations=lambda i, n: 0))
    changes = compare_results(none, before)
    assert (changes.counts["ratio"] == np.inf).all() and changes.counts["risen"].all()
    unknown = write(tmp_path / "unknown", 1, lambda m: with_rows(m, iterations=lambda i, n: None))
    assert not len(compare_results(unknown, before).counts)


def test_a_qp_that_is_no_longer_verified_is_a_regression(before: Path, tmp_path: Path) -> None:
    worse = only("daqp", lambda m: with_rows(m, verdict=lambda i, v: "inaccurate" if i < 3 else v))
    after = write(tmp_path / "after", 2, worse)
    changes = compare_results(before, after)
    assert changes.verdicts[["arm", "before", "after", "qps", "lost"]].values.tolist() == [
        [arm, "verified", "inaccurate", 3, True] for arm in ARMS
    ]
    assert changes.regressions == ["6 QPs no longer verified"]
    assert changes.times.loc[changes.times["solver"] == "daqp", "qps"].tolist() == [QPS - 3] * 2
    better = compare_results(after, before)
    assert better.regressions == [] and not better.verdicts["lost"].any()


def test_what_only_one_has_is_told(before: Path, tmp_path: Path) -> None:
    after = write(
        tmp_path / "after",
        2,
        lambda m: None if m.key.solver == "osqp" or m.key.name.endswith("piqp__high__warm") else m,
    )
    remarks = compare_results(before, after).remarks
    assert remarks == ("gone solvers: osqp", "gone runs: 1, such as fake high warm piqp")
    assert compare_results(after, before).remarks[0] == "new solvers: osqp"


def test_other_versions_are_told(before: Path, tmp_path: Path) -> None:
    after = write(tmp_path / "after", 2, only("piqp", lambda m: with_key(m, versions="2.0")))
    assert compare_results(before, after).remarks == ("piqp: 1.0; then 2.0",)


def test_times_of_two_machines_are_not_compared(before: Path, tmp_path: Path) -> None:
    def elsewhere(made: Shard) -> Shard:
        return with_key(slowed(made, 3.0), machine="another")

    changes = compare_results(before, write(tmp_path / "after", 2, elsewhere))
    assert changes.regressions == [] and changes.ratios.solvers == {}
    assert changes.times["ratio"].isna().all() and np.isnan(changes.pace)
    assert "machine: a machine; then another; times of two machines" in changes.remarks[0]


def test_disturbed_passes_are_left_out(before: Path, tmp_path: Path) -> None:
    """A neighbour slows down some passes, and the calibration before them."""

    def disturbed(passes: int) -> Change:
        def change(made: Shard) -> Shard:
            times = made.passes.copy()
            times[:passes] *= 1.8
            return replace(made, passes=times)

        return only("daqp", change)

    changes = compare_results(before, write(tmp_path / "one", 2, disturbed(1)))
    assert changes.disturbed == 0 and changes.regressions == []
    changes = compare_results(before, write(tmp_path / "two", 2, disturbed(2)))
    assert changes.disturbed == 2 and "daqp" not in changes.ratios.solvers
    assert changes.regressions == []

    def told(made: Shard) -> Shard:
        slow = np.concatenate([made.passes, 5.0 * made.passes[:2]])
        slow[:, :, TIMES.index("pace")] = 4e-4
        noisy = Unrest(seconds=1.0, steal=0.5)
        return replace(made, passes=slow, unrest=[*made.unrest, noisy, noisy])

    changes = compare_results(before, write(tmp_path / "three", 2, told))
    assert changes.disturbed == 0 and changes.regressions == []


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"recording_digest": "other"}, "scenes, with their digests only in the first"),
        ({"scene": "elsewhere"}, "scenes, with their digests only in the first"),
        ({"settings": "paper"}, "settings only in the first: high; only in the second: paper"),
        ({"time_limit": 2.0}, "limits of time only in the first: 1 s; only in the second: 2 s"),
        ({"memory_limit": 1.0}, "limits of memory"),
    ],
)
def test_other_problems_are_refused(
    before: Path, tmp_path: Path, fields: dict[str, Any], words: str
) -> None:
    def otherwise(made: Shard) -> Shard:
        scene = fields.get("scene", "fake")
        rows = [dict(row) | {"problem": f"{scene}/{i:06d}"} for i, row in enumerate(made.rows)]
        return with_key(replace(made, rows=rows), **fields)

    after = write(tmp_path / "after", 2, otherwise)
    with pytest.raises(StoreError, match=rf"not the same problems: {re.escape(words)}"):
        compare_results(before, after)


def test_a_folder_without_results_is_refused(before: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="holds no results"):
        compare_results(before, tmp_path / "nowhere")


def glambda(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command(before: Path, tmp_path: Path) -> None:
    same = glambda("compare", before, write(tmp_path / "same", 2), "--all")
    assert same.exit_code == 0, same.output
    assert "nothing became worse in 8 runs" in same.output
    assert same.output.count("fake") == 8 and "what all 4 packages share" in same.output
    worse = only("osqp", lambda m: slowed(m, 1.5))
    after = write(tmp_path / "after", 2, worse)
    found = glambda("compare", before, after)
    assert found.exit_code == 1, found.output
    assert "WORSE: 1 slower solvers, 2 slower runs" in found.output
    lost = only(
        "piqp",
        lambda m: with_rows(m, verdict=lambda i, v: "crashed", iterations=lambda i, n: 2 * n),
    )
    found = glambda("compare", before, write(tmp_path / "lost", 2, lost))
    assert found.exit_code == 1
    assert "crashed" in found.output and "lost" in found.output and "risen" in found.output
    refused = glambda("compare", before, tmp_path / "nowhere")
    assert refused.exit_code == 2 and "holds no results" in refused.output
