"""The command line, `glambda`.

It names all four packages and imports each only in the command that needs it, so that `--help` is
there at once.  Exit codes: 0 fine; 1 a judged failure; 2 bad input, told in one line: what, where,
remedy.  GLAMBDA_DEBUG=1 shows the traceback instead.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from harness.threads import ask_for_one_thread

if TYPE_CHECKING:
    from rich.console import Console

    from harness.recording import Recording

EPILOG = """A first walk:

glambda simulate fig4 --plot fig4.png

glambda record fig4 -o recordings

glambda replay recordings/fig4.h5 --solvers lotstedt,daqp -o results

glambda report results -o report

or all of it, four scenes and every backend, at once:  glambda study
"""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

RESUMED = ("replay", "growth", "study")
"""Commands that continue from their results folder after Ctrl-C."""

Command = TypeVar("Command", bound=Callable[..., Any])
Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="recordings (.h5)")]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="a parameter of the scene; may be repeated"),
]
Until = Annotated[float | None, typer.Option(help="end of the motion [s]; default: the scene's")]
Eps = Annotated[float | None, typer.Option(help="the stepper's ε; default: the scene's (0.001)")]
Friction = Annotated[
    Literal["corrected", "paper"], typer.Option(help="the paper's lagged friction, or corrected")
]
DropTol = Annotated[
    float | None, typer.Option(help="speed at which a contact without force is dropped; default: ε")
]
Solvers = Annotated[
    str,
    typer.Option(
        help="names with commas between, such as lotstedt,lotstedt[exact_qr],daqp; "
        "all: every backend that is installed"
    ),
]


def told(command: Command) -> Command:
    """Turn errors of input into one line on stderr and exit code 2."""

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> Any:
        try:
            return command(*arguments, **options)
        except ImportError as error:
            _give_up(error, 2, f"{error}; install its package, or choose another solver or scene")
        except OSError as error:
            what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            _give_up(error, 2, f"{what}; name another file or folder")
        except ValueError as error:
            _give_up(error, 2)
        except RuntimeError as error:  # SimulationError: the simulation could not go on
            if type(error).__name__ != "SimulationError":
                raise
            _give_up(error, 1)
        except KeyboardInterrupt:
            goes_on = ": the same command continues" if command.__name__ in RESUMED else ""
            typer.echo(f"\ninterrupted; what was finished is kept{goes_on}", err=True)
            raise typer.Exit(130) from None

    return run  # type: ignore[return-value]


def _give_up(error: Exception, code: int, message: str = "") -> None:
    if os.environ.get("GLAMBDA_DEBUG"):
        raise error
    typer.echo(f"glambda: {' '.join((message or str(error)).split())}", err=True)
    raise typer.Exit(code) from None


def _console(err: bool = False) -> Console:
    from rich.console import Console

    console = Console(stderr=err)
    if not console.is_terminal:
        console.width = 120  # a file has no width of its own
    return console


def _names(text: str, default: list[str]) -> list[str]:
    """Names with commas between; "all" stands for `default`."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise ValueError("an empty list of names was given; leave the option out for all")
    return default if names == ["all"] else list(dict.fromkeys(names))


def _solver_names(text: str) -> list[str]:
    """Solvers by name; absent ones are told by name where all are meant."""
    from solvers import describe, make_solver
    from solvers.registry import solver_names

    if text.strip() != "all":
        names = _names(text, [])
        for name in names:
            make_solver(name)  # raises for an unknown one
        return names
    known = [describe(name) for name in solver_names()]
    for info in known:
        if not info.available:
            typer.echo(f"skipped: {info.name} is not installed ({info.reason})", err=True)
    return [info.name for info in known if info.available]


def _output(path: Path | None, suffixes: tuple[str, ...], option: str) -> Path | None:
    """An output file, refused before the work and not after it."""
    if path is None:
        return None
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{option} {path}: give a name that ends in {' or '.join(suffixes)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK) or path.is_dir():
        raise ValueError(f"{option} {path}: cannot be written there; name another file")
    return path


