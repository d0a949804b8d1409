"""One table of a report: its numbers as they are, how they are printed, and what they say.

A table carries its numbers as measured (for CSV), how to print them (for Markdown and the page), a
line on how to read it, and notes that its own numbers gave rise to: where our method loses,
the note stands under the table that shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.text import Text

from harness.files.printable import printable
from reports.parts.terminal_table import terminal_table

Format = Callable[[Any], str]
LONGEST = 24
"""Rows from which on a page in Markdown names the file of a table instead of showing it."""


@dataclass(frozen=True)
class Table:
    """One table.

    name : of its file, which it shares with tables of another `key`, {"setting": "paper"} say
    title : what it is called with all of these;  reading : how to read it
    data : numbers as measured;  formats : column → how to print it;  notes : sentences below
    """

    name: str
    title: str
    reading: str
    data: pd.DataFrame
    formats: Mapping[str, Format] = field(default_factory=dict)
    notes: Sequence[str] = ()
    key: Mapping[str, str] = field(default_factory=dict)

    @property
    def heading(self) -> str:
        """Its title, and what tells it from others of its name."""
        return ", ".join([self.title, *(f"{name} {value}" for name, value in self.key.items())])

    def display(self) -> pd.DataFrame:
        """Every cell as it is printed; an unknown number is an en dash."""
        shown = {}
        for name in self.data.columns:
            form = self.formats.get(name, str)
            shown[name] = ["–" if _unknown(value) else form(value) for value in self.data[name]]
        return pd.DataFrame(shown, dtype=object)

    def numeric(self, column: str) -> bool:
        """Whether a column holds numbers, and is set flush right."""
        return bool(pd.api.types.is_numeric_dtype(self.data[column])) or column in self.formats

    def to_markdown(self, longest: int = LONGEST) -> str:
        """Heading, how to read it, the table or where it is if it is longer, and its notes."""
        parts = [f"## {self.heading}", f"*How to read:* {self.reading}"]
        if len(self.data) > longest:
            parts.append(f"{len(self.data):,} rows are in [{self.name}.csv]({self.name}.csv).")
        elif len(self.data):
            parts.append(self.rows_in_markdown())
        else:
            parts.append("*Nothing was measured.*")
        if self.notes:
            parts.append("\n".join(f"- {note}" for note in self.notes))
        return "\n\n".join(parts) + "\n"

    def rows_in_markdown(self) -> str:
        """The table alone, however long."""
        align = ["right" if self.numeric(name) else "left" for name in self.data.columns]
        return self.display().to_markdown(index=False, disable_numparse=True, colalign=align)

    def to_csv(self) -> str:
        """The numbers as measured, one header line."""
        return csv_text(stacked([self]))


def stacked(tables: Sequence[Table]) -> pd.DataFrame:
    """The numbers of tables of one name, what tells them apart in the first columns."""
    rows = [{**table.key, **row} for table in tables for row in table.data.to_dict("records")]
    columns = [name for table in tables for name in (*table.key, *table.data.columns)]
    return pd.DataFrame(rows, columns=list(dict.fromkeys(columns)))


def print_tables(console: Console, tables: Iterable[Table]) -> None:
    """Print tables with their notes below."""
    for table in tables:
        shown = table.display()
        columns = [f">{name}" if table.numeric(name) else name for name in shown.columns]
        console.print(terminal_table(table.heading, columns, shown.to_numpy().tolist()))
        for note in table.notes:
            console.print(Text(f"  {note}"))
        console.print()


def csv_text(data: pd.DataFrame) -> str:
    """Numbers to twelve digits under one header line."""
    return data.to_csv(index=False, lineterminator="\n", float_format="%.12g")


def write_text(path: Path, text: str) -> Path:
    """Write a file of a report, and its folder if that is missing; return its path.

    What results say may be a stranger's: characters that a terminal obeys are written out.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(printable(text), encoding="utf-8")
    return path


def write_page(
    page: Path, text: str, tables: Iterable[Table], rows: Mapping[str, pd.DataFrame] | None = None
) -> Path:
    """Write a page in Markdown, and beside it CSV files of its tables; return the page.

    rows : what was measured, by file name, written as it is
    """
    write_tables(page.parent, tables)
    for name, data in (rows or {}).items():
        write_text(page.with_name(f"{name}.csv"), csv_text(data))
    return write_text(page, text)


def write_tables(folder: Path, tables: Iterable[Table]) -> dict[str, list[Table]]:
    """Write tables as CSV, those of one name into one file; returns them by name."""
    named: dict[str, list[Table]] = {}
    for table in tables:
        named.setdefault(table.name, []).append(table)
    for name, same in named.items():
        write_text(folder / f"{name}.csv", csv_text(stacked(same)))
    return named


def _unknown(value: Any) -> bool:
    return value is None or (isinstance(value, float) and np.isnan(value))


def whole(value: Any) -> str:
    """1234 → 1,234."""
    return f"{round(float(value)):,}"


def percent(value: Any) -> str:
    """A share: 1 → 100 %, and never rounded up to it or down to 0 %."""
    share = 100 * float(value)
    if share in (0.0, 100.0):
        return f"{share:.0f} %"
    return f"{min(max(share, 0.1), 99.9):.1f} %"


def short(value: Any) -> str:
    """Three significant digits or all before the point; an exponent for less than 0.01."""
    number = float(value)
    if not np.isfinite(number):
        return "–" if np.isnan(number) else "∞" if number > 0 else "-∞"
    size = abs(float(f"{number:.3g}"))
    if size == 0:
        return "0"
    if size < 1e-2:
        return scientific(number)
    digits = max(0, 2 - int(np.floor(np.log10(size))))
    return f"{number:,.{min(digits, 3)}f}"


def scientific(value: Any) -> str:
    """Two digits and an exponent, such as 1.3e-12."""
    number = float(value)
    return "0" if number == 0 else f"{number:.1e}"


def power(value: float) -> str:
    """One digit and an exponent, such as 1e-4."""
    return f"{value:.0e}".replace("e-0", "e-")


def times(value: Any) -> str:
    """A ratio such as 3.1×."""
    return f"{short(value)}×"


def microseconds(value: Any) -> str:
    """Seconds, printed in µs."""
    return short(1e6 * float(value))


def duration(seconds: Any) -> str:
    """0.00012 → 120 µs."""
    value = float(seconds)
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{short(value / size)} {unit}"
    return f"{short(1e6 * value)} µs"
