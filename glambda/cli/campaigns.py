"""`glambda criterion | growth | race | stability`: the methods under the lens."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from glambda.cli.app import Files, app, chosen_solvers, split_names, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def criterion(
    files: Files,
    repeats: Annotated[int, typer.Option(min=1, help="fewest timed runs of each rule")] = 5,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder for tables and figures")
    ] = None,
) -> None:
    """When should the paper's method factorize anew? Rules and intervals, counted and timed.

    Then whether the norms, ranks and accuracy that it relies on are what it takes them for, and
    what guessing the active set would cost. A folder that holds some of it already is continued.

    Example:  glambda criterion recordings/*.h5 -o criterion
    """
    from harness.criterion.examination import Examination, criterion_claims, examination_claims
    from harness.criterion.measurement import measurements
    from harness.progress import shown
    from harness.recordings.recording import read_recording
    from harness.results.claim import measure
    from reports.criterion.page import print_criterion, write_criterion

    recordings = [read_recording(file) for file in files]
    with TemporaryDirectory() if output is None else nullcontext(output) as folder:
        with shown("criterion", terminal(err=True)) as tell:
            rows = measure(criterion_claims(recordings, repeats), folder, tell)
        measured = measurements(**rows)
        with shown("examination", terminal(err=True)) as tell:
            examination = Examination(**measure(examination_claims(recordings), folder, tell))
    print_criterion(terminal(), measured, examination)
    if output is not None:
        say(str(write_criterion(measured, output, examination)))


@app.command()
@told
def growth(
    families: Annotated[
        list[str] | None, typer.Argument(metavar="[FAMILY...]", help="default: tower and wall")
    ] = None,
    bodies: Annotated[
        str | None, typer.Option(help="sizes with commas between, such as 5,20,100")
    ] = None,
    solvers: Annotated[
        str | None, typer.Option(help="as for replay; default: all that could reach these sizes")
    ] = None,
    limit: Annotated[
        float, typer.Option(help="[s] per QP; a backend beyond it is not tried at the next size")
    ] = 2.0,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("growth"),
) -> None:
    """How does the time per QP grow with the number of bodies, backend by backend?

    Records a short slow motion of each family at each size, replays it warm through the backends,
    and writes growth.md with tables and a figure. A folder that holds some of it already is
    continued.

    Example:  glambda growth tower wall,mu=0.3 --bodies 5,20,100 -o growth
    """
    from harness.claims.growth import FAMILIES, Plan, measure_growth
    from harness.progress import shown
    from reports.claims.growth import print_growth, write_growth

    plan = Plan(
        families=tuple(families or FAMILIES),
        bodies=tuple(_sizes(bodies)) if bodies is not None else (),
        solvers=tuple(chosen_solvers(solvers)) if solvers is not None else (),
        limit=limit,
    )
    with shown("growth", terminal(err=True)) as tell:
        points = measure_growth(plan, output, progress=tell)
    print_growth(terminal(), points)
    say(str(write_growth(points, output)))


def _sizes(text: str) -> list[int]:
    """Whole numbers with commas between."""
    sizes = [part.strip() for part in text.split(",") if part.strip()]
    if not sizes or not all(size.isdecimal() for size in sizes):
        raise ValueError(f"--bodies {text!r}: give whole numbers with commas between")
    return [int(size) for size in sizes]


@app.command()
@told
def race(
    files: Files,
    solvers: Annotated[
        str, typer.Option(help="names with commas between; all: who can be called by hand")
    ] = "all",
    rounds: Annotated[int, typer.Option(min=1, help="timed rounds of each sequence")] = 9,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("race"),
) -> None:
    """Who is the quickest when nothing goes on between two calls?

    Packages are called as a careful user would by hand, without our adapters, in one process, one
    QP right after the other, warm and cold, by three clocks; every answer is judged. Writes race.md
    with tables and a figure. A folder that holds some of it already is continued.

    Example:  glambda race recordings/*.h5 --solvers glambda,daqp,quadprog -o race
    """
    from harness.progress import shown
    from harness.race.race import race_claim, raced_by
    from harness.recordings.recording import read_recording
    from harness.results.claim import measure
    from reports.claims.race import print_race, write_race

    names = raced_by(split_names(solvers, []))
    claim = race_claim([read_recording(file) for file in files], names, rounds)
    with shown("race", terminal(err=True)) as tell:
        rows = measure([claim], output, tell)["race"]
    print_race(terminal(), rows)
    say(str(write_race(rows, output)))


@app.command()
@told
def stability(
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("stability"),
) -> None:
    """Figure 1: where are the compound methods stable? Roots, and runs of the stepper itself.

    A folder that holds some of them already is continued.

    Example:  glambda stability -o stability
    """
    from harness.claims.stability import stability_claims
    from harness.progress import shown
    from harness.results.claim import measure
    from reports.claims.stability import runs_table, write_stability
    from reports.parts.table import print_tables
    from solvers import make_solver

    with shown("stability", terminal(err=True)) as tell:
        rows = measure(stability_claims(make_solver("glambda")), output, tell)
    page = write_stability(rows["runs"], rows["corners"], output)
    print_tables(terminal(), [runs_table(rows["runs"])])
    say(str(page))
