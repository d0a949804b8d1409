"""`glambda scenes | solvers | info`: what there is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def scenes() -> None:
    """List the scenes by kind, with their parameters and defaults."""
    from glambda.display.lists import scenes_table
    from problems import describe_scene
    from problems.scenes.registry import scene_kinds

    for kind, names in scene_kinds().items():
        terminal().print(scenes_table(kind, {name: describe_scene(name) for name in names}))


@app.command()
@told
def solvers(
    name: Annotated[str, typer.Argument(metavar="[NAME]", help="one of them")] = "",
    protocol: Annotated[
        bool, typer.Option(help="how NAME is called and with which settings, in Markdown")
    ] = False,
) -> None:
    """List the backends: version, form, warm start, or why one is absent.

    The form says what a package is fed: "normal" is P = AᵀA, which squares the condition;
    "residual" keeps y = A x + d as rows. Starred ones are held to miss no A x at all.
    A variant is asked for in brackets: lotstedt[exact_qr].

    Example:  glambda solvers daqp --protocol > daqp.md
    """
    from glambda.display.lists import solvers_table
    from harness.processes.introduction import described
    from solvers.registry import solver_names

    if protocol:
        from solvers.protocol import protocol as page_of

        if not name:
            raise ValueError("--protocol is of one solver; give its name")
        typer.echo(page_of(name), nl=False)
        return
    known = [described(each) for each in ([name] if name else solver_names())]
    terminal().print(solvers_table(known))
    for info in known:
        if not info.available:
            say(f"absent: {info.name} ({info.reason})")


@app.command()
@told
def info(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE...", help="recordings or results")],
) -> None:
    """Tell what recordings (.h5) or results folders hold.

    Example:  glambda info recordings/fig4.h5
    """
    from glambda.display.recordings import print_recording
    from glambda.display.rows import replay_table
    from harness.recordings.recording import read_recording
    from harness.results.store import read_results

    console = terminal()
    for path in paths:
        if path.is_dir():
            rows = read_results(path)
            if not len(rows):
                raise ValueError(f"{path}: holds no results; give a folder of 'glambda replay'")
            console.print(replay_table(rows))
        else:
            with terminal(err=True).status("reading"):
                recording = read_recording(path)
            print_recording(console, recording, str(path))
