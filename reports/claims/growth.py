"""What `glambda growth` prints and writes: time per QP against its number of columns.

    growth_times_FAMILY    runtime (setup + solve) of every backend at every size
    growth_calls_FAMILY    the whole call, with what our adapter does to pose the QP
    growth_ratios          the fastest other backend over our method
    growth_exponents       p in time ~ k^p
    growth_limits          where each backend stops, and why

One figure with both axes logarithmic, one panel per family; one page, growth.md; the measured
points as growth.csv.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rich.console import Console

from harness.claims.growth import FAR, FIT_FROM, MOST, STEP, STEPS, exponent, usable
from harness.machine.machine import machine_label
from harness.names import is_own
from reports.parts.sentences import join
from reports.parts.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    SOFT,
    VERMILLION,
    YELLOW,
    draw_files,
    drawing,
    save,
)
from reports.parts.table import (
    Table,
    duration,
    percent,
    print_tables,
    times,
    whole,
    write_page,
)
from reports.rows.results import METHOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COUNTED = 100.0
"""Range of columns below which sizes are written as they are, and above it as powers of ten."""
LOOKS = {
    METHOD: (VERMILLION, "o"),
    "clarabel": (BLUE, "s"),
    "daqp": (GREEN, "^"),
    "highs": (ORANGE, "D"),
    "osqp": (PURPLE, "v"),
    "piqp": (SKY, "P"),
    "proxqp": (INK, "X"),
    "quadprog": (YELLOW, "p"),
    "scipy_bvls": (SOFT, "<"),
    "scs": (BLUE, ">"),
    "pgs": (GREEN, "*"),
}
"""Colour and marker of a backend, on every page …"""
OTHER_LOOKS = ((ORANGE, "h"), (PURPLE, "d"), (SKY, "H"), (SOFT, "8"))
"""… and of others, by their place in the plan."""


def families_of(points: pd.DataFrame) -> list[str]:
    """Families in the order measured."""
    return list(dict.fromkeys(points["family"]))


def times_table(points: pd.DataFrame, family: str, column: str = "runtime") -> Table:
    """One family: k down, backends across; `column` is "runtime" or "call_time"."""
    part = points[points["family"] == family]
    solvers = list(dict.fromkeys(part["solver"]))
    tried = part[part["tried"].astype(bool)]
    data = part.drop_duplicates("bodies")[["bodies", "m", "k"]].reset_index(drop=True)
    for solver in solvers:
        found = tried[tried["solver"] == solver].set_index("bodies")[column]
        data[solver] = found.reindex(data["bodies"]).to_numpy(float)
    whole_call = column == "call_time"
    what = "the whole call, with posing the QP in the package's form" if whole_call else (
        "setup and solve; posing the QP in the package's form is not counted, and the paper's "
        "method has nothing to pose"
    )  # fmt: skip
    notes = []
    if not whole_call:
        bad = tried[tried["verified"] < 1]
        notes = [
            f"{row.solver} at k = {row.k:,}: {percent(row.verified)} of the answers are verified."
            for row in bad.itertuples()
        ]
        notes += [
            f"k = {row.k:,}: of {row.undecided:.0f} of {row.qps:.0f} QPs nobody's answer is proved "
            "right or wrong (columns opposite but for rounding); they count in the times, and not "
            "in what is verified."
            for row in tried[tried["undecided"] > 0].drop_duplicates("k").itertuples()
        ]
    return Table(
        name=f"growth_{'calls' if whole_call else 'times'}_{_plain(family)}",
        title=f"Time per QP, {family}" + (", whole call" if whole_call else ""),
        reading=f"median over the QPs: {what}. An en dash: not tried, see where they stop.",
        data=data,
        formats={"bodies": whole, "m": whole, "k": whole} | dict.fromkeys(solvers, duration),
        notes=notes,
    )


def ratios_table(points: pd.DataFrame) -> Table:
    """The fastest other backend against our method, size by size."""
    good = usable(points)
    rows = []
    for (_, bodies), part in good.groupby(["family", "bodies"], sort=False):
        ours = part[part["solver"] == METHOD]
        others = part[~part["solver"].map(is_own).astype(bool)]
        if not len(ours) or not len(others):
            continue
        best, mine = others.loc[others["runtime"].idxmin()], ours.iloc[0]
        ratio = best["runtime"] / mine["runtime"]
        rows.append(
            {
                "family": mine["family"], "bodies": bodies, "k": mine["k"],
                METHOD: mine["runtime"], "best other": best["solver"], "its time": best["runtime"],
                "ratio": ratio,
                "ratio from": best["runtime_from"] / mine["runtime_to"],
                "ratio to": best["runtime_to"] / mine["runtime_from"],
                "ratio of calls": others["call_time"].min() / mine["call_time"],
            }
        )  # fmt: skip
    ratios = ["ratio", "ratio from", "ratio to", "ratio of calls"]
    columns = ["family", "bodies", "k", METHOD, "best other", "its time", *ratios]
    data = pd.DataFrame(rows, columns=columns)
    return Table(
        name="growth_ratios",
        title="Our method and the fastest other backend",
        reading=(
            f"ratio is the time of the fastest other backend over that of {METHOD}, among those "
            "whose every answer is verified: above 1, our method is faster. ratio from, ratio to: "
            "of the medians of single passes, the least of one's over the greatest of the "
            "other's, and the other way round. ratio of "
            "calls is the same with what it takes to pose the QP, and may have another backend "
            "for best."
        ),
        data=data,
        formats={
            "bodies": whole, "k": whole, METHOD: duration, "its time": duration,
            **dict.fromkeys(ratios, times),
        },
        notes=_ratio_notes(data),
    )  # fmt: skip


def least_ahead(data: pd.DataFrame, count: int = 2) -> str:
    """Where our method is least ahead, by each clock; empty where it meets nobody.

    data : that of `ratios_table`
    """
    if data.empty:
        return ""
    said = []
    for column, clock in (("ratio", "set-up and solve"), ("ratio of calls", "the whole call")):
        least = data.sort_values(column).head(count)
        places = [
            f"{row['family']} of {row['bodies']:,} bodies ({times(row[column])})"
            for _, row in least.iterrows()
        ]
        said.append(f"by {clock} {join(places)}")
    return f"Our method is least ahead of the fastest other backend, {'; '.join(said)}."


def _ratio_notes(data: pd.DataFrame) -> list[str]:
    notes = []
    for family, part in data.groupby("family", sort=False):
        lost = part[part["ratio"] < 1]
        if len(lost):
            who = join([f"k = {r.k:,} ({r._5})" for r in lost.itertuples()])
            notes.append(f"{family}: another backend is faster at {who}.")
        large = part.loc[part["k"] >= FIT_FROM, "ratio"]
        if len(large):
            ends = dict.fromkeys([times(large.min()), times(large.max())])
            notes.append(f"{family}: from k = {FIT_FROM} on the ratio is {' to '.join(ends)}.")
    return notes


def exponents_table(points: pd.DataFrame) -> Table:
    """p in time ~ k^p, per family and backend."""
    good, rows = usable(points), []
    for (family, solver), part in good.groupby(["family", "solver"], sort=False):
        found = exponent(part["k"], part["runtime"])
        if found is not None:
            row = {"family": family, "solver": solver, "p": found.p, "p from": found.low}
            rows.append({**row, "p to": found.high, "k from": found.k_from, "k to": found.k_to})
    columns = ["family", "solver", "p", "p from", "p to", "k from", "k to"]
    return Table(
        name="growth_exponents",
        title="Exponents of growth",
        reading=(
            f"p in time ~ k^p, fitted from k = {FIT_FROM} on over all sizes at which every answer "
            "is verified, three or more. p from, p to: the slopes between neighbouring sizes. "
            "Slopes over different ranges of k do not compare."
        ),
        data=pd.DataFrame(rows, columns=columns),
        formats={**dict.fromkeys(["p", "p from", "p to"], "{:.2f}".format),
                 "k from": whole, "k to": whole},
    )  # fmt: skip


def limits_table(points: pd.DataFrame) -> Table:
    """Where each backend was last tried, and why it went no further."""
    rows = []
    for (family, solver), part in points.groupby(["family", "solver"], sort=False):
        last = part[part["tried"].astype(bool)].iloc[-1]
        reason = "all sizes were tried" if part["tried"].iloc[-1] else last["reason"]
        row = {"family": family, "solver": solver, "last k": last["k"]}
        rows.append({**row, "call there": last["call_time"], "why no further": reason})
    return Table(
        name="growth_limits",
        title="Where they stop",
        reading=(
            "the largest k that was tried. A backend is not tried at the next size where its "
            "median call exceeds the limit, where by its growth over the last two sizes a call "
            f"there would take over {FAR:g} limits, or where fewer than half of its answers are "
            "verified."
        ),
        data=pd.DataFrame(rows),
        formats={"last k": whole, "call there": duration},
    )


def tables_of(points: pd.DataFrame) -> list[Table]:
    """All tables of the page."""
    families = families_of(points)
    return [
        ratios_table(points),
        exponents_table(points),
        *(times_table(points, family) for family in families),
        limits_table(points),
        *(times_table(points, family, "call_time") for family in families),
    ]


def plot_growth(points: pd.DataFrame, path: str | Path) -> Path:
    """Time per QP against k, one panel per family, both axes logarithmic."""
    families = families_of(points)
    solvers = list(dict.fromkeys(points["solver"]))
    others = [solver for solver in solvers if solver not in LOOKS]
    looks = {
        solver: LOOKS.get(solver) or OTHER_LOOKS[others.index(solver) % len(OTHER_LOOKS)]
        for solver in solvers
    }
    with drawing() as Figure:
        rows = -(-len(families) // 2)
        figure = Figure(figsize=(PAGE_WIDTH, 3.4 * rows + 0.6), layout="constrained")
        grid = figure.subplots(rows, min(2, len(families)), squeeze=False, sharey=True)
        panels = grid.ravel()
        for axes in panels[len(families) :]:
            axes.set_visible(False)
        for axes, family in zip(panels, families, strict=False):
            _panel(axes, points[points["family"] == family], looks)
            axes.set_title(family)
            axes.set_xlabel("columns k")
        for axes in grid[:, 0]:
            axes.set_ylabel("time per QP [s]")
        handles: dict[str, Any] = {}
        for axes in panels[: len(families)]:
            lines, labels = axes.get_legend_handles_labels()
            handles.update(zip(labels, lines, strict=True))
        figure.legend(
            list(handles.values()), list(handles), loc="outside lower center",
            ncols=min(6, len(handles)),
        )  # fmt: skip
        return save(figure, Path(path))


def _panel(axes: Axes, part: pd.DataFrame, looks: dict[str, tuple[str, str]]) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    tried = part[part["tried"].astype(bool)]
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    if len(tried) and tried["k"].max() < COUNTED * tried["k"].min():
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    for solver, (colour, marker) in looks.items():
        own = tried[tried["solver"] == solver]
        if not len(own):
            continue
        k, time = own["k"].to_numpy(float), own["runtime"].to_numpy(float)
        wide = solver == METHOD
        axes.plot(
            k, time, color=colour, marker=marker, markersize=5 if wide else 3.8,
            linewidth=2.0 if wide else 1.0, zorder=4 if wide else 3, label=solver,
        )  # fmt: skip
        missed = own["verified"].to_numpy(float) < 1
        axes.plot(
            k[missed], time[missed], linestyle="none", marker=marker, markersize=6,
            markerfacecolor="white", markeredgecolor=colour, zorder=5,
        )  # fmt: skip
    _guide(axes, tried)


def _guide(axes: Axes, tried: pd.DataFrame) -> None:
    """A line of slope 1, to compare with."""
    k = np.array([tried["k"].min(), tried["k"].max()], float)
    start = 0.35 * float(tried["runtime"].min())
    axes.plot(k, start * k / k[0], color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)), zorder=1)
    axes.annotate(
        "~ k", (k[1], start * k[1] / k[0]), xytext=(-2, -9), textcoords="offset points",
        color=SOFT, ha="right", fontsize=8,
    )  # fmt: skip


def _plain(family: str) -> str:
    return family.replace(",", "_").replace("=", "")


def print_growth(console: Console, points: pd.DataFrame) -> None:
    """Print where ours is least ahead, and every table but those of whole calls."""
    tables = tables_of(points)
    if least := least_ahead(tables[0].data):
        console.print(least)
    print_tables(console, (table for table in tables if "growth_calls" not in table.name))


def write_growth(points: pd.DataFrame, folder: str | Path) -> Path:
    """Write growth.md, growth.csv, the figure and one CSV per table; return the page."""
    folder = Path(folder)
    draw_files(partial(plot_growth, points), folder / "growth")
    tables = tables_of(points)
    return write_page(folder / "growth.md", _page(points, tables), tables, {"growth": points})


def _page(points: pd.DataFrame, tables: Sequence[Table]) -> str:
    largest = int(points["k"].max())
    introduction = (
        f"QPs of {join(families_of(points))} with up to {largest:,} columns: {STEPS} steps of "
        f"{1000 * STEP:g} ms of a slowly moving scene, or the first {MOST} QPs of them, replayed "
        "warm, by who can, at accuracy `high` (1e-9 of the scale of the QP), every answer "
        "judged. One thread of "
        f"{machine_label()}. "
        "Hollow markers: not every answer is verified."
    )
    parts = [
        "# Time per QP against its size\n",
        introduction + "\n",
        *(said + "\n" for said in [least_ahead(tables[0].data)] if said),
        "![Time per QP against the number of columns](growth.png)\n",
        *(table.to_markdown() for table in tables),
    ]
    return "\n".join(parts)
