"""Who wins outside: recordings that are not the paper's four scenes, apart from these.

They are of three sources: MuJoCo's own QPs, QPs that were imported, and families of scenes.  The
method was made for four scenes; here is what it is worth elsewhere, by the same rules: who is
fastest among those that are verified on every QP (`reports.rows.comparison`).  What was at hand
while the solvers were written is marked as seen (`SEEN`); nothing was tuned on the rest.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from harness.judging.recorded_answers import SETTING, recorded_answers
from harness.names import is_own
from problems.scenes.labels import PAPER_SCENES
from problems.scenes.registry import scene_kinds
from reports.parts.names import solver_order
from reports.parts.sentences import Answer, join
from reports.parts.style import BLUE, FAINT, INK, ORANGE, PAGE_WIDTH, SOFT, drawing, save
from reports.parts.table import Table, microseconds, percent, scientific, times, whole
from reports.rows.comparison import compare
from reports.rows.results import ARMS, Results

SOURCES = {"mujoco": "MuJoCo", "import": "imported"}
UNKNOWN = "unknown"
SEEN = (
    *("LIPMWALK", "HS35", "LISWET", "POWELL20", "BoxesStack", "Confeti", "Rover", "fclib_local"),
    *("fc2d_granularflowonwall", "Spheres", "2cubes"),
)
"""Parts of the names of sets of others that were at hand while the solvers were written."""
CLOCKS = {"solve_time": "solve", "runtime": "set-up and solve", "call_time": "whole call"}


def source_of(results: Results, scene: str) -> str | None:
    """Where a recording is from, or the kind of its scene; None for the paper's scenes."""
    name = scene.partition(",")[0]
    if name in PAPER_SCENES:
        return None
    recording = results.recordings.get(scene)
    source = "" if recording is None else str(recording.parameters.get("source", ""))
    kinds = (kind for kind, names in scene_kinds().items() if name in names)
    return SOURCES.get(source) or next(kinds, UNKNOWN)


def outside_scenes(results: Results) -> dict[str, str]:
    """Recording → source, of those that are not the paper's scenes, by source."""
    known = {scene: source_of(results, scene) for scene in results.scenes}
    found = {scene: source for scene, source in known.items() if source is not None}
    order = [*SOURCES.values(), *scene_kinds(), UNKNOWN]
    return dict(sorted(found.items(), key=lambda item: (order.index(item[1]), item[0])))


def outside_tables(results: Results) -> list[Table]:
    """A table for each setting; none where nothing is from outside."""
    scenes = outside_scenes(results)
    tables = []
    for setting in results.settings:
        rows = [row for scene in scenes for row in _rows(results, scene, scenes[scene], setting)]
        if rows:
            tables.append(_table(pd.DataFrame(rows), setting))
    return tables


def _rows(results: Results, scene: str, source: str, setting: str) -> list[dict[str, Any]]:
    seen = any(name in scene for name in SEEN) if source == SOURCES["import"] else False
    found: dict[str, dict[str, Any]] = {}
    for arm in ARMS:
        comparison = compare(results.rows, scene, setting, arm)
        if not len(comparison.rows):
            continue
        summary = comparison.summary()
        best = float(summary["median"][summary["best"]].min())
        for solver, line in summary.iterrows():
            if solver in comparison.without_warm:
                continue
            part = comparison.rows[comparison.rows["solver"] == solver]
            row = found.setdefault(
                str(solver),
                {
                    "scene": scene,
                    "source": source,
                    "seen": "yes" if seen else "no",
                    "QPs": comparison.qps,
                    "median k": float(part["k"].median()),
                    "solver": solver,
                },
            )
            row[f"verified, {arm}"] = line["verified"]
            for clock, name in CLOCKS.items():
                row[f"{name}, {arm}"] = float(part[clock].median())
            row[f"over the best, {arm}"] = line["median"] / best if np.isfinite(best) else np.nan
    for row in found.values():
        warm, cold = (row.get(f"set-up and solve, {arm}", np.nan) for arm in ("warm", "cold"))
        row["warm over cold"] = warm / cold
    return [found[solver] for solver in sorted(found, key=solver_order)]


