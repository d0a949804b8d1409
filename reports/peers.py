"""What `glambda peers` prints and writes: accuracy against CPU time, engine by engine.

    peers_least        least CPU time for an error of the pose, of each engine
    peers_order        order in the step, smallest error, time per step
    peers_whole        whole motions: deepest overlap, energy gained
    peers_rest         towers at rest: drift, overlap, time per step
    peers_lost         runs that did not end, and why
    peers_engines      versions, and how their models differ from ours

One figure, error against CPU time on logarithmic axes with a panel for each motion; one page,
peers.md; every run as peers.csv.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rich.console import Console

from harness.machine import machine_label
from harness.peers import OURS, REMEDY, EngineInfo
from harness.peers.compare import (
    ABOVE_REFERENCE,
    TARGETS,
    cheapest,
    compared,
    frontier,
    order_of,
)
from harness.peers.tasks import REST_STEP, REST_STEPS
from reports.findings import join
from reports.growth import duration
from reports.style import (
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
)  # fmt: skip
from reports.table import Table, print_tables, scientific, times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOKS = {
    OURS: (VERMILLION, "o"), "pymunk": (BLUE, "s"), "box2d": (GREEN, "^"),
    "box2d3": (SKY, "v"), "mujoco": (ORANGE, "D"), "dart": (PURPLE, "P"),
    "drake": (INK, "X"), "cenic": (SOFT, "*"),
}  # fmt: skip
"""Colour and marker of each engine."""
FREE_FALL = 0.9
"""Share of a free fall beyond which a tower's top is said to fall freely."""


def least_table(rows: pd.DataFrame, task: str) -> Table:
    """One motion: engines down, errors across, the least CPU time of any setting and step."""
    part = compared(rows)
    part = part[part["task"] == task]
    lines = []
    for engine, own in part.groupby("engine", sort=False):
        line: dict[str, Any] = {"engine": engine}
        for target in TARGETS:
            best = cheapest(own, target)
            line[_at_most(target)] = np.nan if best is None else best["cpu"]
        finest = own.loc[own["error"].idxmin()]
        lines.append({**line, "least error": finest["error"], "by": finest["setting"]})
    names = [_at_most(target) for target in TARGETS]
    own_error = part["reference_error"].max()
    return Table(
        name=f"peers_least_{_plain(task)}",
        title=f"CPU time for an error, {task} s",
        reading=(
            "the least CPU time of any setting and step whose error of the pose, over all bodies "
            "and all times compared, is at most that [m or rad]. It takes the lucky runs of every "
            "engine. An en dash: no run was that accurate. The reference's own error is estimated "
            f"at {scientific(own_error)}."
        ),
        data=pd.DataFrame(lines, columns=["engine", *names, "least error", "by"]),
        formats={**dict.fromkeys(names, duration), "least error": scientific},
        notes=[_who_is_cheapest(part, target) for target in TARGETS],
    )


def _at_most(target: float) -> str:
    return f"≤ {target:.0e}".replace("e-0", "e-")


def _who_is_cheapest(part: pd.DataFrame, target: float) -> str:
    """A sentence, whoever it flatters."""
    best = {
        engine: found["cpu"]
        for engine, own in part.groupby("engine", sort=False)
        if (found := cheapest(own, target)) is not None
    }
    asked = f"At an error of {_at_most(target)[2:]}"
    if not best:
        return f"{asked} nobody arrives."
    first = min(best, key=lambda engine: best[engine])
    if OURS not in best:
        return f"{asked} {OURS} does not arrive; {first} is cheapest ({duration(best[first])})."
    mine, others = best.pop(OURS), best
    if not others:
        return f"{asked} {OURS} is alone ({duration(mine)})."
    rival = min(others, key=lambda engine: others[engine])
    if first == OURS:
        ratio = times(others[rival] / mine)
        return f"{asked} {OURS} is cheapest: {rival}, the next, takes {ratio} its time."
    cheaper = join([engine for engine in others if others[engine] < mine])
    ratio = times(mine / others[rival])
    return f"{asked} {OURS} takes {ratio} the time of {rival}; cheaper than it: {cheaper}."


def order_table(rows: pd.DataFrame) -> Table:
    """Order and floor of every setting, motion by motion."""
    lines = []
    for (task, engine, setting), own in compared(rows).groupby(
        ["task", "engine", "setting"], sort=False
    ):
        order = order_of(own)
        finest = own.loc[own["error"].idxmin()]
        lines.append(
            {
                "motion": task, "engine": engine, "setting": setting,
                "order": np.nan if order is None else order.p,
                "runs": np.nan if order is None else order.points,
                "least error": finest["error"], "at a mean step of": finest["step"],
                "CPU time per step": own["cpu_step"].median(),
                "overlap": finest["penetration"], "energy error": finest["energy_error"],
            }
        )  # fmt: skip
    columns = ["motion", "engine", "setting", "order", "runs", "least error", "at a mean step of"]
    data = pd.DataFrame(lines, columns=[*columns, "CPU time per step", "overlap", "energy error"])
    return Table(
        name="peers_order",
        title="Order in the step",
        reading=(
            "order is p in error ~ (mean step)^p, fitted by least squares to the runs whose error "
            f"is below 0.1 and above {ABOVE_REFERENCE:g} times the reference's own. overlap and "
            "energy error (relative) are those of the most accurate run."
        ),
        data=data,
        formats={
            "order": "{:.2f}".format, "runs": "{:.0f}".format, "least error": scientific,
            "at a mean step of": duration, "CPU time per step": duration,
            "overlap": scientific, "energy error": scientific,
        },
        notes=_order_notes(data),
    )  # fmt: skip


