"""`glambda cases`: scenes whose answer is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def cases(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[CASE...]", help="default: all of them")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("cases"),
) -> None:
    """Are scenes with a known answer answered right?

    Ramp, braking cube, mass ratios, masonry arch, cards, dominoes, overlap, and the networks: each
    number beside the analytic one, in cases.md and cases.csv. A folder that holds some of it
    already is continued.

    Example:  glambda cases arch cards -o cases
    """
    from harness.cases.table import CASES, cases_claim
    from harness.progress import shown
    from harness.results.claim import measure
    from reports.cases.page import cases_table, write_cases
    from reports.parts.table import print_tables
    from solvers import make_solver

    claim = cases_claim(names or CASES, make_solver("glambda"))
    with shown("cases", terminal(err=True)) as tell:
        rows = measure([claim], output, tell)["cases"]
    page = write_cases(rows, output)
    print_tables(terminal(), [cases_table(rows)])
    say(str(page))
