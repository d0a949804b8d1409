"""The command that tells a maker whether a plug-in or a file is right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glambda.cli.app import Until, app, terminal, told

if TYPE_CHECKING:
    from harness.study.check import Finding

checks = typer.Typer(no_args_is_help=True, help="Is this solver, scene or recording right?")
app.add_typer(checks, name="check")


@checks.command("solver")
@told
def solver(name: Annotated[str, typer.Argument(help="see 'glambda solvers'")]) -> None:
    """Is a solver right? Short motions and odd QPs, cold and warm, judged as in a study.

    Example:  glambda check solver daqp
    """
    from harness.study.check import check_solver

    tell(check_solver(name))


@checks.command("scene")
@told
def scene(
    label: Annotated[str, typer.Argument(help="such as fig4 or fig4,mu_I=0.8")],
    until: Until = None,
) -> None:
    """Is a scene right? It is made, moved and recorded; its physics is told.

    Example:  glambda check scene tower,bodies=3
    """
    from harness.study.check import check_scene

    tell(check_scene(label, until))


@checks.command("recording")
@told
def recording(path: Annotated[Path, typer.Argument(metavar="FILE", help="a recording")]) -> None:
    """Is a recording sound? It is read, and its references are sought again.

    Example:  glambda check recording recordings/fig4.h5
    """
    from harness.study.check import check_recording

    tell(check_recording(path))


def tell(findings: Iterator[Finding]) -> None:
    """Print findings as they come; exit 1 if something is wrong."""
    wrong, console = 0, terminal()
    for finding in findings:
        wrong += not finding.right
        line = f"{'ok   ' if finding.right else 'WRONG'}  {finding.question}: {finding.words}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if wrong:
        raise typer.Exit(1)
