"""The figures of the closed loop: accuracy, separation, physics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.motions.closed_loop import Findings
from harness.motions.in_loop import SLOPPY
from harness.motions.motion_error import APART, pose_error
from reports.motions.closed_loop_findings import (
    AS_GOOD,
    allowed,
    backends,
    discretization,
    own_error,
)
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
    drawing,
    save,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SETTING_LOOKS = {"paper": (BLUE, "o"), "high": (GREEN, "s"), "default": (VERMILLION, "^")}
OTHER_LOOK = (SOFT, "D")
NOISE_COLOURS = (PURPLE, ORANGE, GREEN, INK, SKY)
NOISE_LINES = ("-", "--", (0, (6, 1)), ":", "-.")
NOISE_LOOKS = dict(zip(SLOPPY, zip(NOISE_COLOURS, NOISE_LINES, strict=True), strict=True))
LEAST_RATIO = 1e-8
"""Answers that are better than this, in multiples of what was asked, are drawn here."""
LEAST = 1e-9
"""Smaller errors [m] and energies are drawn here."""
NEAR = (1.0, 0.15)
"""Decades within which two outliers share a label."""
BESIDE = (3.0, 0.6)
"""Decades within which labels of two would overlap: the one on the right stands below its place."""
LONGER = 1.1
"""Loops that come to rest later than this, over the time of that with exact QPs, are cut off."""
SHOWN_NOISE = (("0.01x", SKY), ("1x", GREEN), ("100x", ORANGE), ("1e4x", VERMILLION))
"""Sloppy loops of the kind `any` that stand out in the figure of separation."""


def worst_ratio(rows: pd.DataFrame) -> np.ndarray:
    """Worst answer of each loop, to a step or an impulse, in multiples of what its QP asks for."""
    worst = rows[["eps0_ratio", "impulse_ratio"]].max(axis=1).to_numpy(float)
    return np.maximum(worst, LEAST_RATIO)


def plot_accuracy(found: Sequence[Findings], path: str | Path) -> Path:
    """Pose error against the worst answer, one panel per scene, both axes logarithmic."""
    with drawing() as Figure:
        figure, panels = _panels(Figure, found, 3.3)
        for axes, each in zip(panels, found, strict=True):
            own = max(own_error(each), LEAST)
            axes.axhspan(
                own / 10, allowed(each), color=FAINT, alpha=0.35, linewidth=0,
                label=f"within {AS_GOOD:g} × exact QPs",
            )  # fmt: skip
            axes.axhline(discretization(each), color=INK, linewidth=0.8, label="exact QPs")
            axes.axhline(own, color=SOFT, linewidth=0.8, ls=":", label="error of the reference")
            _against_accuracy(axes, each, each.rows["error"])
            _label_outliers(axes, each)
            axes.set_title(each.scene)
            axes.set_ylim(own / 3, 3 * max(each.rows["error"].max(), allowed(each)))
            axes.set_ylabel("largest pose error [m]")
        _finish(figure, panels)
        return save(figure, Path(path))


def plot_physics(found: Sequence[Findings], path: str | Path) -> Path:
    """Overlap, reach and the work of too large forces against the worst answer, a row each."""
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 6.6), layout="constrained")
        grid = figure.subplots(3, len(found), squeeze=False, sharex=True, sharey="row")
        for column, each in enumerate(found):
            rows, peak = each.rows, each.reference.measures["peak_kinetic"]
            shown = (rows["overlap"], rows["reach"], rows["pumped"] / peak)
            for axes, values in zip(grid[:, column], shown, strict=True):
                _against_accuracy(axes, each, values)
            grid[0, column].set_title(each.scene)
        grid[0, 0].set_ylabel("deepest overlap [m]")
        grid[1, 0].set_ylabel("reach of a force [m]")
        grid[2, 0].set_ylabel("energy pumped in")
        for axes in grid[2]:
            axes.set_xlabel("worst answer / asked")
        _legend(figure, list(grid.ravel()))
        return save(figure, Path(path))


def plot_separation(found: Sequence[Findings], path: str | Path) -> Path:
    """Pose error in time: exact QPs, the check, sloppy answers, and all backends in grey."""
    with drawing() as Figure:
        figure, panels = _panels(Figure, found, 3.0)
        for axes, each in zip(panels, found, strict=True):
            _separation(axes, each)
            axes.set_xlim(0.0, LONGER * float(each.twin_error.t[-1]))
            axes.set_title(each.scene)
            axes.set_xlabel("t [s]")
            axes.set_ylabel("pose error [m]")
        _legend(figure, panels)
        return save(figure, Path(path))


def _separation(axes: Axes, each: Findings) -> None:
    axes.set_yscale("log")
    axes.set_ylim(LEAST, 20)
    axes.grid(True, which="major")
    axes.axhline(APART, color=SOFT, linewidth=0.8, ls=":")
    grey = {"color": SOFT, "alpha": 0.5, "linewidth": 0.6, "zorder": 1, "label": "backends"}
    for row in backends(each).itertuples():
        _draw_error(axes, each, (row.solver, row.setting), **grey)
    for setting, colour in SHOWN_NOISE:
        _draw_error(
            axes, each, (SLOPPY[0], setting), color=colour, linewidth=1.0, zorder=3,
            label=f"{SLOPPY[0]} {setting}",
        )  # fmt: skip
    for error, colour, style, label in (
        (each.twin_error, INK, "-", "exact QPs"),
        (each.check_error, INK, "--", "check of the reference"),
    ):
        _draw(
            axes, error.t, error.error.max(axis=1), color=colour, linestyle=style, linewidth=1.4,
            zorder=4, label=label,
        )  # fmt: skip


def _draw_error(axes: Axes, each: Findings, name: tuple[str, str], **look: Any) -> None:
    result = each.results.get(name)
    if result is None or result.motion is None or each.reference.motion is None:
        return
    error = pose_error(result.motion, each.reference.motion)
    _draw(axes, error.t, error.error.max(axis=1), **look)


def _draw(axes: Axes, t: np.ndarray, error: np.ndarray, **look: Any) -> None:
    """The largest error so far: what matters, and fewer wiggles."""
    axes.plot(t, np.maximum.accumulate(np.maximum(error, LEAST)), **look)


def _panels(Figure: Any, found: Sequence[Findings], height: float) -> tuple[Any, list[Axes]]:
    rows = -(-len(found) // 2)
    figure = Figure(figsize=(PAGE_WIDTH, height * rows + 0.6), layout="constrained")
    grid = figure.subplots(rows, min(2, len(found)), squeeze=False).ravel()
    for axes in grid[len(found) :]:
        axes.set_visible(False)
    return figure, list(grid[: len(found)])


def _finish(figure: Any, panels: Sequence[Axes]) -> None:
    for axes in panels:
        axes.set_xlabel("worst answer / asked (1: ε₀ of (3.13))")
    _legend(figure, panels)


def _legend(figure: Any, panels: Sequence[Axes]) -> None:
    handles: dict[str, Any] = {}
    for axes in panels:
        lines, labels = axes.get_legend_handles_labels()
        handles.update(zip(labels, lines, strict=True))
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4)


def _against_accuracy(axes: Axes, each: Findings, values: pd.Series) -> None:
    """One panel: sloppy solvers as lines, backends as markers."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    axes.axvline(1.0, color=SOFT, linewidth=0.8)
    rows = each.rows.assign(value=np.maximum(values.to_numpy(float), LEAST))
    rows["ratio"] = worst_ratio(rows)
    for solver, (colour, style) in NOISE_LOOKS.items():
        own = rows[(rows["solver"] == solver) & (rows["verdict"] == "finished")]
        own = own.sort_values("ratio")
        if len(own):
            axes.plot(
                own["ratio"], own["value"], color=colour, linestyle=style, linewidth=1.3,
                label=solver, zorder=2,
            )  # fmt: skip
    own = rows.loc[backends(each).index]
    for setting in reversed(dict.fromkeys(own["setting"])):  # the first one on top
        colour, marker = SETTING_LOOKS.get(setting, OTHER_LOOK)
        part = own[own["setting"] == setting]
        for ended, face in ((True, colour), (False, "white")):
            some = part[(part["verdict"] == "finished") == ended]
            axes.plot(
                some["ratio"], some["value"], linestyle="none", marker=marker, markersize=4.2,
                markerfacecolor=face, markeredgecolor=colour, zorder=4,
                label=f"backends, {setting}" if ended else None,
            )  # fmt: skip


def _label_outliers(axes: Axes, each: Findings) -> None:
    """Name the backends that are not as good as exact QPs; neighbours share a label."""
    rows = backends(each)
    bad = rows[rows["error"] > allowed(each)]
    places = np.log10(np.column_stack([worst_ratio(bad), bad["error"]])) if len(bad) else []
    groups: list[tuple[np.ndarray, list[str]]] = []
    for place, name in zip(places, bad["solver"], strict=True):
        near = [names for at, names in groups if (np.abs(place - at) < NEAR).all()]
        if near:
            near[0].append(name)
        else:
            groups.append((place, [name]))
    last, below = np.full(2, -np.inf), False
    for place, names in sorted(groups, key=lambda group: float(group[0][0])):
        below = not below and bool((np.abs(place - last) < BESIDE).all())
        axes.annotate(
            ", ".join(dict.fromkeys(names)), tuple(10**place), xytext=(0, -5 if below else 5),
            ha="center", va="top" if below else "bottom", textcoords="offset points",
            fontsize=6.5, color=INK,
        )  # fmt: skip
        last = place
