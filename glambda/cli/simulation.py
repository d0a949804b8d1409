"""`glambda simulate | record`: run a scene, keep its QPs."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from glambda.cli.app import (
    Drift,
    DriftTime,
    DropTol,
    Eps,
    FixedStep,
    Friction,
    Impulses,
    Restitution,
    SceneName,
    Sets,
    SolverName,
    Stops,
    Until,
    app,
    made_scene,
    output_file,
    terminal,
    told,
)
from glambda.cli.completion import complete_scenes

if TYPE_CHECKING:
    from harness.recordings.recording import Recording
    from problems import Run

RUN_OPTIONS: dict[str, tuple[Any, Any]] = {
    "eps": (Eps, None),
    "until": (Until, None),
    "fixed_step": (FixedStep, None),
    "stops": (Stops, "located"),
    "friction": (Friction, "corrected"),
    "impulses": (Impulses, "paper"),
    "restitution": (Restitution, "poisson"),
    "drop_tol": (DropTol, None),
    "drift": (Drift, "none"),
    "drift_time": (DriftTime, None),
}
"""Options about how a scene is run, with their types and defaults."""


def runs_scenes(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with `RUN_OPTIONS`, which it is handed as `how`, for `problems.simulate`.

    Raises ValueError for a time of drift without the rule that takes it.
    """

    @functools.wraps(command)
    def run(**options: Any) -> Any:
        how = {name: options.pop(name) for name in RUN_OPTIONS}
        if how["drift_time"] is None:
            del how["drift_time"]
        elif how["drift"] != "baumgarte":
            raise ValueError(f"--drift-time {how['drift_time']:g}: give --drift baumgarte with it")
        return command(**options, how=how)

    signature = inspect.signature(command, eval_str=True)
    own = [each for each in signature.parameters.values() if each.name != "how"]
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in RUN_OPTIONS.items()
    ]
    run.__signature__ = inspect.Signature([*own, *more])  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in (*own, *more)}
    return run


@app.command()
@told
@runs_scenes
def simulate(
    how: dict[str, Any],
    scene: SceneName,
    solver: SolverName = "glambda",
    settings: Sets = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="F.csv", help="positions; events to F.events.csv")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="F.png", help="frames (.png, .svg, .pdf)")
    ] = None,
    animate: Annotated[
        Path | None, typer.Option(metavar="F.gif", help="a film of the motion (.gif, .mp4)")
    ] = None,
    speed: Annotated[float, typer.Option(help="seconds of motion in a second of the film")] = 1.0,
    size: Annotated[int, typer.Option(min=16, help="width of the film [pixels]")] = 640,
) -> None:
    """Simulate a scene, with any backend in the loop.

    Example:  glambda simulate fig4 --set mu_I=0.8 --solver daqp --plot fig4.png
    """
    from glambda.display.runs import print_run
    from harness.machine.kernels import compile_ahead
    from harness.names import is_own
    from harness.progress import shown
    from problems import simulate as run_scene
    from problems.sequence import SimulationError
    from solvers import make_solver
    from solvers.registry import target_of

    table = output_file(trajectory, (".csv",), "--trajectory")
    picture = output_file(plot, (".png", ".svg", ".pdf"), "--plot")
    film = None if animate is None else _film_file(animate)
    if not speed > 0:
        raise ValueError(f"--speed {speed:g}: give seconds of motion, above 0")
    with shown(f"make {scene}", terminal(err=True)):  # a large heap takes half a minute
        made = made_scene(scene, settings)
    end = made.end_time if how["until"] is None else how["until"]
    early: BaseException | None = None
    target_of(solver)  # raises for an unknown one, before anything is compiled
    try:
        with shown("kernels", terminal(err=True)) as tell:
            compile_ahead(("steps", "dense" if is_own(solver) else "posing"), tell)
        with shown(f"simulate {made.label}", terminal(err=True)) as tell:
            run = run_scene(
                made,
                make_solver(solver),
                **how,
                keep_qps=False,
                progress=lambda t: tell(f"t = {t:.3f} s", t, end),
            )
    except (SimulationError, KeyboardInterrupt) as error:
        if getattr(error, "run", None) is None:
            raise
        early, run = error, error.run  # type: ignore
    print_run(terminal(), run)
    written = _write(run, table, picture, film, speed=speed, pixels=size)
    if early is not None:
        files = f" is in {', '.join(map(str, written))}" if written else " is kept by --trajectory"
        raise type(early)("; ".join([*map(str, early.args), f"the motion until then{files}"]))


