"""Accuracy against time: each solver swept over the accuracy that it is asked for.

The accuracies are settings given as numbers, relative to the scale of the QP.  One point per
(solver, accuracy asked) on the QPs of one scene and arm:

1. time: shifted geometric mean of setup + solve, as measured, whether or not the answer is as good
   as was asked; a point tells what one gets, not what was promised.
2. error: the `SHARE` quantile of the error in Gλ over the scale, no answer counting as infinite, so
   that a point promises nine answers in ten.  Errors below the rounding of float64 are drawn there.

A point is on the front where no other solver's point is both faster and no less accurate.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from harness.names import is_own
from reports.parts.names import in_order, is_number, solver_order
from reports.parts.sentences import Answer, join
from reports.parts.style import FAINT, INK, PAGE_WIDTH, PAPER, SOFT, VERMILLION, drawing, save
from reports.parts.table import Table, microseconds, percent, scientific, short
from reports.rows.comparison import shifted_geometric_mean
from reports.rows.results import ARMS, METHOD, Results, form_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARE = 0.9
"""Quantile of the errors that a point stands for."""
FLOOR = float(np.finfo(float).eps)
"""Errors below this fraction of the scale are rounding."""
LEVELS = (1e-3, 1e-6, 1e-9, 1e-12)
"""Accuracies at which the fastest solver is named."""
ALL = "all scenes"
DEFAULTS = "default"
"""The setting at which packages keep their own tolerances; a point of its own, where it was run."""


def sweep_rows(results: Results) -> pd.DataFrame:
    """Rows at accuracies given as numbers, and at the packages' defaults, of QPs to solve."""
    rows = results.everything
    numbers = rows["settings"].map(is_number).astype(bool)
    if not numbers.any():
        return rows[numbers]
    swept = rows[numbers | (rows["settings"] == DEFAULTS)]
    swept = swept[(swept["k"] > 0) & swept["arm"].isin(ARMS) & swept["solver"].map(form_of).isna()]
    return swept[swept["scene"].isin(rows.loc[numbers, "scene"])]


def pareto_points(rows: pd.DataFrame, scene: str, arm: str) -> pd.DataFrame:
    """solver, asked, time [s], error, verified, front: one row per point.

    scene : a label, or `ALL` for all of them together
    arm : in "warm" a solver without a warm arm stands with its cold one

    Solvers that skipped a QP of it are left out.
    """
    part = rows if scene == ALL else rows[rows["scene"] == scene]
    if arm == "warm":
        started = part.loc[part["arm"] == "warm", "solver"].unique()
        part = part[(part["arm"] == "warm") | ~part["solver"].isin(started)]
    else:
        part = part[part["arm"] == arm]
    whole = part["problem"].nunique()
    out: list[dict[str, Any]] = []
    for (solver, setting), own in part.groupby(["solver", "settings"]):
        if own["skipped"].any() or len(own) < whole:
            continue
        error = own["glambda_error"].fillna(own["error_bound"] / own["scale"]).fillna(np.inf)
        out.append(
            {
                "solver": solver,
                "asked": setting,
                "time": shifted_geometric_mean(own["runtime"]),
                "error": float(np.quantile(error, SHARE, method="higher")),
                "worst": float(error.max()),
                "verified": float(own["verified"].mean()),
            }
        )
    columns = ["solver", "asked", "time", "error", "worst", "verified"]
    points = pd.DataFrame(out, columns=columns)
    order = {name: i for i, name in enumerate(in_order(points["asked"], ()))}
    points = points.sort_values(
        ["solver", "asked"], key=lambda c: c.map(order if c.name == "asked" else solver_order)
    ).reset_index(drop=True)
    return points.assign(front=_on_front(points))


def _on_front(points: pd.DataFrame) -> list[bool]:
    time = points["time"].to_numpy(float)
    error = np.maximum(points["error"].to_numpy(float), FLOOR)
    return [
        bool(np.isfinite(e)) and not ((time < t) & (error <= e)).any()
        for t, e in zip(time, error, strict=True)
    ]


def fastest_for(points: pd.DataFrame, level: float) -> pd.Series | None:
    """The fastest point whose error is at most `level`, or None."""
    good = points[points["error"].clip(lower=FLOOR) <= level]
    return None if good.empty else good.loc[good["time"].idxmin()]


def arms_of(rows: pd.DataFrame) -> list[str]:
    """The arms that were swept."""
    return in_order(rows["arm"].unique(), ARMS)


def pareto_tables(results: Results) -> list[Table]:
    """Points of all scenes together, one table per arm; nothing where nobody was swept on all."""
    rows = sweep_rows(results)
    points = {arm: pareto_points(rows, ALL, arm) for arm in arms_of(rows)}
    return [_table(found, arm) for arm, found in points.items() if len(found)]


