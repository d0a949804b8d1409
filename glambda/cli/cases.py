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
    foils: Annotated[
        bool, typer.Option("--foils", help="also fig4 and fig5 by springs and other impulses")
    ] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("cases"),
) -> None:
    """Are scenes with a known answer answered right?

    Ramp, braking cube, mass ratios, masonry arch, cards, dominoes, overlap, joints and limits, the
    networks, and tops, boxes and balls in space: each number beside the analytic one, in cases.md
    and cases.csv. With --foils, figures 4 and 5 as Cundall's springs and impulses by Newton and
    Coulomb have them, half a minute more. A folder that holds some of it already is continued.

    Example:  glambda cases arch cards -o cases
    """
    from harness.cases.foils import foils_claim
    from harness.cases.table import CASES, cases_claim
    from harness.progress import shown
    from harness.results.claim import measure
    from reports.cases.foils import foils_table
    from reports.cases.page import cases_table, write_cases
    from reports.parts.table import print_tables
    from solvers import make_solver

    solver = make_solver("glambda")
    claims = [cases_claim(names or CASES, solver)]
    if foils:
        claims.append(foils_claim(solver))
    with shown("cases", terminal(err=True), minutes=3) as tell:
        measured = measure(claims, output, tell)
    tables = [cases_table(measured["cases"])]
    if foils:
        tables.append(foils_table(measured["foils"]))
    page = write_cases(tables, output)
    print_tables(terminal(), tables)
    say(str(page))
