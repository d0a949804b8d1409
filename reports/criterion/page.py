"""What `glambda criterion` prints and writes: advice, the tables and figures of the criterion.

After them come the tables of what else of the method was examined: its estimates of norms and
ranks, the accuracy that it reaches, guessing the active set beside it, the ways to (4.8), and
what other packages can keep from QP to QP.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from harness.criterion.examination import Examination
from harness.criterion.measurement import Measurement
from reports.criterion.advice import advice
from reports.criterion.enumeration import enumeration_table
from reports.criterion.estimates import (
    accuracy_table,
    directions_table,
    kept_table,
    norms_table,
    rank_table,
)
from reports.criterion.figures import plot_growth, plot_sweep
from reports.criterion.growth import age_table, growth_table, premise_table
from reports.criterion.intervals import costs_table, interval_table, regret_table, runs_table
from reports.criterion.kept import kept_factors_table, kept_runs_table, plot_kept
from reports.criterion.minimum_norm import minimum_norm_table
from reports.parts.style import draw_files
from reports.parts.table import Table, print_tables, write_page


def tables_of(measured: Sequence[Measurement]) -> list[Table]:
    """All tables of the criterion but the one of every run."""
    return [
        costs_table(measured),
        growth_table(measured),
        interval_table(measured),
        regret_table(measured, "flops"),
        regret_table(measured, "runtime"),
        premise_table(measured),
        age_table(measured),
    ]


def examination_tables(examination: Examination | None) -> list[Table]:
    """The tables of an examination, where there is one."""
    if examination is None:
        return []
    return [
        norms_table(examination),
        kept_table(examination),
        rank_table(examination),
        accuracy_table(examination),
        directions_table(examination),
        enumeration_table(examination),
        minimum_norm_table(examination.ways),
        kept_factors_table(examination.kept),
    ]


def print_criterion(
    console: Console, measured: Sequence[Measurement], examination: Examination | None = None
) -> None:
    """Print the advice, and every table with its notes."""
    for sentence in advice(measured):
        console.print(sentence, markup=False, highlight=False)
    print_tables(console, [*tables_of(measured), *examination_tables(examination)])


def write_criterion(
    measured: Sequence[Measurement], folder: str | Path, examination: Examination | None = None
) -> Path:
    """Write criterion.md, the figures, one CSV per table and one of every run; return the page."""
    folder = Path(folder)
    tables = [*tables_of(measured), *examination_tables(examination)]
    runs = [runs_table(measured)]
    figures: list[tuple[str, str, Callable[[Path], Path]]] = [
        (
            "criterion_sweep",
            "Cost per QP against the interval between factorizations",
            lambda path: plot_sweep(measured, path),
        ),
        (
            "criterion_growth",
            "Conjugate gradient iterations against the age of R",
            lambda path: plot_growth(measured, path),
        ),
    ]
    if examination is not None and len(examination.kept):
        kept = examination.kept
        runs.append(kept_runs_table(kept))
        figures.append(
            (
                "criterion_kept",
                "Time per QP of other packages against the interval between renewals",
                lambda path: plot_kept(kept, path),
            )
        )
    parts = ["# When to refactorize\n", *(f"{sentence}\n" for sentence in advice(measured))]
    for name, caption, plot in figures:
        draw_files(plot, folder / name)
        parts.append(f"![{caption}]({name}.png)\n")
    parts += [table.to_markdown() for table in tables]
    return write_page(folder / "criterion.md", "\n".join(parts), [*tables, *runs])
