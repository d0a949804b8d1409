"""The cases as a page: cases.md and cases.csv."""

from __future__ import annotations

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


def write_cases(rows: pd.DataFrame, folder: Path) -> Path:
    """Write both files; return the page."""
    table = cases_table(rows)
    text = table.display().to_markdown(index=False, disable_numparse=True)
    page = f"# {table.title}\n\n*How to read:* {table.reading}\n\n{text}\n"
    return write_page(folder / "cases.md", page, [table])
