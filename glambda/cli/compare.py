"""The command that tells two studies apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from glambda.cli.app import app, terminal, told

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from harness.results.changes import Changes

RUN = ("scene", "setting", "arm", "solver")


@app.command()
@told
def compare(
    first: Annotated[Path, typer.Argument(metavar="BEFORE", help="results folder, the measure")],
    second: Annotated[Path, typer.Argument(metavar="AFTER", help="results folder")],
    every: Annotated[
        bool, typer.Option("--all", help="every run, also those that have not changed")
    ] = False,
) -> None:
    """What changed between two studies of the same problems? Exit 1 if something became worse.

    Worse is: a QP that was verified and is no longer; a sum of work counts that rose by over 2 %; a
    time that is longer beyond doubt. Times are told as ratios relative to the machine, which is
    what all solvers share, with intervals that hold all at once in 95 of 100 comparisons of a study
    with another like it. Other scenes, recordings, settings or limits are refused; other versions
    and machines are told, and times of different machines are not compared.

    Example:  glambda compare results-before results-after
    """
    from harness.results.changes import compare_results

    with terminal(err=True).status("comparing"):
        changes = compare_results(first, second)
    console = terminal()
    for remark in changes.remarks:
        console.print(remark, markup=False, highlight=False, soft_wrap=True)
    for table in tables(changes, every):
        console.print(table)
    if changes.disturbed:
        console.print(
            f"{changes.disturbed} runs are not compared in time: the machine was disturbed in most "
            "of their passes; replay on a quieter one",
            highlight=False,
            soft_wrap=True,
        )
    console.print(machine(changes), markup=False, highlight=False, soft_wrap=True)
    if changes.regressions:
        console.print(f"WORSE: {', '.join(changes.regressions)}", highlight=False)
        raise typer.Exit(1)
    console.print(f"nothing became worse in {len(changes.times)} runs", highlight=False)


def machine(changes: Changes) -> str:
    """What is said of the machine."""
    from math import isnan

    from harness.results.time_ratios import FEWEST_PACKAGES

    ratios = changes.ratios
    pace = "" if isnan(changes.pace) else f"; a fixed piece of work took {changes.pace:.2f} ×"
    if not ratios.solvers:
        return f"no times were compared{pace}"
    if ratios.packages < FEWEST_PACKAGES:
        words = f"{ratios.packages} packages are too few to tell the machine from the solvers"
    else:
        words = (
            f"what all {ratios.packages} packages share, {ratios.machine:.2f} ×, is the machine's"
        )
    return f"{words}{pace}; beyond that and what passes show, runs differ by {ratios.spread:.0%}"


def tables(changes: Changes, every: bool) -> list[Table]:
    """Solvers, runs, work counts and verdicts, as far as there is something to say of them."""
    times = changes.times
    if not every:
        times = times[(times["low"] > 1.0) | (times["high"] < 1.0)]
    parts = (
        (len(changes.ratios.solvers), lambda: solvers_table(changes)),
        (len(times), lambda: runs_table(times)),
        (len(changes.counts), lambda: counts_table(changes.counts)),
        (len(changes.verdicts), lambda: verdicts_table(changes.verdicts)),
    )
    return [make() for filled, make in parts if filled]


def solvers_table(changes: Changes) -> Table:
    """The runs of each solver taken together."""
    from reports.parts.terminal_table import terminal_table

    return terminal_table(
        "Solvers: time relative to the machine",
        ("solver", ">ratio", ">interval", "change"),
        ((solver, *_ratio(ratio)) for solver, ratio in changes.ratios.solvers.items()),
    )


def runs_table(times: pd.DataFrame) -> Table:
    """Runs with their times."""
    from reports.parts.terminal_table import terminal_table

    return terminal_table(
        "Runs: time relative to the machine (µs: median over the QPs)",
        (*RUN, ">QPs", ">µs before", ">after", ">ratio", ">interval", "change"),
        (
            (*row[:4], row.qps, f"{1e6 * row.before:.2f}", f"{1e6 * row.after:.2f}", *_ratio(row))
            for row in times.itertuples(index=False)
        ),
    )


def counts_table(counts: pd.DataFrame) -> Table:
    """Sums of work counts."""
    from reports.parts.terminal_table import terminal_table

    return terminal_table(
        "Work counts that differ (sums over the QPs)",
        (*RUN, "work", ">before", ">after", ">ratio", "change"),
        (
            (*row[:4], row.work, row.before, row.after, f"{row.ratio:.3f}", "risen" * row.risen)
            for row in counts.itertuples(index=False)
        ),
    )


def verdicts_table(verdicts: pd.DataFrame) -> Table:
    """Verdicts of QPs."""
    from reports.parts.terminal_table import terminal_table

    return terminal_table(
        "Verdicts that differ",
        (*RUN, "before", "after", ">QPs", "change"),
        (
            (*row[:4], row.before, row.after, row.qps, "lost" * row.lost)
            for row in verdicts.itertuples(index=False)
        ),
    )


def _ratio(found: Any) -> tuple[str, str, str]:
    """Ratio, interval, and whether that says something."""
    if found.ratio != found.ratio:  # NaN
        return "–", "–", "not compared"
    word = "slower" if found.low > 1.0 else "faster" if found.high < 1.0 else ""
    return f"{found.ratio:.3f}", f"{found.low:.3f} to {found.high:.3f}", word
