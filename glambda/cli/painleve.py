"""`glambda painleve`: where Coulomb's law has no motion, or two."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def painleve(
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("painleve"),
) -> None:
    """Painlevé's rod: does the first step stay bounded, and what becomes of the rod?

    Runs of the stepper by the paper's friction and by the corrected one, beside closed forms. A
    folder that holds some of them already is continued.

    Example:  glambda painleve -o painleve
    """
    from harness.claims.painleve import Painleve, painleve_claims
    from harness.progress import shown
    from harness.results.claim import measure
    from reports.claims.painleve import painleve_tables, write_painleve
    from reports.parts.table import print_tables
    from solvers import make_solver

    with shown("painleve", terminal(err=True)) as tell:
        measured = Painleve(**measure(painleve_claims(make_solver("glambda")), output, tell))
    page = write_painleve(measured, output)
    print_tables(terminal(), painleve_tables(measured))
    say(str(page))
