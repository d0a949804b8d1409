"""What OSQP, ProxQP and PIQP gain by keeping what they made for earlier QPs: table and figure.

    criterion_kept       per recording, package and what is kept: the best interval, and both ends
    criterion_kept_runs  every interval, for CSV

Their numbers are those of `harness.criterion.kept_factors`.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from harness.criterion.kept_factors import COLUMNS, INTERVALS, LONGEST, METHOD
from reports.criterion.figures import plot_panels
from reports.criterion.intervals import interval_text
from reports.parts.sentences import join
from reports.parts.style import BLUE, GREEN, INK, VERMILLION
from reports.parts.table import Table, microseconds, percent, short, times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOTABLE = 1.1
"""Gains and losses below this factor are not told."""
NEVER_AT = 50.0
"""Where the interval ∞ stands on a logarithmic axis that ends at 20."""
WIDE = 400.0
"""Costs that span more than this factor are marked at powers of ten only."""
WRONG = 0.5
"""Share of verified answers below which an interval is no choice at all."""
COLOURS = {"osqp": GREEN, "proxqp": VERMILLION, "piqp": BLUE}
STYLES = ("-", (0, (4, 2)), (0, (1, 1.3)))
"""Of the first, second and third thing that a package keeps."""


def kept_factors_table(runs: pd.DataFrame) -> Table:
    """The best interval of everything that can be kept, beside renewing always and never."""
    rows = [
        _row(scene, package, kept, part, _method(runs, scene))
        for (scene, package, kept), part in _groups(runs)
    ]
    data = pd.DataFrame(rows)
    return Table(
        name="criterion_kept",
        title="What other packages can keep from QP to QP",
        reading=(
            "Mean time per QP (setup and solve, µs) where what is kept is renewed at every QP "
            "(always), at the best interval of those at which every answer is verified that is "
            "verified with it renewed always, and never renewed; iterations and verified answers "
            f"at both ends; and the best over {METHOD} as it is shipped, on the same QPs.  setup "
            "is the whole object; x and multipliers are always carried over.  osqp P keeps the "
            "factorization and with it an old matrix, so that it solves another QP.  At setting "
            f"paper, up to {LONGEST} QPs of each recording."
        ),
        data=data,
        formats={
            **dict.fromkeys(["always", "best", "never"], microseconds),
            "best s": interval_text,
            **dict.fromkeys(["its., always", "its., never"], short),
            **dict.fromkeys(["verified, always", "verified, never"], percent),
            f"best/{METHOD}": times,
        },
        notes=_notes(data) if len(data) else [],
    )


def _groups(runs: pd.DataFrame) -> Any:
    return runs[runs["package"] != METHOD].groupby(["scene", "package", "kept"], sort=False)


def _method(runs: pd.DataFrame, scene: str) -> float:
    return float(runs.loc[(runs["scene"] == scene) & (runs["package"] == METHOD), "mean"].iloc[0])


def _row(scene: str, package: str, kept: str, part: pd.DataFrame, method: float) -> dict[str, Any]:
    always, never = part.iloc[0], part.iloc[-1]
    sound = part[~(part["verified"] < always["verified"])]
    best = sound.loc[sound["mean"].idxmin()]
    return {
        "scene": scene,
        "package": package,
        "kept": kept,
        "always": always["mean"],
        "best s": best["interval"],
        "best": best["mean"],
        "never": never["mean"],
        "its., always": always["iterations"],
        "its., never": never["iterations"],
        "verified, always": always["verified"],
        "verified, never": never["verified"],
        f"best/{METHOD}": best["mean"] / method,
    }


def _notes(data: pd.DataFrame) -> list[str]:
    """What it is worth to keep each thing, where it harms, and where answers are lost."""
    notes = []
    for (package, kept), part in data.groupby(["package", "kept"], sort=False):
        lost = part[part["verified, never"] < part["verified, always"]]
        gain, harm = part["always"] / part["best"], part["never"] / part["always"]
        if len(lost):
            share = percent(lost["verified, never"].max())
            notes.append(
                f"{package} with {kept} never renewed is verified on {share} of the QPs at most "
                f"on {join(list(lost['scene']))}: an old factor there is the factor of another QP."
            )
        elif harm.max() > NOTABLE:
            where = part.loc[harm.idxmax(), "scene"]
            notes.append(
                f"To keep {kept} costs {package} up to {times(harm.max())} the time of renewing it "
                f"at every QP ({where})."
            )
        elif gain.max() > NOTABLE:
            notes.append(f"To keep {kept} saves {package} a factor of {_range(gain)}.")
        else:
            notes.append(f"Whether {package} keeps {kept} makes no difference of 10 %.")
    shorter = data[(data["never"] > NOTABLE * data["best"]) & (data["best s"] > 1)]
    notes.append(
        "There is no interval to be tuned: what is worth keeping is best kept for good."
        if not len(shorter)
        else "The best interval lies between always and never, by more than 10 %, on "
        + join([f"{r['scene']} ({r['package']} {r['kept']})" for r in shorter.to_dict("records")])
        + "."
    )
    ratio = f"best/{METHOD}"
    near = data.loc[data[ratio].idxmin()]
    notes.append(
        f"The nearest to {METHOD} is {near['package']}, {near['kept']} kept, on {near['scene']}: "
        f"{times(near[ratio])} its time."
    )
    return notes


def _range(values: pd.Series) -> str:
    low, high = short(values.min()), short(values.max())
    return low if low == high else f"{low} to {high}"


def kept_runs_table(runs: pd.DataFrame) -> Table:
    """Every run."""
    return Table("criterion_kept_runs", "Every run", "Times in seconds.", runs[list(COLUMNS)])


def plot_kept(runs: pd.DataFrame, path: str | Path) -> Path:
    """Time per QP against the interval between renewals, one panel per recording."""

    def panel(axes: Axes, scene: str) -> None:
        _panel(axes, runs[runs["scene"] == scene])
        axes.set_title(scene)

    scenes = list(dict.fromkeys(runs["scene"]))
    labels = "QPs from one renewal to the next", "µs per QP"
    return plot_panels(scenes, panel, labels, 0.62, path)


def _panel(axes: Axes, runs: pd.DataFrame) -> None:
    styles: dict[str, int] = {}
    for (_, package, kept), part in _groups(runs):
        style = STYLES[styles.setdefault(package, 0) % len(STYLES)]
        styles[package] += 1
        at = [_place(interval) for interval in part["interval"]]
        cost = 1e6 * part["mean"].to_numpy()
        colour = COLOURS.get(package, INK)
        axes.plot(at, cost, color=colour, linestyle=style, linewidth=1.2,
                  label=f"{package}: {kept}")  # fmt: skip
        wrong = (part["verified"] < WRONG).to_numpy()
        axes.plot(
            [x for x, bad in zip(at, wrong, strict=True) if bad], cost[wrong], color=colour,
            marker="x", markersize=5, linestyle="none",
            label="most answers wrong" if wrong.any() else None,
        )  # fmt: skip
    axes.axhline(
        1e6 * runs.loc[runs["package"] == METHOD, "mean"].iloc[0], color=INK, linewidth=1.0,
        label=METHOD,
    )  # fmt: skip
    axes.set_yscale("log")
    _cost_axis(axes)
    _interval_axis(axes, INTERVALS)


def _place(interval: float) -> float:
    return NEVER_AT if interval == inf else interval


def _cost_axis(axes: Axes) -> None:
    """1, 2, 5, 10, …, 1k; only powers of ten where there are many."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > WIDE * low else (1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value / 1e3:g}k" if value >= 1e3 else f"{value:g}")
    )
    axes.yaxis.set_minor_locator(NullLocator())


def _interval_axis(axes: Axes, intervals: Sequence[float]) -> None:
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.set_xscale("log")
    axes.set_xlim(0.9, 1.15 * NEVER_AT)
    axes.xaxis.set_major_locator(FixedLocator([_place(s) for s in intervals]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticklabels([interval_text(s) if s == inf else f"{s:g}" for s in intervals])
    axes.grid(axis="y")
