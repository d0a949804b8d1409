"""What `glambda race` prints and writes: our method beside packages called by hand.

    race_ratios               the best package over our method, least ahead first
    race_inside, race_arrays, race_whole    everybody's time per QP by each clock

One figure, a panel for each recording, started warm; one page, race.md; the measured rounds as
race.csv.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from rich.console import Console

from harness.machine.machine import machine_label
from harness.names import METHOD
from harness.race.race import CLOCKS, MOST, ONE_CALL, OURS, POSED, ratios
from reports.parts.sentences import join
from reports.parts.style import (
    BLUE,
    GREEN,
    INK,
    PAGE_WIDTH,
    VERMILLION,
    draw_files,
    drawing,
    save,
)
from reports.parts.table import (
    Table,
    duration,
    microseconds,
    percent,
    print_tables,
    times,
    whole,
    write_page,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATIOS = "race_ratios"
BY_CLOCK = {
    "inside": "inside the package",
    "arrays": "from ready arrays",
    "whole": "from A, d and bounds",
}
READ_AS = {
    "inside": "by the package's own clock, of ours the compiled call; a dash: it has none",
    "arrays": "set-up and solve, from what the package takes to x, such as AᵀA and Aᵀd; ours takes "
    "a ContactQP",
    "whole": "from A, d and bounds to x, what the package takes built within; of ours "
    f"`solve_arrays`, which checks them; `{POSED}` copies them too",
}
MANY = 12
"""Places that are named where more have lost."""
WIDEST = 30
"""Characters of a line above a panel."""
LOOKS = {"inside": (GREEN, "o"), "arrays": (BLUE, "s"), "whole": (VERMILLION, "D")}
"""Colour and marker of a clock."""


def ratios_table(rows: pd.DataFrame) -> Table:
    """Our method and the best package by each clock, least ahead first."""
    data = ratios(rows)
    return Table(
        name=RATIOS,
        title="Our method and the best package, least ahead first",
        reading=(
            f"ratio is the time of the best package over that of {METHOD}, by each clock among "
            "those whose every answer is verified: below 1, ours is slower. It is the median of "
            "the rounds; from, to: their middle half."
        ),
        data=data.assign(clock=data["clock"].map(BY_CLOCK)),
        formats={
            "k": whole, METHOD: duration, "its": duration,
            **dict.fromkeys(("ratio", "from", "to"), times),
        },
    )  # fmt: skip


def clock_table(rows: pd.DataFrame, clock: str) -> Table:
    """Everybody's medians by a clock, those alone who are verified on every QP."""
    medians = _medians(rows)
    found = medians.pivot(index=["scene", "arm", "k"], columns="solver", values=clock)
    solvers = [name for name in dict.fromkeys(rows["solver"]) if found[name].notna().any()]
    keys = rows[["scene", "arm"]].drop_duplicates()
    data = keys.merge(found[solvers].reset_index(), on=["scene", "arm"])
    missed = medians[medians["verified"] < 1.0]
    notes = [
        f"{row.scene}, {row.arm}: {row.solver} is verified on {percent(row.verified)} of the QPs "
        "only, and has no time here."
        for row in missed.itertuples()
    ]
    return Table(
        name=f"race_{clock}",
        title=f"Time per QP {BY_CLOCK[clock]} [µs]",
        reading=f"medians over QPs and rounds, {READ_AS[clock]}.",
        data=data,
        formats={"k": whole, **dict.fromkeys(solvers, microseconds)},
        notes=notes if clock == CLOCKS[-1] else (),
    )


def _medians(rows: pd.DataFrame) -> pd.DataFrame:
    """Medians over the rounds; no times of who is not verified on every QP."""
    keys = ["scene", "arm", "solver", "k", "verified"]
    medians = rows.groupby(keys, sort=False)[list(CLOCKS)].median().reset_index()
    medians.loc[medians["verified"] < 1.0, list(CLOCKS)] = np.nan
    return medians


def tables_of(rows: pd.DataFrame) -> list[Table]:
    """Ratios first, then the times by each clock."""
    return [ratios_table(rows), *(clock_table(rows, clock) for clock in CLOCKS)]


def losses(folder: Path) -> list[str]:
    """Where our method is not the fastest in a race, one sentence for each clock, of its page.

    folder : where `write_race` has written it
    """
    return _lost(pd.read_csv(folder / f"{RATIOS}.csv"))