def swept_scenes(rows: pd.DataFrame) -> list[str]:
    """`ALL` and the scenes, as far as there are points to draw."""
    return [
        scene
        for scene in (ALL, *sorted(rows["scene"].unique()))
        if any(_can_be_drawn(pareto_points(rows, scene, arm)) for arm in arms_of(rows))
    ]


def _can_be_drawn(points: pd.DataFrame) -> bool:
    return bool(np.isfinite(points["error"].to_numpy(float)).any())


def _table(points: pd.DataFrame, arm: str) -> Table:
    notes = []
    for level in LEVELS:
        best = fastest_for(points, level)
        if best is None:
            notes.append(f"Nobody has an error of {scientific(level)} in nine QPs of ten.")
        else:
            notes.append(
                f"The least time for an error of {scientific(level)} is "
                f"{microseconds(best['time'])} µs, by {best['solver']} asked for {best['asked']}."
            )
    return Table(
        name="pareto",
        key={"arm": arm},
        title="Accuracy against time",
        reading=(
            "One line per solver and accuracy asked, relative to the scale, on the QPs of all "
            "scenes.  time is the shifted geometric mean in µs; error in Gλ over the scale is what "
            f"{percent(SHARE)} of the answers keep to, worst what all do.  front: nobody is both "
            "faster and as accurate."
            + (
                "  A solver without a warm start stands with its cold times."
                if arm == "warm"
                else ""
            )
        ),
        data=points.assign(front=points["front"].map({True: "yes", False: ""})),
        formats={
            "time": microseconds,
            "error": scientific,
            "worst": scientific,
            "verified": percent,
        },
        notes=notes,
    )


def plot_pareto(results: Results, scene: str, path: str | Path) -> Path:
    """Error against time, one panel per arm, one line per solver; the front is set off.

    scene : a label, or `ALL`

    Raises ValueError where nothing was swept on this scene.
    """
    rows = sweep_rows(results)
    panels = {arm: pareto_points(rows, scene, arm) for arm in arms_of(rows)}
    panels = {arm: points for arm, points in panels.items() if _can_be_drawn(points)}
    if not panels:
        raise ValueError(f"no accuracies given as numbers were run on {scene}")
    every = pd.concat(panels.values())
    shown = every[np.isfinite(every["error"])]
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 4.8), layout="constrained")
        grid = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)
        for axes, (arm, points) in zip(grid[0], panels.items(), strict=True):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlim(1e6 * shown["time"].min() / 3, 1e6 * shown["time"].max() * 4)
            axes.set_ylim(FLOOR / 300, max(100 * shown["error"].max(), 1e3 * FLOOR))
            _panel(axes, points)
            axes.set_title(f"{scene}, {arm}")
            axes.set_xlabel("time per QP [µs]")
        grid[0, 0].set_ylabel(f"error in Gλ / scale, {100 * SHARE:g} % of the QPs below")
        entries, names = grid[0, 0].get_legend_handles_labels()
        once = dict(zip(names, entries, strict=True)) if (every["asked"] == DEFAULTS).any() else {}
        if once:
            figure.legend(list(once.values()), list(once), loc="outside lower center", ncols=2)
        return save(figure, Path(path))


def _panel(axes: Axes, points: pd.DataFrame) -> None:
    axes.grid(True, which="major")
    lines = []
    for solver, part in points.groupby("solver", sort=False):
        part = part[np.isfinite(part["error"])]
        own = is_own(str(solver))
        colour = VERMILLION if own else SOFT
        x, y = 1e6 * part["time"], part["error"].clip(lower=FLOOR)
        swept = part["asked"] != DEFAULTS
        axes.plot(
            x[swept], y[swept], color=colour, linewidth=1.8 if own else 0.8, marker="o",
            markersize=4.0 if own else 2.6, alpha=1.0 if own else 0.75, zorder=4 if own else 2,
        )  # fmt: skip
        axes.plot(
            x[~swept], y[~swept], "x", color=colour, markersize=4.5, zorder=3,
            label="the package's own tolerances",
        )  # fmt: skip
        if swept.any():
            lines.append(Line(str(solver), x[swept].to_numpy(), y[swept].to_numpy(), own))
    front = points[points["front"]].sort_values("time")
    axes.step(
        1e6 * front["time"], front["error"].clip(lower=FLOOR), where="post", color=FAINT,
        linewidth=5.0, zorder=1, label="front",
    )  # fmt: skip
    _label(axes, lines)


