"""What `glambda peers` prints and writes: accuracy against CPU time, engine by engine.

The tables of `reports.peers.tables`; one figure, error against CPU time on logarithmic axes with a
panel for each motion; one page, peers.md; every run as peers.csv.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from rich.console import Console

from harness.machine.machine import machine_label
from harness.peers import OURS, EngineInfo
from harness.peers.compare import compared, frontier
from reports.parts.style import (
    BLUE,
    FAINT,
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
)  # fmt: skip
from reports.parts.table import print_tables, write_page
from reports.peers.tables import tables_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOKS = {
    OURS: (VERMILLION, "o"), "pymunk": (BLUE, "s"), "box2d": (GREEN, "^"),
    "box2d3": (SKY, "v"), "mujoco": (ORANGE, "D"), "dart": (PURPLE, "P"),
    "drake": (INK, "X"), "cenic": (SOFT, "*"), "cundall": (YELLOW, "p"),
    "bullet": (GREEN, "<"),
}  # fmt: skip
"""Colour and marker of each engine."""
LOOK_ELSE = (SOFT, "h")
"""Of an engine from elsewhere."""


def plot_peers(rows: pd.DataFrame, path: str | Path) -> Path:
    """Error of the pose against CPU time, one panel per motion: every run, and the best ones."""
    part = compared(rows)
    tasks = list(dict.fromkeys(part["task"]))
    engines = list(dict.fromkeys(part["engine"]))
    with drawing() as Figure:
        lines = -(-len(tasks) // 2)
        figure = Figure(figsize=(PAGE_WIDTH, 3.3 * lines + 0.5), layout="constrained")
        grid = figure.subplots(lines, min(2, len(tasks)), squeeze=False)
        panels = grid.ravel()
        for axes in panels[len(tasks) :]:
            axes.set_visible(False)
        for axes, task in zip(panels, tasks, strict=False):
            _panel(axes, part[part["task"] == task], engines)
            axes.set_title(f"{task} s")
            axes.set_xlabel("CPU time [s]")
        for axes in grid[:, 0]:
            axes.set_ylabel("error of the pose [m or rad]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(9, len(labels)))
        return save(figure, Path(path))


def _panel(axes: Axes, part: pd.DataFrame, engines: Sequence[str]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    for engine in engines:
        own = part[part["engine"] == engine]
        colour, marker = LOOKS.get(engine, LOOK_ELSE)
        ours = engine == OURS
        axes.plot(
            own["cpu"], own["error"], linestyle="none", marker=".", markersize=2.5, color=colour,
            alpha=0.35, zorder=2,
        )  # fmt: skip
        best = frontier(own)
        axes.plot(
            best["cpu"], best["error"], color=colour, marker=marker, label=engine,
            markersize=5 if ours else 3.6, linewidth=2.2 if ours else 1.0, zorder=5 if ours else 3,
        )  # fmt: skip
    floor = float(part["reference_error"].max())
    axes.axhspan(0.0, floor, color=FAINT, alpha=0.5, linewidth=0, zorder=0)
    axes.set_ylim(min(floor, float(part["error"].min())) / 2, 1.0)


def print_peers(console: Console, rows: pd.DataFrame, engines: Sequence[EngineInfo]) -> None:
    """Print every table with its notes."""
    print_tables(console, tables_of(rows, engines))


def write_peers(rows: pd.DataFrame, engines: Sequence[EngineInfo], folder: str | Path) -> Path:
    """Write peers.md, peers.csv, the figure and one CSV per table; return the page."""
    folder = Path(folder)
    drawn = len(compared(rows)) > 0
    if drawn:
        draw_files(partial(plot_peers, rows), folder / "peers")
    tables = tables_of(rows, engines)
    figure = "![Error of the pose against CPU time, engine by engine](peers.png)\n"
    figure += "\n*Lines join the runs of an engine that none of its others beats; dots are all of "
    figure += "its runs. Shaded: below the reference's own error.*\n"
    parts = [
        "# Other engines on the same scenes\n",
        _introduction() + "\n",
        *([figure] if drawn else []),
        *(table.to_markdown() for table in tables),
    ]
    return write_page(folder / "peers.md", "\n".join(parts), tables, {"peers": rows})


def _introduction() -> str:
    return (
        "Every engine starts from the same positions and velocities, has the same coefficient of "
        "friction and no restitution, and is asked to do the same. Its poses are compared with "
        f"those of {OURS}'s own finest run. That the errors of engines whose contacts are rigid go "
        "on falling with their steps, on some motions through dozens of impacts with friction, is "
        "what confirms the reference; an engine whose errors stop falling has another model of "
        "contact, or a fault. Times are CPU time of the stepping alone, the least of up to three "
        f"passes, each engine in a process of its own, on one thread of {machine_label()}; "
        "building the scene is not counted."
    )
