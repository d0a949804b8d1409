"""Figures of a study: accuracy, cost and performance profiles.

Every figure is drawn from stored results alone and written without a date, so that the same results
give the same bytes.  Panels stand side by side, one per scene, with one line per backend, so that
backends are told apart by their label and never by a colour; colours tell cold from warm.

Pictures of the bodies themselves are in `reports.motions.frames`, work along a motion in
`reports.sections.work`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.names import is_own
from reports.parts.style import (
    BLUE,
    COLD,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    SOFT,
    VERMILLION,
    WARM,
    drawing,
    save,
)
from reports.rows.comparison import compare
from reports.rows.results import ARMS, METHOD, Results
from reports.sections.profiles import profile, scene_ratios

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PANELS = 5
"""Scenes side by side."""

LINE = 0.2
"""Height of one backend's line [in]."""

TITLE, LETTER = 8.5, 0.72
"""Size of a panel's title [pt], and the width of its letters at most, of their size."""

ARM_COLOURS = {"cold": COLD, "warm": WARM}
ARM_MARKERS = {"cold": "o", "warm": "D"}


def plot_accuracy(results: Results, setting: str, path: str | Path) -> Path:
    """Error over the accuracy asked, per backend and scene, cold and warm.

    A thin line runs from the least to the largest error, a thick one over the middle 90 %, and the
    mark is the median.  Raises ValueError where the setting has no solves.
    """
    rows = _solved(results, setting)
    solvers = [name for name in results.solvers if name in set(rows["solver"])]
    values = rows["asked_ratio"].replace(0.0, np.nan).dropna()
    floor = 10.0 ** np.floor(np.log10(max(values.min(), 1e-12))) if len(values) else 1e-3
    top = max(100.0, 10.0 ** np.ceil(np.log10(values.max()))) if len(values) else 100.0

    def draw(axes: Axes, scene: str) -> None:
        axes.axvspan(10, top, color=FAINT, alpha=0.45, linewidth=0)
        axes.axvline(1, color=INK, linewidth=0.9)
        for place, solver in enumerate(solvers):
            part = rows[(rows["scene"] == scene) & (rows["solver"] == solver)]
            arms = [arm for arm in ARMS if (part["arm"] == arm).any()]
            for arm in arms:
                y = place + (0.18 if arm == "warm" else -0.18) * (len(arms) > 1)
                error = part.loc[part["arm"] == arm, "asked_ratio"].dropna().clip(lower=floor)
                if len(error):
                    _spread(axes, y, error, ARM_COLOURS[arm], ARM_MARKERS[arm])
        axes.set_xlim(floor, top)

    return _panels(
        [scene for scene in results.scenes if (rows["scene"] == scene).any()],
        solvers,
        draw,
        Path(path),
        title=f"Error in Gλ over the accuracy asked, setting {setting}",
        label="‖A(x − x*)‖ / asked        line: asked        shaded: not verified",
        legend=_arm_legend(rows),
    )


def _spread(axes: Axes, y: float, values: pd.Series, colour: str, marker: str) -> None:
    low, five, middle, most, high = np.quantile(values, [0, 0.05, 0.5, 0.95, 1])
    axes.plot([low, high], [y, y], color=colour, linewidth=0.7, solid_capstyle="butt")
    axes.plot([five, most], [y, y], color=colour, linewidth=2.6, alpha=0.55, solid_capstyle="butt")
    axes.plot(middle, y, marker=marker, markersize=3.2, color=colour)