def _order_notes(data: pd.DataFrame) -> list[str]:
    notes = []
    for task, part in data.groupby("motion", sort=False):
        known = part[part["order"].notna()]
        mine, others = known[known["engine"] == OURS], known[known["engine"] != OURS]
        text = f"{task} s:"
        if len(mine):
            text += f" {OURS} has order {join([f'{p:.2f} ({s})' for p, s in _pairs(mine)])}"
        if len(others):
            text += f"; the others' settings {others['order'].min():.2f} to "
            text += f"{others['order'].max():.2f}, median {others['order'].median():.2f}"
        notes.append(text + ".")
    return notes


def _pairs(rows: pd.DataFrame) -> list[tuple[float, str]]:
    return list(zip(rows["order"], rows["setting"], strict=True))


def whole_table(rows: pd.DataFrame) -> Table:
    """Overlap and energy of the whole motions, beyond what can be compared in pose."""
    part = rows[(rows["kind"] == "whole") & (rows["status"] == "done")]
    data = part[["task", "engine", "setting", "swept", "resolution", "penetration", "gain", "cpu"]]
    data = data.assign(resolution=[f"{r.swept} = {_value(r)}" for r in data.itertuples()])
    data = data.drop(columns="swept").rename(
        columns={"task": "motion", "resolution": "run", "penetration": "overlap", "cpu": "CPU time"}
    )
    return Table(
        name="peers_whole",
        title="Whole motions",
        reading=(
            "overlap is the deepest of two bodies or of one and the ground, at any multiple of "
            "1/60 s [m]; gain is the largest rise of the energy after any of them, relative to "
            "that at the start, where only losses are physical."
        ),
        data=data.reset_index(drop=True),
        formats={"overlap": scientific, "gain": scientific, "CPU time": duration},
        notes=_whole_notes(part),
    )


def _value(row: Any) -> str:
    return f"1/{round(1 / row.resolution):,}" if row.swept == "h" else f"{row.resolution:.0e}"


def _whole_notes(part: pd.DataFrame) -> list[str]:
    notes = []
    for task, own in part.groupby("task", sort=False):
        mine, others = own[own["engine"] == OURS], own[own["engine"] != OURS]
        fixed = others[np.isclose(others["resolution"], REST_STEP)]
        if len(mine) and len(fixed):
            notes.append(
                f"{task} s: at h = 1/{round(1 / REST_STEP)} the others' bodies overlap by up to "
                f"{scientific(fixed['penetration'].min())} to "
                f"{scientific(fixed['penetration'].max())} m; in {OURS} by up to "
                f"{scientific(mine['penetration'].max())} m."
            )
        gains = own[own["gain"] > 1e-3]
        if len(gains):
            who = join(list(dict.fromkeys(gains["engine"])))
            notes.append(f"{task} s: energy rises by more than 1e-3 in runs of {who}.")
    return notes


def rest_table(rows: pd.DataFrame) -> Table:
    """Towers: who holds them, and at what price."""
    part = rows[rows["kind"] == "rest"].reset_index(drop=True)
    data = pd.DataFrame(
        {
            "tower": [task.removesuffix(" at rest") for task in part["task"]],
            "engine": part["engine"], "setting": part["setting"], "drift": part["drift"],
            "of the top": part["top"], "turn": part["turn"], "overlap": part["penetration"],
            "CPU time per step": part["cpu"] / REST_STEPS,
            "ended": [r.status if r.status == "done" else r.reason for r in part.itertuples()],
        }
    )  # fmt: skip
    numbers = dict.fromkeys(("drift", "of the top", "turn", "overlap"), scientific)
    return Table(
        name="peers_rest",
        title="Towers at rest",
        reading=(
            f"after {REST_STEPS} steps of 1/{round(1 / REST_STEP)} s: drift is how far the body "
            "that moved most has moved in x or y [m]; turn by how much one has turned [rad]. A "
            "rigid tower at rest stays where it is. Sleeping is off."
        ),
        data=data,
        formats={**numbers, "CPU time per step": duration},
        notes=_rest_notes(part),
    )