def _table(data: pd.DataFrame, setting: str) -> Table:
    seconds = [f"{name}, {arm}" for name in CLOCKS.values() for arm in ARMS]
    shares = [f"verified, {arm}" for arm in ARMS]
    ratios = [*(f"over the best, {arm}" for arm in ARMS), "warm over cold"]
    for name in (*shares, *seconds, *ratios):
        if name not in data:
            data[name] = np.nan
    first = ["scene", "source", "seen", "QPs", "median k", "solver"]
    return Table(
        name="outside",
        key={"setting": setting},
        title="Who wins outside",
        reading=(
            "Recordings that are not the paper's scenes.  verified: share of the QPs with columns "
            "that the judge verified.  Times are medians in µs by three clocks: the "
            "package's solve alone, with its set-up or update, and the whole call from A, d and "
            "bounds.  over the best: the second of them over that of the fastest backend that is "
            "verified on every QP.  A backend without a warm arm has no warm time.  seen: whether "
            "the set was at hand while the solvers were written; nothing was tuned on the rest."
        ),
        data=data[[*first, *shares, *seconds, *ratios]],
        formats={
            "QPs": whole,
            "median k": whole,
            **dict.fromkeys(shares, percent),
            **dict.fromkeys(seconds, microseconds),
            **dict.fromkeys(ratios, times),
        },
        notes=_notes(data),
    )


def leads(data: pd.DataFrame, arm: str, clock: str = CLOCKS["runtime"]) -> pd.DataFrame:
    """One row per recording: the best of ours and of the others, of those that are verified.

    Columns: scene, ours, others (names), ratio (our time over theirs).
    """
    clock, share = f"{clock}, {arm}", f"verified, {arm}"
    out = []
    for scene, part in data.groupby("scene", sort=False):
        sound = part[(part[share] == 1.0) & part[clock].notna()]
        own = sound["solver"].map(is_own).astype(bool)
        if own.any() and (~own).any():
            ours, others = (sound[flag].set_index("solver")[clock] for flag in (own, ~own))
            ratio = float(ours.min() / others.min())
            out.append((scene, ours.idxmin(), others.idxmin(), ratio))
    return pd.DataFrame(out, columns=["scene", "ours", "others", "ratio"])


def _notes(data: pd.DataFrame) -> list[str]:
    notes = []
    for arm in ARMS:
        for clock in CLOCKS.values():
            for row in leads(data, arm, clock).itertuples():
                if row.ratio > 1:
                    notes.append(
                        f"On {row.scene}, {arm}, by the clock “{clock}”, {row.others} is faster: "
                        f"{row.ours} takes {row.ratio:.2g} times as long."
                    )
    missing = data[
        data["solver"].map(is_own) & (data[[c for c in data if "verified" in c]] < 1).any(axis=1)
    ]
    for row in missing.to_dict("records"):
        notes.append(f"On {row['scene']} {row['solver']} is not verified on every QP.")
    return notes


def answers_table(results: Results) -> Table | None:
    """What the answers are worth that came with recordings from outside; None without such."""
    out = []
    for scene, source in outside_scenes(results).items():
        recording = results.recordings.get(scene)
        found = (
            None
            if recording is None or source not in SOURCES.values()
            else recorded_answers(recording)
        )
        if found is not None:
            verified = found.verdicts.get("verified", 0) / found.answers
            out.append(
                {"scene": scene, "answers": found.answers, "verified": verified,
                 "KKT, median": found.kkt_median, "KKT, worst": found.kkt_worst,
                 "Gλ error, max": found.error_worst}
            )  # fmt: skip
    if not out:
        return None
    return Table(
        name="recorded_answers",
        title="The engine's own answers",
        reading=(
            "The forces that the engine itself found for the QPs, judged like any backend's at "
            f"setting {SETTING}.  KKT: largest violation of the optimality conditions, over the "
            "scale of the QP."
        ),
        data=pd.DataFrame(out),
        formats={"answers": whole, "verified": percent,
                 **dict.fromkeys(["KKT, median", "KKT, worst", "Gλ error, max"], scientific)},
    )  # fmt: skip