def plot_cost(results: Results, setting: str, path: str | Path) -> Path:
    """Median time per QP, per backend and scene, cold and warm on one line.

    A cross instead of a mark: not every QP was verified, so the time is that of wrong answers too.
    Backends stand in the order of their time.  Raises ValueError where the setting has no solves.
    """
    rows = _solved(results, setting)
    summaries = {
        (scene, arm): compare(results.rows, scene, setting, arm)
        for scene in results.scenes
        for arm in ARMS
    }
    tables = {key: comparison.summary() for key, comparison in summaries.items()}
    filled = [table["median"] for table in tables.values() if len(table)]
    if not filled:
        raise ValueError("no compared backend solved a QP with a contact; there is no cost to draw")
    everything = pd.concat(filled)
    speed = np.log(everything.clip(lower=1e-9)).groupby(level=0).mean()
    solvers = sorted(speed.index, key=lambda name: (float(speed[name]), name))

    def draw(axes: Axes, scene: str) -> None:
        for place, solver in enumerate(solvers):
            at = {
                arm: tables[scene, arm].loc[solver]
                for arm in ARMS
                if solver in tables[scene, arm].index
                and solver not in summaries[scene, arm].without_warm
            }
            if len(at) == 2:
                ends = [1e6 * float(at[arm]["median"]) for arm in ARMS]
                axes.plot(ends, [place, place], color=SOFT, linewidth=0.9, zorder=1)
            for arm, found in at.items():
                sound = found["verified"] == 1.0
                axes.plot(
                    1e6 * float(found["median"]),
                    place,
                    marker=ARM_MARKERS[arm] if sound else "x",
                    markersize=(4.2 if arm == "cold" else 3.6) if sound else 4.6,
                    markeredgewidth=1.2,
                    color=ARM_COLOURS[arm],
                    linestyle="none",
                )
        axes.set_xlim(0.7e6 * everything.min(), 1.4e6 * everything.max())

    return _panels(
        [scene for scene in results.scenes if any(len(tables[scene, arm]) for arm in ARMS)],
        solvers,
        draw,
        Path(path),
        title=f"Median time per QP, setting {setting}",
        label="µs        cross: not every QP verified",
        legend=_arm_legend(rows),
    )


def _solved(results: Results, setting: str) -> pd.DataFrame:
    rows = results.rows[(results.rows["settings"] == setting) & ~results.rows["skipped"]]
    if rows.empty:
        known = ", ".join(results.settings) or "none"
        raise ValueError(f"setting {setting!r} has no solves; the results hold: {known}")
    return rows


def _arm_legend(rows: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {"label": arm, "color": ARM_COLOURS[arm], "marker": ARM_MARKERS[arm]}
        for arm in ARMS
        if (rows["arm"] == arm).any()
    ]


