"""Errors against ε, time against error, and drift against τ in one figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.claims.convergence import ROUNDING, Converged
from harness.claims.reference_motion import STOCK
from harness.claims.stabilization import SHALLOW
from harness.peers.ours import BOUNDED
from reports.parts.style import (
    BLUE,
    GREEN,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    SOFT,
    VERMILLION,
    drawing,
    save,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Looks = dict[str, dict[str, Any]]
COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY)
LINES: dict[str, Any] = {BOUNDED: "-", STOCK: (0, (2, 2))}
MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_convergence(measured: Converged, path: Path) -> Path:
    """Six panels: errors by ε three times, time by error, overlap and error by τ; dashed: STOCK."""
    labels = list(measured.swept["scene"].unique())
    looks: Looks = {
        label: {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
        for i, label in enumerate(labels)
    }
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 5.6), layout="constrained")
        top, bottom = figure.subplots(2, 3)
        titles = {"before": "before the first impact", "after": "after it", "late": "late"}
        for axes, (stretch, title) in zip(top, titles.items(), strict=True):
            _draw_errors(axes, measured.swept[measured.swept["stretch"] == stretch], looks)
            axes.set_title(title)
        top[2].sharey(top[1])
        _draw_work(bottom[0], measured.swept, looks)
        drifted = measured.drifted
        drifted = drifted[drifted.groupby("scene")["depth"].transform("max") > SHALLOW]
        _draw_drift(bottom[1], drifted, "depth", looks)
        bottom[1].set_title("worst gap of an active contact")
        bottom[1].set_ylabel("−min φ [m]")
        worst = drifted.assign(pose=drifted[["before", "after"]].max(axis=1))
        _draw_drift(bottom[2], worst, "pose", looks)
        bottom[2].set_title("pose error")
        bottom[2].set_ylabel("error [m]")
        lines = [
            top[0].plot([], [], markersize=4, linewidth=1.1, **look)[0] for look in looks.values()
        ]
        figure.legend(lines, labels, loc="outside lower center", ncols=min(len(labels), 4))
        return save(figure, path)


def _draw_errors(axes: Axes, part: pd.DataFrame, looks: Looks) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    above = part[part["pose"] > ROUNDING]
    for (label, bound), runs in above.groupby(["scene", "bound"], sort=False):
        axes.plot(
            runs["eps"], runs["pose"], markersize=3.5 if bound == BOUNDED else 2, linewidth=1.1,
            linestyle=LINES[bound], **looks[label],
        )  # fmt: skip
    eps = np.array([part["eps"].min(), part["eps"].max()]) if len(part) else np.array([1e-6, 1e-2])
    axes.plot(eps, eps, color=SOFT, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.annotate("ε", (eps[0], eps[0]), xytext=(2, 4), textcoords="offset points", color=SOFT)
    axes.set_xlabel("ε")
    axes.set_ylabel("pose error [m]")
    axes.grid(True)


def _draw_work(axes: Axes, swept: pd.DataFrame, looks: Looks) -> None:
    """CPU time against the largest error of a run, dashed where ε alone decides."""
    worst = swept.groupby(["scene", "bound", "eps"], sort=False)[["pose", "cpu"]].max()
    worst = worst[worst["pose"] > ROUNDING].reset_index()
    for (label, bound), runs in worst.groupby(["scene", "bound"], sort=False):
        axes.loglog(
            runs["pose"], runs["cpu"], markersize=3, linewidth=1.1,
            linestyle=LINES[bound], **looks[label],
        )  # fmt: skip
    axes.set_title(f"dashed: {STOCK}, else {BOUNDED}", fontsize=8)
    axes.set_xlabel("pose error [m]")
    axes.set_ylabel("CPU [s]")
    axes.grid(True)


def _draw_drift(axes: Axes, drifted: pd.DataFrame, column: str, looks: Looks) -> None:
    """By τ of Baumgarte's rule at the coarsest ε; without a rule on the right, projected left."""
    part = drifted[drifted["eps"] == drifted["eps"].max()]
    part = part[part["rule"] != "none, compiled"]
    taus = np.sort(part["tau"].dropna().unique())
    if not taus.size:
        axes.text(0.5, 0.5, "no drift above rounding", ha="center", transform=axes.transAxes)
        return
    ends = {"projection": taus[0] / 4, "none": taus[-1] * 4}
    axes.set_xscale("log")
    axes.set_yscale("log")
    for label, runs in part.groupby("scene", sort=False):
        place = runs["tau"].fillna(runs["drift"].map(ends))
        kept = runs.assign(place=place)[runs[column] > 1e-17].sort_values("place")
        inner = kept[kept["drift"] == "baumgarte"]
        axes.plot(inner["place"], inner[column], markersize=3.5, linewidth=1.1, **looks[label])
        outer = kept[kept["drift"] != "baumgarte"]
        axes.plot(
            outer["place"], outer[column], linestyle="none", markersize=4.5,
            markerfacecolor="none", **looks[label],
        )  # fmt: skip
    shown = taus[:: max(1, taus.size // 2)]
    axes.set_xticks(
        [ends["projection"], *shown, ends["none"]], ["proj.", *(f"{t:g}" for t in shown), "none"]
    )
    axes.minorticks_off()
    axes.set_xlabel("τ of Baumgarte's rule [s]")
    axes.grid(True)
