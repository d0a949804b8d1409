"""The cases as a page: cases.md, cases.csv and, where they were asked for, foils.csv."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from reports.parts.table import Table, scientific, write_page


def cases_table(rows: pd.DataFrame) -> Table:
    """Each number beside the one that is known."""
    return Table(
        name="cases",
        title="Scenes whose answer is known",
        reading=(
            "A number of our stepper's run, what mechanics or a closed solution says that it is, "
            "the difference, and the order of it in h where steps were fixed and halved twice. The "
            "arch's 0.1075 is of infinitely many stones: hinges of a few form only at joints. "
            "Thresholds are bisected to a 256th of a bracket."
        ),
        data=rows[["case", "quantity", "value", "expected", "error", "order"]],
        formats={
            "value": lambda x: f"{float(x):.6g}",
            "expected": lambda x: f"{float(x):.6g}",
            "error": scientific,
            "order": lambda x: f"{float(x):.2f}",
        },
    )


def write_cases(tables: Sequence[Table], folder: Path) -> Path:
    """Write the page, every row of it, and the tables as CSV; return the page."""
    parts = [
        f"# {table.title}\n\n*How to read:* {table.reading}\n\n{table.rows_in_markdown()}\n"
        for table in tables
    ]
    return write_page(folder / "cases.md", "\n".join(parts), tables)
