"""`glambda convergence`: error against ε, and what is done about drift."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def convergence(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENE...]", help="default: the paper's four, a tower and a wall"),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("convergence"),
) -> None:
    """Is the error of a motion proportional to ε, and what are the rules against drift worth?

    ε is swept over 1e-2 … 1e-6, before and after the first impact; then Baumgarte's stabilization
    and projection run beside no rule. About two minutes. A folder that holds some of it already is
    continued.

    Example:  glambda convergence fig4 tower,bodies=5,lean=0.1 -o convergence
    """
    from harness.claims.convergence import SCENES, Converged, convergence_claims
    from harness.progress import shown
    from harness.results.claim import measure
    from reports.claims.convergence import convergence_tables, write_convergence
    from reports.parts.table import print_tables
    from solvers import make_solver

    with shown("convergence", terminal(err=True), minutes=3) as tell:
        claims = convergence_claims(scenes or SCENES, make_solver("glambda"))
        measured = Converged(**measure(claims, output, tell))
    page = write_convergence(measured, output)
    print_tables(terminal(), convergence_tables(measured))
    say(str(page))
