"""Rows of a replay: in a table, those that miss, and one with all its columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table
from rich.text import Text

from harness.judging.facts import SETTINGS
from harness.passes.starts import EVERY_ARM
from reports.parts.terminal_table import terminal_table

SCREEN = 36
"""Lines that are seen at once on a terminal of usual size."""


def replay_table(rows: pd.DataFrame) -> Table:
    """A line per solver and setting over all scenes; of more than a screen, of one setting only.

    That is the first of them, and then variants are left out, too: the report has all.
    """
    title = "Replayed (error: ‖A(x − x*)‖/scale; µs: median per QP)"
    if rows.groupby(["solver", "settings"]).ngroups > SCREEN:
        there = sorted(set(rows["settings"]))
        first = next((name for name in SETTINGS if name in there), there[0])
        rows = rows[rows["settings"] == first]
        if rows["solver"].nunique() > SCREEN:
            rows = rows[~rows["solver"].str.contains("[", regex=False)]
        title += f"; here at {first}, the report has all"
    arms = [arm for arm in EVERY_ARM if arm in set(rows["arm"])]
    lines = []
    for (solver, setting), part in rows.groupby(["solver", "settings"], sort=True):
        done = part[part["verdict"] != "skipped"]
        lines.append(
            (
                *(solver, setting, len(done), len(part) - len(done)),
                share(int((done["verdict"] == "verified").sum()), len(done)),
                int((done["verdict"] == "undecided").sum()),
                _scientific(done["glambda_error"].max()),
                *(
                    _scientific(1e6 * done["runtime"][done["arm"] == arm].median(), "{:.1f}")
                    for arm in arms
                ),
            )
        )
    columns = (
        *("solver", "setting", ">QPs", ">skipped", ">verified", ">undecided", ">max error"),
        *(f">µs {arm}" for arm in arms),
    )
    return terminal_table(title, columns, lines)


def share(part: int, whole: int) -> str:
    """A percentage that says 100 % of all only, and 0 % of none only."""
    if whole == 0:
        return "–"
    if part in (0, whole):
        return f"{part / whole:.0%}"
    return f"{min(max(part / whole, 0.001), 0.999):.1%}"


def misses_table(lines: pd.DataFrame, title: str) -> Table:
    """Lines of `harness.study.verify.misses`."""
    return terminal_table(
        title,
        (
            *("scene", "solver", "setting", ">solved", ">skipped", ">missed", ">expected"),
            *(">worst/asked", "reason"),
        ),
        (
            (
                line.scene,
                line.solver,
                line.settings,
                line.solves,
                line.skipped,
                line.missed,
                "–" if pd.isna(line.expected) else line.expected,
                _scientific(line.worst),
                line.reason,
            )
            for line in lines.itertuples()
        ),
    )


def print_row(console: Console, row: Mapping[str, Any]) -> None:
    """Every column of one solve."""
    for name, value in row.items():
        if isinstance(value, np.ndarray):
            value = np.array2string(value, max_line_width=80)
        if value is not None:
            console.print(Text(f"{name:20s} {value}"), soft_wrap=True)


def _scientific(value: float, form: str = "{:.1e}") -> str:
    return "–" if value is None or np.isnan(value) else form.format(value)
