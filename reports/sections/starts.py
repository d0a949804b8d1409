"""What the quality of a start is worth: the arms beside cold and warm (`harness.passes.starts`).

Each arm is compared with the same solver's cold solves of the same QPs: those that the arm started,
that do not follow a restart, and that are verified both ways.

1. ratio: geometric mean of time(arm)/time(cold), the times being the least over the passes, with an
   interval from resampling stretches of QPs (`reports.parts.intervals`).
2. worse: the least time of the arm exceeds that of cold by more than the spread, the larger of the
   two distances from the least time to the median; better likewise.  Of QPs that cost the same a
   few per cent are called worse, and as many better, by chance; with one pass there is no spread,
   and neither is told.
3. Iterations do not depend on the clock: their ratio, and the share of QPs that take more of them.

The arms of `QUALITIES` differ in x and the working set alone; all of them have the solver's memory,
so that they can be compared with one another.  `bare` is `warm` without it.  Making a start is work
between two solves, which leaves the caches colder: a solve of 1 µs took up to 0.3 µs more for it.
So differences of less than `DISTURBED` between two arms are not put down to the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from reports.parts.intervals import SURE, geometric_mean
from reports.parts.names import in_order, solver_order
from reports.parts.sentences import Answer, join
from reports.parts.style import COLD, INK, PAGE_WIDTH, SOFT, WARM, drawing, save
from reports.parts.table import Table, microseconds, percent, short, times, whole
from reports.rows.results import ARMS, METHOD, Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes

QUALITIES = ("exact", "extrapolated", "warm", "stale5", "stale20", "corrupted")
"""Arms that differ in the quality of x and of the working set, best first, roughly."""
CHECKS = ("bare", "shuffled")
ORDER = (*QUALITIES, *CHECKS)
WORDS = {
    "exact": "the right answer",
    "extrapolated": "x extrapolated in time",
    "warm": "its own last answer",
    "stale5": "that of 5 QPs ago",
    "stale20": "that of 20 QPs ago",
    "corrupted": "a spoilt one",
}
LEAST = 0.04
"""Left end of the figure; fewer iterations than this part of the cold ones are drawn there."""
DISTURBED = 0.5e-6
"""Difference of two mean times [s] that what lies between the solves may make."""
NOTABLE = 0.05
"""Difference of two mean ratios that is worth a word."""


def setting_of(results: Results) -> str | None:
    """The first setting with arms beside cold and warm, or None."""
    rows = results.everything
    found = rows.loc[rows["arm"].isin(set(ORDER) - set(ARMS)), "settings"].unique()
    order = in_order(found, tuple(results.settings))
    return order[0] if order else None


def start_pairs(results: Results) -> pd.DataFrame:
    """One row per (scene, solver, arm, QP): `ratio` of times, `better`, `worse`, `more`.

    more : whether it took more iterations than cold.  better and worse are NaN where there was one
    pass only.  Empty where no such arm was run.
    """
    setting, rows = setting_of(results), results.everything
    if setting is None:
        return pd.DataFrame()
    rows = rows[(rows["settings"] == setting) & ~rows["skipped"] & (rows["k"] > 0)]
    columns = ["runtime", "runtime_median", "iterations", "verified"]
    key = ["scene", "solver", "problem"]
    started = rows["arm"].isin(ORDER) & rows["warm_started"].astype(bool)
    arms = rows.loc[started & ~rows["after_restart"].astype(bool), [*key, "arm", *columns]]
    cold = rows.loc[rows["arm"] == "cold", [*key, "repeats", *columns]]
    pairs = arms.merge(cold, on=key, suffixes=("", "_cold"))
    pairs = pairs[pairs["verified"] & pairs["verified_cold"]].sort_values(key, kind="stable")
    spread = np.maximum(
        pairs["runtime_median"] - pairs["runtime"],
        pairs["runtime_median_cold"] - pairs["runtime_cold"],
    )
    lost = pairs["runtime"] - pairs["runtime_cold"]
    told = pairs["repeats"] > 1
    return pairs.assign(
        ratio=pairs["runtime"] / pairs["runtime_cold"],
        better=(-lost > spread).astype(float).where(told),
        worse=(lost > spread).astype(float).where(told),
        more=(pairs["iterations"] > pairs["iterations_cold"]).astype(float),
    )


def summarise(pairs: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """One row per group of pairs: QPs, ratio with its range, iterations, better, worse, more."""
    out = []
    for group, part in pairs.groupby(by, sort=False):
        ratio, total = geometric_mean(part["ratio"]), part["iterations_cold"].sum()
        out.append(
            {
                **dict(zip(by, group, strict=True)),
                "QPs": len(part),
                "mean": geometric_mean(part["runtime"]).mean,
                "ratio": ratio.mean,
                "from": ratio.low,
                "to": ratio.high,
                "iterations": part["iterations"].sum() / total if total else np.nan,
                "better": part["better"].mean(),
                "worse": part["worse"].mean(),
                "more iterations": part["more"].mean(),
            }
        )
    place = {arm: i for i, arm in enumerate(ORDER)}
    return (
        pd.DataFrame(out)
        .sort_values(
            ["solver", "arm"], key=lambda c: c.map(place if c.name == "arm" else solver_order)
        )
        .reset_index(drop=True)
    )


def starts_tables(results: Results) -> list[Table]:
    """The table of all scenes together, then one per scene; nothing where nothing is compared."""
    pairs = start_pairs(results)
    if pairs.empty:
        return []
    scenes = sorted(pairs["scene"].unique())
    made = [_table(pairs, "all", results)]
    if len(scenes) > 1:
        made += [_table(pairs[pairs["scene"] == scene], scene, results) for scene in scenes]
    return made


def _table(pairs: pd.DataFrame, scene: str, results: Results) -> Table:
    data = summarise(pairs, ["solver", "arm"])
    slower = data[data["arm"].isin(["exact", "extrapolated", "warm"]) & (data["from"] > 1)]
    return Table(
        name="starts",
        key={"setting": str(setting_of(results)), "scene": scene},
        title="What the quality of a start is worth",
        reading=(
            "Each solver against its own cold solves of the same QPs, verified both ways and not "
            "after a restart.  ratio is the geometric mean of the times, below 1 a gain, with the "
            f"range of {percent(SURE)} of resampled sequences.  x and the working set are those "
            "of the reference (exact), of the last QP (warm), of 5 and 20 QPs ago, extrapolated "
            "linearly in time, or the last ones spoilt: x moved by ‖x‖ at random, the working set "
            "at random.  bare: warm without the solver's memory.  shuffled: warm, the QPs in "
            "random order.  mean: geometric, in µs; making a start disturbs the next solve by part "
            f"of {microseconds(DISTURBED)} µs.  better, worse: by more than the spread of the "
            "passes, which chance "
            "too does to a few per cent."
        ),
        data=data,
        formats={
            "QPs": whole,
            "mean": microseconds,
            **dict.fromkeys(["ratio", "from", "to", "iterations"], times),
            **dict.fromkeys(["better", "worse", "more iterations"], percent),
        },
        notes=[
            f"{row['solver']} takes {times(row['ratio'])} its cold time from {WORDS[row['arm']]}."
            for row in slower.to_dict("records")
        ],
    )


def plot_starts(results: Results, path: str | Path) -> Path:
    """Time over cold time against the arm: one panel per solver, its scenes as faint lines.

    Those of which nothing but warm was run share a panel below, a row each.

    Raises ValueError where no such arm is to be compared with cold solves.
    """
    pairs = start_pairs(results)
    if pairs.empty:
        raise ValueError("no arm beside cold and warm was run with a cold one to compare it with")
    arms = [arm for arm in ORDER if (pairs["arm"] == arm).any()]
    pooled = summarise(pairs, ["solver", "arm"])
    by_scene = summarise(pairs, ["solver", "scene", "arm"])
    count = pooled.groupby("solver").size()
    several = count > 1 if (count > 1).any() else count > 0
    solvers = sorted(count[several].index, key=solver_order)
    others = sorted(count[~several].index, key=solver_order)
    with drawing() as Figure:
        across = min(4, len(solvers))
        down = -(-len(solvers) // across)
        heights = [0.19 * len(arms) + 0.45] * down + [0.19 * len(others) + 0.45] * bool(others)
        figure = Figure(figsize=(PAGE_WIDTH, sum(heights) + 0.7), layout="constrained")
        grid = figure.add_gridspec(len(heights), across, height_ratios=heights)
        panels: list[Axes] = []
        for place, solver in enumerate(solvers):
            shared = panels[0] if panels else None
            axes = figure.add_subplot(grid[divmod(place, across)], sharex=shared, sharey=shared)
            own, scenes = (part[part["solver"] == solver] for part in (pooled, by_scene))
            _panel(axes, own.set_index("arm"), scenes, arms)
            axes.set_title(solver)
            axes.tick_params(labelleft=place % across == 0)
            axes.set_xlabel("time / cold time")
            panels.append(axes)
        panels[0].set_yticks(range(len(arms)), arms)
        panels[0].set_ylim(len(arms) - 0.5, -0.5)
        if others:
            arm = str(pooled.loc[pooled["solver"] == others[0], "arm"].iloc[0])
            axes = figure.add_subplot(grid[down, :], sharex=panels[0])
            _rows(axes, pooled[pooled["solver"].isin(others)].set_index("solver"), others)
            axes.set_title(f"The others, {arm}")
            axes.set_xlabel("time / cold time")
        lines, labels = panels[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=len(labels))
        return save(figure, Path(path))


def _rows(axes: Axes, pooled: pd.DataFrame, solvers: list[str]) -> None:
    """One arm of each of these solvers: its time, and iterations as bars."""
    _ratio_axis(axes)
    _draw_iterations(axes, pooled.reindex(solvers))
    look = {"color": COLD, "marker": "o", "linewidth": 0.0}
    _draw_times(axes, pooled.reindex(solvers), range(len(solvers)), look)
    axes.set_yticks(range(len(solvers)), solvers)
    axes.set_ylim(len(solvers) - 0.5, -0.5)


def _panel(axes: Axes, own: pd.DataFrame, scenes: pd.DataFrame, arms: list[str]) -> None:
    """Arms of differing quality on one line, the checks below it, iterations as bars."""
    axes.set_xscale("log")
    axes.set_xlim(LEAST, 6.0)
    axes.set_xticks([0.1, 1.0], ["0.1", "1"])
    _ratio_axis(axes)
    line = [arm for arm in arms if arm in QUALITIES]
    for _, part in scenes.groupby("scene"):
        ratios = part.set_index("arm")["ratio"].reindex(line)
        axes.plot(ratios, range(len(line)), color=SOFT, linewidth=0.6, alpha=0.6, zorder=1)
    _draw_iterations(axes, own.reindex(arms))
    looks: tuple[tuple[list[str], dict[str, Any]], ...] = (
        (line, {"color": COLD, "marker": "o", "linewidth": 1.6, "label": "time, by quality"}),
        (
            [arm for arm in arms if arm in CHECKS],
            {"color": WARM, "marker": "D", "linewidth": 0.0, "label": "time, checks"},
        ),
    )
    for chosen, look in looks:
        _draw_times(axes, own.reindex(chosen), [arms.index(arm) for arm in chosen], look)


def _ratio_axis(axes: Axes) -> None:
    axes.grid(True, axis="x", which="both")
    axes.axvline(1.0, color=INK, linewidth=0.8, zorder=1)


def _draw_iterations(axes: Axes, at: pd.DataFrame) -> None:
    axes.plot(
        at["iterations"].clip(lower=1.05 * LEAST), range(len(at)), color=SOFT,
        linestyle="none", marker="|", markersize=7, markeredgewidth=1.4, label="iterations",
    )  # fmt: skip


def _draw_times(axes: Axes, at: pd.DataFrame, places: Sequence[int], look: dict[str, Any]) -> None:
    """Ratios of times with their ranges."""
    off = [(at["ratio"] - at["from"]).clip(lower=0), (at["to"] - at["ratio"]).clip(lower=0)]
    axes.errorbar(at["ratio"], places, xerr=off, markersize=3.6, elinewidth=1.0, zorder=3, **look)


def starts_answer(results: Results) -> Answer | None:
    """What a start must be like, in sentences; None where nothing is compared."""
    pairs = start_pairs(results)
    if pairs.empty:
        return None
    table = summarise(pairs, ["solver", "arm"])
    solvers = list(dict.fromkeys(table["solver"]))
    table = table.set_index(["solver", "arm"])
    leader = METHOD if METHOD in solvers else solvers[0]
    own = table.loc[leader]
    shown = "exact" if "exact" in own.index else str(own.index[0])
    ladder = [f"{short(own.at[a, 'ratio'])} from {WORDS[a]}" for a in QUALITIES if a in own.index]
    said = [
        f"In units of its cold time {leader} takes {join(ladder, 10)}.",
        *_memory(table, solvers),
        *_extrapolation(table, solvers),
        *_spoilt(table, solvers),
        *_shuffled(table, solvers),
    ]
    return Answer(
        "How good must a start be?",
        f"{short(own.at[shown, 'ratio'])}×",
        f"the cold time of {leader}, from {WORDS.get(shown, shown)}",
        tuple(said),
        "starts",
    )


def _compared(table: pd.DataFrame, solvers: list[str], one: str, other: str) -> dict[str, float]:
    """Ratio of the mean ratios of two arms, for each solver that has both."""
    return {
        solver: float(table.at[(solver, one), "ratio"] / table.at[(solver, other), "ratio"])
        for solver in solvers
        if (solver, one) in table.index and (solver, other) in table.index
    }


def _listed(ratios: dict[str, float]) -> str:
    return join([f"{solver} ({short(ratio)})" for solver, ratio in ratios.items()], 12)


def _memory(table: pd.DataFrame, solvers: list[str]) -> list[str]:
    worth = _compared(table, solvers, "bare", "warm")
    if not worth:
        return []
    said = (
        f"Without the solver's memory a warm start takes this many times as long: {_listed(worth)}."
    )
    more = [
        solver
        for solver, ratio in worth.items()
        if ratio > max(1 + NOTABLE, 1 / float(table.at[(solver, "bare"), "ratio"]))
    ]
    if more:
        said += f"  To {join(more, 12)} memory is worth more than x and the working set are."
    return [said]


def _extrapolation(table: pd.DataFrame, solvers: list[str]) -> list[str]:
    change = _compared(table, solvers, "extrapolated", "warm")
    if not change:
        return []
    change = {
        solver: ratio
        for solver, ratio in change.items()
        if abs(table.at[(solver, "extrapolated"), "mean"] - table.at[(solver, "warm"), "mean"])
        > DISTURBED
    }
    gain = {solver: ratio for solver, ratio in change.items() if ratio < 1 - NOTABLE}
    loss = {solver: ratio for solver, ratio in change.items() if ratio > 1 + NOTABLE}
    parts = [f"gains for {_listed(gain)}"] if gain else []
    parts += [f"loses for {_listed(loss)}"] if loss else []
    if not parts:
        return [
            "Extrapolating x in time changes nobody's time by more than "
            f"{percent(NOTABLE)} and {microseconds(DISTURBED)} µs."
        ]
    return [f"Extrapolating x in time {join(parts)}, in units of the time from the last x."]


def _spoilt(table: pd.DataFrame, solvers: list[str]) -> list[str]:
    had = [solver for solver in solvers if (solver, "corrupted") in table.index]
    if not had:
        return []
    slower = {
        solver: float(table.at[(solver, "corrupted"), "ratio"])
        for solver in had
        if table.at[(solver, "corrupted"), "from"] > 1
    }
    if not slower:
        return ["From a spoilt start, but with memory, nobody is slower than cold."]
    return [
        f"From a spoilt start {len(slower)} of {len(had)} are slower than cold: {_listed(slower)}."
    ]


def _shuffled(table: pd.DataFrame, solvers: list[str]) -> list[str]:
    """The check: a start from another time of the motion should be worth less."""
    rise = _compared(table, solvers, "shuffled", "warm")
    if not rise:
        return []
    said = (
        "Where the QPs come in random order a start should not help: the times of a warm start "
        f"change by {_listed(rise)}."
    )
    even = {
        solver: float(table.at[(solver, "shuffled"), "ratio"])
        for solver in rise
        if table.at[(solver, "shuffled"), "to"] < 1
    }
    if even:
        said += f"  Memory kept, this is still less than cold for {_listed(even)}."
    return [said]
