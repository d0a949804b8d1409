"""Showing how far something long has got: a bar on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console

Progress = Callable[[str, float, float], None]
"""Called with what is being done, how much of it is done, and how much there is."""

LINE_EVERY = 20.0
"""Seconds between two lines where there is no terminal."""


@contextmanager
def shown(title: str, console: Console, minutes: float = 0.0) -> Iterator[Progress]:
    """Show the progress that is told to the callable, under `title`, until the block ends.

    minutes : that all of it takes, as it stands by default, on two cores; told beforehand
    """
    if minutes:
        text = f"{title}: by default some {minutes:g} minutes on two cores"
        console.print(text, markup=False, highlight=False)
    if not console.is_terminal:
        yield _Lines(title, console)
        return
    columns = (
        bars.TextColumn("{task.fields[title]}", markup=False),
        bars.BarColumn(),
        bars.TextColumn("{task.percentage:3.0f} %"),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
        bars.TextColumn("{task.description}", style="dim", markup=False),
    )
    with bars.Progress(*columns, console=console, transient=True, refresh_per_second=5) as bar:
        task = bar.add_task("", total=None, title=title)

        def tell(what: str, done: float, total: float) -> None:
            bar.update(task, description=what, completed=done, total=total)

        yield tell


class _Lines:
    """A line whenever `LINE_EVERY` seconds have passed, for logs."""

    def __init__(self, title: str, console: Console) -> None:
        self.title, self.console = title, console
        self.told = self.begun = time.monotonic()
        self.done = 0.0

    def __call__(self, what: str, done: float, total: float) -> None:
        now = time.monotonic()
        if done < self.done:  # something else has begun
            self.begun = now
        self.done = done
        if now - self.told >= LINE_EVERY and total > 0:
            self.told = now
            line = f"{self.title}: {100 * done / total:.0f} % {what}{self._left(now, done, total)}"
            self.console.print(line, markup=False, highlight=False)

    def _left(self, now: float, done: float, total: float) -> str:
        """How long the rest takes at the pace so far, where that is over a minute."""
        minutes = (now - self.begun) * (total / done - 1) / 60 if done > 0 else 0.0
        return f", some {minutes:.0f} min left" if minutes > 1 else ""