def _lost(data: pd.DataFrame) -> list[str]:
    """The same of the numbers of `ratios_table`."""
    said = []
    for clock, part in data.groupby("clock", sort=False):
        lost = part[part["ratio"] < 1.0]
        if lost.empty:
            continue
        places = [
            f"{row['scene']} {row['arm']} ({row['best']}, {times(1 / row['ratio'])})"
            for _, row in lost.iterrows()
        ]
        said.append(
            f"Called by hand, one QP right after the other, a package is faster than {METHOD} "
            f"{clock} on {len(lost)} of {len(part)}: {join(places, MANY)}."
        )
    return said


def plot_race(rows: pd.DataFrame, path: Path) -> Path:
    """Times by three clocks of the first arm, a panel for each recording, the quickest on top."""
    drawn = _medians(rows[rows["arm"] == rows["arm"].iloc[0]])
    scenes = list(dict.fromkeys(drawn["scene"]))
    with drawing() as Figure:
        lines = -(-len(scenes) // 2)
        most = drawn.groupby("scene")["solver"].nunique().max()
        size = (PAGE_WIDTH, lines * (0.17 * most + 0.75) + 0.4)
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(lines, 2, squeeze=False)
        for axes in grid.ravel()[len(scenes) :]:
            axes.set_visible(False)
        for axes, scene in zip(grid.ravel(), scenes, strict=False):
            _panel(axes, drawn[drawn["scene"] == scene])
            axes.set_title(fill(scene.replace(",", ", "), WIDEST), fontsize=9)
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return save(figure, path)


def _panel(axes: Axes, part: pd.DataFrame) -> None:
    from matplotlib.ticker import NullFormatter

    most = part["k"].max()
    part = part[part["verified"] == 1.0]
    order = part.assign(by=part["whole"].fillna(part["arrays"])).sort_values("by", ascending=False)
    places = np.arange(len(order))
    axes.set_xscale("log")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, axis="x", which="major")
    for clock in CLOCKS:
        colour, marker = LOOKS[clock]
        axes.plot(
            1e6 * order[clock].to_numpy(float), places, linestyle="none", marker=marker,
            markersize=3.8, color=colour, label=BY_CLOCK[clock],
        )  # fmt: skip
    axes.set_yticks(places, order["solver"].tolist(), color=INK)
    for text, name in zip(axes.get_yticklabels(), order["solver"], strict=True):
        text.set_fontweight("bold" if name.startswith(OURS) else "normal")
    axes.set_xlabel(f"µs per QP, k ≤ {most}")


def print_race(console: Console, rows: pd.DataFrame) -> None:
    """Print every table."""
    print_tables(console, (table for table in tables_of(rows) if len(table.data)))


def write_race(rows: pd.DataFrame, folder: str | Path) -> Path:
    """Write race.md, race.csv, the figure and one CSV per table; return the page."""
    folder, tables = Path(folder), tables_of(rows)
    draw_files(partial(plot_race, rows), folder / "race")
    return write_page(folder / "race.md", _page(rows, tables), tables, {"race": rows})


def _page(rows: pd.DataFrame, tables: Sequence[Table]) -> str:
    scenes = list(dict.fromkeys(rows["scene"]))
    introduction = (
        f"{len(scenes)} recordings, the first {MOST} QPs of each that end a step, at accuracy "
        "`high` (1e-9 of the scale of the QP), every answer judged. Everybody lives in one "
        "process and takes a whole sequence, one QP right after the other, packages as a careful "
        "user would call them by hand, without our adapters; then the next one does, in turns, "
        f"{rows['round'].max() + 1} rounds. In the replay of a study, and in a simulation, other "
        "things go on between two calls; here nothing does, and the quickest are at their best. "
        f"One thread of {machine_label()}. `{POSED}` is made for each QP, as a simulation that "
        f"keeps its QPs makes them, and `{ONE_CALL}` is a whole sequence in one compiled call, "
        "from packed arrays; both stand beside the race."
    )
    parts = [
        "# A race: one QP right after the other\n",
        introduction + "\n",
        *(f"- {said}\n" for said in _lost(tables[0].data)),
        "![Time per QP by three clocks](race.png)\n",
        f"*Started {rows['arm'].iloc[0]}; verified on every QP.*\n",
        *(table.to_markdown(longest=len(table.data)) for table in tables),
    ]
    return "\n".join(parts)
