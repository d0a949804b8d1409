"""`glambda claims`: what the paper and this project claim, run again."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def claims(
    ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ID...]", help="ids, or what they begin with; default: all"),
    ] = None,
    slow: Annotated[bool, typer.Option("--slow", help="those that take long as well")] = False,
    manifest: Annotated[
        Path | None, typer.Option(help="another manifest than claims.toml of harness/claims")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder for rows and claims.md")
    ] = None,
) -> None:
    """Run the claims of the manifest again, each with its negative control.

    Exit 1 where a check does not run, a figure leaves its range, or a negative control passes.

    Example:  glambda claims -o claims
    """
    from harness.claims.checking import refuse_unknown, run
    from harness.claims.manifest import MANIFEST, chosen, read_manifest
    from harness.progress import shown
    from reports.claims.manifest import print_outcomes, write_outcomes

    entries = chosen(read_manifest(manifest or MANIFEST), ids or [])
    for entry in entries:
        refuse_unknown(entry)
    kept = TemporaryDirectory() if output is None else nullcontext(output)
    with kept as folder, shown("claims", terminal(err=True)) as tell:
        outcomes = list(run(entries, Path(folder), slow, tell))
    print_outcomes(terminal(), outcomes)
    if output is not None:
        say(str(write_outcomes(outcomes, output)))
    if any(outcome.wrong and outcome.ran for outcome in outcomes):
        raise typer.Exit(1)
