"""What changed between two results folders of the same problems.

1. The problems must be the same: scenes by the digests of their recordings, settings, limits of
   time and memory.  Otherwise it is refused.  Other versions and machines are told.
2. **Verdicts.** A QP that was verified and is no longer is a regression.
3. **Work counts** are exact.  Their sum over the QPs that both have solved may rise by `MAY_RISE`,
   which leaves room for what another rounding does.
4. **Times**, of the QPs that are verified in both and on the same machine
   (`harness.results.time_ratios`): a regression is a ratio whose whole interval lies above 1.
   Passes before which a fixed piece of work took more than `DISTURBED` times its median are left
   out: somebody else was at work.  A run of which not most passes are left is not compared.
5. Runs that only one of them has are listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from harness.results.shard_file import TIMES, StoredShard, StoreError, runtimes
from harness.results.store import read_shards
from harness.results.time_ratios import ComparedRun, TimeRatios, time_ratios
from problems.qp import WorkCounts

PACE = TIMES.index("pace")
COUNTS = ("iterations", *WorkCounts.__dataclass_fields__)
MAY_RISE = 0.02
"""Share by which a sum of work counts may rise."""
DISTURBED = 1.2


class Name(NamedTuple):
    """Which run: a solver in an arm on a recording at a setting."""

    scene: str
    settings: str
    arm: str
    solver: str


Shards = Mapping[Name, StoredShard]


@dataclass(frozen=True)
class Changes:
    """What `compare_results` found.  Each table has the columns of `Name`, and

    times : qps (that are compared), before, after [s] (medians of the QPs' least times), ratio,
        low, high (relative to the machine's); NaN where times are not judged
    counts : work (which), before, after, ratio, risen; only of those that differ
    verdicts : before, after, qps, lost; only of those that differ

    ratios : the machine's ratio and the solvers'
    pace : ratio of the fixed piece of work that is timed before every pass; NaN if unknown
    disturbed : runs that are not compared in time since most of their passes were disturbed
    remarks : sentences on versions, machines and runs that are not the same
    """

    times: pd.DataFrame
    counts: pd.DataFrame
    verdicts: pd.DataFrame
    ratios: TimeRatios
    pace: float
    disturbed: int
    remarks: tuple[str, ...]

    @property
    def regressions(self) -> list[str]:
        """What has become worse, in a few words each; empty if nothing has."""
        found = {
            "slower solvers": sum(ratio.slower for ratio in self.ratios.solvers.values()),
            "slower runs": int((self.times["low"] > 1.0).sum()),
            "risen work counts": int(self.counts["risen"].sum()),
            "QPs no longer verified": int(self.verdicts.loc[self.verdicts["lost"], "qps"].sum()),
        }
        return [f"{count} {what}" for what, count in found.items() if count]


def compare_results(first: str | Path, second: str | Path) -> Changes:
    """Compare two results folders, `first` being the measure.

    Raises StoreError for a folder without results, a damaged one, or one of other problems.
    """
    a, b = _shards(Path(first)), _shards(Path(second))
    _refuse_other_problems(a, b)
    both = [name for name in a if name in b]
    sides = [_calm(shards) for shards in (a, b)]
    runs: list[ComparedRun] = []
    times: list[dict[str, Any]] = []
    counts: list[dict[str, Any]] = []
    verdicts: list[dict[str, Any]] = []
    for name in both:
        before, after = a[name].rows.to_pandas(), b[name].rows.to_pandas()
        if not before["problem"].equals(after["problem"]):
            raise StoreError(f"{second}: the QPs of {' '.join(name)} are not those of {first}")
        verified = (before["verdict"] == "verified") & (after["verdict"] == "verified")
        compared = verified.to_numpy() & (a[name].key.machine == b[name].key.machine)
        run = ComparedRun(
            name.solver,
            (name.scene, name.settings),
            *(np.where(compared, side[name], np.nan) for side in sides),
        )
        runs.append(run)
        times.append(name._asdict() | _typical(run))
        counts.extend(name._asdict() | row for row in _changed_counts(before, after))
        verdicts.extend(name._asdict() | row for row in _changed_verdicts(before, after))
    ratios = time_ratios(runs)
    for row, ratio in zip(times, ratios.runs, strict=True):
        row |= ratio._asdict()
    return Changes(
        _table(times, "qps", "before", "after", "ratio", "low", "high"),
        _table(counts, "work", "before", "after", "ratio", "risen"),
        _table(verdicts, "before", "after", "qps", "lost"),
        ratios,
        _pace([(a[name], b[name]) for name in both]),
        sum(any(np.isnan(side[name]).all() for side in sides) for name in both),
        tuple(_remarks(a, b)),
    )


def _table(rows: list[dict[str, Any]], *columns: str) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=[*Name._fields, *columns])


def _shards(folder: Path) -> Shards:
    shards = {}
    for shard in read_shards(folder):
        name = Name(*(getattr(shard.key, field) for field in Name._fields))
        shards[name] = shard._replace(rows=shard.rows.select(["problem", "verdict", *COUNTS]))
    if not shards:
        raise StoreError(f"{folder}: holds no results; give a folder of 'glambda replay'")
    return dict(sorted(shards.items()))


def _refuse_other_problems(a: Shards, b: Shards) -> None:
    for what, of in (
        ("scenes, with their digests", lambda key: f"{key.scene} {key.recording_digest[:12]}…"),
        ("settings", lambda key: key.settings),
        ("limits of time", lambda key: f"{key.time_limit:g} s"),
        ("limits of memory", lambda key: f"{key.memory_limit:g} GiB"),
    ):
        one, other = ({of(shard.key) for shard in shards.values()} for shards in (a, b))
        if one != other:
            raise StoreError(
                f"these are not the same problems: {what} only in the first: "
                f"{_listed(one - other)}; only in the second: {_listed(other - one)}; "
                "replay the same recordings in the same way"
            )


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _calm(shards: Shards) -> dict[Name, NDArray[np.float64]]:
    """(passes, n) times [s] of the passes that were not disturbed; of none, NaN."""
    paces: dict[str, list[float]] = {}
    for shard in shards.values():
        paces.setdefault(shard.key.machine, []).extend(_paces(shard))
    usual = {machine: np.median(known) if known else np.nan for machine, known in paces.items()}
    found = {}
    for name, shard in shards.items():
        passes = shard.counted
        times, pace = runtimes(passes), passes[:, :, PACE]
        calm = np.array([not (of > DISTURBED * usual[shard.key.machine]).any() for of in pace])
        found[name] = times[calm] if 2 * calm.sum() > len(calm) else np.full(times.shape, np.nan)
    return found


def _paces(shard: StoredShard) -> list[float]:
    """What the fixed piece of work took before each pass, as far as it is known [s]."""
    pace = shard.counted[:, :, PACE]
    known = pace[np.isfinite(pace).any(axis=1)]
    return np.nanmedian(known, axis=1).tolist() if len(known) else []


def _typical(run: ComparedRun) -> dict[str, float]:
    """Number of QPs that are compared, and the medians of their least times."""
    least = np.array([run.before.min(axis=0), run.after.min(axis=0)])
    known = least[:, np.isfinite(least).all(axis=0)]
    qps = known.shape[1]
    before, after = np.median(known, axis=1) if qps else (np.nan, np.nan)
    return {"qps": qps, "before": before, "after": after}


def _changed_counts(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[dict[str, Any]]:
    for count in COUNTS:
        both = before[count].notna() & after[count].notna()
        old, new = int(before.loc[both, count].sum()), int(after.loc[both, count].sum())
        if old != new:
            ratio = new / old if old else np.inf
            risen = ratio > 1 + MAY_RISE
            yield {"work": count, "before": old, "after": new, "ratio": ratio, "risen": risen}


def _changed_verdicts(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[dict[str, Any]]:
    pairs = zip(before["verdict"], after["verdict"], strict=True)
    changed = pd.Series([(old, new) for old, new in pairs if old != new], dtype=object)
    for (old, new), qps in changed.value_counts().items():
        yield {"before": old, "after": new, "qps": qps, "lost": old == "verified"}


def _pace(pairs: list[tuple[StoredShard, StoredShard]]) -> float:
    """Median over the runs of the ratio of what the fixed piece of work took."""
    known = [
        np.log(np.median(_paces(after)) / np.median(_paces(before)))
        for before, after in pairs
        if before.key.machine == after.key.machine and _paces(before) and _paces(after)
    ]
    return float(np.exp(np.median(known))) if known else np.nan


def _remarks(a: Shards, b: Shards) -> Iterator[str]:
    one, other = ([shard.key for shard in shards.values()] for shards in (a, b))
    machines = [_listed({key.machine for key in keys}) for keys in (one, other)]
    if machines[0] != machines[1]:
        yield f"machine: {machines[0]}; then {machines[1]}; times of two machines are not compared"
    versions = [{key.solver: key.versions for key in keys} for keys in (one, other)]
    for solver in sorted(versions[0].keys() & versions[1].keys()):
        before, after = (of[solver] for of in versions)
        if before != after:
            yield f"{solver}: {before}; then {after}"
    for what, more, fewer in (("gone", a, b), ("new", b, a)):
        alone = [name for name in more if name not in fewer]
        solvers = {name.solver for name in more} - {name.solver for name in fewer}
        if solvers:
            yield f"{what} solvers: {_listed(solvers)}"
        left = [name for name in alone if name.solver not in solvers]
        if left:
            yield f"{what} runs: {len(left)}, such as {' '.join(left[0])}"
