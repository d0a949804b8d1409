"""The console that is printed on: what it is told is printed, and nothing of it obeyed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.segment import Segment

from harness.files.printable import printable


class Terminal(Console):
    """A console that prints what it is told, without markup, and obeys none of it."""

    def __init__(self, err: bool = False) -> None:
        super().__init__(stderr=err, markup=False, highlight=False, emoji=False)
        if not self.is_terminal:
            self.width = 120  # a file has no width of its own

    def render(self, *arguments: Any, **options: Any) -> Iterable[Segment]:
        """Segments of a renderable, as `Console` makes them, of printable text."""
        for text, style, control in super().render(*arguments, **options):
            yield Segment(text if control else printable(text), style, control)