@app.callback(epilog=EPILOG)
def glambda() -> None:
    """Rigid bodies in contact by Lötstedt's 1984 method, and a fair replay of its QPs.

    A scene is simulated; each time step poses a quadratic program, min ½‖A x + d‖² within bounds.
    A recording keeps these QPs in order. A replay hands the identical QPs to every backend, and
    each answer is judged by A x, so by Gλ and the motion, never by λ, which is not unique where
    contacts are redundant.
    """


@app.command()
@told
def scenes() -> None:
    """List the scenes, with their parameters and defaults."""
    from harness.display import scenes_table
    from problems import describe_scene, scene_names

    _console().print(scenes_table({name: describe_scene(name) for name in scene_names()}))


@app.command()
@told
def solvers() -> None:
    """List the backends: version, form, warm start, or why one is absent.

    The form says what a package is fed: "normal" is P = AᵀA, which squares the condition;
    "residual" keeps y = A x + d as rows. Starred ones are held to miss no A x at all.
    """
    from harness.display import solvers_table
    from solvers import describe
    from solvers.registry import solver_names

    known = [describe(name) for name in solver_names()]
    _console().print(solvers_table(known))
    for info in known:
        if not info.available:
            typer.echo(f"absent: {info.name} ({info.reason})")


@app.command()
@told
def info(
    paths: Annotated[list[Path], typer.Argument(metavar="FILE...", help="recordings or results")],
) -> None:
    """Tell what recordings (.h5) or results folders hold.

    Example:  glambda info recordings/fig4.h5
    """
    from harness.display import print_recording, replay_table
    from harness.recording import read_recording
    from harness.store import read_results

    console = _console()
    for path in paths:
        if path.is_dir():
            rows = read_results(path)
            if not len(rows):
                raise ValueError(f"{path}: holds no results; give a folder of 'glambda replay'")
            console.print(replay_table(rows))
        else:
            print_recording(console, read_recording(path), str(path))


@app.command()
@told
def simulate(
    scene: Annotated[str, typer.Argument(help="a scene, see 'glambda scenes'")],
    solver: Annotated[str, typer.Option(help="drives the simulation")] = "lotstedt",
    eps: Eps = None,
    until: Until = None,
    fixed_step: Annotated[
        float | None, typer.Option(help="step length [s], without error control")
    ] = None,
    friction: Friction = "corrected",
    drop_tol: DropTol = None,
    settings: Sets = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="F.csv", help="positions; events to F.events.csv")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="F.png", help="frames (.png, .svg, .pdf)")
    ] = None,
    animate: Annotated[Path | None, typer.Option(metavar="F.gif", help="the motion")] = None,
) -> None:
    """Simulate a scene, with any backend in the loop.

    Example:  glambda simulate fig4 --set mu_I=0.8 --solver daqp --plot fig4.png
    """
    from harness.display import print_run
    from harness.progress import shown
    from harness.study import parse_label, parse_settings
    from problems import scene as make_scene
    from problems import simulate as run_scene
    from solvers import make_solver

    table = _output(trajectory, (".csv",), "--trajectory")
    picture = _output(plot, (".png", ".svg", ".pdf"), "--plot")
    film = _output(animate, (".gif",), "--animate")
    name, parameters = parse_label(scene)
    made = make_scene(name, **{**parameters, **parse_settings(settings or [])})
    end = made.end_time if until is None else until
    with shown(f"simulate {made.label}", _console(err=True)) as tell:
        run = run_scene(
            made,
            make_solver(solver),
            eps=eps,
            until=until,
            fixed_step=fixed_step,
            friction=friction,
            drop_tol=drop_tol,
            progress=lambda t: tell(f"t = {t:.3f} s", t, end),
        )
    print_run(_console(), run)
    if table is not None:
        run.trajectory.to_csv(table, index=False)
        run.events.to_csv(table.with_suffix(".events.csv"), index=False)
    if picture is not None:
        from reports.figures import plot_scene

        plot_scene(run, picture)
    if film is not None:
        from reports.figures import animate_scene

        animate_scene(run, film)


