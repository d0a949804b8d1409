"""The claims of the manifest with what came of each: a table, and a page.

claims.md    the claims one by one, with source, figure, range and its reason, negative control
claims.csv   the table
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.text import Text

from harness.claims.checking import Outcome
from harness.claims.manifest import DISPOSITIONS
from reports.parts.table import Table, short, write_page
from reports.parts.terminal_table import terminal_table

COLUMNS = ("id", ">figure", ">range", "is", "control", ">s", "claim")


def _number(value: float) -> str:
    """Four digits, an en dash for none."""
    return "–" if value != value else f"{value:.4g}".replace("inf", "∞")


def _range(outcome: Outcome) -> str:
    low, high = outcome.entry.range
    return f"{_number(low)} … {_number(high)}"


def _state(outcome: Outcome) -> str:
    if not outcome.ran:
        return "not run"
    return "WRONG" if outcome.wrong else outcome.entry.disposition


def _control(outcome: Outcome) -> str:
    """Whether the negative control failed, as it must."""
    if not outcome.ran or outcome.control != outcome.control:
        return "–"
    return "PASSES" if outcome.entry.holds(outcome.control) else "fails"


def print_outcomes(console: Console, outcomes: Sequence[Outcome]) -> None:
    """One line per claim, then what is wrong and how many are what."""
    shown = [outcome for outcome in outcomes if outcome.ran]
    rows = [
        (o.entry.id, _number(o.figure), _range(o), _state(o), _control(o), short(o.seconds),
         o.entry.short)
        for o in shown
    ]  # fmt: skip
    console.print(terminal_table("Claims", COLUMNS, rows))
    for outcome in shown:
        if outcome.wrong:
            console.print(Text(f"{outcome.entry.id}: {outcome.wrong}"), soft_wrap=True)
    console.print(Text(summary(outcomes)), soft_wrap=True)


def summary(outcomes: Sequence[Outcome]) -> str:
    """How many claims are what, in one sentence."""
    states = Counter(_state(outcome) for outcome in outcomes)
    told = [f"{states[name]} {name}" for name in (*DISPOSITIONS, "WRONG") if states[name]]
    left = states["not run"]
    said = f"{len(outcomes)} claims: " + (", ".join(told) or "none was run")
    return said + (f"; {left} slow ones were not run: --slow" if left else "") + "."


def outcomes_table(outcomes: Sequence[Outcome]) -> Table:
    """All claims, one row each."""
    data = pd.DataFrame(
        {
            "id": o.entry.id, "claim": o.entry.short, "source": o.entry.source,
            "figure": o.figure, "low": o.entry.range[0], "high": o.entry.range[1],
            "is": _state(o), "control": o.control, "seconds": o.seconds,
        }
        for o in outcomes
    )  # fmt: skip
    formats: dict[str, Any] = dict.fromkeys(("figure", "low", "high", "control"), _number)
    return Table(
        name="claims",
        title="Claims",
        reading=(
            "figure: what the check gave; low, high: what it may give. control: what it gave for "
            "the negative control, which must lie outside."
        ),
        data=data,
        formats=formats | {"seconds": short},
    )


def write_outcomes(outcomes: Sequence[Outcome], folder: str | Path) -> Path:
    """Write claims.md and claims.csv; return the page."""
    table = outcomes_table(outcomes)
    parts = ["# Claims\n", summary(outcomes), "", table.to_markdown(), *map(_section, outcomes)]
    return write_page(Path(folder) / "claims.md", "\n".join(parts), [table])


def _section(outcome: Outcome) -> str:
    """A claim in words."""
    entry = outcome.entry
    given = ", ".join(f"{name} = {value}" for name, value in entry.parameters.items())
    changed = ", ".join(f"{name} = {value}" for name, value in entry.control.items())
    lines = [
        f"## {entry.id}: {_state(outcome)}\n",
        f"{entry.says} *({entry.source})*\n",
        f"- Figure {_number(outcome.figure)}, range {_range(outcome)}: {entry.reason}",
        f"- Check `{entry.check}`" + (f" with {given}" if given else ""),
        f"- Negative control, {changed}: {_number(outcome.control)}. {entry.fails}",
    ]
    if entry.condition:
        lines.append(f"- {entry.condition}")
    if outcome.wrong:
        lines.append(f"- **{outcome.wrong}**")
    return "\n".join(lines) + "\n"