class Line(NamedTuple):
    """One solver's points, the most accurate first: x [µs] and y as drawn."""

    solver: str
    x: np.ndarray
    y: np.ndarray
    own: bool


def _label(axes: Axes, lines: list[Line]) -> None:
    """Each name slants away from the upper or the lower end of its line, where there is room."""
    from matplotlib.patheffects import withStroke

    wide, high = (
        np.log10(end) - np.log10(start) for start, end in (axes.get_xlim(), axes.get_ylim())
    )
    placed: list[tuple[float, float]] = []
    for line in sorted(lines, key=lambda line: (not line.own, line.x[-1])):
        room = []
        for x, y, above in ((line.x[-1], line.y[-1], True), (line.x[0], line.y[0], False)):
            middle = np.log10(x) / wide, np.log10(y) / high + (0.06 if above else -0.06)
            free = min(
                (max(abs(middle[0] - a) / 0.035, abs(middle[1] - b) / 0.11) for a, b in placed),
                default=np.inf,
            )
            room.append((min(free, 1.0), above, middle, (x, y)))
        _, above, middle, (x, y) = max(room, key=lambda end: end[:2])
        placed.append(middle)
        axes.annotate(
            line.solver, (x, y), xytext=(2, 4 if above else -4), textcoords="offset points",
            rotation=55 if above else -55, rotation_mode="anchor", ha="left", va="center",
            fontsize=7.5, color=VERMILLION if line.own else INK, zorder=5,
            fontweight="bold" if line.own else "normal",
            path_effects=[withStroke(linewidth=2.0, foreground=PAPER)],
        )  # fmt: skip


def pareto_answer(results: Results) -> Answer | None:
    """Who is on the front, and what accuracy costs, in sentences."""
    rows = sweep_rows(results)
    if rows.empty:
        return None
    arm = "warm" if "warm" in arms_of(rows) else "cold"
    points = pareto_points(rows, ALL, arm)
    if points.empty:
        return None
    front = points[points["front"]]
    names = sorted(front["solver"].unique(), key=solver_order)
    said = [f"On the front of accuracy against time ({arm}, all scenes) stand {join(names, 10)}."]
    for level in LEVELS:
        best = fastest_for(points, level)
        if best is None:
            said.append(f"Nobody keeps nine answers in ten to {scientific(level)} of the scale.")
            continue
        said.append(
            f"For {scientific(level)} {best['solver']} is the fastest, "
            f"{microseconds(best['time'])} µs" + _rival(points, level, str(best["solver"])) + "."
        )
    said += _price(points)
    return Answer(
        "What does accuracy cost in time?",
        str(len(names)),
        f"of {points['solver'].nunique()} solvers on the front",
        tuple(said),
        "pareto",
    )


def _rival(points: pd.DataFrame, level: float, winner: str) -> str:
    """The next solver that is not of the winner's kind."""
    own = is_own(winner)
    same = points["solver"].map(is_own if own else lambda name: name == winner).astype(bool)
    rival = fastest_for(points[~same], level)
    if rival is None:
        return "; nobody else reaches it"
    return f", then {rival['solver']} ({microseconds(rival['time'])} µs)"


def _price(points: pd.DataFrame) -> list[str]:
    """Time at the tightest over time at the loosest accuracy asked, and who does not follow."""
    swept = points[points["asked"].map(is_number).astype(bool)]
    asked = in_order(swept["asked"].unique(), ())
    if len(asked) < 2:
        return []
    tight, loose = asked[0], asked[-1]
    time = swept.pivot(index="solver", columns="asked", values="time")
    ratio = (time[tight] / time[loose]).dropna().sort_values()
    level = [name for name in ratio.index if ratio[name] < 1.1]
    steep = [f"{name} ({short(ratio[name])})" for name in ratio.index[::-1] if ratio[name] >= 2]
    said = []
    if level:
        said.append(
            f"From {loose} to {tight} the time of {join(sorted(level, key=solver_order), 12)} does "
            "not rise by a tenth."
        )
    if steep:
        said.append(f"It more than doubles for {join(steep, 12)}.")
    at = swept[swept["asked"] == tight].set_index("solver")
    missed = [name for name in at.index if not at.loc[name, "error"] <= 10 * float(tight)]
    if missed:
        said.append(
            f"Asked for {tight}, {join(sorted(missed, key=solver_order), 12)} "
            f"{'does' if len(missed) == 1 else 'do'} not come within ten times of it in nine QPs "
            "of ten."
        )
    own = swept[swept["solver"] == METHOD]
    if len(own):
        said.append(
            f"In nine QPs of ten {METHOD} gives {scientific(own['error'].max())} or better, "
            "whatever it is asked for."
        )
    return said