@app.command()
@told
def record(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENE...]", help="default: the paper's four")
    ] = None,
    settings: Sets = None,
    eps: Eps = None,
    until: Until = None,
    friction: Friction = "corrected",
    drop_tol: DropTol = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("recordings"),
) -> None:
    """Simulate scenes by the paper's method and keep every QP, with a reference answer.

    One HDF5 file each, named by the scene and what differs from its defaults; the same command
    makes the same bytes.

    Example:  glambda record fig4 --set mu_I=0.8 -o recordings
    """
    options = {"eps": eps, "until": until, "friction": friction, "drop_tol": drop_tol}
    for made, path in _recorded(scene, settings, options, output):
        typer.echo(f"{path}: {len(made.qps)} QPs, digest {made.digest[:12]}…")


def _recorded(
    labels: list[str] | None,
    settings: list[str] | None,
    options: dict[str, Any],
    folder: Path,
) -> list[tuple[Recording, Path]]:
    from harness.progress import shown
    from harness.record import record as record_scene
    from harness.recording import write_recording
    from harness.study import PAPER_SCENES, parse_label, parse_settings
    from problems import scene as make_scene

    named = [parse_label(label) for label in labels or PAPER_SCENES]
    extra = parse_settings(settings or [])
    made = [make_scene(name, **{**parameters, **extra}) for name, parameters in named]
    done = []
    for each in made:
        with shown(f"record {each.label}", _console(err=True)) as tell:
            recording = record_scene(each, **options, progress=tell)
        path = folder / f"{recording.scene}.h5"
        write_recording(path, recording)
        done.append((recording, path))
    return done


