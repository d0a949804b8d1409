"""`glambda report | study`: tables, figures and the page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import Cluster, Workers, app, chosen_solvers, cluster_of, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def report(
    results: Annotated[Path, typer.Argument(help="results folder")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("report"),
) -> None:
    """Write tables, figures and the pages of stored results, linked with one another.

    The page of the study stands alone. Beside it stand a player of each recorded scene, and a page
    of every other command that has its results in a folder under RESULTS (-o results/growth).

    Example:  glambda report results -o report
    """
    from reports.page.page import write_report

    with terminal(err=True).status("drawing the report"):
        page = write_report(results, output)
    say(str(page))


@app.command()
@told
def study(
    plan_file: Annotated[
        Path | None, typer.Argument(metavar="[PLAN.toml]", help="a study that is written down")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="about a minute: short motions, one pass, fast backends")
    ] = False,
    scenes: Annotated[
        str | None,
        typer.Option(
            help="with spaces between, such as 'fig3 tower,bodies=20', or a kind of `glambda "
            "scenes`, such as linkages; all: of every kind; default: paper"
        ),
    ] = None,
    solvers: Annotated[str | None, typer.Option(help="as for replay")] = None,
    results: Annotated[
        Path | None, typer.Option(help="folder; default: results, or results/quick")
    ] = None,
    workers: Workers = None,
    cluster: Cluster = None,
) -> None:
    """Record the scenes, replay them through every backend, and report.

    An interrupted study continues where it stopped. The report is RESULTS/report/index.html.

    A plan in TOML has any of scenes, solvers, settings, arms, repeats, until, time_limit and
    slow_pass; an option that is given here counts instead, and a copy stays with the results.

    With --cluster or --workers, what is compared in time stays together: one scene at one accuracy
    is one job, done by one worker.
    """
    from dataclasses import replace as with_changes

    from glambda.display.rows import replay_table
    from harness.progress import shown
    from harness.results.store import read_results
    from harness.study.plan_file import read_plan
    from harness.study.study import QUICK, StudyPlan, run_study
    from problems.scenes.registry import chosen_scenes
    from reports.page.page import write_report

    plan, written = QUICK if quick else StudyPlan(), None
    if plan_file is not None:
        plan, written = read_plan(plan_file, plan)
    if scenes is not None:
        plan = with_changes(plan, scenes=chosen_scenes(scenes))
    if solvers is not None:
        plan = with_changes(plan, solvers=tuple(chosen_solvers(solvers)))
    folder = results or Path("results/quick" if quick else "results")
    console = terminal(err=True)
    with shown("study", console) as tell:
        run_study(
            plan,
            folder,
            written=written,
            cluster=cluster_of(workers, cluster),
            announce=lambda text: say(text, err=True) if text else None,
            progress=tell,
        )
    with console.status("drawing the report"):
        page = write_report(folder, folder / "report")
    terminal().print(replay_table(read_results(folder)))
    say(str(page))
