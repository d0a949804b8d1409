"""`glambda closed-loop`: what a solver does to the motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import Eps, Solvers, Until, app, chosen_solvers, split_names, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def closed_loop(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENE...]", help="default: the paper's four"),
    ] = None,
    solvers: Solvers = "all",
    settings: Annotated[
        str,
        typer.Option(
            help="of paper, high, default, a fraction of the scale (1e-3), or of ε₀ (100x)"
        ),
    ] = "paper,high,default",
    sweep: Annotated[
        str,
        typer.Option(help="settings of solvers that are sloppy on purpose; none: leave them out"),
    ] = "all",
    until: Until = None,
    eps: Eps = None,
    time_limit: Annotated[float, typer.Option(help="[s] of wall time of one motion")] = 300.0,
    workers: Annotated[int, typer.Option(min=1, help="motions at a time")] = 1,
    output: Annotated[Path, typer.Option("-o", "--output", help="results folder")] = Path(
        "closed_loop"
    ),
) -> None:
    """What does a sloppy solver do to the motion? Every backend drives every scene.

    Each motion is compared with a fine reference (exact QPs at ε/1000, whose own error is told) and
    with exact QPs at the same ε. Writes closed_loop.md with tables and figures. A folder that holds
    some of it already is continued.

    Example:  glambda closed-loop fig4 --solvers glambda,clarabel,osqp --settings paper,1e-3
    """
    from harness.motions.closed_loop import LoopPlan, close_loops
    from harness.progress import shown
    from problems.scenes.labels import PAPER_SCENES
    from reports.motions.closed_loop import print_closed_loop, write_closed_loop

    plan = LoopPlan(
        scenes=tuple(scenes or PAPER_SCENES),
        solvers=tuple(chosen_solvers(solvers)),
        settings=tuple(split_names(settings, list(LoopPlan.settings))),
        sweep=() if sweep == "none" else tuple(split_names(sweep, list(LoopPlan.sweep))),
        until=until,
        eps=eps,
        time_limit=time_limit,
        workers=workers,
    )
    with shown("closed loop", terminal(err=True)) as tell:
        found = close_loops(plan, output, progress=tell)
    print_closed_loop(terminal(), found)
    say(str(write_closed_loop(found, output)))