def _rest_notes(part: pd.DataFrame) -> list[str]:
    notes = []
    fall = 0.5 * 9.81 * (REST_STEPS * REST_STEP) ** 2
    for task, own in part.groupby("task", sort=False):
        name = task.removesuffix(" at rest")
        held = own[own["status"] == "done"]
        mine, others = held[held["engine"] == OURS], held[held["engine"] != OURS]
        if len(mine):
            notes.append(f"{name}: {OURS} drifts by {scientific(mine['drift'].min())} m.")
        else:
            why = own.loc[own["engine"] == OURS, "reason"]
            notes.append(f"{name}: {OURS} does not finish ({join(list(why))}).")
        if len(others):
            best = others.loc[others["drift"].idxmin()]
            falling = others.groupby("engine")["top"].min() > FREE_FALL * fall
            text = f"{name}: of the others {best['engine']} ({best['setting']}) drifts least, by "
            text += f"{scientific(best['drift'])} m"
            if falling.any():
                text += f"; in no setting of {join(list(falling[falling].index))} is the top held: "
                text += f"it falls by {FREE_FALL:.0%} of a free fall or more"
            notes.append(text + ".")
    return notes


def lost_table(rows: pd.DataFrame) -> Table:
    """Runs that did not end."""
    part = rows[~rows["status"].isin(["done", "skipped"])]
    data = part[["task", "engine", "setting", "swept", "resolution", "status", "reason"]]
    data = data.assign(resolution=[f"{r.swept} = {_value(r)}" for r in data.itertuples()])
    return Table(
        name="peers_lost",
        title="Runs that did not end",
        reading="finer steps of a setting whose pass took too long were not tried.",
        data=data.drop(columns="swept").rename(columns={"resolution": "run"}),
    )


def engines_table(engines: Sequence[EngineInfo]) -> Table:
    """Who was asked, and how their models differ."""
    data = pd.DataFrame(
        [
            {"engine": e.name, "version": e.version or "absent", "model": e.model or e.reason}
            for e in engines
        ]
    )
    return Table(
        name="peers_engines",
        title="Engines",
        reading=(
            "each in the settings it comes with (stock) and in those that its manual recommends "
            f"for accuracy. {REMEDY} installs them all."
        ),
        data=data,
    )


def tables_of(rows: pd.DataFrame, engines: Sequence[EngineInfo]) -> list[Table]:
    """All tables of the page."""
    tasks = list(dict.fromkeys(compared(rows)["task"]))
    made = [*(least_table(rows, task) for task in tasks), order_table(rows)]
    made += [whole_table(rows), rest_table(rows), lost_table(rows)]
    return [*(table for table in made if len(table.data)), engines_table(engines)]


def plot_peers(rows: pd.DataFrame, path: str | Path) -> Path:
    """Error of the pose against CPU time, one panel per motion: every run, and the best ones."""
    part = compared(rows)
    tasks = list(dict.fromkeys(part["task"]))
    engines = [engine for engine in LOOKS if engine in set(part["engine"])]
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
        figure.legend(handles, labels, loc="outside lower center", ncols=min(8, len(labels)))
        return save(figure, Path(path))


def _panel(axes: Axes, part: pd.DataFrame, engines: Sequence[str]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    for engine in engines:
        own = part[part["engine"] == engine]
        colour, marker = LOOKS[engine]
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


def _plain(task: str) -> str:
    return "".join(c if c.isalnum() or c == "." else "_" for c in task)


def print_peers(console: Console, rows: pd.DataFrame, engines: Sequence[EngineInfo]) -> None:
    """Print every table with its notes."""
    print_tables(console, tables_of(rows, engines))


def write_peers(rows: pd.DataFrame, engines: Sequence[EngineInfo], folder: str | Path) -> Path:
    """Write peers.md, peers.csv, the figure and one CSV per table; return the page."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rows.to_csv(folder / "peers.csv", index=False, lineterminator="\n", float_format="%.12g")
    drawn = len(compared(rows)) > 0
    if drawn:
        for suffix in (".svg", ".png"):
            plot_peers(rows, folder / f"peers{suffix}")
    tables = tables_of(rows, engines)
    for table in tables:
        (folder / f"{table.name}.csv").write_text(table.to_csv(), encoding="utf-8")
    figure = "![Error of the pose against CPU time, engine by engine](peers.png)\n"
    figure += "\n*Lines join the runs of an engine that none of its others beats; dots are all of "
    figure += "its runs. Shaded: below the reference's own error.*\n"
    parts = [
        "# Other engines on the same scenes\n",
        _introduction() + "\n",
        *([figure] if drawn else []),
        *(table.to_markdown() for table in tables),
    ]
    page = folder / "peers.md"
    page.write_text("\n".join(parts), encoding="utf-8")
    return page


def _introduction() -> str:
    return (
        f"Every engine starts from the same positions and velocities and is asked to do the same. "
        f"Its poses are compared with those of {OURS}'s own finest run, until the first impact or, "
        "where no friction acts at impacts, beyond it: there all engines mean the same inelastic "
        "impact. With friction they do not, and nothing is compared beyond it. That the peers' "
        "errors go on falling with their steps is what confirms the reference. Times are CPU time "
        "of the stepping alone, the least of up to three passes, each engine in a process of its "
        f"own, one thread of {machine_label()}; building the scene is not counted."
    )
