"""`glambda play`: a recording as a page that plays it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, output_file, told
from glambda.cli.streams import say


@app.command()
@told
def play(
    recording: Annotated[Path, typer.Argument(help="of bodies, as 'glambda record' writes it")],
    output: Annotated[Path, typer.Option("-o", metavar="F.html", help="page")] = Path(
        "player.html"
    ),
) -> None:
    """Write a page that plays a recording: bodies, contact forces, events, k and the active set.

    It stands alone. The players of a report also show the iterations of every backend.

    Example:  glambda play recordings/fig4.h5 -o fig4.html
    """
    from harness.recordings.recording import read_recording
    from reports.motions.network import is_network
    from reports.motions.player import write_player

    path = output_file(output, (".html",), "-o")
    assert path is not None
    read = read_recording(recording)
    if is_network(read):
        raise ValueError(f"{recording}: {read.scene} is a network, which has no bodies to play")
    say(str(write_player(read, path)))
