"""What a warm start is worth, apart from what a kept object is.

A package in a sequence gains in two ways, and a warm start is one of them only:

    object   from cold, where its object is made afresh, to kept, where it is updated with today's
             data and told to start from nothing
    start    from kept to warm, where it starts from the last answer, too

Clarabel, PIQP and HiGHS carry no x: what is called their warm arm is kept.  Ratios are geometric
means over the QPs that do not follow a restart and are verified in every arm, with an interval from
resampling (`reports.parts.intervals`).

Whether a start is *used* shows in what it saves where little has changed.  With X_n the rows at
their bounds at the reference x* of QP n, each with its bound, |X_n Δ X_{n−1}| counts what a start
has wrong; iterations and time of the warm arm are fitted by a line in it, scene by scene.  Who
starts warm with as many iterations as cold even where nothing has changed ignores the hint, or has
a cold start that is as good.  A slope that fewer than `FEWEST` changes tell is not told.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from problems.qp import AT_LOWER, AT_UPPER, working_set_of
from problems.sequence import WARM_KINDS
from reports.parts.intervals import SURE, geometric_mean, line
from reports.parts.names import solver_order
from reports.parts.sentences import Answer, join
from reports.parts.table import Table, microseconds, percent, short, times, whole
from reports.rows.comparison import shifted_geometric_mean
from reports.rows.results import METHOD, Results
from reports.sections.tables import SLOWER

COLUMNS = ("runtime", "iterations", "verified")
IGNORED = 0.9
"""Iterations at no change over cold ones, from which on a hint is ignored."""
FEWEST = 5
"""QPs with a change below which there is no slope."""


def triples(results: Results, setting: str) -> pd.DataFrame:
    """Cold, kept and warm side by side, one row per (scene, solver, problem).

    Columns end in _cold, _kept and _warm; those of warm are NaN for who carries no x.  Empty where
    the arm `kept` was not run.
    """
    rows = results.everything
    rows = rows[(rows["settings"] == setting) & ~rows["skipped"] & (rows["k"] > 0)]
    if not (rows["arm"] == "kept").any():
        return pd.DataFrame()
    key = ["scene", "solver", "problem"]
    started = rows["warm_started"].astype(bool) & ~rows["after_restart"].astype(bool)
    arms = {
        arm: rows[(rows["arm"] == arm) & (started | (arm == "cold"))].set_index(key)[[*COLUMNS]]
        for arm in ("cold", "kept", "warm")
    }
    with_x = set(arms["kept"].index.get_level_values("solver"))
    carries = arms["warm"].index.get_level_values("solver").isin(with_x)
    object_only = arms["warm"][~carries]
    kept = pd.concat([arms["kept"], object_only])
    both = arms["cold"].add_suffix("_cold").join(kept.add_suffix("_kept"), how="inner")
    made = both.join(arms["warm"][carries].add_suffix("_warm"), how="left").reset_index()
    made["carries_x"] = made["solver"].isin(with_x)
    sound = made["verified_cold"] & made["verified_kept"]
    sound &= ~made["carries_x"] | (made["verified_warm"] == True)  # noqa: E712  NaN where not run
    return made[sound].sort_values(key, kind="stable").reset_index(drop=True)


def split(pairs: pd.DataFrame) -> pd.DataFrame:
    """One row per solver: what its object, its start and both are worth."""
    rows = []
    for solver in sorted(pairs["solver"].unique(), key=solver_order):
        part = pairs[pairs["solver"] == solver]
        kept = geometric_mean(part["runtime_kept"] / part["runtime_cold"])
        start = geometric_mean(part["runtime_warm"] / part["runtime_kept"])
        last = part["runtime_warm" if part["carries_x"].any() else "runtime_kept"]
        rows.append(
            {
                "solver": solver,
                "QPs": len(part),
                "cold mean": shifted_geometric_mean(part["runtime_cold"]),
                "object": kept.mean,
                "object, from": kept.low,
                "object, to": kept.high,
                "start": start.mean,
                "start, from": start.low,
                "start, to": start.high,
                "both": geometric_mean(last / part["runtime_cold"]).mean,
                "iterations, object": _over(part, "kept", "cold"),
                "iterations, start": _over(part, "warm", "kept"),
            }
        )
    return pd.DataFrame(rows)


def _over(part: pd.DataFrame, one: str, other: str) -> float:
    """Iterations in one arm over those in another; NaN where they are not known."""
    known = part[f"iterations_{one}"].notna()
    total = part.loc[known, f"iterations_{other}"].sum()
    return float(part.loc[known, f"iterations_{one}"].sum() / total) if total else np.nan


def split_table(results: Results, setting: str) -> Table | None:
    """What is the object's and what is the start's, over all scenes; None where it was not run."""
    pairs = triples(results, setting)
    if pairs.empty:
        return None
    data = split(pairs)
    return Table(
        name="warm_split",
        key={"setting": setting},
        title="A kept object, and a warm start",
        reading=(
            "Each backend against itself on the same QPs of all scenes, verified in every arm and "
            "not after a restart.  object: time with the object of the last solve, kept and "
            "updated but started from nothing, over that of a fresh one (cold mean, in µs).  "
            "start: time from the last answer over that from nothing, both with the kept object.  "
            f"both: warm over cold.  Ratios are geometric means with the range of {percent(SURE)} "
            "of resampled sequences; below 1 is a gain.  A dash: it carries no x."
        ),
        data=data,
        formats={"QPs": whole, "cold mean": microseconds, **dict.fromkeys(data.columns[3:], times)},
        notes=_carries(results, data),
    )


def _carries(results: Results, data: pd.DataFrame) -> list[str]:
    """Who carries what."""
    object_only = list(data.loc[data["start"].isna(), "solver"])
    without = [name for name in results.solvers if name not in set(data["solver"])]
    said = []
    if object_only:
        said.append(f"An object and no x is all that is carried by {join(object_only, 12)}.")
    if without:
        said.append(f"Nothing is carried by {join(without, 12)}.")
    return said


def warm_answer(results: Results) -> Answer | None:
    """What a start is worth to our method, and who gains most by what; None without `kept`."""
    setting = results.headline
    pairs = triples(results, setting) if setting is not None else pd.DataFrame()
    if pairs.empty:
        return None
    data = split(pairs).set_index("solver")
    starts = data["start"].dropna().sort_values(kind="stable")
    if starts.empty:
        return None
    objects = data["object"].sort_values(kind="stable")
    shown = METHOD if METHOD in starts.index else str(starts.index[0])
    own = data.loc[shown]
    said = [
        f"{shown} takes {short(own['object'])} of its cold time where it keeps its object, and of "
        f"that {short(own['start'])} where it starts from its last answer, too "
        f"({int(own['QPs']):,} QPs that do not follow a restart).",
        f"By the start {starts.index[0]} gains most ({short(starts.iloc[0])} of its time with a "
        f"kept object), by the object {objects.index[0]} ({short(objects.iloc[0])} of its time "
        "with a fresh one).",
    ]
    slower = [f"{name} ({short(ratio)})" for name, ratio in starts.items() if ratio > SLOWER]
    if slower:
        said.append(f"A start costs more than it saves for {join(slower)}.")
    said += _carries(results, data.reset_index())
    return Answer(
        "What is a warm start worth?",
        f"{short(own['start'])}×",
        f"the time of {shown} with its object kept",
        tuple(said),
        "warm-start",
    )


# Against the true change of the active set


def changes_of(recording: Any) -> dict[str, int]:
    """problem → |X_n Δ X_{n−1}|, for QPs with a predecessor and references of both."""
    found: dict[str, int] = {}
    before: set[tuple[int, int]] | None = None
    for i, (qp, known) in enumerate(zip(recording.qps, recording.references, strict=True)):
        if qp.kind not in WARM_KINDS:
            continue
        now = None
        if known is not None:
            members = working_set_of(qp, known.x)
            at_bound = (members == AT_LOWER) | (members == AT_UPPER)
            now = set(zip(qp.row_id[at_bound].tolist(), members[at_bound].tolist(), strict=True))
        if before is not None and now is not None and not qp.restart:
            found[f"{recording.scene}/{i:06d}"] = len(now ^ before)
        before = now
    return found


def change_rows(results: Results, setting: str) -> pd.DataFrame:
    """A line for each scene and solver: warm time and iterations against |X_n Δ X_{n−1}|."""
    rows = results.rows
    rows = rows[(rows["settings"] == setting) & rows["verified"] & (rows["k"] > 0)]
    cold = rows[rows["arm"] == "cold"].set_index(["solver", "problem"])
    warm = rows[(rows["arm"] == "warm") & rows["warm_started"].astype(bool)]
    out: list[Mapping[str, Any]] = []
    for scene, recording in results.recordings.items():
        changes = changes_of(recording)
        here = warm[warm["problem"].isin(list(changes))]
        for solver in sorted(here["solver"].unique(), key=solver_order):
            part = here[here["solver"] == solver]
            twin = cold.reindex(pd.MultiIndex.from_frame(part[["solver", "problem"]]))
            change = part["problem"].map(changes).to_numpy(float)
            known = change if (change > 0).sum() >= FEWEST else np.zeros(len(change))
            time, work = line(known, 1e6 * part["runtime"]), line(known, part["iterations"])
            usual = twin["iterations"].mean()
            out.append(
                {
                    "scene": scene,
                    "solver": solver,
                    "QPs": len(part),
                    "changed": change.mean(),
                    "µs at none": time.at_none,
                    "µs per row": time.slope,
                    "µs, from": time.low,
                    "µs, to": time.high,
                    "iterations at none": work.at_none,
                    "iterations per row": work.slope,
                    "iterations, from": work.low,
                    "iterations, to": work.high,
                    "of cold": work.at_none / usual if usual > 0 else np.nan,
                }
            )
    return pd.DataFrame(out)


def change_table(results: Results, setting: str) -> Table | None:
    """Who ignores hints; None where nothing was started warm with a recording at hand."""
    data = change_rows(results, setting)
    if data.empty:
        return None
    return Table(
        name="warm_change",
        key={"setting": setting},
        title="Warm starts against the true change of the active set",
        reading=(
            "changed is the mean of |X_n Δ X_{n−1}|, rows that enter or leave the set of those at "
            "a bound, by the references.  Time in µs and iterations of verified warm solves are "
            "fitted by a line in it: at none, where the start has every row right, and per row "
            f"that it has wrong, with the range of {percent(SURE)} of resampled sequences.  of "
            "cold: iterations at none over the cold ones."
        ),
        data=data,
        formats={"QPs": whole, **dict.fromkeys(data.columns[3:], short)},
        notes=_ignored(data),
    )


def _ignored(data: pd.DataFrame) -> list[str]:
    least = data.groupby("solver")["of cold"].min().dropna()
    ignored = [f"{name} ({short(least[name])})" for name in least.index if least[name] >= IGNORED]
    if not ignored:
        return ["Everybody uses the hint on some scene."]
    return [
        "Where no row has changed these still take as many iterations as a cold solve, on every "
        f"scene, so that the hint is ignored or saves nothing: {join(ignored, 12)}."
    ]
