"""Work of the paper's method along one scene: when does a QP take more than one direction, and why?

Four panels over time: the events of the motion, the number of multipliers, the descent directions
(§3.2: "at most time points the optimum is found after the computation of one"), and the conjugate
gradient iterations with the factorizations made and the threshold of the criterion.  Where the
paper's method was not run it is our own, which makes no such iterations where QPs are small.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from reports.parts.style import BLUE, GREEN, INK, PAGE_WIDTH, VERMILLION, drawing, save
from reports.rows.results import Results
from reports.sections.thresholds import keeper

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def work_rows(results: Results, scene: str) -> pd.DataFrame:
    """Warm solves of `keeper` on one scene at the study's first setting, by time."""
    rows = results.rows
    chosen = (
        (rows["scene"] == scene)
        & (rows["solver"] == keeper(results))
        & (rows["settings"] == results.headline)
        & (rows["arm"] == "warm")
        & ~rows["skipped"]
    )
    # A rejected step ends later than the one that replaces it.
    return rows[chosen].sort_values(["t", "step"])


def plot_work(
    results: Results, scene: str, path: str | Path, *, threshold: float | None = None
) -> Path:
    """Work of `keeper` along a scene: events, k, descent directions, CG iterations.

    Drawn from its warm solves at the study's first setting; factorizations are ticks under the CG
    iterations, and `threshold` the number of them beyond which the paper refactorizes.

    Raises ValueError where it was not run warm on this scene.
    """
    rows = work_rows(results, scene)
    name = keeper(results)
    if rows.empty:
        raise ValueError(f"{name} was not run warm on {scene}, so there is no work to draw")
    recording = results.recordings.get(scene)
    events = [] if recording is None else list(recording.events)
    kinds = sorted({str(kind) for _, kind, *_ in events})
    panels = [
        ("k", "multipliers k", BLUE),
        ("descent_directions", "descent\ndirections", GREEN),
        ("cg_iterations", "CG\niterations", VERMILLION),
    ]
    from matplotlib.ticker import MaxNLocator

    each, gap, top, bottom = 0.72, 0.16, 0.32, 0.42
    rug = 0.15 * len(kinds) + (0.1 if kinds else 0)
    total = top + rug + len(panels) * (each + gap) + bottom
    left, right = 1.05, 0.1
    t = rows["t"].to_numpy()
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        figure.text(
            0, 1 - 0.04 / total, f"{scene}: work of {name} along the motion",
            va="top", weight="bold", size=10,
        )  # fmt: skip
        span = (left / PAGE_WIDTH, (PAGE_WIDTH - left - right) / PAGE_WIDTH)
        limits = (min(0.0, float(t.min())), float(t.max()) or 1.0)
        if kinds:
            axes = figure.add_axes((span[0], 1 - (top + rug) / total, span[1], rug / total))
            for line, kind in enumerate(kinds):
                at = [float(time) for time, name, *_ in events if str(name) == kind]
                axes.vlines(at, line - 0.38, line + 0.38, color=INK, linewidth=0.8)
            axes.set_ylim(len(kinds) - 0.4, -0.6)
            axes.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
            axes.tick_params(axis="y", length=0, labelsize=7)
            axes.set_xlim(*limits)
            axes.set_xticks([])
            for side in axes.spines.values():
                side.set_visible(False)
        for place, (column, label, colour) in enumerate(panels):
            bottom_edge = total - top - rug - (place + 1) * (each + gap)
            axes = figure.add_axes((span[0], bottom_edge / total, span[1], each / total))
            values = rows[column].to_numpy(dtype=float)
            axes.plot(t, values, drawstyle="steps-mid", color=colour, linewidth=0.9)
            axes.fill_between(t, values, step="mid", color=colour, alpha=0.2, linewidth=0)
            axes.set_xlim(*limits)
            axes.set_ylim(0, max(1.0, float(np.nanmax(values))) * 1.12)
            axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
            axes.grid(axis="y")
            axes.set_ylabel(label, rotation=0, ha="right", va="center", size=8)
            if column == "cg_iterations":
                _factorizations(axes, rows, threshold)
            if place < len(panels) - 1:
                axes.set_xticklabels([])
            else:
                axes.set_xlabel("t [s]")
        return save(figure, Path(path))


def _factorizations(axes: Axes, rows: pd.DataFrame, threshold: float | None) -> None:
    """Ticks where a factorization was made, and the line of the paper's criterion."""
    made = rows.loc[rows["qr_factorizations"] > 0, "t"]
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.22 * (high - low), high)
    axes.vlines(made, low - 0.17 * (high - low), low - 0.05 * (high - low), color=INK, lw=0.6)
    if threshold is not None and np.isfinite(threshold):
        axes.set_ylim(top=max(high, 1.15 * threshold))
        axes.axhline(threshold, color=INK, linewidth=0.9, linestyle=(0, (5, 2)))
