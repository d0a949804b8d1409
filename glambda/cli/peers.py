"""`glambda peers`: the same scenes in other physics engines."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import app, split_names, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def peers(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE...]",
            help="a scene to its first impact; SCENE@0.8: to that time; SCENE@rest: stands still; "
            "default: fig2, fig4 and towers, and in space balls, boxes and towers",
        ),
    ] = None,
    engines: Annotated[
        str, typer.Option(help="names with commas between; all: every one that is installed")
    ] = "all",
    limit: Annotated[
        float, typer.Option(help="time of a pass [s]; finer steps are not tried beyond it")
    ] = 60.0,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("peers"),
) -> None:
    """The same scenes in other physics engines and in ours: accuracy against CPU time.

    Each engine runs over its steps and settings in a process of its own. Writes peers.md with
    tables and a figure. Finished runs are kept: the same command continues.

    Example:  glambda peers fig2@0.8 tower,bodies=100,jitter=0,speed=0,mu=0.5@rest --engines mujoco
    """
    from harness.peers import ENGINES
    from harness.peers.campaign import Plan, run_campaign
    from harness.peers.compare import table_of
    from harness.peers.tasks import DEFAULT
    from harness.progress import shown
    from reports.peers.page import print_peers, write_peers

    chosen = split_names(engines, list(ENGINES))
    plan = Plan(
        scenes=tuple(scenes or DEFAULT),
        engines=() if engines.strip() == "all" else tuple(chosen),
        limit=limit,
    )
    described = plan.described()
    for info in described:
        if not info.available:
            say(f"skipped: {info.name} is not installed ({info.reason})", err=True)
    with shown("peers", terminal(err=True)) as tell:
        runs = run_campaign(plan, output, progress=tell)
    rows = table_of(runs)
    print_peers(terminal(), rows, described)
    say(str(write_peers(rows, described, output)))
