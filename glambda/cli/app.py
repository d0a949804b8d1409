"""The Typer application, and what its commands share: options, names, errors told in one line."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from glambda.cli.completion import complete_scenes, complete_solvers
from glambda.cli.streams import say

if TYPE_CHECKING:
    from glambda.terminal import Terminal

EPILOG = """A first walk:

glambda simulate fig4 --plot fig4.png

glambda record fig4 -o recordings

glambda replay recordings/fig4.h5 --solvers glambda,daqp -o results

glambda report results -o report

or all of it, four scenes and every backend, at once:  glambda study
"""

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

RESUMED = (
    *("replay", "verify", "growth", "stability", "painleve", "convergence", "criterion"),
    *("cases", "closed_loop", "peers", "study"),
)
"""Commands that continue from their results folder, where they were given one, after Ctrl-C."""
WRITES_EACH = ("record", "stretch", "disturb", "import_")
"""Commands that have written some of their files by then, and begin anew."""

Command = TypeVar("Command", bound=Callable[..., Any])
SceneName = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="a scene, see 'glambda scenes', such as fig4,mu_I=0.8",
        autocompletion=complete_scenes,
    ),
]
SolverName = Annotated[
    str, typer.Option(help="drives the simulation", autocompletion=complete_solvers)
]
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
Impulses = Annotated[
    Literal["paper", "newton_coulomb"], typer.Option(help="what friction does in a collision")
]
Restitution = Annotated[
    Literal["poisson", "newton"],
    typer.Option(help="how a collision bounces where the scene has coefficients of restitution"),
]
FixedStep = Annotated[
    float | None, typer.Option(help="step length [s], without error control; cut only by events")
]
Stops = Annotated[
    Literal["located", "held"],
    typer.Option(help="where slip ends: an event each, or what would stop in a step sticks for it"),
]
DropTol = Annotated[
    float | None,
    typer.Option(help="speed at which a contact that separates is dropped; default: ε"),
]
Drift = Annotated[
    Literal["none", "baumgarte", "projection"],
    typer.Option(help="what closes the gaps of contacts that bear a load"),
]
DriftTime = Annotated[
    float | None, typer.Option(help="τ [s] in which Baumgarte's rule does; default: 0.1")
]
Solvers = Annotated[
    str,
    typer.Option(
        help="names with commas between, such as glambda,lotstedt[deferred],daqp; "
        "all: every backend that is installed; forms: the packages in each form that they take; "
        "all,-enumeration: all but one",
        autocompletion=complete_solvers,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1, help="spread the replay over so many processes (needs Dask); they share this machine"
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="or over a Dask cluster, such as tcp://10.0.0.1:8786"),
]


def told(command: Command) -> Command:
    """Turn errors of input into one line on stderr and exit code 2."""

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> Any:
        try:
            _check_folder(options.get("output", options.get("results")))
            return command(*arguments, **options)
        except ImportError as error:
            _give_up(error, 2, f"{error}; install its package, or choose another solver or scene")
        except OSError as error:
            what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            _give_up(error, 2, f"{what}; name another file or folder")
        except ValueError as error:
            _give_up(error, 2)
        except MemoryError as error:
            _give_up(
                error, 2, f"not enough memory ({error}); take fewer bodies or a shorter motion"
            )
        except RuntimeError as error:  # the simulation, or the processes of a replay, did not go on
            if type(error).__name__ not in ("SimulationError", "IsolationError"):
                raise
            _give_up(error, 1)
        except KeyboardInterrupt as stopped:
            resumed = command.__name__ in RESUMED and options.get("output", ...) is not None
            kept = resumed or command.__name__ in WRITES_EACH
            said = "; what was finished is kept" if kept else ""
            said += ": the same command continues" if resumed else ""
            said += "".join(f"; {word}" for word in stopped.args)
            say(f"\ninterrupted{said}", err=True)
            raise typer.Exit(130) from None

    return run  # type: ignore[return-value]


def _check_folder(path: Path | None) -> None:
    """Refuse an output folder before the work and not after it."""
    if path is None:
        return
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        raise ValueError(f"-o {path}: {there} is no folder to write in; name another one")


def _give_up(error: Exception, code: int, message: str = "") -> None:
    if os.environ.get("GLAMBDA_DEBUG"):
        raise error
    say(f"glambda: {' '.join((message or str(error)).split())}", err=True)
    raise typer.Exit(code) from None


def terminal(err: bool = False) -> Terminal:
    """The console of stdout or stderr."""
    from glambda.terminal import Terminal

    return Terminal(err)


def split_names(text: str, default: list[str]) -> list[str]:
    """Names with commas between; "all" stands for `default`."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise ValueError("an empty list of names was given; leave the option out for all")
    return default if names == ["all"] else list(dict.fromkeys(names))