def outside_answer(tables: list[Table]) -> Answer | None:
    """The answer at the head of the page, by the warm arm of the first setting."""
    if not tables:
        return None
    data = tables[0].data
    found = leads(data, "warm")
    if found.empty:
        return None
    wins = found[found["ratio"] < 1]
    lost = found[found["ratio"] >= 1]
    sentences = []
    if len(wins):
        sentences.append(f"Ours is the fastest on {join(list(wins['scene']))}.")
    if len(lost):
        who = join(
            [f"{row.others} on {row.scene} ({row.ratio:.2g} times)" for row in lost.itertuples()]
        )
        sentences.append(f"Faster than ours is {who}.")
    return Answer(
        "Who wins on QPs that nobody here posed?",
        f"{len(wins)} of {len(found)}",
        "recordings from outside on which ours is the fastest when warm, of the backends that are "
        "verified on every QP",
        sentences,
        "outside",
    )


def plot_outside(table: Table, path: str | Path) -> Path:
    """Time of every verified backend over that of ours, a line for each recording, by arms.

    Left of 1 stands who is faster than ours.  Raises ValueError where there is nothing to compare.
    """
    arms = [arm for arm in ARMS if len(leads(table.data, arm))]
    if not arms:
        raise ValueError("no recording has ours and another backend verified on every QP")
    scenes = list(dict.fromkeys(table.data["scene"]))
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 1.1 + 0.34 * len(scenes)))
        panels = figure.subplots(1, len(arms), sharey=True, squeeze=False)[0]
        for axes, arm in zip(panels, arms, strict=True):
            _draw_arm(axes, table.data, scenes, arm)
        panels[0].set_yticks(range(len(scenes)), scenes)
        figure.supxlabel("time of a backend over that of ours; left of 1: faster", size=8.5)
        figure.tight_layout(pad=0.6)
        return save(figure, Path(path))


def _draw_arm(axes: Any, data: pd.DataFrame, scenes: list[str], arm: str) -> None:
    found = leads(data, arm).set_index("scene")
    clock = f"set-up and solve, {arm}"
    axes.set_xscale("log")
    axes.set_ylim(len(scenes) - 0.5, -0.5)
    axes.axvline(1.0, color=INK, linewidth=0.8)
    for line, scene in enumerate(scenes):
        if scene not in found.index:
            axes.text(0.02, line, "ours or all others are not verified on every QP", size=6.5,
                      color=SOFT, va="center", transform=axes.get_yaxis_transform())  # fmt: skip
            continue
        part = data[(data["scene"] == scene) & (data[f"verified, {arm}"] == 1.0)]
        part = part[part[clock].notna()].set_index("solver")[clock]
        ours = part[found.loc[scene, "ours"]]
        others = (part[[not is_own(str(name)) for name in part.index]] / ours).sort_values()
        axes.plot(others, [line] * len(others), "o", color=SOFT, markersize=3, alpha=0.7)
        first = str(others.index[0])
        axes.plot(
            others.iloc[0], line, "o", color=ORANGE if others.iloc[0] < 1 else BLUE, markersize=5
        )
        axes.annotate(first, (others.iloc[0], line), (0, 4), textcoords="offset points", size=6.5,
                      ha="center")  # fmt: skip
    axes.grid(axis="x", color=FAINT)
    axes.set_title(arm)
    axes.tick_params(axis="y", length=0)
