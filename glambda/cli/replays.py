"""`glambda replay | verify`: hand recorded QPs to the backends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import pandas as pd

from glambda.cli.app import (
    Cluster,
    Files,
    Solvers,
    Workers,
    app,
    chosen_solvers,
    cluster_of,
    refuse_absent,
    split_names,
    terminal,
    told,
)
from glambda.cli.simulation import recorded
from glambda.cli.streams import say


@app.command()
@told
def replay(
    files: Files,
    solvers: Solvers = "all",
    settings: Annotated[
        str, typer.Option(help="of paper, high, default, or numbers such as 1e-6")
    ] = "paper,high",
    arms: Annotated[
        str,
        typer.Option(
            help="of cold, kept, warm, exact, extrapolated, stale5, stale20, corrupted, bare, "
            "shuffled"
        ),
    ] = "cold,warm",
    repeats: Annotated[int, typer.Option(min=1, help="timed passes of each run")] = 3,
    time_limit: Annotated[float, typer.Option(help="[s] per QP; beyond, it is a timeout")] = 1.0,
    memory_limit: Annotated[
        float, typer.Option(help="[GiB] per backend; beyond, it has crashed")
    ] = 4.0,
    again: Annotated[
        str,
        typer.Option(help="of --solvers, those to begin anew, such as one of yours that changed"),
    ] = "",
    qp: Annotated[
        int | None, typer.Option(help="solve and show this one QP; nothing is stored")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="results folder")] = Path(
        "results"
    ),
) -> None:
    """Hand the identical recorded QPs to every backend; judge and time each answer.

    The accuracy asked, in ‖A δx‖: "paper" is each QP's own ε₀ (3.13), "high" 1e-9 of the scale of
    the QP, "default" leaves the package its own tolerances and judges at 1e-6; a number is a
    fraction of the scale, as 1e-9 is. A warm run starts each QP from its own last answer; the other
    arms differ in the quality of what they start from. A folder that holds some of it already is
    continued.

    Example:  glambda replay recordings/*.h5 --solvers glambda,daqp,osqp -o results

    One row again:  glambda replay recordings/fig4.h5 --solvers osqp --settings high --qp 17
    """
    from glambda.display.rows import print_row, replay_table
    from harness.judging.facts import SETTINGS
    from harness.passes.starts import EVERY_ARM
    from harness.progress import shown
    from harness.recordings.recording import read_recording
    from harness.study.replay import replay as replay_all
    from harness.study.replay import reproduce

    refuse_absent(files)
    names = chosen_solvers(solvers)
    chosen, runs = split_names(settings, list(SETTINGS)), split_names(arms, list(EVERY_ARM))
    if qp is not None:
        for recording in map(read_recording, files):
            for name in names:
                for setting in chosen:
                    for arm in runs:
                        print_row(terminal(), reproduce(recording, name, setting, arm, qp))
                        say()
        return
    with shown("replay", terminal(err=True)) as tell:
        rows = replay_all(
            files,
            names,
            chosen,
            runs,
            results=output,
            repeats=repeats,
            time_limit=time_limit,
            memory_limit=memory_limit,
            again=split_names(again, names) if again else (),
            progress=tell,
        )
    terminal().print(replay_table(rows))
    told_if_no_result(rows)


def told_if_no_result(rows: pd.DataFrame) -> None:
    """Exit 1 with the runs that are no result of a solver, and why."""
    from harness.processes.introduction import NO_IMPORT
    from harness.results.store import is_disturbed

    broken = rows[rows["status_text"].str.startswith(NO_IMPORT)]
    for solver, text in broken.groupby("solver")["status_text"].first().items():
        typer.echo(f"{solver}: {text}", err=True)
    disturbed = rows[[is_disturbed(row) for row in rows[["status_text"]].to_dict("records")]]
    for (solver, scene), part in disturbed.groupby(["solver", "scene"]):
        typer.echo(f"{solver} on {scene}: {part['status_text'].iloc[0]}", err=True)
    if len(disturbed):
        text = f"{len(disturbed)} QPs were disturbed; the same command tries them again"
        typer.echo(text, err=True)
    if len(disturbed) or len(broken):
        raise typer.Exit(1)


@app.command()
@told
def verify(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE...]", help="recordings; default: record the four scenes"),
    ] = None,
    solvers: Solvers = "all",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="keep and continue the results there")
    ] = None,
    workers: Workers = None,
    cluster: Cluster = None,
) -> None:
    """Does every backend reproduce the same Gλ? Exit 1 and a table if not.

    glambda, lotstedt, velocity, enumeration, scipy_bvls, daqp and quadprog must not miss once. The
    others are held to a table of expected misses, each with its reason: exit 1 where there are
    more, or larger ones, or on other QPs.
    """
    import tempfile

    from glambda.display.rows import misses_table
    from harness.progress import shown
    from harness.recordings.recording import read_recording
    from harness.study.verify import verify as verify_all

    refuse_absent(files or [])
    names = chosen_solvers(solvers)
    if files:
        recordings = [read_recording(path) for path in files]
    else:
        with tempfile.TemporaryDirectory() as folder:
            recordings = [made for made, _ in recorded(None, None, {}, Path(folder))]
    with shown("verify", terminal(err=True)) as tell:
        lines = verify_all(
            recordings,
            names,
            results=output,
            cluster=cluster_of(workers, cluster),
            progress=tell,
        )
    missed, broken = lines[lines["missed"] > 0], lines[~lines["holds"]]
    console = terminal()
    if len(missed):
        console.print(misses_table(missed, "Missed A x by more than 10 × the accuracy asked"))
    skipped = int(lines["skipped"].sum())
    say(
        f"{int(lines['solves'].sum())} answers of {len(names)} backends judged, {skipped} skipped, "
        f"{int(lines['missed'].sum())} missed, {int(lines['undecided'].sum())} undecided"
    )
    if len(broken):
        console.print(misses_table(broken, "FAILED: misses that are not expected"))
        raise typer.Exit(1)
    say("every backend reproduces the same Gλ, but for the expected misses")