def _film_file(path: Path) -> Path | None:
    """`output_file` of a film.  Raises ImportError where there is no program that writes it."""
    from reports.motions.film import SUFFIXES, writer_of

    film = output_file(path, SUFFIXES, "--animate")
    writer_of(path)
    return film


def _write(
    run: Run, table: Path | None, picture: Path | None, film: Path | None, **how: Any
) -> list[Path]:
    """What of a run was asked for, and where it is; how : the film is, see `animate_scene`."""
    written = [path for path in (table, picture, film) if path is not None]
    if table is not None:
        events = table.with_suffix(".events.csv")
        run.trajectory.to_csv(table, index=False)
        run.events.to_csv(events, index=False)
        written.insert(1, events)
    if picture is not None:
        from reports.motions.frames import plot_scene

        plot_scene(run, picture)
    if film is not None:
        from reports.motions.frames import animate_scene

        animate_scene(run, film, **how)
    return written


@app.command()
@told
@runs_scenes
def record(
    how: dict[str, Any],
    scene: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE...]",
            help="default: the paper's four; or mujoco:NAME, a model of ours or an .xml of yours",
            autocompletion=complete_scenes,
        ),
    ] = None,
    settings: Sets = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="also where another recording of the scene is")
    ] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("recordings"),
) -> None:
    """Simulate scenes and keep every QP, with a reference answer.

    One HDF5 file each, named by the scene and what differs from its defaults; the same command
    makes the same bytes on one type of processor. A recording of the scene with other QPs (another
    --until or --eps, other code) is not replaced unless told so.

    Of an MJCF model, MuJoCo steps it and its own QPs are kept, with its own forces as answers
    (extra [mujoco]). mujoco:NAME,rigid=true keeps the same without what makes contacts soft.

    Example:  glambda record fig4 --set mu_I=0.8 -o recordings

    Example:  glambda record mujoco:arm mujoco:walker --until 5 -o recordings
    """
    from glambda.cli.engines import PREFIX, recorded_models

    models = [label for label in scene or [] if label.startswith(PREFIX)]
    scenes = [label for label in scene or [] if label not in models]
    if models:
        strange = [name for name in how if name != "until" and how[name] != RUN_OPTIONS[name][1]]
        if strange:
            raise ValueError(f"--{strange[0].replace('_', '-')} is not for {models[0]}; "
                             "an MJCF model says itself how it is stepped")  # fmt: skip
        recorded_models(models, settings, how["until"], output, overwrite)
    if scenes or not models:
        for made, path in recorded(scenes, settings, how, output, overwrite):
            typer.echo(f"{path}: {len(made.qps)} QPs, digest {made.digest[:12]}…")


def recorded(
    labels: list[str] | None,
    settings: list[str] | None,
    options: dict[str, Any],
    folder: Path,
    overwrite: bool = False,
) -> list[tuple[Recording, Path]]:
    from harness.machine.kernels import compile_ahead
    from harness.progress import shown
    from harness.study.kept_recording import first_difference, how_run, kept_recording
    from harness.study.record import record as record_scene
    from harness.study.record import recording_label
    from problems import scene as make_scene
    from problems.scenes.labels import PAPER_SCENES, parse_label, parse_settings

    named = [parse_label(label) for label in labels or PAPER_SCENES]
    extra = parse_settings(settings or [])
    with shown("make scenes", terminal(err=True)):
        made = [make_scene(name, **{**parameters, **extra}) for name, parameters in named]
    paths = [
        folder / f"{recording_label(each, options.get('friction', 'corrected'))}.h5"
        for each in made
    ]
    kept = [None if overwrite else kept_recording(path) for path in paths]
    for each, path, before in zip(made, paths, kept, strict=True):
        how = how_run(each, **options)
        differs = first_difference(before, each, how) if before is not None else None
        if differs is not None:
            raise _taken(path, *differs)
    with shown("kernels", terminal(err=True)) as tell:
        compile_ahead(tell=tell)
    done = []
    for each, path, before in zip(made, paths, kept, strict=True):
        with shown(f"record {each.label}", terminal(err=True)) as tell:
            recording = record_scene(each, **options, progress=tell)
        write_new(path, recording, before)
        done.append((recording, path))
    return done


def write_new(path: Path, made: Recording, before: Recording | None) -> None:
    """Write a recording where none or the same is; before : what is there and to be kept."""
    from harness.recordings.recording import write_recording

    if before is not None and before.digest != made.digest:
        raise _taken(path, "digest", before.digest[:12], made.digest[:12])
    write_recording(path, made)


def _taken(path: Path, name: str, before: object, now: object) -> ValueError:
    return ValueError(
        f"{path}: holds another recording of this scene, with {name} {before}, now {now}; "
        "give --overwrite to replace it, or another folder by -o"
    )
