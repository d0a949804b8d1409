"""A table on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text


def terminal_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """A plain table; columns whose name starts with ">" are set to the right."""
    made = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name in columns:
        right = name.startswith(">")
        # Names are read whole or not at all; only the last column may wrap.
        made.add_column(
            name.lstrip(">"),
            justify="right" if right else "left",
            no_wrap=name != columns[-1],
            header_style="dim",
        )
    for row in rows:
        made.add_row(*(Text(str(value)) for value in row))
    return made
