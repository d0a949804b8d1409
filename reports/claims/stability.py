"""Figure 1 of the paper: stability regions of (AB-r, BDF-r), and runs of the stepper on them.

stability.png    the regions; runs of the stepper inside and outside; growth at the corners
stability.md     the same as a page, with the table of runs
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from harness.claims.stability import CORNERS, border, region
from problems.qp import Vector
from reports.parts.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    PAGE_WIDTH,
    SOFT,
    VERMILLION,
    drawing,
    save,
)
from reports.parts.table import Table, scientific, short, whole, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDEST = 4.0
"""Largest D = h d drawn."""
CLOSE = 0.02
"""Relative difference of two growth factors that is put down to the fit."""


def runs_table(checked: pd.DataFrame) -> Table:
    """Runs of the stepper beside the roots."""
    notes = [
        "The largest residual of a run in the difference equation is "
        f"{scientific(checked['residual'].max())}; (3.9) is solved to ε, not to rounding."
    ]
    off = checked[(checked["growth"] / checked["amplification"] - 1).abs() > CLOSE]
    notes.extend(
        f"r = {row.order}, D = {row.D:g}, K = {row.K:.3g}: the run grows by {row.growth:.4f} per "
        f"step and not by {row.amplification:.4f}; it has {row.steps} steps only."
        for row in off.itertuples()
    )
    return Table(
        name="stability_runs",
        title="Runs of the stepper on the test equation",
        reading=(
            "D = h d, K = h² k; below the border the method is stable for this D. The largest root "
            "|ζ| is the factor per step by the theory, growth the one measured. The residual is "
            "that of the run in the difference equation, relative to the motion."
        ),
        data=checked.rename(columns={"order": "r", "amplification": "largest |ζ|"}),
        formats={
            "r": whole, "D": short, "K": short, "border": short, "largest |ζ|": "{:.4f}".format,
            "steps": whole, "growth": "{:.4f}".format, "residual": scientific,
        },
        notes=notes,
    )  # fmt: skip


def plot_stability(checked: pd.DataFrame, corners: pd.DataFrame, path: Path) -> Path:
    """The two regions with the runs on them, and the runs at the corners."""
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 3.1), layout="constrained")
        first, second, last = figure.subplots(1, 3)
        for axes, order in ((first, 1), (second, 2)):
            _draw_region(axes, order, checked[checked["order"] == order])
        second.sharey(first)
        first.set_ylabel("K = h² k")
        for (order, _), run in corners.groupby(["order", "K"], sort=False):
            last.plot(
                _sizes(run), color=BLUE if order == 1 else GREEN, linewidth=1.4,
                linestyle="-" if order == 1 else (0, (4, 2)), label=f"r = {order}",
            )  # fmt: skip
        for K, runs in corners.groupby("K"):
            top = max((_sizes(run) for _, run in runs.groupby("order")), key=lambda run: run[-1])
            last.annotate(
                f"K = {K:g}", (0.8 * (top.size - 1), 0.8 * top[-1]), xytext=(-4, 4),
                textcoords="offset points", ha="right", fontsize=7.5,
            )  # fmt: skip
        lines, labels = last.get_legend_handles_labels()
        named = dict(zip(labels, lines, strict=True))
        last.legend(list(named.values()), list(named), loc="upper left")
        last.set_title("double root at a corner")
        last.set_xlabel("steps")
        last.set_ylabel("size of the motion")
        last.grid(True)
        return save(figure, path)


def _draw_region(axes: Axes, order: int, runs: pd.DataFrame) -> None:
    D = np.linspace(0.0, WIDEST, 161)
    K = np.linspace(0.0, float(border(1, WIDEST)), 193)
    found = region(order, D, K)
    # rounding scatters the roots of size 1 on K = 0 and D = 0
    axes.contourf(D, K, found.growth, levels=[1.0 + 1e-6, np.inf], colors=[FAINT])
    axes.plot(D, border(order, D), color=INK, linewidth=1.0)
    grows = runs["growth"] > 1.0 + 1e-3
    for part, colour, marker in ((runs[~grows], BLUE, "o"), (runs[grows], VERMILLION, "x")):
        axes.plot(
            part["D"], part["K"], marker, color=colour, markersize=4, markeredgewidth=1.2,
            clip_on=False, zorder=4,
        )  # fmt: skip
    axes.plot(
        *zip(*CORNERS, strict=True), "s", color=INK, markerfacecolor="white", markersize=4.5,
        clip_on=False, zorder=5,
    )  # fmt: skip
    axes.set_title(f"(AB-{order}, BDF-{order})")
    axes.set_xlabel("D = h d")
    axes.set_xlim(0, WIDEST)
    axes.set_ylim(0, K[-1])
    axes.text(
        0.55 * WIDEST, 0.35 * float(border(order, 0.55 * WIDEST)), "stable", ha="center", color=SOFT
    )


def _sizes(run: pd.DataFrame) -> Vector:
    """Size of the motion at the start and after each step."""
    return run["size"].to_numpy()


def write_stability(checked: pd.DataFrame, corners: pd.DataFrame, folder: str | Path) -> Path:
    """Write stability.md, the table and the figure; return the page."""
    folder = Path(folder)
    plot_stability(checked, corners, folder / "stability.png")
    table = runs_table(checked)
    said = []
    for (order, K), run in corners.groupby(["order", "K"], sort=False):
        size, steps = _sizes(run), len(run) - 1
        said.append(
            f"r = {order}, K = {K:g}: {size[steps // 2]:.0f} after {steps // 2} steps, "
            f"{size[-1]:.0f} after {steps}"
        )
    return write_page(
        folder / "stability.md",
        "# Stability of the compound methods\n\n"
        "On ü + d u̇ + k u = 0 (3.6) with constant steps, D = h d and K = h² k, (AB-1, BDF-1) is "
        "stable for 0 ≤ K ≤ 4 + 2D and (AB-2, BDF-2) for 0 ≤ K ≤ 4 + D, D ≥ 0: figure 1 of the "
        "paper. Without a damper both are the leapfrog. Grey: unstable, from the roots of the "
        "difference equation. Dots and crosses: runs of the stepper itself that stay bounded or "
        "grow, where its iteration for the damper (3.9) converges to a useful tolerance in twelve "
        "passes. Squares: corners with a double root of size 1.\n\n"
        "![Stability regions](stability.png)\n\n"
        f"At the corners runs grow linearly: {', '.join(said)}.\n\n" + table.to_markdown(),
        [table],
    )
