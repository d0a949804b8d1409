"""`glambda gallery`: every scene as a picture and a short animation, and a page of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, terminal, told
from glambda.cli.completion import complete_scenes
from glambda.cli.streams import say

LONGEST = 6.0
"""Longest motion that is shown [s]."""


@app.command()
@told
def gallery(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE...]", help="default: every scene", autocompletion=complete_scenes
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("gallery"),
) -> None:
    """Draw every scene as a picture and a short animation, and an index page.

    Motions are shown for 6 s at most. A few minutes for all.

    Example:  glambda gallery fig4 arch bridge -o gallery
    """
    from harness.progress import shown
    from problems import scene, simulate
    from problems.scenes.registry import scene_kinds
    from reports.motions.gallery import draw_entry, write_index
    from solvers import make_solver

    kinds = scene_kinds()
    wanted = list(names or [name for each in kinds.values() for name in each])
    made = {name: scene(name) for name in wanted}
    entries, solver = {}, make_solver("glambda")
    with shown("gallery", terminal(err=True)) as tell:
        for done, (name, each) in enumerate(made.items()):
            tell(name, done, len(made))
            until = min(each.end_time, LONGEST)
            run = simulate(each, solver, until=until, keep_qps=False)
            entries[name] = draw_entry(name, run, output)
    say(str(write_index(output, kinds, entries)))