def _panels(
    scenes: Sequence[str],
    solvers: Sequence[str],
    draw: Callable[[Axes, str], None],
    path: Path,
    *,
    title: str,
    label: str,
    legend: Sequence[dict[str, Any]],
) -> Path:
    """One panel per scene on a logarithmic axis, one line per backend."""
    columns = min(len(scenes), PANELS)
    rows = -(-len(scenes) // columns)
    left, right, gap = 0.15 + 0.066 * max(map(len, solvers)), 0.1, 0.12
    body, header, caption, top, bottom = LINE * len(solvers) + 0.1, 0.25, 0.3, 0.35, 0.3
    total = top + rows * (header + body + caption) + bottom
    width = (PAGE_WIDTH - left - right - gap * (columns - 1)) / columns
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        figure.text(0, 1 - 0.04 / total, title, va="top", weight="bold", size=10)
        _legend(figure, legend)
        for place, scene in enumerate(scenes):
            row, column = divmod(place, columns)
            x = left + column * (width + gap)
            y = total - top - (row + 1) * (header + body) - row * caption
            axes = figure.add_axes((x / PAGE_WIDTH, y / total, width / PAGE_WIDTH, body / total))
            axes.set_xscale("log")
            axes.set_ylim(len(solvers) - 0.5, -0.5)
            for line, solver in enumerate(solvers):
                if is_own(solver):
                    axes.axhspan(line - 0.5, line + 0.5, color=FAINT, alpha=0.3, linewidth=0)
            draw(axes, scene)
            _decades(axes)
            axes.grid(axis="x")
            fits = 72 * (width + gap) / (LETTER * len(scene))
            axes.set_title(scene, size=min(TITLE, fits))
            axes.spines["left"].set_visible(False)
            axes.tick_params(axis="y", length=0)
            axes.set_yticks(range(len(solvers)), solvers if column == 0 else [])
            for text in axes.get_yticklabels():
                if text.get_text() == METHOD:
                    text.set_fontweight("bold")
        figure.text(
            (left + (PAGE_WIDTH - left) / 2) / PAGE_WIDTH,
            0.06 / total,
            label,
            ha="center",
            size=8.5,
        )
        return save(figure, path)


def _decades(axes: Axes, edge: float = 0.06) -> None:
    """A few powers of ten on a logarithmic axis, 1 among them, none within `edge` of its ends."""
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = np.log10(axes.get_xlim())
    every = max(1, int(np.ceil((high - low) / 4)))
    first = every * int(np.ceil(low / every))
    margin = edge * (high - low)
    powers = [p for p in range(first, int(high) + 1, every) if low + margin <= p <= high - margin]
    axes.xaxis.set_major_locator(FixedLocator([10.0**p for p in powers]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(axis="x", labelsize=7)


def _legend(figure: Figure, entries: Sequence[dict[str, Any]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], linestyle="none", markersize=4.5, **entry) for entry in entries]
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(1, 1),
        ncols=max(1, len(handles)),
        borderaxespad=0,
        handletextpad=0.1,
        columnspacing=1.2,
    )


def plot_profiles(results: Results, setting: str, path: str | Path) -> Path:
    """Performance profiles over all scenes, cold and as in a simulation.

    Raises ValueError where the setting has no solves.
    """
    _solved(results, setting)
    tables = {arm: scene_ratios(results, setting, arm) for arm in ARMS}
    tables = {arm: table for arm, table in tables.items() if len(table)}
    solvers = list(dict.fromkeys(name for table in tables.values() for name in table.columns))
    looks = _line_looks(solvers)
    worst = max(
        float(table.to_numpy()[np.isfinite(table.to_numpy())].max(initial=2.0))
        for table in tables.values()
    )
    taus = np.geomspace(1, 1.2 * worst, 200)
    height = max(2.9, 0.35 + 0.17 * len(solvers))
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, height))
        width = (PAGE_WIDTH - 0.5 - 1.85 - 0.3 * (len(tables) - 1)) / len(tables)
        for place, (arm, table) in enumerate(tables.items()):
            left = 0.5 + place * (width + 0.3)
            axes = figure.add_axes(
                (left / PAGE_WIDTH, 0.42 / height, width / PAGE_WIDTH, 1 - 0.95 / height)
            )
            for solver, share in profile(table, list(taus)).items():
                axes.plot(taus, share, drawstyle="steps-post", **looks[str(solver)])
            axes.set_xscale("log")
            axes.set_xlim(1, taus[-1])
            axes.set_ylim(0, 1.02)
            axes.grid()
            _decades(axes, edge=0.0)
            axes.set_title(f"{arm} ({len(table):,} QPs)", size=8.5)
            axes.set_xlabel("τ, times the fastest")
            if place:
                axes.set_yticklabels([])
            else:
                axes.set_ylabel("share of QPs within τ")
        figure.text(
            0, 1 - 0.04 / height, f"Performance profiles, setting {setting}",
            va="top", weight="bold", size=10,
        )  # fmt: skip
        from matplotlib.lines import Line2D

        figure.legend(
            handles=[Line2D([], [], label=name, **looks[name]) for name in solvers],
            loc="center right",
            bbox_to_anchor=(1, 0.5),
            handlelength=2.6,
            borderaxespad=0,
        )
        return save(figure, Path(path))


def _line_looks(solvers: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour and dash of each backend: our method in ink and thick, the paper's in ink."""
    dashes = ["-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5))]
    colours = [BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY]
    looks: dict[str, dict[str, Any]] = {}
    own = [name for name in solvers if is_own(name)]
    for i, name in enumerate(own):
        looks[name] = {
            "color": INK,
            "linestyle": dashes[i % len(dashes)],
            "linewidth": 2.4 if name == METHOD else 1.4,
        }
    for i, name in enumerate(name for name in solvers if not is_own(name)):
        looks[name] = {
            "color": colours[i % len(colours)],
            "linestyle": dashes[i // len(colours) % len(dashes)],
            "linewidth": 1.2,
        }
    return looks
