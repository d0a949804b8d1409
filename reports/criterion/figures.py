"""Figures of the refactorization criterion: cost against interval, and iterations against age."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from harness.criterion.cost_model import cost_per_call
from harness.criterion.measurement import Measurement, Run
from reports.parts.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SOFT,
    VERMILLION,
    drawing,
    save,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

T = TypeVar("T")
NEVER_AT = 200.0
"""Where the interval ∞ stands on a logarithmic axis that ends at 100."""
TICKS = (1, 2, 5, 10, 20, 50, 100)
WIDE = 4.0
"""Costs that span more than this factor stand on a logarithmic axis."""
COLUMNS = 2
"""Panels beside each other."""
PANEL_HEIGHT = 2.2
"""Height of a panel with its title and labels [in]."""


def plot_sweep(measured: Sequence[Measurement], path: str | Path) -> Path:
    """Cost per QP against the interval, one panel per recording, with every rule marked.

    Costs are relative to the best fixed interval, in operations (dark) and in time (light).
    """
    labels = "QPs per factorization", "cost per QP / best"
    return plot_panels(measured, _sweep_panel, labels, 0.62, path)


def _sweep_panel(axes: Axes, one: Measurement) -> None:
    best = one.best()
    at = [_place(run.interval) for run in one.sweep]
    cost = np.array([run.cost for run in one.sweep]) / best.cost
    time = np.array([run.time for run in one.sweep]) / one.best("runtime").time
    axes.plot(at, time, color=FAINT, linewidth=1.6, zorder=1, label="measured time")
    axes.plot(
        at, cost, color=BLUE, marker="o", markersize=3, linewidth=1.2, zorder=3,
        label="counted operations",
    )  # fmt: skip
    lowest = min(
        [1.0, *(one.rules[name].cost / best.cost for name in ("online", "paper deferred"))]
    )
    top = max(1.12, float(cost.max()), one.rules["paper"].cost / best.cost)
    if top > WIDE * lowest:
        axes.set_yscale("log")
        _plain_ticks(axes.yaxis)
        axes.set_ylim(0.93 * lowest, 1.1 * top)
    else:
        margin = 0.09 * (top - lowest)
        axes.set_ylim(lowest - margin, top + margin)
    _model(axes, one)
    for name, colour, style in (
        ("paper", VERMILLION, (0, (4, 2))),
        ("fitted", GREEN, (0, (1, 1.3))),
    ):
        axes.axvline(
            _place(max(1.0, one.predicted[name])), color=colour, linestyle=style, linewidth=1.2,
            zorder=2, label="s* with c = r = 1" if name == "paper" else "s* with c, r fitted",
        )  # fmt: skip
    axes.plot(
        [_place(best.interval)], [1.0], marker="o", markersize=9, markerfacecolor="none",
        markeredgecolor=INK, linestyle="none", zorder=4, label="best fixed interval",
    )  # fmt: skip
    for name, marker, colour, size in (
        ("paper", "X", VERMILLION, 7),
        ("paper deferred", "v", PURPLE, 6),
        ("online", "*", ORANGE, 11),
    ):
        run = one.rules[name]
        axes.plot(
            [_cycle_place(run)], [run.cost / best.cost], marker=marker,
            color=colour, markersize=size, linestyle="none", markeredgecolor=INK,
            markeredgewidth=0.5, zorder=5, label=f"rule: {name}",
        )  # fmt: skip
    online = one.rules["online"]
    axes.plot(
        [_cycle_place(online)], [online.time / one.best("runtime").time], marker="*", color=FAINT,
        markersize=9, linestyle="none", markeredgecolor=SOFT, markeredgewidth=0.5, zorder=4,
        label="online, in time",
    )  # fmt: skip
    axes.axhline(1.0, color=SOFT, linewidth=0.5, zorder=0)
    _interval_axis(axes)
    _head(axes, one.scene, f"f = {one.criterion.free:g}, best {best.cost:,.0f} flops")


def _model(axes: Axes, one: Measurement) -> None:
    """The cost model with the fitted c and r, with C_0 such that it fits on average."""
    if one.growth is None:
        return
    counted, (c, r) = one.criterion, one.growth.prediction()

    def model(s: float) -> float:
        return cost_per_call(s, counted.C_QR, counted.C_IT, c, r)

    rest = float(np.mean([run.cost - model(run.cycle) for run in one.sweep]))
    longest = max(run.cycle for run in one.sweep)
    s = np.geomspace(1, min(100.0, max(2.0, longest)), 80)
    axes.plot(
        s,
        np.array([model(float(x)) + rest for x in s]) / one.best().cost,
        color=GREEN,
        linewidth=0.9,
        alpha=0.8,
        zorder=2,
        label="cost model, c and r fitted",
    )


def plot_growth(measured: Sequence[Measurement], path: str | Path) -> Path:
    """Iterations per QP against the age of R, with the fit, and how the bound from κ grows."""
    labels = "QPs since the factorization, s", "CG iterations per QP"
    return plot_panels(measured, _growth_panel, labels, 0.42, path)


def _growth_panel(axes: Axes, one: Measurement) -> None:
    growth = one.growth
    if growth is not None:
        axes.plot(
            growth.ages, growth.means, color=BLUE, marker="o", markersize=4, linestyle="none",
            zorder=3, label="counted mean",
        )  # fmt: skip
        s = np.geomspace(1, growth.ages.max(), 50)
        axes.plot(s, growth.c * s**growth.r, color=BLUE, linewidth=1.1, label="c s^r fitted")
        if len(one.drift):
            effort = one.drift["effort"].to_numpy()
            axes.plot(
                one.drift["age"], growth.means[0] * effort / effort[0], color=GREEN,
                linewidth=1.0, linestyle=(0, (1, 1.3)), label="bound from κ (same start)",
            )  # fmt: skip
        axes.plot(
            s, s, color=VERMILLION, linewidth=1.0, linestyle=(0, (4, 2)), label="the paper's s"
        )
    axes.axhline(
        one.criterion.free,
        color=SOFT,
        linewidth=0.8,
        linestyle=(0, (1, 2)),
        label="columns f of A_F",
    )
    axes.axhline(one.criterion.threshold, color=ORANGE, linewidth=1.0, label="√(2 C_QR/C_IT)")
    axes.set_xscale("log")
    axes.set_yscale("log")
    largest = max(one.criterion.free, float(growth.means.max()) if growth is not None else 1.0)
    axes.set_ylim(min(0.8, 0.9 * one.criterion.threshold), 2.2 * largest)
    _plain_ticks(axes.xaxis)
    _plain_ticks(axes.yaxis)
    axes.grid(axis="y")
    fit = "" if growth is None else f"c = {growth.c:.2g}, r = {growth.r + 0.0:.2g}"
    _head(axes, one.scene, fit)


def _plain_ticks(axis: Axis) -> None:
    """1, 2, 5, 10, … on a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _head(axes: Axes, title: str, aside: str) -> None:
    """A title, and a remark under it, which would not fit beside a long one."""
    axes.set_title(title, pad=15)
    axes.text(0, 1.04, aside, transform=axes.transAxes, va="bottom", size=7, color=SOFT)


