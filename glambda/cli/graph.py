"""`glambda graph`: figure 6 of a real instant."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import SceneName, Sets, app, output_file, scene_of_bodies, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def graph(
    scene: SceneName,
    at: Annotated[float, typer.Option(help="the instant [s]")],
    settings: Sets = None,
    picture: Annotated[
        Path, typer.Option("-o", metavar="F.png", help="picture (.png, .svg, .pdf)")
    ] = Path("graph.png"),
) -> None:
    """Draw the constraint graph of an instant beside the bodies, as figure 6 does.

    Below it stands how many constraints are possible, and how many the broad phase leaves.

    Example:  glambda graph fig4 --at 1.2 -o graph.png
    """
    from harness.motions.instant import instant_of
    from harness.progress import shown
    from reports.motions.graph import plot_graph
    from solvers import make_solver

    path = output_file(picture, (".png", ".svg", ".pdf"), "-o")
    assert path is not None
    made = scene_of_bodies(scene, settings, "whose graph of constraints is not that of contacts")
    with shown(f"simulate {made.label}", terminal(err=True)):
        instant = instant_of(made, at, make_solver("glambda"))
    say(str(plot_graph(instant, path)))