@app.command()
@told
def replay(
    files: Files,
    solvers: Solvers = "all",
    settings: Annotated[str, typer.Option(help="of paper, high, default")] = "paper,high",
    arms: Annotated[str, typer.Option(help="of cold, warm")] = "cold,warm",
    repeats: Annotated[int, typer.Option(min=1, help="timed passes of each run")] = 3,
    time_limit: Annotated[float, typer.Option(help="[s] per QP; beyond, it is a timeout")] = 1.0,
    qp: Annotated[
        int | None, typer.Option(help="solve and show this one QP; nothing is stored")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="results folder")] = Path(
        "results"
    ),
) -> None:
    """Hand the identical recorded QPs to every backend; judge and time each answer.

    The accuracy asked, in ‖A δx‖: "paper" is each QP's own ε₀ (3.13), "high" 1e-9 of the scale of
    the QP, "default" leaves the package its own tolerances and judges at 1e-6. A warm run starts
    each QP from its own last answer. A folder that holds some of it already is continued.

    Example:  glambda replay recordings/*.h5 --solvers lotstedt,daqp,osqp -o results

    One row again:  glambda replay recordings/fig4.h5 --solvers osqp --settings high --qp 17
    """
    from harness.display import print_row, replay_table
    from harness.facts import SETTINGS
    from harness.progress import shown
    from harness.recording import read_recording
    from harness.replay import ARMS, reproduce
    from harness.replay import replay as replay_all

    names = _solver_names(solvers)
    chosen, runs = _names(settings, list(SETTINGS)), _names(arms, list(ARMS))
    recordings = [read_recording(path) for path in files]
    if qp is not None:
        for recording in recordings:
            for name in names:
                for setting in chosen:
                    for arm in runs:
                        print_row(_console(), reproduce(recording, name, setting, arm, qp))
                        typer.echo()
        return
    with shown("replay", _console(err=True)) as tell:
        rows = replay_all(
            recordings,
            names,
            chosen,
            runs,
            results=output,
            repeats=repeats,
            time_limit=time_limit,
            progress=tell,
        )
    _console().print(replay_table(rows))


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
) -> None:
    """Does every backend reproduce the same Gλ? Exit 1 and a table if not.

    lotstedt, velocity, enumeration, scipy_bvls, daqp and quadprog must not miss once. The others
    are held to a table of expected misses, each with its reason: exit 1 where a count rises.
    """
    import tempfile

    from harness.display import misses_table
    from harness.progress import shown
    from harness.recording import read_recording
    from harness.verify import verify as verify_all

    names = _solver_names(solvers)
    if files:
        recordings = [read_recording(path) for path in files]
    else:
        with tempfile.TemporaryDirectory() as folder:
            recordings = [made for made, _ in _recorded(None, None, {}, Path(folder))]
    with shown("verify", _console(err=True)) as tell:
        lines = verify_all(recordings, names, results=output, progress=tell)
    missed, broken = lines[lines["missed"] > 0], lines[~lines["holds"]]
    console = _console()
    if len(missed):
        console.print(misses_table(missed, "Missed A x by more than 10 × the accuracy asked"))
    skipped = int(lines["skipped"].sum())
    typer.echo(
        f"{int(lines['solves'].sum())} answers of {len(names)} backends judged, {skipped} skipped, "
        f"{int(lines['missed'].sum())} missed"
    )
    if len(broken):
        console.print(misses_table(broken, "FAILED: more misses than expected"))
        raise typer.Exit(1)
    typer.echo("every backend reproduces the same Gλ, but for the expected misses")


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
    what guessing the active set would cost.

    Example:  glambda criterion recordings/*.h5 -o criterion
    """
    from harness.criterion import measure_all
    from harness.examination import examine
    from harness.progress import shown
    from harness.recording import read_recording
    from reports.criterion_report import print_criterion, write_criterion

    recordings = [read_recording(file) for file in files]
    with shown("criterion", _console(err=True)) as tell:
        measured = measure_all(recordings, repeats=repeats, progress=tell)
    with shown("examination", _console(err=True)) as tell:
        examination = examine(recordings, progress=tell)
    print_criterion(_console(), measured, examination)
    if output is not None:
        typer.echo(str(write_criterion(measured, output, examination)))


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
    from harness.growth import FAMILIES, Plan, measure_growth
    from harness.progress import shown
    from reports.growth import print_growth, write_growth

    plan = Plan(
        families=tuple(families or FAMILIES),
        bodies=tuple(_sizes(bodies)) if bodies is not None else (),
        solvers=tuple(_solver_names(solvers)) if solvers is not None else (),
        limit=limit,
    )
    with shown("growth", _console(err=True)) as tell:
        points = measure_growth(plan, output, progress=tell)
    print_growth(_console(), points)
    typer.echo(str(write_growth(points, output)))


def _sizes(text: str) -> list[int]:
    """Whole numbers with commas between."""
    sizes = [part.strip() for part in text.split(",") if part.strip()]
    if not sizes or not all(size.isdecimal() for size in sizes):
        raise ValueError(f"--bodies {text!r}: give whole numbers with commas between")
    return [int(size) for size in sizes]


@app.command()
@told
def report(
    results: Annotated[Path, typer.Argument(help="results folder")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("report"),
) -> None:
    """Write tables, figures and one self-contained page from stored results.

    Example:  glambda report results -o report
    """
    from reports.page import write_report

    with _console(err=True).status("drawing the report"):
        page = write_report(results, output)
    typer.echo(str(page))


@app.command()
@told
def study(
    quick: Annotated[
        bool, typer.Option("--quick", help="about a minute: short motions, one pass, fast backends")
    ] = False,
    scenes: Annotated[
        str | None,
        typer.Option(
            help="with spaces between, such as 'fig3 tower,bodies=20'; all: the paper's four"
        ),
    ] = None,
    solvers: Annotated[str | None, typer.Option(help="as for replay")] = None,
    results: Annotated[
        Path | None, typer.Option(help="folder; default: results, or results/quick")
    ] = None,
) -> None:
    """Record the scenes, replay them through every backend, and report.

    An interrupted study continues where it stopped. The report is RESULTS/report/index.html.
    """
    from dataclasses import replace as with_changes

    from harness.display import replay_table
    from harness.progress import shown
    from harness.store import read_results
    from harness.study import PAPER_SCENES, QUICK, Plan, run_study
    from reports.page import write_report

    plan = QUICK if quick else Plan()
    if scenes is not None:
        plan = with_changes(plan, scenes=PAPER_SCENES if scenes == "all" else tuple(scenes.split()))
    if solvers is not None:
        plan = with_changes(plan, solvers=tuple(_solver_names(solvers)))
    folder = results or Path("results/quick" if quick else "results")
    console = _console(err=True)
    with shown("study", console) as tell:
        run_study(plan, folder, progress=tell)
    with console.status("drawing the report"):
        page = write_report(folder, folder / "report")
    rows = read_results(folder)
    for setting in plan.settings:
        _console().print(replay_table(rows[rows["settings"] == setting]))
    typer.echo(str(page))


def main() -> None:
    """Entry point of the command `glambda`."""
    ask_for_one_thread()
    app()