def _place(interval: float) -> float:
    """Position of an interval on the axis."""
    return NEVER_AT if interval == inf or interval > 150 or not isfinite(interval) else interval


def _cycle_place(run: Run) -> float:
    """Position of the mean interval of a rule."""
    never = not (run.steps["age"] == 0)[run.steps["counted"]].any()
    return NEVER_AT if never else run.cycle


def _interval_axis(axes: Axes) -> None:
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.set_xscale("log")
    axes.set_xlim(0.85, 1.25 * NEVER_AT)
    axes.xaxis.set_major_locator(FixedLocator([*TICKS, NEVER_AT]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticklabels([*(str(tick) for tick in TICKS), "never"])
    axes.grid(axis="y")


def plot_panels(
    items: Sequence[T],
    draw: Callable[[Axes, T], None],
    labels: tuple[str, str],
    legend: float,
    path: str | Path,
) -> Path:
    """One panel per item, drawn by `draw`, and one legend; labels (x, y) of the axes.

    legend : height left for it at the bottom [in]
    """
    with drawing() as Figure:
        figure, panels = _panels_of(Figure, len(items), legend)
        for place, (axes, item) in enumerate(zip(panels, items, strict=True)):
            draw(axes, item)
            axes.set_xlabel(labels[0])
            if place % COLUMNS == 0:
                axes.set_ylabel(labels[1])
        _legend_below(figure, panels)
        return save(figure, Path(path))


def _panels_of(Figure: type[Figure], count: int, legend: float) -> tuple[Figure, list[Axes]]:
    """A figure with so many panels, `legend` inches left free at the bottom."""
    rows = ceil(count / COLUMNS)
    height = rows * PANEL_HEIGHT + legend
    figure = Figure(figsize=(PAGE_WIDTH, height))
    left, gap, right = 0.55, 0.5, 0.1
    width = (PAGE_WIDTH - left - right - (COLUMNS - 1) * gap) / COLUMNS
    panels = []
    for place in range(count):
        row, column = divmod(place, COLUMNS)
        x, y = left + column * (width + gap), height - (row + 1) * PANEL_HEIGHT + 0.42
        panels.append(
            figure.add_axes(
                (x / PAGE_WIDTH, y / height, width / PAGE_WIDTH, (PANEL_HEIGHT - 0.87) / height)
            )
        )
    return figure, panels


def _legend_below(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels, at the bottom."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(
        handles=list(found.values()), labels=list(found), loc="lower center", ncols=4, fontsize=7.5
    )