def refuse_absent(files: Iterable[Path]) -> None:
    """Raise as reading does where one is not there: before anything else is told."""
    from harness.recordings.recording import read_recording

    for path in files:
        if not path.exists():
            read_recording(path)


def chosen_solvers(text: str) -> list[str]:
    """Solvers by name, without those named with a "-" before; "all" and "forms" stand for many."""
    from harness.processes.introduction import about, form_variants

    groups = {"all": _installed_solvers, "forms": form_variants}
    names = split_names(text, ["all"])
    for name in names:
        if name not in groups:
            about(name.removeprefix("-"))  # raises for an unknown one
    chosen: dict[str, None] = {}
    for name in names:
        if name.startswith("-"):
            chosen.pop(name[1:], None)
        else:
            chosen.update(dict.fromkeys(groups[name]() if name in groups else [name]))
    if not chosen:
        raise ValueError(f"--solvers {text}: nothing is left; name one more, such as all")
    return list(chosen)


def _installed_solvers() -> list[str]:
    """Every backend that is there; absent ones are told by name."""
    from harness.processes.introduction import described
    from solvers.registry import solver_names

    known = [described(name) for name in solver_names()]
    for info in known:
        if not info.available:
            say(f"skipped: {info.name} is not installed ({info.reason})", err=True)
    return [info.name for info in known if info.available]


def cluster_of(workers: int | None, cluster: str | None) -> str | int | None:
    """What `harness.study.cluster.replayer` takes, of the two options."""
    if workers is not None and cluster is not None:
        raise ValueError("--workers and --cluster: give one of them")
    return workers if cluster is None else cluster


def output_file(path: Path | None, suffixes: tuple[str, ...], option: str) -> Path | None:
    """An output file, refused before the work and not after it."""
    if path is None:
        return None
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{option} {path}: give a name that ends in {' or '.join(suffixes)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK) or path.is_dir():
        raise ValueError(f"{option} {path}: cannot be written there; name another file")
    return path


def _tell_version(asked: bool) -> None:
    if asked:
        import glambda

        say(f"glambda {glambda.__version__}")
        raise typer.Exit


@app.callback(epilog=EPILOG)
def main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_tell_version, is_eager=True, help="tell it and exit"),
    ] = False,
) -> None:
    """Rigid bodies in contact by Lötstedt's 1984 method, and a fair replay of its QPs.

    A scene is simulated; each time step poses a quadratic program, min ½‖A x + d‖² within bounds.
    A recording keeps these QPs in order. A replay hands the identical QPs to every backend, and
    each answer is judged by A x, so by Gλ and the motion, never by λ, which is not unique where
    contacts are redundant.
    """


def made_scene(label: str, settings: list[str] | None) -> Any:
    """The scene, whatever it is of, that a command is told of: "fig4,mu_I=0.8" and its --set."""
    from problems import scene
    from problems.scenes.labels import parse_label, parse_settings

    name, parameters = parse_label(label)
    return scene(name, **{**parameters, **parse_settings(settings or [])})


def scene_of_bodies(label: str, settings: list[str] | None, remedy: str) -> Any:
    """The same, of bodies in the plane.  Raises ValueError, with a remedy, for anything else."""
    from problems import Scene

    made = made_scene(label, settings)
    if not isinstance(made, Scene):
        kind = "in space" if hasattr(made, "solids") else "a network"
        raise ValueError(f"{label} is {kind}, {remedy}")
    return made
